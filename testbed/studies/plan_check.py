"""Checks of a study before its first flight: scenarios, metrics, and code of the user's."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from testbed.core.errors import InputError
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.metrics.names import run_numbers
from testbed.plan.code_check import check_code, code_names
from testbed.plan.scenario_files import referents
from testbed.plan.world import build
from testbed.scenario import Scenario, place_of_key
from testbed.scenario.problems import Problem, ScenarioError, did_you_mean, merge_repeated
from testbed.scenario.reference_fields import Reference
from testbed.scenario.set_keys import KeyUse
from testbed.scenario.yaml_io import walk
from testbed.studies.plan import Plan, Study, StudyRun
from testbed.studies.predicted_numbers import predicted_names
from testbed.studies.study_schema import Value

MAX_CHECKED = 2_000  # scenarios read before a study is flown; each takes some milliseconds
MAX_BUILT = 100  # flights that are built to see which keys act; mostly the first shows all
MAX_NAMED = 6  # names in an error
_EXAMPLES = (".mean_rms_m", "min_separation_m")  # ends of names that are offered


@dataclass(frozen=True, slots=True)
class CheckedPlan:
    """Result of reading the scenarios of a plan.

    Args:
        scenarios: for each case its scenario without the keys that vary, or if that cannot be
            flown the one of the first point that can.
        referents: what these, and all others that were read, name.
        checked: number of scenarios read.
        invalid: number of them that cannot be flown.
        example: why, for the first.
        without_effect: keys that act in some flights only.
    """

    scenarios: Mapping[str, Scenario]
    referents: Collection[Reference]
    checked: int
    invalid: int
    example: str
    without_effect: tuple[str, ...] = ()


def check_plan(plan: Plan) -> CheckedPlan:
    """Read the scenarios of a study before any is flown.

    Of more than `MAX_CHECKED`, so many that every level of every key is read in every case, and of
    drawn points the first ones, and those with words that these do not have: a word may name a
    file. Of more cases than that, one each. A level or a case that cannot be flown is an error. So
    is a drawn value only if no point of its case can be flown; otherwise the row of the run has the
    error. A law or function of the user's that cannot be built, and a metric that no run has, are
    errors.

    Raises:
        ScenarioError: with the place in the study file.
        InputError: code of the user's cannot be built; with its place.
    """
    drawn = any(values.is_distribution for values in plan.study.config.vary.values())
    scenarios: dict[str, Scenario] = {}
    named: dict[Reference, None] = {}
    flown = FlownScenarios(plan)
    checked = invalid = 0
    example = ""
    for index, case in enumerate(plan.cases):
        first: ScenarioError | None = None
        for point in _points_to_check(plan):
            run = plan.run(index, point)
            checked += 1
            try:
                scenario = plan.scenario(run)
            except ScenarioError as error:
                if not drawn:
                    raise _in_study_file(plan, run, error) from None
                invalid += 1
                first = first or _in_study_file(plan, run, error)
                example = example or f"run {run.number}: {error.problems[0]}"
            else:
                scenarios.setdefault(case, scenario)
                flown.add(run, scenario)
                named |= referents(scenario)
        if case not in scenarios:
            assert first is not None
            raise first
        with suppress(ScenarioError):
            scenarios[case] = plan.case_scenario(index)
            named |= referents(scenarios[case])
    settings = plan.study.config.study
    metrics = [(("study", "metrics", k), name) for k, name in enumerate(settings.metrics)]
    flown.check_metrics([*metrics, *settings.deciding_metrics])
    flown.check_code()
    keys = tuple(flown.check_keys())
    return CheckedPlan(scenarios, tuple(named), checked, invalid, example, keys)


class FlownScenarios:
    """Scenarios of a plan, for checks that need only those that differ."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._codes: dict[tuple[str, ...], tuple[StudyRun, Scenario]] = {}
        self._shapes: dict[object, Scenario] = {}
        self._use, self._built = KeyUse(), 0
        self._runs: dict[object, StudyRun] = {}  # by place of a key

    def add(self, run: StudyRun, scenario: Scenario) -> None:
        """Add the scenario of a run."""
        if names := code_names(scenario):
            self._codes.setdefault((run.case, *names), (run, scenario))
        self._shapes.setdefault(_shape(scenario), scenario)
        if self._built < MAX_BUILT and self._use.is_new(scenario.set_keys):
            self._built += 1
            with suppress(InputError):  # the row of the run has the error
                unused = build(scenario, unused="list").unused
                self._use.add(scenario.set_keys, unused)
                for each in unused:
                    self._runs.setdefault(each.key.place, run)

    def check_keys(self) -> list[str]:
        """Check that each key that the study or the scenario's file sets acts in some flight.

        Returns:
            Keys that act in some flights only, or, where there are too many to build, perhaps in
            none that was built.

        Raises:
            ScenarioError: with all keys that never act, and their places.
        """
        refused = self._use.refused
        if refused and self._built < MAX_BUILT:
            problems: list[Problem] = []
            for each in refused:
                run = self._runs[each.key.place]
                error = ScenarioError([each.problem])
                problems += _in_study_file(self._plan, run, error).problems
            raise ScenarioError(merge_repeated(problems))
        return [str(each.problem) for each in (*refused, *self._use.warned) if each.key.by_setting]

    def check_code(self) -> None:
        """Build the laws and functions of the user's.

        Raises:
            InputError: one cannot be built; with the place in the study file or the scenario.
        """
        for run, scenario in self._codes.values():
            try:
                check_code(scenario)
            except InputError as error:
                raise _code_error(self._plan, run, str(error)) from None

    def check_metrics(self, wanted: Sequence[tuple[tuple[str | int, ...], str]]) -> None:
        """Check that the numbers of a study exist.

        Args:
            wanted: key paths in the study file and names.

        Raises:
            ScenarioError: with all numbers that no run has, and their places.
        """
        if self._plan.margins_at_deg is not None:
            known = dict.fromkeys(predicted_names())
        else:
            known = {name: None for each in self._shapes.values() for name in number_names(each)}
        missing = [(loc, name) for loc, name in wanted if name not in known]
        if (
            missing and self._plan.margins_at_deg is None
        ):  # of windows that the duration of the study drops
            whole = {n: None for each in self._plan.whole_scenarios() for n in number_names(each)}
            known = whole | known
        problems = [
            _problem_at(self._plan.study, loc, describe_unknown(name, tuple(known)))
            for loc, name in missing
            if name not in known
        ]
        if problems:
            raise ScenarioError(problems)


