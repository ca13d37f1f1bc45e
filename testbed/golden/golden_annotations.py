"""Annotations of files in a CI: where a comparison with golden tables found what."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from testbed.core.input_files import read_bounded_text
from testbed.core.numbers import parse_whole
from testbed.golden.golden import GoldenCase
from testbed.golden.golden_compare import Verdict
from testbed.golden.golden_report import improvement_line, update_command, violation_line
from testbed.golden.golden_table import MAX_GOLDEN_BYTES
from testbed.scenario import FilePosition, ScenarioError

MAX_ANNOTATIONS = 10  # errors of a step that GitHub shows


@dataclass(frozen=True, slots=True)
class Annotation:
    """An error or a notice at a place in a file; without a place, of the whole step."""

    place: FilePosition | None
    title: str
    text: str
    level: Literal["error", "notice"] = "error"


def annotations_of(cases: Sequence[GoldenCase], verdicts: Sequence[Verdict]) -> list[Annotation]:
    """Return errors of failed scenarios and notices of better numbers, each up to a limit.

    A violated bound is at its line of the scenario; a number that differs at its line of the golden
    table, one for each scenario, with the number of the others; a failed flight at the scenario. A
    notice is at the line of the number that is better, one for each scenario.
    """
    both = list(zip(cases, verdicts, strict=True))
    notices = [each for case, verdict in both for each in _notices(case, verdict)]
    found = [each for case, verdict in both for each in _of_verdict(case, verdict)]
    return [*_limited(found), *notices[:MAX_ANNOTATIONS]]


def _notices(case: GoldenCase, verdict: Verdict) -> Iterator[Annotation]:
    if verdict.improved:
        first, *others = verdict.improved
        place = FilePosition(str(case.path), _line_of(case.path, first.key), 1)
        keep = f" (to keep it: {update_command([verdict])})" if not verdict.overrides else ""
        text = f"better: {improvement_line(first)}{_more(len(others))}{keep}"
        yield Annotation(place, f"{verdict.name}: golden table", text, "notice")


def input_annotations(error: Exception) -> list[Annotation]:
    """Return the errors of unreadable input, with places where known."""
    title = "testbed check: bad input"
    if isinstance(error, ScenarioError):
        problems = [(each.place, str(each)) for each in error.problems]
    else:
        problems = [(_leading_place(line), line) for line in str(error).splitlines()]
    return _limited([Annotation(place, title, text) for place, text in problems])


def _leading_place(line: str) -> FilePosition | None:
    """Return the `file:line:column` with which the text of a problem begins."""
    file, *rest = line.split(":", 3)
    numbers = [parse_whole(each) for each in rest[:2]] if len(rest) == 3 else []
    row, column = numbers or (None, None)
    return None if row is None or column is None else FilePosition(file, row, column)


def _of_verdict(case: GoldenCase, verdict: Verdict) -> Iterator[Annotation]:
    for bound in verdict.bounds:
        if bound.violations:
            text, *others = bound.texts
            yield Annotation(
                bound.place,
                f"{verdict.name}: {bound.key}",
                f"{text}{_more(len(others))}",
            )
    if verdict.problems:
        first, *rest = verdict.problems
        place = FilePosition(str(case.source), 1, 1)
        yield Annotation(place, f"{verdict.name}: flights", f"{first}{_more(len(rest))}")
    if verdict.violations:
        largest, *less = verdict.violations
        changed = "; ".join(verdict.changes[:3])
        why = f" (the scenario changed: {changed})" if changed else ""
        text = f"{violation_line(largest, verdict)}{_more(len(less))}{why}"
        place = FilePosition(str(case.path), _line_of(case.path, largest.key), 1)
        yield Annotation(place, f"{verdict.name}: golden table", text)


def _more(count: int) -> str:
    return f"; and {count} more" if count else ""


def _line_of(table: Path, key: str) -> int:
    """Return the line of a row in a golden table, from 1."""
    start, text = f'"{key}":', read_bounded_text(table, MAX_GOLDEN_BYTES)
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith(start):
            return number
    return 1


def _limited(found: Sequence[Annotation]) -> list[Annotation]:
    """Return the first annotations; the last of them counts those left out."""
    if len(found) <= MAX_ANNOTATIONS:
        return list(found)
    shown = list(found[: MAX_ANNOTATIONS - 1])
    text = f"{len(found) - len(shown)} more errors: the log and the JSON file have all"
    return [*shown, Annotation(None, "testbed check", text)]


def to_github(annotation: Annotation) -> str:
    """Return an annotation as a workflow command of GitHub, `::error file=...,line=...::text`.

    Files are relative to GITHUB_WORKSPACE, the folder of the checkout, else to the current one.
    """
    properties = {"title": annotation.title}
    place = annotation.place
    if place and not place.source.startswith("--set"):
        workspace = Path(os.environ.get("GITHUB_WORKSPACE") or Path.cwd()).resolve()
        path = Path(place.source).resolve()
        file = path.relative_to(workspace) if path.is_relative_to(workspace) else path
        properties = {"file": file.as_posix(), **properties}
        if place.line:
            properties |= {"line": str(place.line), "col": str(place.column)}
    joined = ",".join(f"{key}={_property(value)}" for key, value in properties.items())
    return f"::{annotation.level} {joined}::{_data(annotation.text)}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
