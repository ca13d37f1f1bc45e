"""Tune gains: search, then compare the best gains with the scenario's on held-out seeds.

The flights are runs of the tune's study with other gains. The files are all candidates, the best
gains, a scenario with them, and the result; each is complete at any time of the search.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.version import __version__
from testbed.logs.run_directory import write_run_file
from testbed.metrics.document import write_json
from testbed.pool.flight_pool import FlightPool, Progress, group_numbers, open_flight_pool
from testbed.pool.flight_task import INVALID, FlightResult, FlightTask
from testbed.scenario import (
    Scenario,
    dump_middle_loop,
    find_scenario,
    library,
    load_scenario,
    middle_loop_gains,
    set_seed,
)
from testbed.scenario.arguments import check_calls, check_count, check_path
from testbed.scenario.problems import Problem, ScenarioError, did_you_mean
from testbed.scenario.yaml_io import to_inline, walk, write
from testbed.studies.journal import flatten_metrics
from testbed.studies.plan import Plan, StudyRun
from testbed.studies.plan_check import FlownScenarios
from testbed.tuning.tune_constraints import (
    ConstraintResult,
    Measure,
    constraint_results,
    measurements,
)
from testbed.tuning.tune_schema import GAINS, Tune
from testbed.tuning.tune_search import (
    SATURATION_FACTOR,
    Candidate,
    Evaluation,
    Gains,
    GainSpace,
    HeldOutComparison,
    aggregate_costs,
    compare_held_out,
    completed_metric,
    default_population,
    describe_aggregate,
    flight_cost,
    generation_count,
    make_evaluation,
    search,
)

Work = tuple[StudyRun, Measure | None]  # a run to be flown, or of which something is measured


class TuneProblem:
    """Scenarios, runs and bounds of a tune.

    Attributes:
        tune: its file.
        runs: of its study.
        keys: scenario keys of the gains.
        space: of the gains.
        before: gains of the scenario.
        start: gains at which the search starts.
        durations_s: planned duration of each run.
    """

    def __init__(self, tune: Tune) -> None:
        """Read the scenarios; check that each gain's bounds are valid in them.

        Raises:
            ScenarioError: they cannot; with the place in the tune file.
            InputError: no run has the metric, or code of the user's cannot be built.
        """
        self.tune = tune
        self._plan = Plan(tune.study)
        self.runs = list(self._plan)
        self.keys = tuple(tune.config.gains)
        self.space = GainSpace(tune.config.gains)
        self._first = self._plan.scenario(self.runs[0])
        self.before: Gains = tuple(self._current(key) for key in self.keys)
        starts = [bounds.start for bounds in tune.config.gains.values()]
        self.start: Gains = tuple(
            before if start is None else start
            for before, start in zip(self.before, starts, strict=True)
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

    def _check_airframe(self) -> None:
        airframes = {follower.aircraft for follower in self._first.fleet}
        if len(airframes) > 1 and any(key.startswith(GAINS) for key in self.keys):
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
                hint = did_you_mean(part, known) if known else ""
                raise self._error(("gains", key), f"there is no key {part!r}{hint}")
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
        return {} if gains == self.before else dict(zip(self.keys, gains, strict=True))

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

    def fly(
        self, pool: FlightPool, works: Sequence[Work], progress: Progress
    ) -> list[FlightResult]:
        """Fly runs, or measure them, and return the results in this order."""

        def tasks(numbers: Sequence[int]) -> Iterator[FlightTask]:
            # read once: several candidates are flown at the same time
            scenario = self._plan.scenario(works[numbers[0]][0])
            for number in numbers:
                run, measure = works[number]
                yield FlightTask(number, set_seed(scenario, run.seed), measure=measure)

        groups = group_numbers((run.case, run.overrides) for run, _ in works)
        results: list[FlightResult | None] = [None] * len(works)
        flights = 0
        for result in pool.run_groups(map(tasks, groups)):
            results[result.number] = result
            flights += works[result.number][1] is None
            progress(flights, len(works))
        return [each for each in results if each is not None]


CANDIDATES, GAINS_FILE, SCENARIO, RESULT, TUNE_FILE = (
    "candidates.csv", "middle_loop.yaml", "tuned.yaml", "result.json", "tune.yaml",
)  # fmt: skip
NOT_COMPARED = "not compared on held-out seeds"


@dataclass(frozen=True, slots=True)
class TuneResult:
    """Result of a tune.

    Args:
        tune: its file.
        directory: of its output files.
        candidates: all evaluated ones, in order; the first has the gains of the scenario.
        best: the cheapest, of equals the first.
        saturation: metric above which costs saturate.
        flights: number of flights of the search.
        stop_reason: why the search ended.
        comparison: on held-out seeds; None if nothing better was found.
        held_out_costs: combined costs on these seeds, before and after.
    """

    tune: Tune
    directory: Path
    candidates: Sequence[Candidate]
    best: Candidate
    saturation: float
    flights: int
    stop_reason: str
    comparison: HeldOutComparison | None
    held_out_costs: tuple[float, float] | None


class SearchLog:
    """Write the files of a running search, each complete at any time."""

    def __init__(self, problem: TuneProblem, directory: Path) -> None:
        self._problem = problem
        self.directory = directory
        self._lines: list[str] = []  # of the candidates

    def start(self, first: Candidate) -> None:
        """Write the tune file, and the gains of the scenario as the first candidate."""
        tune = self._problem.tune
        write_run_file(self.directory, TUNE_FILE, tune.study.text.encode())
        runs = [f"cost of run {run.number}" for run in self._problem.runs]
        head = ["candidate", "generation", "cost", *tune.config.gains, *runs]
        for result in first.evaluation.constraints:
            at = f"at {result.constraint.bank_deg:g} deg"
            head += [f"{key} {at}" for key, _ in result.required()] + [f"shortfall {at}"]
        self._lines.append(_csv_line(head))
        self._write_candidates([first])

    def add(self, candidates: Sequence[Candidate], best: Candidate) -> None:
        """Append a generation, and write the best gains if they are in it."""
        self._write_candidates(candidates)
        if any(each is best for each in candidates):
            self._write_gains(best, NOT_COMPARED)

    def finish(self, result: TuneResult) -> None:
        """Write the result, and the verdict into the files of the gains."""
        if result.comparison is not None:
            self._write_gains(result.best, result.comparison.verdict)
        write_json(self.directory / RESULT, to_document(result, self._problem))

    def _write_candidates(self, new: Sequence[Candidate]) -> None:
        """Write all candidates: lines that are appended can be cut by the end of the process."""
        self._lines += [_csv_line(_cells(each)) for each in new]
        self._write(CANDIDATES, "".join(self._lines))

    def _write_gains(self, best: Candidate, verdict: str) -> None:
        """Write the middle loop's gains, and a scenario that extends the tuned one."""
        problem = self._problem
        settings, scenario = problem.tune.config.study, problem.scenario_with(best.gains)
        objective = problem.tune.config.objective
        comment = (
            f"# Tuned by testbed {__version__} for {objective.metric} of {settings.scenario}, "
            f"study {settings.name}:\n# {describe_aggregate(objective.aggregate)} over its flights "
            f"is {best.evaluation.objective:.4g} ({verdict}).\n"
        )
        for result in best.evaluation.constraints:
            comment += f"# {result.describe()}\n"
        changes: dict[str, Any] = {}
        others = [key for key in problem.keys if not key.startswith(GAINS)]
        if others:  # of the gains before, with which the new file must not be flown
            (self.directory / SCENARIO).unlink(missing_ok=True)
        if any(key.startswith(GAINS) for key in problem.keys):
            profile, airframe = scenario.controller.profile, scenario.fleet[0].aircraft
            gains = dump_middle_loop({profile: middle_loop_gains(scenario, airframe)})
            self._write(GAINS_FILE, f"{comment}\n{gains}")
            changes["controller"] = {"middle_loop": GAINS_FILE, "profile": profile}
            if load_scenario(self._scenario_path).controller.gains:  # the gains file has them too
                changes["controller"]["gains"] = None
        for key, value in problem.changed_keys(best.gains).items():
            if not key.startswith(GAINS):
                node = changes
                *parts, last = key.split(".")
                for part in parts:
                    node = node.setdefault(part, {})
                node[last] = value
        header = {"extends": self._extends(), "scenario": {"name": f"{settings.name}-tuned"}}
        command = f"# testbed run {self.directory / SCENARIO}\n"
        self._write(SCENARIO, f"{comment}{command}\n{write({**header, **changes})}")

    @property
    def _scenario_path(self) -> Path:
        return find_scenario(self._problem.runs[0].scenario)

    def _extends(self) -> str:
        path = self._scenario_path
        if path.parent == library() / "scenarios":
            return path.stem
        return os.path.relpath(path, self.directory)

    def _write(self, name: str, text: str) -> None:
        path = self.directory / name
        with report_write_errors(path), write_text_file(path) as file:
            file.write(text)


