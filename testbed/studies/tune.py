"""Tune gains: search, then compare the best gains with the scenario's on held-out seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from testbed.core.errors import InputError
from testbed.scenario.problems import did_you_mean
from testbed.studies.flight_pool import FlightPool, open_flight_pool
from testbed.studies.flight_task import FlightResult
from testbed.studies.golden import Progress
from testbed.studies.plan import StudyRun
from testbed.studies.rows import flatten_metrics
from testbed.studies.tune_log import SearchLog, TuneResult
from testbed.studies.tune_objective import (
    SATURATION_FACTOR,
    HeldOutComparison,
    aggregate_costs,
    compare_held_out,
    completed_metric,
    flight_cost,
)
from testbed.studies.tune_problem import TuneProblem
from testbed.studies.tune_search import (
    Candidate,
    Gains,
    default_population,
    generation_count,
    search,
)

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
        self._report(f"gains of the scenario: {first.cost:.4g}")
        population = settings.population or default_population(len(problem.keys))
        generations = self._generations(population)
        for found in search(
            problem.space,
            problem.start,
            self._evaluate,
            aggregate=self._config.objective.aggregate,
            settings=settings,
            generations=generations,
        ):
            candidates += found
            cheapest = min(found, key=lambda candidate: candidate.cost)
            best = cheapest if cheapest.cost < best.cost else best
            self._log.add(found, best)
            self._report(
                f"generation {found[0].generation} of {generations}: {cheapest.cost:.4g}, best so "
                f"far {best.cost:.4g}"
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
        results = self._fly([self._problem.run_with(k, gains) for k in self._runs])
        self._saturation = self._choose_saturation(results)
        costs = self._costs(results, self._problem.durations_s)
        combined = aggregate_costs(costs, self._config.objective.aggregate)
        return Candidate(0, 0, gains, costs, combined)

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

    def _evaluate(self, candidates: Sequence[Gains]) -> list[tuple[float, ...]]:
        """Return the costs of all flights of each candidate."""
        results = self._fly(
            [self._problem.run_with(k, gains) for gains in candidates for k in self._runs]
        )
        each = len(self._runs)
        return [
            self._costs(results[i : i + each], self._problem.durations_s)
            for i in range(0, len(results), each)
        ]

    def _compare(self, best: Gains) -> tuple[HeldOutComparison, tuple[float, float]]:
        """Fly the gains of the scenario and the best ones on held-out seeds."""
        problem, objective = self._problem, self._config.objective
        seeds, runs = self._config.held_out_seeds, self._without_seeds
        results = self._fly(
            [
                problem.run_with(k, gains, seed)
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

    def _fly(self, runs: Sequence[StudyRun]) -> list[FlightResult]:
        before = self._flights
        results = self._problem.fly(
            self._pool, runs, lambda done, _: self._progress(before + done, self._most_flights)
        )
        self._flights += len(runs)
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
