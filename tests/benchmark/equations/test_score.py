"""Paired differences, Holm's correction and ranks: second routes, and false claims."""

import itertools
import math
import os

import numpy as np
import pytest

from testbed.benchmark.score import (
    ALL,
    agreement,
    compare,
    holm,
    standings,
    student_p,
    with_all,
)

PAGES = int(os.environ.get("TESTBED_BENCHMARK_PAGES", "150"))


def adjusted(values):
    """Holm's adjusted p-values by their definition: another route than the procedure."""
    order = np.argsort(values)
    count = len(values)
    steps = [(count - k) * values[order[k]] for k in range(count)]
    found = np.empty(count)
    for k in range(count):
        found[order[k]] = min(1.0, max(steps[: k + 1]))
    return found


def test_holm_is_that_of_the_adjusted_values():
    random = np.random.default_rng(1)
    for count in (1, 2, 5, 40):
        for _ in range(50):
            values = random.uniform(size=count) ** random.integers(1, 9)
            assert holm(values.tolist()) == (adjusted(values) <= 0.05).tolist()


def test_holm_is_between_bonferroni_and_none():
    """The second smallest of three is compared with alpha / 2, not alpha / 3 or alpha."""
    assert holm([0.01, 0.02, 0.9]) == [True, True, False]
    assert [p <= 0.05 / 3 for p in (0.01, 0.02, 0.9)] == [True, False, False]
    assert holm([0.01, 0.04, 0.04]) == [True, False, False]
    assert holm([0.02, 0.02, 0.02]) == [False, False, False]
    assert holm([]) == []


def tail(t, freedom):
    """P(|T| > t) by the midpoint rule on Student's density, without scipy."""
    scale = math.gamma((freedom + 1) / 2) / math.sqrt(freedom * math.pi) / math.gamma(freedom / 2)
    steps = 200_000
    # u from 0 to 1 stands for t / (1 - u) - t, so that the whole tail is in the sum
    u = (np.arange(steps) + 0.5) / steps
    x = t + u / (1.0 - u)
    density = scale * (1.0 + x**2 / freedom) ** (-(freedom + 1) / 2) / (1.0 - u) ** 2
    return 2.0 * density.sum() / steps


def test_student_p_is_the_integral_of_the_density():
    random = np.random.default_rng(2)
    for count in (3, 8, 12):
        values = random.normal(0.4, 1.0, count)
        t = abs(values.mean()) / (values.std(ddof=1) / math.sqrt(count))
        assert student_p(values) == pytest.approx(tail(t, count - 1), rel=1e-4)
    assert student_p(np.zeros(12)) == 1.0
    assert student_p(np.full(12, 0.25)) == 0.0
    assert student_p(np.array([0.3])) == 1.0


def page(random, shifts, seeds=12):
    """Numbers of laws on three tasks: seeds are shared, and a flight is sometimes lost."""
    names = [f"law-{k}" for k in range(len(shifts))]
    shared = random.normal(0.0, 0.5, (3, seeds))
    found = {}
    for name, shift in zip(names, shifts, strict=True):
        own = 3.0 + shift + shared + random.normal(0.0, 0.3, (3, seeds))
        own[random.uniform(size=own.shape) < 0.05] = 50.0
        found[name] = with_all(dict(zip("abc", own, strict=True)))
    return found


def test_equal_laws_are_seldom_claimed_to_differ():
    """On at most 5 % of the pages of six equal laws, with losses; without Holm on most."""
    random = np.random.default_rng(3)
    claimed = plain = 0
    for _ in range(PAGES):
        found = compare(page(random, [0.0] * 6))
        claimed += any(each.claimed for each in found)
        plain += any(each.p < 0.05 for each in found)
    assert claimed <= 0.05 * PAGES + 2.0 * math.sqrt(0.05 * 0.95 * PAGES)
    assert plain > 0.3 * PAGES


def test_a_better_law_is_claimed_in_every_table():
    numbers = page(np.random.default_rng(4), [0.0, 0.0])
    rows = {k: v - 2.0 for k, v in numbers["law-0"].items()}
    found = compare({"good": rows, "bad": numbers["law-0"]})
    assert {(each.better, each.worse, each.claimed) for each in found} == {("good", "bad", True)}
    assert {each.table for each in found} == {ALL, "a", "b", "c"}


def test_ranks_say_where_nothing_is_claimed():
    random = np.random.default_rng(5)
    base = random.normal(3.0, 0.5, 12)
    numbers = {
        "worst": {"a": base + 4.0 + random.normal(0.0, 0.1, 12)},
        "one": {"a": base + random.normal(0.0, 0.1, 12)},
        "two": {"a": base + random.normal(0.0, 0.1, 12)},
    }
    rows = {each.entry: each for each in standings(numbers, compare(numbers))["a"]}
    assert (rows["worst"].rank, rows["worst"].last_rank, rows["worst"].equal) == (3, 3, ())
    assert {(rows[k].rank, rows[k].last_rank) for k in ("one", "two")} == {(1, 2)}
    assert rows["one"].equal == ("two",)


def test_the_order_of_entry_changes_no_rank():
    numbers = page(np.random.default_rng(6), [0.0, 0.1, 1.0, 3.0])
    first = standings(numbers, compare(numbers))
    for order in itertools.permutations(numbers):
        again = {name: numbers[name] for name in order}
        assert standings(again, compare(again)) == first


def test_a_difference_below_the_rounding_is_none():
    base = np.random.default_rng(7).normal(3.0, 0.5, 12)
    found = compare({"one": {"a": base}, "two": {"a": base + 0.004}})
    assert found[0].p < 1e-9
    assert not found[0].claimed
    assert compare({"one": {"a": base}, "two": {"a": base + 0.006}})[0].claimed


def test_a_second_set_of_seeds_is_counted():
    random = np.random.default_rng(8)
    first = compare(page(random, [0.0, 5.0, 5.0]))
    same = agreement(first, compare(page(random, [0.0, 5.0, 5.0])))
    other = agreement(first, compare(page(random, [5.0, 0.0, 0.0])))
    assert same.reversed == 0
    assert same.again > 0
    assert other.reversed > 0


def test_all_tasks_are_a_geometric_mean_by_seed():
    found = with_all({"a": np.array([1.0, 2.0]), "b": np.array([4.0, 8.0])})
    assert found[ALL] == pytest.approx([2.0, 4.0])
