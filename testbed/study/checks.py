"""What can be wrong with a study that only its scenarios know, found before anything flies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

from testbed.scenario import Scenario
from testbed.scenario.messages import Problem, ScenarioError
from testbed.scenario.tree import walk
from testbed.study.levels import count_levels
from testbed.study.plan import Plan, StudyRun

MOST_CHECKED = 2_000  # pages; each takes some milliseconds


@dataclass(frozen=True, slots=True)
class Checked:
    """What was found.

    Args:
        pages: for each case its page before anything is varied, or if that cannot be flown the
            page of the first point that can.
        points: how many pages were read.
        refused: of how many of them it is known that they cannot be flown.
        example: why, of the first.
    """

    pages: Mapping[str, Scenario]
    points: int
    refused: int
    example: str


def check(plan: Plan) -> Checked:
    """Read the pages of a study before any is flown.

    All of them, or of many as many as show every level of every key in every case. A level or a
    case that cannot be flown is an error of the study. What a distribution yields may be one now
    and then, which its row will say; an error is only if a case has no point that can be flown.

    Raises:
        ScenarioError: with the place in the study's page.
    """
    drawn = any(spread.drawn for spread in plan.study.page.vary.values())
    pages: dict[str, Scenario] = {}
    seen = refused = 0
    example = ""
    for index, case in enumerate(plan.cases):
        problem: ScenarioError | None = None
        for point in _points(plan):
            run = plan.run(index, point)
            seen += 1
            try:
                page = plan.page(run)
            except ScenarioError as error:
                if not drawn:
                    raise _placed(plan, run, error) from None
                refused += 1
                problem = problem or _placed(plan, run, error)
                example = example or f"run {run.number}: {error.problems[0]}"
            else:
                pages.setdefault(case, page)
        if case not in pages:
            assert problem is not None
            raise problem
        with suppress(ScenarioError):
            pages[case] = plan.base(index)
    return Checked(pages, seen, refused, example)


def _points(plan: Plan) -> Iterator[int]:
    """Indices of all points; of many, of some that have every level of every key."""
    most = max(1, MOST_CHECKED // len(plan.cases))
    if plan.points <= most:
        yield from range(plan.points)
        return
    if plan.study.page.study.samples:
        yield from range(most)
        return
    counts = [count_levels(spread) for spread in plan.study.page.vary.values()]
    for row in range(max(counts)):  # of each key the next level
        point = 0
        for count in counts:
            point = point * count + row % count
        yield point


def _placed(plan: Plan, run: StudyRun, error: ScenarioError) -> ScenarioError:
    """The error with the places of the study's page: those of the changes that caused it."""
    problems = []
    for problem in error.problems:
        source = problem.place.source if problem.place else ""
        text = source.removeprefix("--set ") if source.startswith("--set ") else None
        key = text.partition("=")[0] if text else ""
        loc = _where(plan, run, key) if key else None
        if loc is None:
            problems.append(problem)
            continue
        node, path, _ = walk(plan.study.tree, loc)
        said = ".".join(problem.path)
        about = f"{text}: {said}: {problem.text}" if said else f"{text}: {problem.text}"
        problems.append(Problem(node.place, about, path))
    return ScenarioError(problems)


def _where(plan: Plan, run: StudyRun, key: str) -> tuple[str, ...] | None:
    """Where a study's page sets a key for this run."""
    page = plan.study.page
    if key in page.vary:
        return ("vary", key)
    if key in page.cases.get(run.case, {}):
        return ("cases", run.case, key)
    return ("study", "set", key) if key in page.study.set else None
