"""What a study flies: runs numbered from 0, each with its case, its point and its seed.

A plan is a function of the page alone. Cases come first, then points, then seeds: all seeds of a
point are flown one after another. Points of a factorial design have the last key change fastest;
others are drawn from a stream for each key, so that another key moves nobody's dice. All cases
have the same points.
"""

from __future__ import annotations

import functools
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from testbed.scenario import Draft, Scenario, find_study, library, open_draft, shorten
from testbed.scenario.messages import Place, Problem, ScenarioError
from testbed.scenario.tree import Node, walk
from testbed.scenario.yaml_door import read, validated, word
from testbed.streams import stream
from testbed.study.flights import with_seed
from testbed.study.levels import Value, at, count_levels, level
from testbed.study.page import CASE_SCENARIO, StudyPage


@dataclass(frozen=True, slots=True)
class Study:
    """A study's page, and where it was read.

    Args:
        page: the page, checked.
        path: its file.
        text: the file's text.
        tree: where everything stands in it.
    """

    page: StudyPage
    path: Path
    text: str
    tree: Node = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.page.study.name


@dataclass(frozen=True, slots=True)
class StudyRun:
    """One run of a plan.

    Args:
        number: from 0.
        case: name of its case; empty where the study has none.
        point: values of the keys that vary, in the page's order.
        seed: of every random stream.
        scenario: name or path, as for `testbed run`.
        overrides: changes, as for `--set`; the seed is not among them.
        duration_s: as for `--duration`.
    """

    number: int
    case: str
    point: Mapping[str, Value]
    seed: int
    scenario: str
    overrides: tuple[str, ...]
    duration_s: float | None

    @property
    def command(self) -> str:
        """What repeats this run in a shell, to the last bit on the same machine and versions."""
        words = ["testbed", "run", self.scenario]
        for each in self.overrides:
            words += ["--set", each]
        if self.duration_s is not None:
            words += ["--duration", repr(self.duration_s).removesuffix(".0")]
        return shlex.join([*words, "--seed", str(self.seed)])


def load_study(name_or_path: str | Path) -> Study:
    """Read a study by name or path and return it, checked as far as it needs no scenario.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    path = find_study(name_or_path)
    tree = read(path)
    page = validated(tree, StudyPage)
    return Study(page, path, path.read_text(encoding="utf-8-sig"), tree)


class Plan(Sequence[StudyRun]):
    """All runs of a study, made when they are asked for."""

    def __init__(self, study: Study) -> None:
        """Lay the points; read the scenarios.

        Raises:
            ScenarioError: there is no such scenario, or it cannot be read.
        """
        self.study = study
        page = study.page
        self.cases: tuple[str, ...] = tuple(page.cases) or ("",)
        self.keys: tuple[str, ...] = tuple(page.vary)
        self.seeds: tuple[int, ...] = page.study.seeds
        self._spreads = tuple(page.vary.values())
        self._counts = tuple(map(count_levels, self._spreads))
        self.points: int = page.study.samples or math.prod(self._counts)
        self._shares = _shares(page) if page.study.samples else None
        self._drafts = {case: self._draft(case) for case in self.cases}
        self._page = functools.lru_cache(maxsize=2)(self._load)

    def __len__(self) -> int:
        """How many runs there are."""
        return len(self.cases) * self.points * len(self.seeds)

    def __getitem__(self, number: int) -> StudyRun:  # type: ignore[override]
        """The run of a number."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        rest, seed = divmod(number, len(self.seeds))
        case, point = divmod(rest, self.points)
        return self.run(case, point, seed)

    def __iter__(self) -> Iterator[StudyRun]:
        """All runs, in order."""
        return map(self.__getitem__, range(len(self)))

    def run(self, case: int, point: int, seed: int = 0) -> StudyRun:
        """The run of a case, a point and a seed, by their indices."""
        name = self.cases[case]
        values = self.point(point)
        page = self.study.page
        own = {key: each for key, each in page.cases.get(name, {}).items() if key != CASE_SCENARIO}
        changes = {**page.study.set, **own}  # none of which varies
        return StudyRun(
            (case * self.points + point) * len(self.seeds) + seed,
            name,
            values,
            self.seeds[seed],
            _named(self._drafts[name]),
            tuple(f"{key}={word(value)}" for key, value in {**changes, **values}.items()),
            page.study.duration_s,
        )

    def base(self, case: int) -> Scenario:
        """The page of a case before anything is varied.

        Raises:
            ScenarioError: it cannot be flown so.
        """
        run = self.run(case, 0)
        fixed = run.overrides[: len(run.overrides) - len(self.keys)]
        return self._load(run.case, fixed)

    def point(self, index: int) -> dict[str, Value]:
        """The values of the keys that vary."""
        if self._shares is not None:
            each = zip(self.keys, self._spreads, self._shares, strict=True)
            return {key: at(spread, shares[index]) for key, spread, shares in each}
        values: dict[str, Value] = {}
        for key, spread, count in zip(
            reversed(self.keys), reversed(self._spreads), reversed(self._counts), strict=True
        ):
            index, here = divmod(index, count)
            values[key] = level(spread, here)
        return {key: values[key] for key in self.keys}

    def page(self, run: StudyRun) -> Scenario:
        """The page a run flies: what `testbed run` makes of its command.

        Raises:
            ScenarioError: it cannot be flown.
        """
        return with_seed(self._page(run.case, run.overrides), run.seed)

    def _load(self, case: str, overrides: tuple[str, ...]) -> Scenario:
        page = self._drafts[case].page(overrides)
        duration_s = self.study.page.study.duration_s
        return page if duration_s is None else shorten(page, duration_s)

    def _draft(self, case: str) -> Draft:
        own = self.study.page.cases.get(case, {})
        loc = ("cases", case, CASE_SCENARIO) if CASE_SCENARIO in own else ("study", "scenario")
        node, path, _ = walk(self.study.tree, loc)
        try:
            return open_draft(str(node.value), folder=self.study.path.resolve().parent)
        except ScenarioError as error:
            if error.problems[0].place == Place(str(node.value)):
                raise ScenarioError([Problem(node.place, error.problems[0].text, path)]) from None
            raise


def plan(study: Study) -> Plan:
    """All runs of a study.

    Raises:
        ScenarioError: there is no such scenario, or it cannot be read.
    """
    return Plan(study)


def _shares(page: StudyPage) -> tuple[tuple[float, ...], ...]:
    """For each key, how far along its distribution each point is."""
    head = page.study
    assert head.samples is not None
    shares = []
    for key in page.vary:
        dice = stream(head.design_seed, f"study/{head.design}/{key}")
        drawn = dice.random(head.samples)
        if head.design == "latin-hypercube":  # each of as many equal parts has one point
            drawn = (dice.permutation(head.samples) + drawn) / head.samples
        shares.append(tuple(drawn.tolist()))
    return tuple(shares)


def _named(draft: Draft) -> str:
    """A scenario as `testbed run` finds it: its name, or the path as short as it can be."""
    if draft.path.parent == library() / "scenarios":
        return draft.path.stem
    here, path = Path.cwd().resolve(), draft.path.resolve()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