def to_document(result: TuneResult, problem: TuneProblem) -> dict[str, Any]:
    """Return the result as plain data for JSON."""
    config, comparison = result.tune.config, result.comparison
    document: dict[str, Any] = {
        "schema": 2,
        "study": config.study.name,
        "scenario": config.study.scenario,
        "metric": config.objective.metric,
        "aggregate": describe_aggregate(config.objective.aggregate),
        "seeds": list(config.study.seeds),
        "held_out_seeds": list(config.held_out_seeds),
        "saturate_above": result.saturation,
        "flights": result.flights,
        "stop_reason": result.stop_reason,
        "gains": {
            key: {"before": before, "after": after, "from": bounds.low, "to": bounds.high}
            for (key, bounds), before, after in zip(
                config.gains.items(), problem.before, result.best.gains, strict=True
            )
        },
        "cost": {
            "before": result.candidates[0].evaluation.objective,
            "after": result.best.evaluation.objective,
        },
        "constraints": [
            {
                "bank_deg": before.constraint.bank_deg,
                "required": dict(before.required()),
                "before": _constraint_document(before),
                "after": _constraint_document(after),
            }
            for before, after in zip(
                result.candidates[0].evaluation.constraints,
                result.best.evaluation.constraints,
                strict=True,
            )
        ],
        "comparison": None,
    }
    if comparison is not None and result.held_out_costs is not None:
        mean, low, high = comparison.difference
        document["comparison"] = {
            "verdict": comparison.verdict,
            "better": comparison.better,
            "pairs": comparison.pairs,
            "seeds": comparison.seeds,
            "before": _finite(comparison.before),
            "after": _finite(comparison.after),
            "difference": {"mean": _finite(mean), "low": _finite(low), "high": _finite(high)},
            "failed_before": comparison.failed_before,
            "failed_after": comparison.failed_after,
            "cost": {"before": result.held_out_costs[0], "after": result.held_out_costs[1]},
        }
    return document


