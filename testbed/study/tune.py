"""Gains sought: the flights of a search, what it leaves as it goes, and what it is worth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from testbed.errors import InputError
from testbed.scenario import Scenario, gains_of
from testbed.scenario.messages import Problem, ScenarioError, did_you_mean
from testbed.scenario.tree import walk
from testbed.scenario.yaml_door import word
from testbed.study.cma_door import usual_population
from testbed.study.crew import Crew, Flown, Task, crew
from testbed.study.plan import Plan, StudyRun, plan
from testbed.study.rows import flatten
from testbed.study.tune_cost import FACTOR, cost, sound, together
from testbed.study.tune_files import Keeper
from testbed.study.tune_judge import Judgement, judge
from testbed.study.tune_page import GAINS, Tune
from testbed.study.tune_search import Gains, Space, Trial, generations, seek

Progress = Callable[[int, int], None]
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Tuned:
    """What came of a search.

    Args:
        tune: the page.
        directory: where its files are.
        trials: all that were flown, in order; the first is what the scenario had.
        best: of these, the cheapest and of equals the first.
        bound: of the costs.
        flights: of the search.
        ended: why it went no further.
        judgement: on the seeds it did not see; None if nothing better was found.
        costs: of all flights on these seeds together, before and after.
    """

    tune: Tune
    directory: Path
    trials: Sequence[Trial]
    best: Trial
    bound: float
    flights: int
    ended: str
    judgement: Judgement | None
    costs: tuple[float, float] | None


class Tuner:
    """One search, with the crew that flies it."""

    def __init__(self, tune: Tune) -> None:
        """Read the scenarios, and try whether they can be flown at all bounds.

        Raises:
            ScenarioError: they cannot; with the place on the page.
        """
        self.tune = tune
        self.plan: Plan = plan(tune.study)
        self.runs = list(self.plan)
        self.keys = tuple(tune.page.gains)
        self.space = Space(tune.page.gains)
        self.page = self.plan.page(self.runs[0])
        self.before = tuple(self._now(key) for key in self.keys)
        starts = [b.start for b in tune.page.gains.values()]
        self.start = tuple(
            now if start is None else start for now, start in zip(self.before, starts, strict=True)
        )
        for run in {run.case: run for run in reversed(self.runs)}.values():
            self._try(run)
        self.durations = [self.plan.page(run).scenario.duration_s for run in self.runs]
        self._check_airframe()

    def _check_airframe(self) -> None:
        airframes = {follower.aircraft for follower in self.page.fleet}
        if len(airframes) > 1 and any(key.startswith(GAINS) for key in self.keys):
            raise self._stop(
                ("study", "scenario"),
                f"flies {', '.join(sorted(airframes))}, and gains of a middle loop are one "
                "airframe's (write a scenario whose followers are alike)",
            )

    def _try(self, run: StudyRun) -> None:
        """Check a run as it is and with each gain at either bound."""
        self.plan.page(run)
        for key, bounds in self.tune.page.gains.items():
            for name, value in (("from", bounds.low), ("to", bounds.high)):
                try:
                    self.plan.page(self._with(run, {key: value}))
                except ScenarioError as error:
                    text = f"{run.scenario} cannot be flown there: {error}"
                    raise self._stop(("gains", key, name), text) from None

    def _now(self, key: str) -> float:
        """What the scenario has, before anything is sought."""
        if key.startswith(GAINS):
            airframe = self.page.fleet[0].aircraft
            node: Any = gains_of(self.page, airframe).model_dump(mode="json")
            parts = key.removeprefix(GAINS).split(".")
        else:
            node, parts = self.page.model_dump(mode="json", by_alias=True), key.split(".")
        for part in parts:
            known = list(node) if isinstance(node, dict) else []
            if part not in known:
                hint = did_you_mean(part, known) if known else ""
                raise self._stop(("gains", key), f"leads nowhere at {part!r}{hint}")
            node = node[part]
        if isinstance(node, bool) or not isinstance(node, int | float):
            raise self._stop(("gains", key), "is not one number of the scenario")
        return float(node)

    def _stop(self, loc: tuple[str, ...], text: str) -> ScenarioError:
        node, path, left = walk(self.tune.study.tree, loc)
        return ScenarioError([Problem(node.place, text, path + left)])

    def _with(self, run: StudyRun, gains: Mapping[str, float]) -> StudyRun:
        more = tuple(f"{key}={word(value)}" for key, value in gains.items())
        return replace(run, overrides=(*run.overrides, *more))

    def changed(self, gains: Gains) -> dict[str, float]:
        """Gains by key; none where they are what the scenario has."""
        return {} if gains == self.before else dict(zip(self.keys, gains, strict=True))

    def run_of(self, index: int, gains: Gains, seed: int | None = None) -> StudyRun:
        """A run of the plan with gains, and with another seed."""
        run = self._with(self.runs[index], self.changed(gains))
        return run if seed is None else replace(run, seed=seed)

    def page_of(self, gains: Gains) -> Scenario:
        """The first run's page with gains."""
        return self.plan.page(self.run_of(0, gains))

    def fly(self, crew: Crew, runs: Sequence[StudyRun], progress: Progress) -> list[Flown]:
        """Fly runs and return what came of each, in order."""

        def tasks() -> Iterator[Task]:
            for k, run in enumerate(runs):
                yield Task(k, self.plan.page(run))

        found: list[Flown | None] = [None] * len(runs)
        for count, flown in enumerate(crew.fly(tasks()), 1):
            found[flown.number] = flown
            progress(count, len(runs))
        return [each for each in found if each is not None]


