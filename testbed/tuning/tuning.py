"""The flights of a tuning file: what gains cost, for the search of `testbed tune` or any other."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from testbed.core.errors import InputError, NotCopied
from testbed.core.records import Array
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.metrics.side_effects import (
    SideEffects,
    flight_numbers,
    seeds_change_nothing,
    side_effects,
    to_columns,
)
from testbed.pool.flight_pool import FlightWorkers, Progress, Report, group_numbers
from testbed.pool.flight_task import INVALID, FlightResult, FlightTask
from testbed.scenario import Scenario, middle_loop_gains, set_seed
from testbed.scenario.arguments import check_calls, check_count, check_path
from testbed.scenario.problems import Problem, ScenarioError, did_you_mean
from testbed.scenario.yaml_io import to_inline, walk
from testbed.studies.margin_changes import MarginChange, margin_change
from testbed.studies.plan import Plan, StudyRun
from testbed.studies.plan_check import FlownScenarios
from testbed.studies.predicted_numbers import predict_numbers
from testbed.tuning.tune_constraints import Measure, constraint_results, measurements
from testbed.tuning.tune_schema import GAINS, load_tune
from testbed.tuning.tune_search import (
    SATURATION_FACTOR,
    Evaluation,
    Gains,
    GainSpace,
    HeldOutComparison,
    aggregate_costs,
    compare_held_out,
    completed_metric,
    flight_cost,
    make_evaluation,
)

Work = tuple[StudyRun, Measure | None]  # a run to be flown, or of which something is measured
OPTIONS = "controller.options."  # keys of a user's law
ROUNDING = 1e-9  # by which gains may be beyond their bounds, as a share


class Costs(NamedTuple):
    """What gains cost, and by how much they miss the constraints.

    Attributes:
        costs: () of one set of gains, or (k,).
        constraints: (m,) of one set, or (k, m): shortfall from each constraint of the file, 0 where
            it is met.
    """

    costs: Array
    constraints: Array


@dataclass(frozen=True, slots=True)
class HeldOutTest:
    """Gains compared with those of the scenario, on seeds that a search does not use.

    Attributes:
        comparison: of the metric.
        costs: combined costs, before and after.
        side_effects: what got worse beside the metric.
        margins: the same of the predicted margins, straight and at the banks of the constraints.
    """

    comparison: HeldOutComparison
    costs: tuple[float, float]
    side_effects: SideEffects
    margins: tuple[MarginChange, ...]

    def __str__(self) -> str:
        """Return the verdict, and a line for each number that got worse."""
        change = self.comparison.change
        lines = [f"{self.comparison.verdict}: {change.before:.4g} before, {change.after:.4g} after"]
        if self.side_effects:
            lines.append(f"worse, {self.side_effects.basis}")
            lines += self.side_effects.lines
        for each in self.margins:
            if each.problem:
                lines.append(f"margins {each.place} are not predicted: {each.problem}")
            if each.side_effects:
                lines.append(f"smaller margins {each.place}, {each.side_effects.basis}")
                lines += each.side_effects.lines
        return "\n".join(lines)


class Tuning(NotCopied):
    """The flights of a tuning file, to be driven by any optimiser.

    With the first flights worker processes start; `close` or the end of a `with` block ends them.

    Attributes:
        tune: the file.
        runs: of its study.
        space: of the gains: names, bounds, scale and start.
        before: gains (n,) of the scenario, in the order of `space.names`.
        durations_s: planned duration of each run.
        flights: number of flights so far.

    Args:
        tuning: name or path of a tuning file.
        jobs: processes at once; default one for each processor.
        progress: called with the flights that have ended, and the number of those that were asked
            for.
        report: called with a line when kernels are compiled.
    """

    def __init__(
        self,
        tuning: str | os.PathLike[str],
        *,
        jobs: int | None = None,
        progress: Progress = lambda done, total: None,
        report: Report = lambda line: None,
    ) -> None:
        """Read the scenarios; check that each gain's bounds are valid in them.

        Raises:
            ScenarioError: they cannot; with the place in the tuning file.
            InputError: no run has the metric, code of the user's cannot be built, or an argument is
                wrong.
        """
        tune = load_tune(check_path("tuning", tuning))
        if jobs is not None:
            check_count("jobs", jobs)
        check_calls("progress", progress)
        check_calls("report", report)
        self.tune = tune
        self.progress = progress
        self._workers = FlightWorkers(jobs, report=report)
        self._one_caller = threading.Lock()  # threads of an optimiser share the processes
        self._plan = Plan(tune.study)
        self.runs = list(self._plan)
        self._keys = tuple(tune.config.gains)
        self._first = self._plan.scenario(self.runs[0])
        self.before: Gains = tuple(self._current(key) for key in self._keys)
        starts = [bounds.start for bounds in tune.config.gains.values()]
        self.space = GainSpace(
            tune.config.gains,
            [b if s is None else s for b, s in zip(self.before, starts, strict=True)],
        )
        for run in {run.case: run for run in reversed(self.runs)}.values():
            self._check_bounds(run)
        flown = FlownScenarios(self._plan)
        self.durations_s: list[float] = []
        for run in self.runs:
            scenario = self._plan.scenario(run)
            flown.add(run, scenario)
            self.durations_s.append(scenario.scenario.duration_s)
        for key, bounds in tune.config.gains.items():
            run = self._with(self.runs[0], {key: bounds.low})
            flown.add(run, self._plan.scenario(run))
        flown.check_metrics([(("objective", "metric"), tune.config.objective.metric)])
        flown.check_code()
        flown.check_keys()
        self._check_airframe()
        self._check_constraints()
        seeds = len(tune.config.study.seeds)
        # one run for each case and point; runs are ordered by case, point, seed
        self.without_seeds = range(0, len(self.runs), seeds)
        self.flights = 0
        self._saturation = 0.0  # until the gains of the scenario are flown
        self._known: dict[Gains, Evaluation] = {}

    def __enter__(self) -> Self:
        """Return the object itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes."""
        self.close()

    def close(self) -> None:
        """End the worker processes; the next flights start others."""
        self._workers.close()

    @contextmanager
    def session(self) -> Iterator[None]:
        """Turn Ctrl-C and SIGTERM in the whole block into requests, and end the processes with it.

        Outside of such a block that holds for each call that flies, and the processes stay.
        """
        with self._workers.pool():
            yield

    def _why_not_copied(self) -> str:
        """See `NotCopied`: it has processes."""
        return "a tuning cannot be copied or pickled (make another one, of the same file)"

    def _check_airframe(self) -> None:
        airframes = {follower.aircraft for follower in self._first.fleet}
        if len(airframes) > 1 and any(key.startswith(GAINS) for key in self._keys):
            raise self._error(
                ("study", "scenario"),
                f"has {', '.join(sorted(airframes))}, and gains of a middle loop are for one "
                "airframe (write a scenario whose followers have the same)",
            )

    def _check_bounds(self, run: StudyRun) -> None:
        """Check a run without changes, and with each gain at either bound."""
        self._plan.scenario(run)
        for key, bounds in self.tune.config.gains.items():
            for name, value in (("from", bounds.low), ("to", bounds.high)):
                try:
                    self._plan.scenario(self._with(run, {key: value}))
                except ScenarioError as error:
                    text = f"{run.scenario} cannot be flown with this value: {error}"
                    raise self._error(("gains", key, name), text) from None

    def _current(self, key: str) -> float:
        if key.startswith(GAINS):
            airframe = self._first.fleet[0].aircraft
            node: Any = middle_loop_gains(self._first, airframe).model_dump(mode="json")
            parts = key.removeprefix(GAINS).split(".")
        else:
            node, parts = self._first.model_dump(mode="json", by_alias=True), key.split(".")
        for part in parts:
            known = list(node) if isinstance(node, dict) else []
            if part not in known:
                raise self._error(("gains", key), _describe_missing(key, part, known))
            node = node[part]
        if isinstance(node, bool) or not isinstance(node, int | float):
            raise self._error(("gains", key), "is not one number of the scenario")
        return float(node)

    def _error(self, loc: tuple[str, ...], text: str) -> ScenarioError:
        node, path, missing = walk(self.tune.study.tree, loc)
        return ScenarioError([Problem(node.place, text, path + missing)])

    def _with(self, run: StudyRun, gains: Mapping[str, float]) -> StudyRun:
        more = tuple(f"{key}={to_inline(value)}" for key, value in gains.items())
        return replace(run, overrides=(*run.overrides, *more))

    def changed_keys(self, gains: Gains) -> dict[str, float]:
        """Return gains by key; empty for the gains of the scenario."""
        return {} if gains == self.before else dict(zip(self._keys, gains, strict=True))

    def run_with(self, index: int, gains: Gains, seed: int | None = None) -> StudyRun:
        """Return a run of the study with gains, and optionally another seed."""
        run = self._with(self.runs[index], self.changed_keys(gains))
        return run if seed is None else replace(run, seed=seed)

    def scenario_with(self, gains: Gains) -> Scenario:
        """Return the scenario of the first run with gains."""
        return self._plan.scenario(self.run_with(0, gains))

    def _check_constraints(self) -> None:
        """Check that what the constraints need can be measured.

        Raises:
            ScenarioError: it cannot; with the place in the tune file.
        """
        if not self.tune.config.constraints:
            return
        from testbed.linear.steady_flight import MarginsError, check_measurable

        for run in self.runs:
            try:
                check_measurable(self._plan.scenario(run))
            except MarginsError as error:
                raise self._error(("constraints",), f"{run.scenario}: {error}") from None

    def evaluate(self, gains: Sequence[float] | Sequence[Sequence[float]] | Array) -> Costs:
        """Fly with gains, and return what they cost.

        The gains of the scenario are flown first, because costs saturate at a multiple of theirs.
        Gains that were flown before are not flown again.

        Args:
            gains: (n,) in the order of `space.names`, or (k, n), which fly at the same time.

        Returns:
            costs: combined cost of the flights, in the unit of the metric, without constraints;
                and constraints: see `Costs`.

        Raises:
            InputError: gains are not of this shape or not within their bounds, the metric is not a
                number of these flights, or a constraint cannot be measured.
            KeyboardInterrupt: Ctrl-C or SIGTERM was received.
        """
        rows, one = self._check_gains(gains)
        found = self.evaluations(rows)
        costs = np.array([each.objective for each in found])
        missed = [[of.shortfall for of in each.constraints] for each in found]
        constraints = np.array(missed, dtype=np.float64).reshape(len(rows), -1)
        return Costs(costs[0], constraints[0]) if one else Costs(costs, constraints)

    def _check_gains(self, gains: object) -> tuple[list[Gains], bool]:
        """Return sets of gains, and whether it was one.

        Raises:
            InputError: see `evaluate`.
        """
        names, bounds = self.space.names, self.space.bounds
        try:
            values: Array = np.array(gains, dtype=np.float64)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.ndim not in (1, 2) or values.shape[-1] != len(names) or not values.size:
            raise InputError(
                f"gains: write {len(names)} numbers, of {', '.join(names)}, or a list of such lists"
            )
        rows = np.atleast_2d(values)
        slack = ROUNDING * np.abs(bounds).max(axis=1)
        beyond = ~((rows >= bounds[:, 0] - slack) & (rows <= bounds[:, 1] + slack))
        if beyond.any():
            row, k = np.argwhere(beyond)[0].tolist()
            low, high = bounds[k]
            raise InputError(
                f"gains: {names[k]} is {rows[row, k]:g} (write a number from {low:g} to {high:g})"
            )
        clipped = np.clip(rows, *bounds.T)
        return [tuple(row) for row in clipped.tolist()], values.ndim == 1

    @property
    def saturation(self) -> float:
        """Metric above which costs saturate; 0 before the first flights."""
        return self._saturation

    def evaluations(self, candidates: Sequence[Gains]) -> list[Evaluation]:
        """Return what sets of gains cost, flight by flight; see `evaluate`."""
        with self._one_caller:
            if not self._saturation:
                self._evaluate_first()
            new = [each for each in dict.fromkeys(candidates) if each not in self._known]
            if new:
                results, measured = self._fly_candidates(new)
                flights, others = len(self.runs), len(measured) // len(new)
                for i, gains in enumerate(new):
                    self._known[gains] = self._evaluation(
                        results[i * flights :][:flights], measured[i * others :][:others]
                    )
            return [self._known[each] for each in candidates]

    def _evaluate_first(self) -> None:
        """Fly the gains of the scenario, and set the saturation of costs."""
        results, measured = self._fly_candidates([self.before])
        for each in measured:
            if each.outcome == INVALID:
                raise InputError(f"constraints: {each.error.removeprefix('invalid: ')}")
        self._saturation = self._choose_saturation(results)
        self._known[self.before] = self._evaluation(results, measured)

    def _fly_candidates(
        self, candidates: Sequence[Gains]
    ) -> tuple[list[FlightResult], list[FlightResult]]:
        """Return the results of all flights, and of all measurements, candidate by candidate."""
        flights: list[Work] = [
            (self.run_with(k, gains), None) for gains in candidates for k in range(len(self.runs))
        ]
        measured: list[Work] = [
            (self.run_with(k, gains), measure)
            for gains in candidates
            for k in self.without_seeds
            for measure in measurements(self.tune.config.constraints)
        ]
        results = self._fly(flights + measured)
        return results[: len(flights)], results[len(flights) :]

    def _evaluation(
        self, results: Sequence[FlightResult], measured: Sequence[FlightResult]
    ) -> Evaluation:
        return make_evaluation(
            self._costs(results, self.durations_s),
            self.tune.config.objective.aggregate,
            constraint_results(self.tune.config.constraints, measured),
            self._saturation,
        )

    def compare(self, gains: Sequence[float] | Array) -> HeldOutTest:
        """Fly the gains of the scenario and others on held-out seeds, and predict their margins.

        Args:
            gains: (n,) in the order of `space.names`.

        Raises:
            InputError: see `evaluate`.
            KeyboardInterrupt: Ctrl-C or SIGTERM was received.
        """
        rows, one = self._check_gains(gains)
        if not one:
            raise InputError("gains: write one set of numbers to compare")
        self.evaluations([])  # sets the saturation of costs
        with self._one_caller:
            return self._compare(rows[0])

    def _compare(self, best: Gains) -> HeldOutTest:
        config, runs = self.tune.config, self.without_seeds
        seeds, aggregate = config.held_out_seeds, config.objective.aggregate
        flights: list[Work] = [
            (self.run_with(k, gains, seed), None)
            for gains in (self.before, best)
            for seed in seeds
            for k in runs
        ]
        # margins depend on the case, and hardly on what varies in it
        cases = {self.runs[k].case: k for k in reversed(runs)}.values()
        banks = sorted({0.0, *(each.bank_deg for each in config.constraints)})
        predicted: list[Work] = [
            (self.run_with(k, gains), partial(predict_numbers, bank))
            for bank in banks
            for gains in (self.before, best)
            for k in cases
        ]
        results = self._fly(flights + predicted)
        results, margins = results[: len(flights)], results[len(flights) :]
        half = len(results) // 2
        numbers, by_seed, costs = [], [], []
        point = np.tile(np.arange(len(runs)), len(seeds))
        for part in (results[:half], results[half:]):
            numbers.append(to_columns([flight_numbers(each.metrics) for each in part]))
            values = [completed_metric(each.metrics, config.objective.metric) for each in part]
            by_seed.append(
                {seed: values[i * len(runs) :][: len(runs)] for i, seed in enumerate(seeds)}
            )
            durations_s = [self.durations_s[k] for k in runs] * len(seeds)
            costs.append(aggregate_costs(self._costs(part, durations_s), aggregate))
        same = all(seeds_change_nothing(each, point) for each in numbers)
        return HeldOutTest(
            compare_held_out(*by_seed, one_flight=same),
            (costs[0], costs[1]),
            side_effects(numbers[0], numbers[1], np.repeat(seeds, len(runs)), point),
            tuple(
                margin_change(bank, pair[: len(cases)], pair[len(cases) :])
                for i, bank in enumerate(banks)
                for pair in (margins[2 * i * len(cases) :][: 2 * len(cases)],)
            ),
        )

    def _fly(self, works: Sequence[Work]) -> list[FlightResult]:
        """Fly runs, or measure them, and return the results in this order."""

        def tasks(numbers: Sequence[int]) -> Iterator[FlightTask]:
            # read once: several candidates are flown at the same time
            scenario = self._plan.scenario(works[numbers[0]][0])
            for number in numbers:
                run, measure = works[number]
                yield FlightTask(number, set_seed(scenario, run.seed), measure=measure)

        groups = group_numbers((run.case, run.overrides) for run, _ in works)
        results: list[FlightResult | None] = [None] * len(works)
        before = self.flights
        total = before + sum(measure is None for _, measure in works)
        with self._workers.pool(keep=True) as pool:
            for result in pool.run_groups(map(tasks, groups)):
                results[result.number] = result
                self.flights += works[result.number][1] is None
                self.progress(self.flights, total)
        return [each for each in results if each is not None]

    def _costs(
        self, results: Sequence[FlightResult], durations_s: Sequence[float]
    ) -> tuple[float, ...]:
        metric = self.tune.config.objective.metric
        return tuple(
            flight_cost(result.metrics, metric, duration_s=duration_s, saturation=self._saturation)
            for result, duration_s in zip(results, durations_s, strict=True)
        )

    def _choose_saturation(self, first: Sequence[FlightResult]) -> float:
        """Return `saturate_above`, or its default from the flights with the scenario's gains."""
        objective = self.tune.config.objective
        documents = [result.metrics for result in first if result.metrics is not None]
        numbers = flatten_metrics(documents[0]) if documents else {}
        if documents and objective.metric not in numbers:
            known = [name for name in numbers if name.startswith("windows.")]
            raise InputError(
                f"objective.metric: {objective.metric} is not a number of these flights"
                f"{did_you_mean(objective.metric, numbers)} (write one of {', '.join(known[:8])}, "
                "...)"
            )
        if objective.saturate_above is not None:
            return objective.saturate_above
        values = [completed_metric(result.metrics, objective.metric) for result in first]
        worst = max((value for value in values if value is not None), default=0.0)
        if worst > 0.0:
            return SATURATION_FACTOR * worst
        errors = "; ".join(dict.fromkeys(result.error for result in first if result.error))
        raise InputError(
            "objective.saturate_above: is needed, because no flight with the gains of the scenario "
            f"has the metric ({errors or 'it is 0'}) (write a number, in the metric's unit)"
        )


def _describe_missing(key: str, part: str, known: Sequence[str]) -> str:
    """Return why a key of gains has no present value, and what to write."""
    hint = did_you_mean(part, known) if known else ""
    text = f"there is no key {part!r}{hint}"
    if not key.startswith(OPTIONS):
        return text
    # an option of a user's law may have its value in the code alone
    name = key.removeprefix(OPTIONS)
    return (
        f"{text} (write its present value in the scenario: controller: {{options: {{{name}: 1}}}})"
    )
