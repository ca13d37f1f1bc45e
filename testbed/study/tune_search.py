"""The search for gains: generation after generation, whoever flies them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.state import Array
from testbed.study.cma_door import Strategy
from testbed.study.tune_cost import Robust, together
from testbed.study.tune_page import Bounds, Search

DIGITS = 4  # of a gain: more would say what no flight can tell

Gains = tuple[float, ...]
Evaluate = Callable[[Sequence[Gains]], list[tuple[float, ...]]]


@dataclass(frozen=True, slots=True)
class Trial:
    """A set of gains that was flown.

    Args:
        number: in the order they were asked for; 0 is what the scenario had.
        generation: from 1; 0 is what the scenario had.
        gains: in the page's order.
        costs: of its flights, in the plan's order.
        cost: of all together.
    """

    number: int
    generation: int
    gains: Gains
    costs: tuple[float, ...]
    cost: float


class Space:
    """Gains as points of the unit cube."""

    def __init__(self, bounds: Mapping[str, Bounds]) -> None:
        """Between these bounds."""
        self._log = np.array([each.scale == "log" for each in bounds.values()])
        self._low = self._scaled([each.low for each in bounds.values()])
        self._high = self._scaled([each.high for each in bounds.values()])
        self._ends = [(each.low, each.high) for each in bounds.values()]

    def _scaled(self, gains: Sequence[float]) -> Array:
        return np.array(
            [math.log(g) if log else g for g, log in zip(gains, self._log, strict=True)]
        )

    def point(self, gains: Sequence[float]) -> Array:
        """Where gains are (n,); those outside, at the nearest bound."""
        inside = [min(max(g, a), b) for g, (a, b) in zip(gains, self._ends, strict=True)]
        return np.asarray((self._scaled(inside) - self._low) / (self._high - self._low))

    def gains(self, point: Array) -> Gains:
        """The gains at a point, to a few digits, inside the bounds."""
        scaled = self._low + point * (self._high - self._low)
        wanted = np.where(self._log, np.exp(scaled), scaled)
        rounded = (float(f"{each:.{DIGITS}g}") for each in wanted)
        each = zip(rounded, self._ends, strict=True)
        return tuple(min(max(gain, low), high) for gain, (low, high) in each)


def generations(search: Search, population: int, flights_each: int) -> int:
    """How many generations the flights are enough for, after those of the gains as they were."""
    return (search.flights - flights_each) // (population * flights_each)


def seek(
    space: Space, start: Gains, evaluate: Evaluate, *, robust: Robust, search: Search, count: int
) -> Iterator[list[Trial]]:
    """Fly generation after generation, at most `count`, and yield the trials of each.

    What comes out depends on the costs and on `search` alone.
    """
    strategy = Strategy(
        space.point(start), step=search.step, population=search.population, seed=search.seed
    )
    number = 1
    for generation in range(1, count + 1):
        points = strategy.ask()
        gains = [space.gains(point) for point in points]
        costs = evaluate(gains)
        each = [together(own, robust) for own in costs]
        strategy.tell(points, each)
        yield [
            Trial(number + k, generation, gains[k], costs[k], each[k]) for k in range(len(points))
        ]
        number += len(points)
        if strategy.ended:
            return
