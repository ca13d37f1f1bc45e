"""Costs of flights and candidates, and the search for gains by CMA-ES; the only importer of pycma.

A metric counts as its value up to a limit B, and above as B (2 - B / value), which has the same
slope at B and stays below 2 B. A flight that loses an aircraft, or exceeds a limit, costs 2 B to
3 B, less the later it did; a flight without a number costs 3 B. So every failure costs more than
every completed flight, a later failure less than an earlier one, and costs are bounded. A candidate
that misses a constraint costs more than that bound, in proportion to its shortfall.

Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.errors import needs_extra
from testbed.core.random import named_stream
from testbed.core.records import Array
from testbed.metrics.document import EXCEEDED, errors
from testbed.metrics.side_effects import NO_CHANGE, PairedChange, change_of
from testbed.pool.flight_task import COMPLETED, LOST
from testbed.tuning.tune_constraints import ConstraintResult
from testbed.tuning.tune_schema import Aggregate, GainBounds, MeanPlusSd, Quantile, Search

Metrics = Mapping[str, Any]
PRINTED_DIGITS = 4  # of a metric
SATURATION_FACTOR = 10.0  # B over the worst flight with the gains of the scenario, by default


def metric_at(metrics: Metrics, path: str) -> float | None:
    """Return the number at a dotted path of a metrics document, or None."""
    node: Any = metrics
    for part in path.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return None
        node = node[part]
    is_number = isinstance(node, int | float) and not isinstance(node, bool)
    return float(node) if is_number and math.isfinite(node) else None


def completed_metric(metrics: Metrics | None, metric: str) -> float | None:
    """Return the metric of a completed flight; None for any other."""
    if metrics is None or metrics["outcome"] != COMPLETED:
        return None
    return metric_at(metrics, metric)


def flight_cost(
    metrics: Metrics | None, metric: str, *, duration_s: float, saturation: float
) -> float:
    """Return the cost of a flight, from 0 to 3 B.

    Args:
        metrics: the document of metrics.json; None for a flight that failed.
        metric: path in metrics.json, of a number of 0 or more to be minimised.
        duration_s: planned duration of the flight.
        saturation: B, above 0, in the metric's unit.
    """
    value = completed_metric(metrics, metric)
    if value is not None:
        return value if value <= saturation else saturation * (2.0 - saturation / value)
    if metrics is None or metrics["outcome"] not in (LOST, *EXCEEDED):
        return 3.0 * saturation
    times_s = [time_s for time_s in metrics["lost_at_s"].values() if time_s is not None]
    if metrics["outcome"] in EXCEEDED:
        times_s += [time_s for time_s, _ in errors(metrics)]
    share = min(times_s) / duration_s if times_s else 0.0
    return saturation * (3.0 - min(max(share, 0.0), 1.0))


def aggregate_costs(costs: Sequence[float], aggregate: Aggregate) -> float:
    """Combine the costs of all flights of a candidate."""
    values = np.array(costs)
    if aggregate == "worst":
        return float(values.max())
    if isinstance(aggregate, Quantile):
        return float(np.quantile(values, aggregate.quantile))
    deviation = float(values.std(ddof=1)) if values.size > 1 else 0.0
    weight = aggregate.mean_plus_sd if isinstance(aggregate, MeanPlusSd) else 0.0
    return float(values.mean()) + weight * deviation


def describe_aggregate(aggregate: Aggregate) -> str:
    """Return an aggregate as text: "the worst", "the 90 % quantile"."""
    if isinstance(aggregate, Quantile):
        return f"the {100.0 * aggregate.quantile:g} % quantile"
    if isinstance(aggregate, MeanPlusSd):
        return f"the mean plus {aggregate.mean_plus_sd:g} standard deviations"
    return f"the {aggregate}"


@dataclass(frozen=True, slots=True)
class HeldOutComparison:
    """Paired comparison of the gains before and after, on seeds the search did not use.

    Args:
        pairs: flights completed with both gains.
        change: of the metric, averaged over these seeds.
        failed_before: flights that were not completed before.
        failed_after: and after.
    """

    pairs: int
    change: PairedChange
    failed_before: int
    failed_after: int

    @property
    def sign(self) -> int:
        """1 if the metric is larger beyond noise, -1 if it is smaller; 0: neither."""
        largest = max(self.change.before, self.change.after)
        digits = math.floor(math.log10(largest)) if largest > 0.0 else 0
        return self.change.sign(10.0 ** (digits - PRINTED_DIGITS + 1))

    @property
    def better(self) -> bool:
        """Return whether the metric is smaller beyond noise and no more flights failed."""
        return self.sign < 0 and self.failed_after <= self.failed_before

    @property
    def verdict(self) -> str:
        """The result as a sentence."""
        change = self.change
        if not self.pairs:
            return "not shown to be better: no flight was completed with both gains"
        if change.too_few:
            return f"not shown to be better: {change.units} seeds are too few"
        share = f"{abs(100.0 * change.mean / change.before):.0f} %" if change.before > 0.0 else "–"
        on = "in one flight" if change.one_flight else "on held-out seeds"
        same = ": no seed changes it, so nothing is held out" if change.one_flight else ""
        if self.better:
            return f"better {on}, by {share}{same}"
        if self.sign > 0:
            return f"worse {on}, by {share}{same}"
        if self.failed_after > self.failed_before:
            return (
                f"not shown to be better: {self.failed_after} failed, {self.failed_before} before"
            )
        reason = f"{on}{same}" if change.one_flight else f"{on}: the interval contains 0"
        return f"not shown to be better {reason}"


MetricsBySeed = Mapping[int, Sequence[float | None]]


def compare_held_out(
    before: MetricsBySeed, after: MetricsBySeed, *, one_flight: bool = False
) -> HeldOutComparison:
    """Compare gains flight by flight; a seed counts once, with the mean over its pairs.

    Args:
        before: by seed, the metric of each flight; None for one that was not completed.
        after: the same seeds and flights with other gains.
        one_flight: whether all seeds have the same flights.
    """
    means: list[tuple[float, float]] = []
    pairs = 0
    for seed, values in before.items():
        both = [
            (old, new)
            for old, new in zip(values, after[seed], strict=True)
            if old is not None and new is not None
        ]
        pairs += len(both)
        if both:
            means.append(
                (statistics.fmean(old for old, _ in both), statistics.fmean(new for _, new in both))
            )
    failed = [
        sum(each is None for values in found.values() for each in values)
        for found in (before, after)
    ]
    if not means:
        return HeldOutComparison(0, NO_CHANGE, failed[0], failed[1])
    change = change_of(
        statistics.fmean(old for old, _ in means),
        statistics.fmean(new for _, new in means),
        np.array([new - old for old, new in means]),
        one_flight=one_flight,
    )
    return HeldOutComparison(pairs, change, failed[0], failed[1])


DIGITS = 4  # of a gain
CONVERGED = 1e-3  # step in every direction, as a share of the bounds, at which a search ends

Gains = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What a set of gains costs.

    Args:
        costs: of its flights, in the order of the plan.
        objective: of all flights combined.
        cost: the same, and more where a constraint is missed: what the search minimises.
        constraints: what it has of each.
    """

    costs: tuple[float, ...]
    objective: float
    cost: float
    constraints: tuple[ConstraintResult, ...] = ()

    @property
    def shortfall(self) -> float:
        """By how much constraints are missed, as a share of what they require; 0: not at all."""
        return sum(each.shortfall for each in self.constraints)


