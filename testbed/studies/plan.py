"""Runs of a study: number, case, point and seed of each, and its scenario.

A plan depends on the study file only; which of its runs are flown is the subject of `run_choice`.
Runs are ordered by case, then point, then seed. In a factorial design and a map the last key
changes fastest; in the other designs each key draws from its own random stream, so that adding a
key changes no other key's values. All cases have the same points.
"""

from __future__ import annotations

import functools
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from testbed.core.input_files import read_bounded_text
from testbed.core.random import named_stream
from testbed.runs.bounds import unchecked_bounds
from testbed.scenario import (
    Scenario,
    ScenarioFile,
    describe_unreached,
    find_study,
    library,
    open_scenario,
    set_duration,
    set_seed,
    unreached_windows,
)
from testbed.scenario.problems import FilePosition, Problem, ScenarioError
from testbed.scenario.setting_paths import setting_from_here
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import Node, read, to_inline, walk
from testbed.studies.study_schema import CASE_SCENARIO, StudyConfig, Value


@dataclass(frozen=True, slots=True)
class Study:
    """A study file.

    Args:
        config: its validated content.
        path: of the file.
        text: of the file.
        tree: its values with their lines and columns.
    """

    config: StudyConfig
    path: Path
    text: str
    tree: Node = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.config.study.name


@dataclass(frozen=True, slots=True)
class StudyRun:
    """One run of a plan.

    Args:
        number: from 0.
        case: name of its case; empty where the study has none.
        point: values of the keys that vary, in the order of the file.
        seed: of every random stream.
        scenario: name or path, as for `testbed run`.
        overrides: changed keys, as for `--set`, without the seed; paths from `folder`.
        duration_s: as for `--duration`.
        folder: of the study file.
        margins_at_deg: bank at which margins are predicted; None: it is flown.
    """

    number: int
    case: str
    point: Mapping[str, Value]
    seed: int
    scenario: str
    overrides: tuple[str, ...]
    duration_s: float | None
    folder: Path
    margins_at_deg: float | None = None

    @property
    def command(self) -> str:
        """Shell command that repeats the run from here, to the bit with the same versions."""
        flown = self.margins_at_deg is None
        words = ["testbed", "run" if flown else "margins", self.scenario]
        here = Path.cwd().resolve()
        for each in self.overrides:
            same = here == self.folder
            words += ["--set", each if same else setting_from_here(each, self.folder, here)]
        if self.duration_s is not None:
            words += ["--duration", repr(self.duration_s).removesuffix(".0")]
        words += ["--seed", str(self.seed)] if flown else ["--bank", f"{self.margins_at_deg:g}"]
        return shlex.join(words)