def tune_gains(
    tuner: Tuner,
    out: Path,
    *,
    jobs: int | None = None,
    progress: Progress = lambda done, of: None,
    tell: Tell = lambda line: None,
) -> Tuned:
    """Search gains and hold them to seeds that the search did not see.

    The result does not depend on `jobs`. After each generation everything found so far is in `out`.

    Args:
        tuner: of the page.
        out: an empty folder.
        jobs: processes at once.
        progress: told how many flights are done, of how many at most.
        tell: told each generation in a line.

    Raises:
        InputError: the metric is no number of these flights, or the flights are too few.
        KeyboardInterrupt: Ctrl-C or SIGTERM came; what was found so far is in `out`.
    """
    with crew(jobs=jobs) as ours:
        return _tuned(tuner, ours, Keeper(tuner, out), progress, tell)


def _tuned(tuner: Tuner, ours: Crew, keeper: Keeper, progress: Progress, tell: Tell) -> Tuned:
    page, each = tuner.tune.page, len(tuner.runs)
    objective, search = page.objective, page.search
    held_out = page.held_out
    last = 2 * len(held_out) * each // len(page.study.seeds)
    total, done = search.flights + last, 0

    def fly(runs: Sequence[StudyRun]) -> list[Flown]:
        nonlocal done
        found = tuner.fly(ours, runs, lambda count, of: progress(done + count, total))
        done += len(runs)
        return found

    first = fly([tuner.run_of(k, tuner.before) for k in range(each)])
    bound = _bound(tuner, first)

    def costs_of(flown: Sequence[Flown], durations: Sequence[float]) -> tuple[float, ...]:
        metric = objective.metric
        return tuple(
            cost(one.metrics, metric, duration_s=duration, bound=bound)
            for one, duration in zip(flown, durations, strict=True)
        )

    def evaluate(gains: Sequence[Gains]) -> list[tuple[float, ...]]:
        flown = fly([tuner.run_of(k, own) for own in gains for k in range(each)])
        return [costs_of(flown[i : i + each], tuner.durations) for i in range(0, len(flown), each)]

    own = costs_of(first, tuner.durations)
    trials = [Trial(0, 0, tuner.before, own, together(own, objective.robust))]
    best = trials[0]
    keeper.begin(trials[0])
    tell(f"as it was: {best.cost:.4g}")
    population = search.population or usual_population(len(tuner.keys))
    count = generations(search, population, each)
    if count < 1:
        raise InputError(
            f"search.flights: {search.flights} are not enough for one generation (write "
            f"{each * (population + 1)} at least: {each} for each of {population} and for what is)"
        )
    ended = f"{count} generations of {population}, as many as {search.flights} flights allow"
    for found in seek(
        tuner.space, tuner.start, evaluate, robust=objective.robust, search=search, count=count
    ):
        trials += found
        cheapest = min(found, key=lambda trial: trial.cost)
        if cheapest.cost < best.cost:
            best = cheapest
        keeper.add(found, best)
        tell(
            f"generation {found[0].generation} of {count}: {cheapest.cost:.4g}, best so far "
            f"{best.cost:.4g}"
        )
    if trials[-1].generation < count:
        ended = f"the step had become small after {trials[-1].generation} generations"
    flights = done
    if best.number == 0:
        return keeper.end(
            Tuned(tuner.tune, keeper.out, trials, best, bound, flights, ended, None, None)
        )
    kinds = range(0, each, len(page.study.seeds))  # of runs that differ in more than the seed
    flown = fly(
        [
            tuner.run_of(k, gains, seed)
            for gains in (tuner.before, best.gains)
            for seed in held_out
            for k in kinds
        ]
    )
    half = len(flown) // 2
    found_by_seed, both = [], []
    for part in (flown[:half], flown[half:]):
        values = [sound(one.metrics, objective.metric) for one in part]
        found_by_seed.append(
            {seed: values[i * len(kinds) :][: len(kinds)] for i, seed in enumerate(held_out)}
        )
        durations = [tuner.durations[k] for k in kinds] * len(held_out)
        both.append(together(costs_of(part, durations), objective.robust))
    verdict, costs = judge(*found_by_seed), (both[0], both[1])
    return keeper.end(
        Tuned(tuner.tune, keeper.out, trials, best, bound, flights, ended, verdict, costs)
    )


def _bound(tuner: Tuner, first: Sequence[Flown]) -> float:
    """The page's, or ten times the worst of the flights with the gains as they were."""
    objective = tuner.tune.page.objective
    documents = [one.metrics for one in first if one.metrics is not None]
    numbers = flatten(documents[0]) if documents else {}
    if documents and objective.metric not in numbers:
        known = [name for name in numbers if name.startswith("portions.")]
        raise InputError(
            f"objective.metric: {objective.metric} is no number of these flights"
            f"{did_you_mean(objective.metric, numbers)} (write one of {', '.join(known[:8])}, ...)"
        )
    if objective.bound is not None:
        return objective.bound
    values = [sound(one.metrics, objective.metric) for one in first]
    worst = max((value for value in values if value is not None), default=0.0)
    if worst > 0.0:
        return FACTOR * worst
    errors = "; ".join(dict.fromkeys(one.error for one in first if one.error))
    raise InputError(
        "objective.bound: is needed where no flight with the gains as they are gives the metric "
        f"({errors or 'it is 0'}); write how large it may be"
    )