def _constraint_document(result: ConstraintResult) -> dict[str, Any]:
    return {"met": not result.shortfall, "problem": result.problem, **result.measured}


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value


def _cells(candidate: Candidate) -> list[str]:
    evaluation = candidate.evaluation
    numbers = [evaluation.cost, *candidate.gains, *evaluation.costs]
    cells = [str(candidate.number), str(candidate.generation), *map(repr, numbers)]
    for result in evaluation.constraints:
        measured = [result.measured.get(key) for key, _ in result.required()]
        cells += ["" if each is None else repr(each) for each in measured]
        cells.append(repr(result.shortfall))
    return cells


def _csv_line(cells: Sequence[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(cells)
    return file.getvalue()


def describe_candidate(candidate: Candidate) -> str:
    """Return the objective as text, and by how much the constraints are missed."""
    evaluation = candidate.evaluation
    missed = f" (misses constraints by {evaluation.shortfall:.2g})" if evaluation.shortfall else ""
    return f"{evaluation.objective:.4g}{missed}"


Report = Callable[[str], None]


def tune_gains(
    problem: TuneProblem,
    out: Path,
    *,
    jobs: int | None = None,
    progress: Progress = lambda done, total: None,
    report: Report = lambda line: None,
) -> TuneResult:
    """Search gains, and compare the best with the scenario's on held-out seeds.

    The result does not depend on `jobs`. After each generation the files in `out` have everything
    found so far.

    Args:
        problem: of the tune file.
        out: an empty directory.
        jobs: processes at once; default one for each processor.
        progress: called with the number of finished flights and the largest possible number.
        report: called with a line for each generation, and when kernels are compiled.

    Raises:
        InputError: the metric is not a number of these flights, or `max_flights` is too small.
        KeyboardInterrupt: Ctrl-C or SIGTERM was received.
    """
    out = check_path("out", out)
    if jobs is not None:
        check_count("jobs", jobs)
    check_calls("progress", progress)
    check_calls("report", report)
    with open_flight_pool(jobs=jobs, report=report) as pool:
        return _Tuning(problem, pool, SearchLog(problem, out), progress, report).run()


class _Tuning:
    """One search with its worker processes, files and messages."""

    def __init__(
        self,
        problem: TuneProblem,
        pool: FlightPool,
        log: SearchLog,
        progress: Progress,
        report: Report,
    ) -> None:
        self._problem, self._pool, self._log = problem, pool, log
        self._progress, self._report = progress, report
        self._config = problem.tune.config
        self._runs = range(len(problem.runs))
        seeds = len(self._config.study.seeds)
        # one run for each case and point; runs are ordered by case, point, seed
        self._without_seeds = range(0, len(problem.runs), seeds)
        held_out = 2 * len(self._config.held_out_seeds) * len(self._without_seeds)
        self._most_flights = self._config.search.max_flights + held_out
        self._flights = 0
        self._saturation = 0.0

    def run(self) -> TuneResult:
        """Search, compare, and write the result."""
        problem, settings = self._problem, self._config.search
        first = self._first_candidate()
        candidates, best = [first], first
        self._log.start(first)
        self._report(f"gains of the scenario: {describe_candidate(first)}")
        population = settings.population or default_population(len(problem.keys))
        generations = self._generations(population)
        for found in search(
            problem.space,
            problem.start,
            self._evaluate,
            settings=settings,
            generations=generations,
        ):
            candidates += found
            cheapest = min(found, key=lambda candidate: candidate.cost)
            best = cheapest if cheapest.cost < best.cost else best
            self._log.add(found, best)
            self._report(
                f"generation {found[0].generation} of {generations}: "
                f"{describe_candidate(cheapest)}, best so far {describe_candidate(best)}"
            )
        last, flights = candidates[-1].generation, self._flights
        if last < generations:
            reason = f"converged after {last} generations"
        else:
            limit = settings.max_flights
            reason = f"{generations} generations of {population}, the limit of {limit} flights"
        comparison, costs = self._compare(best.gains) if best.number else (None, None)
        result = TuneResult(
            tune=problem.tune,
            directory=self._log.directory,
            candidates=candidates,
            best=best,
            saturation=self._saturation,
            flights=flights,
            stop_reason=reason,
            comparison=comparison,
            held_out_costs=costs,
        )
        self._log.finish(result)
        return result

    def _first_candidate(self) -> Candidate:
        """Fly the gains of the scenario, and set the saturation of costs."""
        gains = self._problem.before
        results, measured = self._fly_candidates([gains])
        for each in measured:
            if each.outcome == INVALID:
                raise InputError(f"constraints: {each.error.removeprefix('invalid: ')}")
        self._saturation = self._choose_saturation(results)
        return Candidate(0, 0, gains, self._evaluation(results, measured))

    def _generations(self, population: int) -> int:
        each, settings = len(self._runs), self._config.search
        generations = generation_count(settings, population, each)
        if generations < 1:
            raise InputError(
                f"search.max_flights: {settings.max_flights} is too small for one generation "
                f"(write {each * (population + 1)} or more: {each} for each of {population} "
                "candidates, and for the gains of the scenario)"
            )
        return generations

    def _evaluate(self, candidates: Sequence[Gains]) -> list[Evaluation]:
        results, measured = self._fly_candidates(candidates)
        count = len(candidates)
        flights, others = len(results) // count, len(measured) // count
        return [
            self._evaluation(results[i * flights :][:flights], measured[i * others :][:others])
            for i in range(count)
        ]

    def _fly_candidates(
        self, candidates: Sequence[Gains]
    ) -> tuple[list[FlightResult], list[FlightResult]]:
        """Return the results of all flights, and of all measurements, candidate by candidate."""
        problem, constraints = self._problem, self._config.constraints
        flights: list[Work] = [
            (problem.run_with(k, gains), None) for gains in candidates for k in self._runs
        ]
        measured: list[Work] = [
            (problem.run_with(k, gains), measure)
            for gains in candidates
            for k in self._without_seeds
            for measure in measurements(constraints)
        ]
        results = self._fly(flights + measured)
        return results[: len(flights)], results[len(flights) :]

    def _evaluation(
        self, results: Sequence[FlightResult], measured: Sequence[FlightResult]
    ) -> Evaluation:
        return make_evaluation(
            self._costs(results, self._problem.durations_s),
            self._config.objective.aggregate,
            constraint_results(self._config.constraints, measured),
            self._saturation,
        )

    def _compare(self, best: Gains) -> tuple[HeldOutComparison, tuple[float, float]]:
        """Fly the gains of the scenario and the best ones on held-out seeds."""
        problem, objective = self._problem, self._config.objective
        seeds, runs = self._config.held_out_seeds, self._without_seeds
        results = self._fly(
            [
                (problem.run_with(k, gains, seed), None)
                for gains in (problem.before, best)
                for seed in seeds
                for k in runs
            ]
        )
        half = len(results) // 2
        by_seed, costs = [], []
        for part in (results[:half], results[half:]):
            values = [completed_metric(each.metrics, objective.metric) for each in part]
            by_seed.append(
                {seed: values[i * len(runs) :][: len(runs)] for i, seed in enumerate(seeds)}
            )
            durations_s = [problem.durations_s[k] for k in runs] * len(seeds)
            costs.append(aggregate_costs(self._costs(part, durations_s), objective.aggregate))
        return compare_held_out(*by_seed), (costs[0], costs[1])

    def _fly(self, works: Sequence[Work]) -> list[FlightResult]:
        before = self._flights
        results = self._problem.fly(
            self._pool, works, lambda done, _: self._progress(before + done, self._most_flights)
        )
        self._flights += sum(measure is None for _, measure in works)
        return results

    def _costs(
        self, results: Sequence[FlightResult], durations_s: Sequence[float]
    ) -> tuple[float, ...]:
        metric = self._config.objective.metric
        return tuple(
            flight_cost(result.metrics, metric, duration_s=duration_s, saturation=self._saturation)
            for result, duration_s in zip(results, durations_s, strict=True)
        )

    def _choose_saturation(self, first: Sequence[FlightResult]) -> float:
        """Return `saturate_above`, or its default from the flights with the scenario's gains."""
        objective = self._config.objective
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
