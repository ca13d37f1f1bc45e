"""The search over seeds, on breaking values that are known."""

import random

import pytest

from testbed.assessment import search
from testbed.assessment.search import find_largest, geometric_levels

LEVELS = geometric_levels(0.0, 0.5, 40.0)


class Formation:
    """Flights whose seeds break above a value of their own."""

    def __init__(self, breaking):
        self.breaking, self.flown = breaking, []

    def keeps(self, seed, value):
        self.flown.append((seed, value))
        return value <= self.breaking[seed]

    def search(self):
        return find_largest(LEVELS, self.breaking, self.keeps)


def drawn(number, mean=10.0, sigma=1.0, seeds=59):
    source = random.Random(number)
    return {seed: source.gauss(mean, sigma) for seed in range(1, seeds + 1)}


def largest_below(value):
    return max((level for level in LEVELS if level <= value), default=None)


@pytest.mark.parametrize("number", range(20))
def test_value_is_the_least_of_all_seeds(number):
    formation = Formation(drawn(number))
    found = formation.search()
    weakest = min(formation.breaking, key=formation.breaking.get)
    assert found.value == largest_below(formation.breaking[weakest])
    assert largest_below(formation.breaking[found.weakest]) == found.value
    assert found.above == LEVELS[LEVELS.index(found.value) + 1]
    assert found.seeds == 59
    assert found.flights == len(formation.flown) == len(set(formation.flown)) < 125


@pytest.mark.parametrize("number", range(20))
def test_median_breaks_within_a_level(number):
    formation = Formation(drawn(number))
    found = formation.search()
    nine = sorted(list(formation.breaking.values())[: search.MEDIAN_SEEDS])
    assert found.breaks == min(level for level in LEVELS if level > nine[len(nine) // 2])


def test_a_search_that_lowers_nothing_is_found(monkeypatch):
    monkeypatch.setattr(search._SeedFlights, "search_down", lambda self, seed, failed: failed)
    formation = Formation(drawn(1))
    assert formation.search().value != largest_below(min(formation.breaking.values()))


def test_a_seed_that_breaks_at_once_gives_no_value():
    breaking = drawn(3)
    breaking[20] = -1.0
    found = Formation(breaking).search()
    assert (found.value, found.above, found.weakest) == (None, 0.0, 20)
    assert 9.0 < found.breaks < 11.0
    found = Formation(dict.fromkeys(breaking, -1.0)).search()
    assert (found.value, found.breaks) == (None, 0.0)


def test_nothing_breaks():
    found = Formation(dict.fromkeys(range(1, 60), 99.0)).search()
    assert (found.value, found.above, found.breaks) == (40.0, None, None)
    assert found.weakest is None


def test_one_seed_has_a_step_either_way():
    found = Formation({1: 7.0}).search()
    assert found.value == largest_below(7.0)
    assert found.breaks == found.above
    assert found.others == pytest.approx((2.0 * found.value - found.above, found.above))


def test_interval_covers_other_seeds():
    """In 19 of 20 pairs of sets of 59 seeds, of breaking values that scatter little or much."""
    for sigma in (0.5, 1.0, 2.5):
        found = [Formation(drawn(number, sigma=sigma)).search() for number in range(300)]
        pairs = zip(found[::2], found[1::2], strict=True)
        covered = [a.others[0] <= b.value <= a.others[1] for a, b in pairs]
        assert sum(covered) >= 0.92 * len(covered), sigma
        width = [(each.others[1] - each.others[0]) / 2 for each in found]
        assert sum(width) / len(found) < 2.0 * sigma


def test_levels_are_written_exactly():
    assert [float(f"{level:.4g}") for level in LEVELS] == LEVELS == sorted(set(LEVELS))
    steps = [after / before for before, after in zip(LEVELS[1:], LEVELS[2:], strict=False)]
    assert max(steps) < 1.052