def _shape(scenario: Scenario) -> object:
    """Return what decides which numbers a run of a scenario has."""
    header = scenario.scenario
    expects = bool(scenario.expect.bounds)
    return scenario.aircraft_names, tuple(header.windows), header.begin is not None, expects


def number_names(scenario: Scenario) -> Sequence[str]:
    """Return the names of the numbers that runs of a scenario have, as columns of a study."""
    header = scenario.scenario
    document = run_numbers(
        scenario.aircraft_names,
        tuple(header.windows),
        begins=header.begin is not None,
        expects=bool(scenario.expect.bounds),
    )
    return tuple(flatten_metrics(document))


def describe_unknown(name: str, known: Sequence[str]) -> str:
    """Describe a number that no run has, with the names that are nearest to it."""
    below = [each for each in known if each.startswith(f"{name}.")]
    near = "" if below else did_you_mean(name, known)
    last = name.rpartition(".")[2]
    alike = below or [each for each in known if each.rpartition(".")[2] == last]
    alike = alike or [each for end in _EXAMPLES for each in known if each.endswith(end)]
    alike = alike or list(known)
    more = ", …" if len(alike) > MAX_NAMED else ""
    return (
        f"no run has a number {name!r}{near} (write for example {', '.join(alike[:MAX_NAMED])}"
        f"{more})"
    )


def _problem_at(study: Study, loc: tuple[str | int, ...], text: str) -> Problem:
    node, path, missing = walk(study.tree, loc)
    return Problem(node.place, text, path + missing)


def _points_to_check(plan: Plan) -> Iterator[int]:
    """Yield the indices of all points, or of some with every level."""
    limit = max(1, MAX_CHECKED // len(plan.cases))
    if plan.point_count <= limit:
        yield from range(plan.point_count)
        return
    if plan.study.config.study.samples:
        seen: set[tuple[str, Value]] = set()
        levels = [values.choice or () for values in plan.study.config.vary.values()]
        words = any(isinstance(each, str) for choice in levels for each in choice)
        for point in range(plan.point_count if words else limit):
            new = {each for each in plan.point(point).items() if isinstance(each[1], str)} - seen
            seen |= new
            if point < limit or new:
                yield point
        return
    counts = [values.level_count for values in plan.study.config.vary.values()]
    for row in range(max(counts)):  # the next level of each key
        point = 0
        for count in counts:
            point = point * count + row % count
        yield point


def _in_study_file(plan: Plan, run: StudyRun, error: ScenarioError) -> ScenarioError:
    """Return the error with the places of the changed keys in the study file."""
    problems = []
    for problem in error.problems:
        source = problem.place.source if problem.place else ""
        override = source.removeprefix("--set ") if source.startswith("--set ") else None
        key = override.partition("=")[0] if override else ""
        loc = _key_location(plan, run, key) if key else None
        if loc is None:
            problems.append(problem)
            continue
        in_scenario = ".".join(problem.path)
        text = f"{in_scenario}: {problem.text}" if in_scenario else problem.text
        problems.append(_problem_at(plan.study, loc, f"{override}: {text}"))
    return ScenarioError(problems)


def _code_error(plan: Plan, run: StudyRun, text: str) -> InputError:
    """Return the error of a law or function, `key: text`, with the place of the key."""
    key = text.partition(":")[0]
    for override in reversed(run.overrides):
        changed = override.partition("=")[0]
        loc = _key_location(plan, run, changed)
        if loc is not None and _overlap(key, changed):
            own = text.removeprefix(f"{changed}: ")
            return ScenarioError([_problem_at(plan.study, loc, own)])
    place = place_of_key(text, run.scenario, run.overrides)
    return InputError(f"{place}: {text}" if place else text)


def _overlap(key: str, other: str) -> bool:
    """Return whether one of two keys is the other, or inside it."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def _key_location(plan: Plan, run: StudyRun, key: str) -> tuple[str, ...] | None:
    """Return where the study file sets a scenario key of this run."""
    config = plan.study.config
    if key in config.vary:
        return ("vary", key)
    if key in config.case_changes(run.case):
        return ("cases", run.case, key)
    return ("study", "set", key) if key in config.study.set else None
