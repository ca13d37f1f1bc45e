"""Which numbers got worse beyond noise: pairs by seed, one flight, losses."""

import math

import numpy as np
import pytest
from scipy import stats

from testbed.metrics.side_effects import (
    NOT_COMPLETED,
    QUANTITIES,
    better_sign,
    change_of,
    describe_change,
    is_worse,
    seeds_change_nothing,
    side_effects,
    to_columns,
    to_document,
)

BY_KEY = {each.key: each for each in QUANTITIES}


def flight(separation=6.0, saturated=(3.0, 4.0), left=(0, 0), ringing=(0.0, None), **more):
    """The numbers of a flight of two followers."""
    numbers = {"windows.laps.min_separation_m": separation, "simulated_s": 100.0}
    numbers |= {"min_separation_outside_windows_m": 9.0, NOT_COMPLETED: 0.0}
    for k, name in enumerate(("uav1", "uav2")):
        numbers |= {f"saturations.{name}.seconds": saturated[k], f"lost_at_s.{name}": None}
        numbers |= {f"left_speed_set.{name}.times": float(left[k])}
        numbers |= {f"ringing.{name}.seconds": ringing[k]}
    return numbers | more


def told(before, after, seeds=None, points=None):
    """Compare flights; by default of one point and as many seeds."""
    seeds = np.arange(len(before)) if seeds is None else np.array(seeds)
    points = np.zeros_like(seeds) if points is None else np.array(points)
    return side_effects(to_columns(before), to_columns(after), seeds, points)


def keys(found):
    return [each.quantity.key for each in found.worse]


def test_change_has_students_interval_of_pairs():
    random = np.random.default_rng(2)
    difference = random.normal(0.3, 0.2, 9)
    found = change_of(1.0, 1.3, difference, one_flight=False)
    theirs = stats.ttest_1samp(difference, 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), rel=1e-12)
    assert (found.units, found.sign(1.0)) == (9, 1)  # the interval decides, not the rounding
    assert change_of(1.0, 1.3, -difference, one_flight=False).sign(0.0) == -1
    assert change_of(1.0, 1.3, difference - 0.3, one_flight=False).sign(0.0) == 0


def test_one_flight_changes_by_more_than_its_rounding():
    same = change_of(5.0, 5.02, np.full(8, 0.02), one_flight=True)
    assert (same.units, same.one_flight, math.isnan(same.low)) == (1, True, True)
    assert (same.sign(0.01), same.sign(0.02)) == (1, 0)
    assert change_of(5.0, 4.98, np.array([-0.02]), one_flight=True).sign(0.01) == -1
    two = change_of(5.0, 6.0, np.array([1.0, 1.1]), one_flight=False)
    assert two.too_few and two.sign(0.01) == 0


def test_worse_is_told_with_its_numbers():
    before = [flight(6.0 + 0.01 * k, (3.0, 4.0 + 0.1 * k)) for k in range(7)]
    after = [flight(4.0 + 0.02 * k, (9.0, 4.0 + 0.2 * k)) for k in range(7)]
    found = told(before, after)
    assert keys(found) == ["separation_in_windows_m", "saturated_s"]
    nearest, saturated = found.worse
    assert nearest.cells[:2] == ("6.03", "4.06") and nearest.cells[2].startswith("-1.97 [-")
    assert saturated.change.mean == pytest.approx(6.3)
    assert found.basis == "paired over 7 seeds, 95 % interval"
    assert [each["key"] for each in to_document(found)] == keys(found)
    assert not told(after, before)  # all of it is better


def test_noise_is_not_told():
    random = np.random.default_rng(4)
    before, after = (
        [flight(6.0 + random.normal(), (3.0 + random.normal(), 4.0)) for _ in range(8)]
        for _ in range(2)
    )
    assert not told(before, after)
    # smaller than the printed rounding, however certain
    tiny = [flight(row["windows.laps.min_separation_m"] - 0.004) for row in before]
    assert not told([flight(row["windows.laps.min_separation_m"]) for row in before], tiny)


def test_seeds_without_effect_are_one_flight():
    before, after = [flight(6.0)] * 5, [flight(5.9, left=(0, 2))] * 5
    found = told(before, after)
    assert keys(found) == ["separation_in_windows_m", "left_speed_set"]
    assert found.basis == "of one flight each: no seed changes them"
    assert found.worse[0].interval == "-0.10"
    one = told(before[:1], after[:1])
    assert (keys(one), one.basis) == (keys(found), "of one flight each")
    other = [*after[:4], flight(5.9, (3.0, 4.1), left=(0, 2))]  # one number of one seed
    assert told(before, other).basis == "paired over 5 seeds, 95 % interval"


