"""Search for gains by CMA-ES, generation after generation; the only importer of pycma.

Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.errors import needs_extra
from testbed.core.random import named_stream
from testbed.core.records import Array
from testbed.studies.tune_objective import aggregate_costs
from testbed.studies.tune_schema import Aggregate, GainBounds, Search

DIGITS = 4  # of a gain
CONVERGED = 1e-3  # step in every direction, as a share of the bounds, at which a search ends

Gains = tuple[float, ...]
Evaluate = Callable[[Sequence[Gains]], list[tuple[float, ...]]]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A set of gains with its costs.

    Args:
        number: from 1 in order of evaluation; 0 has the gains of the scenario.
        generation: from 1; 0 for the gains of the scenario.
        gains: in the order of the file.
        costs: of its flights, in the order of the plan.
        cost: of all flights combined.
    """

    number: int
    generation: int
    gains: Gains
    costs: tuple[float, ...]
    cost: float


class GainSpace:
    """Maps gains between their bounds to the unit cube."""

    def __init__(self, bounds: Mapping[str, GainBounds]) -> None:
        """Set the bounds of n gains."""
        self._log = np.array([each.scale == "log" for each in bounds.values()])
        self._low = self._scale([each.low for each in bounds.values()])
        self._high = self._scale([each.high for each in bounds.values()])
        self._bounds = [(each.low, each.high) for each in bounds.values()]

    def _scale(self, gains: Sequence[float]) -> Array:
        return np.array(
            [math.log(gain) if log else gain for gain, log in zip(gains, self._log, strict=True)]
        )

    def point(self, gains: Sequence[float]) -> Array:
        """Return the point (n,) of gains, which are clamped to the bounds."""
        clamped = [min(max(g, a), b) for g, (a, b) in zip(gains, self._bounds, strict=True)]
        return np.asarray((self._scale(clamped) - self._low) / (self._high - self._low))

    def gains(self, point: Array) -> Gains:
        """Return the gains at a point (n,), rounded to `DIGITS` digits, inside the bounds."""
        scaled = self._low + point * (self._high - self._low)
        exact = np.where(self._log, np.exp(scaled), scaled)
        rounded = (float(f"{each:.{DIGITS}g}") for each in exact)
        each = zip(rounded, self._bounds, strict=True)
        return tuple(min(max(gain, low), high) for gain, (low, high) in each)


def default_population(n: int) -> int:
    """Return the candidates of a generation for n gains, 4 + ⌊3 ln n⌋, as in the tutorial."""
    return 4 + int(3.0 * math.log(n))


def generation_count(search: Search, population: int, flights_each: int) -> int:
    """Return how many generations `max_flights` allows besides the gains of the scenario."""
    return (search.max_flights - flights_each) // (population * flights_each)


class CmaEs:
    """CMA-ES minimising a cost in [0, 1]^n; depends on the costs and its seed only."""

    def __init__(
        self, start: Array, *, initial_step: float, population: int | None, seed: int
    ) -> None:
        """Start at a point.

        Args:
            start: (n,), n at least 2.
            initial_step: first standard deviation in every direction.
            population: candidates of a generation; None for the default.
            seed: of the stream "tune/search".
        """
        with needs_extra("study", "tune"):
            import cma

        random = named_stream(seed, "tune/search")

        def normal(*shape: int) -> Array:
            return random.standard_normal(shape)

        options = {
            "popsize": population or default_population(start.size),
            "bounds": [0.0, 1.0],
            "seed": math.nan,  # do not seed numpy's global generator
            "randn": normal,
            "verbose": -9,
            "verb_log": 0,
            "tolx": CONVERGED,
        }
        self._strategy = cma.CMAEvolutionStrategy(start.tolist(), initial_step, options)

    @property
    def population(self) -> int:
        """Candidates of a generation."""
        return int(self._strategy.popsize)

    @property
    def stopped(self) -> bool:
        """Whether the search has converged or cannot continue."""
        return bool(self._strategy.stop())

    def ask(self) -> list[Array]:
        """Return the points (n,) of the next generation."""
        return [np.clip(np.asarray(each), 0.0, 1.0) for each in self._strategy.ask()]

    def tell(self, points: Sequence[Array], costs: Sequence[float]) -> None:
        """Report the costs of these points."""
        self._strategy.tell(list(points), list(costs))


def search(
    space: GainSpace,
    start: Gains,
    evaluate: Evaluate,
    *,
    aggregate: Aggregate,
    settings: Search,
    generations: int,
) -> Iterator[list[Candidate]]:
    """Evaluate generation after generation, and yield the candidates of each.

    The result depends on the costs and on `settings` only.

    Args:
        space: of the gains.
        start: gains around which the first generation is.
        evaluate: returns for each set of gains the costs of its flights.
        aggregate: combines these costs.
        settings: of the search.
        generations: at most.
    """
    strategy = CmaEs(
        space.point(start),
        initial_step=settings.initial_step,
        population=settings.population,
        seed=settings.seed,
    )
    number = 1
    for generation in range(1, generations + 1):
        points = strategy.ask()
        gains = [space.gains(point) for point in points]
        costs = evaluate(gains)
        combined = [aggregate_costs(each, aggregate) for each in costs]
        strategy.tell(points, combined)
        yield [
            Candidate(number + k, generation, gains[k], costs[k], combined[k])
            for k in range(len(points))
        ]
        number += len(points)
        if strategy.stopped:
            return
