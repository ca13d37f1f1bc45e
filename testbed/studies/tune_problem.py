"""Flights of a tune: runs of its study with other gains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from testbed.scenario import Scenario, middle_loop_gains
from testbed.scenario.problems import Problem, ScenarioError, did_you_mean
from testbed.scenario.yaml_io import to_inline, walk
from testbed.studies.flight_pool import FlightPool
from testbed.studies.flight_task import FlightResult, FlightTask
from testbed.studies.golden import Progress
from testbed.studies.plan import Plan, StudyRun
from testbed.studies.tune_schema import GAINS, Tune
from testbed.studies.tune_search import Gains, GainSpace


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
        scenarios = (self._plan.scenario(run) for run in self.runs)
        self.durations_s = [each.scenario.duration_s for each in scenarios]
        self._check_airframe()

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
        """Return the scenario's value of a gain."""
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

    def fly(
        self, pool: FlightPool, runs: Sequence[StudyRun], progress: Progress
    ) -> list[FlightResult]:
        """Fly runs, and return their results in this order."""

        def tasks() -> Iterator[FlightTask]:
            for number, run in enumerate(runs):
                yield FlightTask(number, self._plan.scenario(run))

        results: list[FlightResult | None] = [None] * len(runs)
        for count, result in enumerate(pool.run(tasks()), 1):
            results[result.number] = result
            progress(count, len(runs))
        return [each for each in results if each is not None]