def test_seeds_are_looked_at_point_by_point():
    numbers = to_columns([flight(6.0), flight(5.0), flight(6.0), flight(5.0)])
    assert seeds_change_nothing(numbers, np.array([0, 1, 0, 1]))
    assert not seeds_change_nothing(numbers, np.array([0, 0, 1, 1]))


def test_two_seeds_are_said_to_be_too_few():
    found = told([flight(6.0), flight(6.1)], [flight(4.0), flight(4.1)])
    assert found and found.too_few and not found.worse
    assert found.basis == "2 seeds are too few for an interval (fly 3 or more)"


def test_a_seed_counts_once_whatever_its_points():
    before = [flight(6.0 + seed) for seed in range(4) for _ in range(3)]
    after = [flight(5.5 + seed - 0.1 * point) for seed in range(4) for point in range(3)]
    found = told(before, after, np.repeat(np.arange(4), 3), np.tile(np.arange(3), 4))
    assert found.worse[0].change.units == 4
    assert found.worse[0].change.mean == pytest.approx(-0.6)


def test_first_losses_are_told_further_by_interval():
    lost = flight(1.0, **{"lost_at_s.uav1": 3.0, NOT_COMPLETED: 1.0})
    good = [flight(6.0 + 0.1 * k) for k in range(8)]
    found = told(good, [lost, *good[1:]])
    assert keys(found) == ["lost", NOT_COMPLETED]  # its other numbers end with it
    assert found.worse[0].cells[:2] == ("0.00", "0.12")
    assert not told([lost, *good[1:]], [lost, lost, *good[2:]])
    assert keys(told([lost, *good[1:]], [lost] * 8)) == ["lost", NOT_COMPLETED]
    assert not told([lost, *good[1:]], good)


def test_other_durations_and_windows_are_not_compared():
    short = {"simulated_s": 50.0}
    assert not told([flight(6.0, (1.0, 1.0), **short)], [flight(5.0)])
    spans = [{"windows.laps.window_s.0": at} for at in (10.0, 20.0)]
    assert not told([flight(6.0, **spans[0])], [flight(5.0, **spans[1])])
    assert told([flight(6.0, **spans[0])], [flight(5.0, **spans[0])])


def test_earlier_studies_have_one_separation():
    found = told([{"min_separation_m": 6.0}], [{"min_separation_m": 5.0}])
    assert keys(found) == ["separation_m"]


def test_margins_are_numbers_where_larger_is_better():
    before = {"margins.damping": 0.3, "margins.roll_latency_s": 0.4, "margins.roll_factor": 3.0}
    worse = before | {"margins.roll_latency_s": 0.2, "margins.roll_factor": 3.2}
    (found,) = told([before], [worse]).worse
    assert (found.quantity.label, found.cells) == (
        "roll latency margin, s",
        ("0.40", "0.20", "-0.20"),
    )


@pytest.mark.parametrize(
    ("metric", "better"),
    [
        ("windows.laps.mean_rms_m", -1),
        ("max_error_m.uav1", -1),
        ("saturations.uav1.seconds", -1),
        ("ringing.uav1.seconds", -1),
        ("min_separation_m", 1),
        ("margins.roll_latency_s", 1),
        ("margins.damping", 1),
        ("margins.frequency_hz", 0),
        ("wind.uav1.mean_mps", 0),
        ("ringing.uav1.period_s", 0),
    ],
)
def test_better_is_known_by_name(metric, better):
    assert better_sign(metric) == better


def test_verdicts_are_words_of_the_metric():
    larger = change_of(1.0, 2.0, np.array([1.0, 1.1, 0.9]), one_flight=False)
    words = [describe_change(name, larger, 0.01) for name in ("max_error_m", "min_separation_m")]
    assert words == ["worse", "better"]
    assert describe_change("wind.uav1.mean_mps", larger, 0.01) == "larger"
    one = change_of(1.0, 2.0, np.array([1.0]), one_flight=True)
    assert describe_change("max_error_m", one, 0.01) == "worse, of one flight"
    assert describe_change("max_error_m", one, 1.0) == "no change"
    none = change_of(1.0, 2.0, np.array([1.0, -1.0, 0.1]), one_flight=False)
    assert describe_change("max_error_m", none, 0.01) == "not significant"
    assert not is_worse(BY_KEY["lost"], change_of(0.0, 0.0, np.zeros(3), one_flight=False))