def load_study(name_or_path: str | Path) -> Study:
    """Read and validate a study file; its scenarios are not read.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    path = find_study(name_or_path)
    tree = read(path)
    config = validate(tree, StudyConfig)
    return Study(config, path, read_bounded_text(path), tree)


class Plan(Sequence[StudyRun]):
    """All runs of a study, computed on access."""

    def __init__(self, study: Study) -> None:
        """Draw the points, and read the scenarios.

        Raises:
            ScenarioError: a scenario does not exist, or cannot be read.
        """
        self.study = study
        self.folder = study.path.resolve().parent  # base of the paths in it
        config = study.config
        self.cases: tuple[str, ...] = tuple(config.cases) or ("",)
        self.keys: tuple[str, ...] = tuple(config.vary)
        self.seeds: tuple[int, ...] = config.study.seeds
        predict = config.study.predict
        self.margins_at_deg = None if predict is None else predict.margins_at_deg
        self._values = tuple(config.vary.values())
        self.level_counts: tuple[int, ...] = tuple(each.level_count for each in self._values)
        self.point_count: int = config.study.samples or math.prod(self.level_counts)
        self._drawn = _draw(config) if config.study.samples else None
        self._drafts = {case: self._open(case) for case in self.cases}
        # all seeds of a point share one scenario
        self._load_cached = functools.lru_cache(maxsize=2)(self._load)

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.cases) * self.point_count * len(self.seeds)

    def __getitem__(self, number: int) -> StudyRun:  # type: ignore[override]
        """Return the run of a number."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        rest, seed = divmod(number, len(self.seeds))
        case, point = divmod(rest, self.point_count)
        return self.run(case, point, seed)

    def __iter__(self) -> Iterator[StudyRun]:
        """Iterate over all runs, in order."""
        return map(self.__getitem__, range(len(self)))

    def run(self, case: int, point: int, seed: int = 0) -> StudyRun:
        """Return the run of a case, a point and a seed, by their indices."""
        name = self.cases[case]
        values = self.point(point)
        config = self.study.config
        changes = {**config.study.set, **config.case_changes(name)}  # no key of vary is among them
        return StudyRun(
            (case * self.point_count + point) * len(self.seeds) + seed,
            name,
            values,
            self.seeds[seed],
            _command_name(self._drafts[name]),
            tuple(f"{key}={to_inline(value)}" for key, value in {**changes, **values}.items()),
            config.study.duration_s,
            self.folder,
            self.margins_at_deg,
        )

    def point(self, index: int) -> dict[str, Value]:
        """Return the values of the keys that vary."""
        if self._drawn is not None:
            each = zip(self.keys, self._values, self._drawn, strict=True)
            return {key: values.quantile(drawn[index]) for key, values, drawn in each}
        point: dict[str, Value] = {}
        for key, values, count in zip(
            reversed(self.keys), reversed(self._values), reversed(self.level_counts), strict=True
        ):
            index, level = divmod(index, count)
            point[key] = values.level(level)
        return {key: point[key] for key in self.keys}

    def scenario(self, run: StudyRun) -> Scenario:
        """Return the scenario of a run: the one `testbed run` makes of its command.

        Raises:
            ScenarioError: it cannot be flown.
        """
        return set_seed(self._load_cached(run.case, run.overrides), run.seed)

    def seeds_of_point(self, number: int) -> range:
        """Return the numbers of the runs that differ from this one by their seeds, with it."""
        first = number - number % len(self.seeds)
        return range(first, first + len(self.seeds))

    def case_scenario(self, case: int) -> Scenario:
        """Return the scenario of a case without the keys that vary.

        Raises:
            ScenarioError: it cannot be flown.
        """
        run = self.run(case, 0)
        fixed = run.overrides[: len(run.overrides) - len(self.keys)]
        return self._load(run.case, fixed)

    def unreached_metrics(self) -> str:
        """Describe windows of the study's metrics that begin after its duration; "" if none do."""
        settings, windows = self.study.config.study, dict[str, str]()
        if settings.duration_s is None:
            return ""
        for index in range(len(self.cases)):
            run = self.run(index, 0)
            with suppress(ScenarioError):
                scenario = self._resolve(run.case, run.overrides)
                missing = unreached_windows(scenario, settings.duration_s)
                if settings.metrics:
                    read = [name.split(".")[1:2] for name in settings.metrics]
                    missing = {name: text for name, text in missing.items() if [name] in read}
                elif len(missing) < len(scenario.scenario.windows):
                    missing = {}
                windows |= missing
        return describe_unreached(windows, settings.duration_s) if windows else ""

    def unchecked_bounds(self) -> list[str]:
        """Describe bounds of the scenarios that runs of the study's duration do not check."""
        duration_s = self.study.config.study.duration_s
        if duration_s is None:
            return []
        lines: list[str] = []
        for index, case in enumerate(self.cases):
            with suppress(ScenarioError):
                scenario = self._resolve(case, self.run(index, 0).overrides)
                lines += unchecked_bounds(scenario, duration_s)
        return list(dict.fromkeys(lines))

    def whole_scenarios(self) -> Iterator[Scenario]:
        """Yield the scenario of the first point of each case with its own duration."""
        for index, case in enumerate(self.cases):
            with suppress(ScenarioError):
                yield self._resolve(case, self.run(index, 0).overrides)

    def _load(self, case: str, overrides: tuple[str, ...]) -> Scenario:
        scenario = self._resolve(case, overrides)
        duration_s = self.study.config.study.duration_s
        return scenario if duration_s is None else set_duration(scenario, duration_s)

    def _resolve(self, case: str, overrides: tuple[str, ...]) -> Scenario:
        return self._drafts[case].resolve(overrides, settings_folder=self.folder)

    def _open(self, case: str) -> ScenarioFile:
        own = self.study.config.cases.get(case, {})
        loc = ("cases", case, CASE_SCENARIO) if CASE_SCENARIO in own else ("study", "scenario")
        node, path, _ = walk(self.study.tree, loc)
        try:
            return open_scenario(str(node.value), folder=self.folder)
        except ScenarioError as error:
            if error.problems[0].place == FilePosition(str(node.value)):
                raise ScenarioError([Problem(node.place, error.problems[0].text, path)]) from None
            raise


def _draw(config: StudyConfig) -> tuple[tuple[float, ...], ...]:
    """Draw the probabilities of each key's values: for each key one for each point."""
    settings = config.study
    assert settings.samples is not None
    drawn = []
    for key in config.vary:
        random = named_stream(settings.design_seed, f"study/{settings.design}/{key}")
        values = random.random(settings.samples)
        if settings.design == "latin-hypercube":  # one point in each of as many equal parts
            values = (random.permutation(settings.samples) + values) / settings.samples
        drawn.append(tuple(values.tolist()))
    return tuple(drawn)


def _command_name(draft: ScenarioFile) -> str:
    """Return the name of a scenario for `testbed run`: its name, or a short path."""
    if draft.path.parent == library() / "scenarios":
        return draft.path.stem
    here, path = Path.cwd().resolve(), draft.path.resolve()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
