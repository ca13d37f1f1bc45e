"""The largest value of a condition at which the flights of all seeds keep their criteria.

The first seed is flown at coarse steps, then by bisection to the largest value at which it keeps
the criteria. Each further seed is flown once at the present value; only one that does not keep them
there is flown at smaller values, and lowers it. Of n seeds about ln n + 0.6 do. That is the least
of the breaking values of all seeds, where a flight that keeps the criteria at a value keeps them at
all smaller ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Keeps: TypeAlias = Callable[[int, float], bool]  # of seed and value

MEDIAN_SEEDS = 9  # of which the median breaking value is found
COARSE = 14  # levels from one value of the first seed to the next
# Another set of seeds has another least value. The least of 59 normal numbers is 2.3 standard
# deviations below the median, and that of another set differs from it by 0.64 of them (1 sigma):
# with a confidence of 95 % by this share of the distance to the median.
SPREAD = 1.96 * 0.64 / 2.3


@dataclass(frozen=True, slots=True)
class Found:
    """What a search has found.

    Attributes:
        lowest: the smallest value.
        value: largest at which all seeds keep the criteria; None: one does not at the smallest.
        above: the next larger value that was possible; None: `value` is the largest.
        breaks: smallest value at which the median flight does not keep them; None: none is.
        weakest: the seed that breaks first; None: no seed breaks.
        seeds: number of different seeds flown.
        flights: number of all flights.
    """

    lowest: float
    value: float | None
    above: float | None
    breaks: float | None
    weakest: int | None
    seeds: int
    flights: int

    @property
    def others(self) -> tuple[float, float] | None:
        """Between which values that of other seeds is; at least a step of the search either way."""
        if self.value is None or self.above is None:
            return None
        width = self.above - self.value
        if self.seeds > 1 and self.breaks is not None:
            width = max(width, SPREAD * (self.breaks - self.value))
        return max(self.lowest, self.value - width), self.value + width


def geometric_levels(lowest: float, low: float, high: float, ratio: float = 1.05) -> list[float]:
    """Return values from low to high, each about `ratio` times the one before, behind the lowest.

    They have four digits, so that a command has them exactly.
    """
    found, value = [lowest], low
    while value < high * (1.0 - 1e-9):
        found.append(float(f"{value:.4g}"))
        value *= ratio
    return [*found, high]


def find_largest(levels: Sequence[float], seeds: Iterable[int], keeps: Keeps) -> Found:
    """Find the largest of some values at which all seeds keep the criteria.

    Args:
        levels: of the condition, growing: the smallest first, which is that of the scenario.
        seeds: at least one; read one by one, so that a first flight may show that there is one.
        keeps: whether the flight of a seed at a value keeps the criteria. It is called once for
            each.
    """
    flights = _SeedFlights(levels, keeps)
    remaining = iter(seeds)
    first = next(remaining)
    best, weakest, flown = flights.scan_up(first), first, [first]
    for seed in remaining:
        if best < 0:
            remaining = itertools.chain([seed], remaining)
            break
        flown.append(seed)
        if not flights.keeps(seed, best):
            best, weakest = flights.search_down(seed, best), seed
    jury = [*flown, *itertools.islice(remaining, max(0, MEDIAN_SEEDS - len(flown)))][:MEDIAN_SEEDS]
    breaks = flights.median_break(jury, best)
    last = len(levels) - 1
    return Found(
        lowest=levels[0],
        value=levels[best] if best >= 0 else None,
        above=levels[best + 1] if best < last else None,
        breaks=None if breaks is None else levels[breaks],
        weakest=weakest if best < last else None,
        seeds=len({seed for seed, _ in flights.known}),
        flights=len(flights.known),
    )


class _SeedFlights:
    """Flights by seed and index of the level, each flown once."""

    def __init__(self, levels: Sequence[float], keeps: Keeps) -> None:
        self._levels, self._keeps = levels, keeps
        self.known: dict[tuple[int, int], bool] = {}

    def keeps(self, seed: int, index: int) -> bool:
        if (seed, index) not in self.known:
            self.known[seed, index] = self._keeps(seed, self._levels[index])
        return self.known[seed, index]

    def scan_up(self, seed: int) -> int:
        """Return the largest index at which a seed keeps the criteria; -1: none."""
        last = len(self._levels) - 1
        kept = -1
        for index in [*range(1, last, COARSE), last]:
            if not self.keeps(seed, index):
                return self._bisect(lambda middle: self.keeps(seed, middle), kept, index)
            kept = index
        return last

    def search_down(self, seed: int, failed: int) -> int:
        """Return the same below an index at which the seed does not keep them."""
        step = 1
        while failed > 0:
            index = max(failed - step, 0)
            if self.keeps(seed, index):
                return self._bisect(lambda middle: self.keeps(seed, middle), index, failed)
            failed, step = index, 2 * step
        return -1

    def median_break(self, seeds: Sequence[int], kept: int) -> int | None:
        """Return the smallest index at which more than half of some seeds break; None: none is.

        Args:
            seeds: an odd number is best.
            kept: index at which all keep the criteria; -1: at none.
        """
        last, step = len(self._levels) - 1, COARSE // 2
        if kept < 0 and self._most_break(seeds, 0):
            return 0
        kept = max(kept, 0)
        while kept < last:
            index = min(kept + step, last)
            if self._most_break(seeds, index):
                return 1 + self._bisect(lambda at: not self._most_break(seeds, at), kept, index)
            kept = index
        return None

    def _most_break(self, seeds: Sequence[int], index: int) -> bool:
        """Return whether more than half of some seeds break; no more are flown than that takes."""
        enough = len(seeds) // 2 + 1
        known = {seed: self._inferred(seed, index) for seed in seeds}
        for seed in seeds:
            found = list(known.values())
            if found.count(False) >= enough:
                return True
            if found.count(True) > len(seeds) - enough:
                return False
            if known[seed] is None:
                known[seed] = self.keeps(seed, index)
        return list(known.values()).count(False) >= enough

    def _inferred(self, seed: int, index: int) -> bool | None:
        """Return what the flights of a seed at other values say about one; None: nothing."""
        own = [(at, kept) for (one, at), kept in self.known.items() if one == seed]
        if any(kept and at >= index for at, kept in own):
            return True
        return False if any(not kept and at <= index for at, kept in own) else None

    def _bisect(self, good: Callable[[int], bool], low: int, high: int) -> int:
        """Return the largest good index from `low`, which is good or -1, below a bad one."""
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if good(middle) else (low, middle)
        return low