def make_evaluation(
    costs: tuple[float, ...],
    aggregate: Aggregate,
    constraints: tuple[ConstraintResult, ...] = (),
    saturation: float = 0.0,
) -> Evaluation:
    """Combine the costs of flights, and the shortfall from constraints in units of B."""
    objective = aggregate_costs(costs, aggregate)
    shortfall = sum(each.shortfall for each in constraints)
    if not shortfall:
        return Evaluation(costs, objective, objective, constraints)
    weight = aggregate.mean_plus_sd if isinstance(aggregate, MeanPlusSd) else 0.0
    highest = 3.0 * saturation * (1.0 + weight)  # of any aggregate
    return Evaluation(costs, objective, highest + saturation * shortfall, constraints)


Evaluate = Callable[[Sequence[Gains]], list[Evaluation]]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A set of gains with its costs.

    Args:
        number: from 1 in order of evaluation; 0 has the gains of the scenario.
        generation: from 1; 0 for the gains of the scenario.
        gains: in the order of the file.
        evaluation: what they cost.
    """

    number: int
    generation: int
    gains: Gains
    evaluation: Evaluation

    @property
    def cost(self) -> float:
        """What the search minimises."""
        return self.evaluation.cost


class GainSpace:
    """Gains with their bounds, which it maps to the unit cube.

    Attributes:
        names: keys of the scenario, n of them.
        bounds: (n, 2) lower and upper.
        scale: "linear", or "log" where ratios matter.
        start: (n,) where a search begins.
    """

    def __init__(self, gains: Mapping[str, GainBounds], start: Sequence[float]) -> None:
        """Use the gains of a tuning file.

        Args:
            gains: bounds by name.
            start: (n,).
        """
        self.names = tuple(gains)
        self.bounds = np.array([(each.low, each.high) for each in gains.values()])
        self.scale = tuple(each.scale for each in gains.values())
        self.start = np.clip(start, *self.bounds.T)
        self._low, self._high = (self._scaled(column) for column in self.bounds.T)

    def _scaled(self, gains: Sequence[float] | Array) -> Array:
        return np.array(
            [
                math.log(gain) if scale == "log" else gain
                for gain, scale in zip(gains, self.scale, strict=True)
            ]
        )

    def point(self, gains: Sequence[float] | Array) -> Array:
        """Return the point (n,) from 0 to 1 of gains (n,), which are clamped to the bounds."""
        scaled = self._scaled(np.clip(gains, *self.bounds.T))
        return np.asarray((scaled - self._low) / (self._high - self._low))

    def gains(self, point: Sequence[float] | Array) -> Gains:
        """Return the gains at a point (n,), rounded to four digits, inside the bounds."""
        scaled = self._low + np.asarray(point) * (self._high - self._low)
        exact = np.where(np.array(self.scale) == "log", np.exp(scaled), scaled)
        rounded = [float(f"{each:.{DIGITS}g}") for each in exact]
        return tuple(np.clip(rounded, *self.bounds.T).tolist())


def default_population(n: int) -> int:
    """Return the tutorial's candidates per generation for n gains, 4 + ⌊3 ln n⌋."""
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
        """Return whether the search has converged or cannot continue."""
        return bool(self._strategy.stop())

    def ask(self) -> list[Array]:
        """Return the points (n,) of the next generation."""
        return [np.clip(np.asarray(each), 0.0, 1.0) for each in self._strategy.ask()]

    def tell(self, points: Sequence[Array], costs: Sequence[float]) -> None:
        """Report the costs of these points."""
        self._strategy.tell(list(points), list(costs))


def search(
    space: GainSpace,
    evaluate: Evaluate,
    *,
    settings: Search,
    generations: int,
) -> Iterator[list[Candidate]]:
    """Evaluate generation after generation, and yield the candidates of each.

    The result depends on the costs and on `settings` only.

    Args:
        space: of the gains, with the start around which the first generation is.
        evaluate: returns what each set of gains costs.
        settings: of the search.
        generations: at most.
    """
    strategy = CmaEs(
        space.point(space.start),
        initial_step=settings.initial_step,
        population=settings.population,
        seed=settings.seed,
    )
    number = 1
    for generation in range(1, generations + 1):
        points = strategy.ask()
        gains = [space.gains(point) for point in points]
        found = evaluate(gains)
        strategy.tell(points, [each.cost for each in found])
        yield [Candidate(number + k, generation, gains[k], found[k]) for k in range(len(points))]
        number += len(points)
        if strategy.stopped:
            return
