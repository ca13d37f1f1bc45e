"""A study in a few lines: how its runs ended, and its first numbers by case and point."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.scenario.messages import did_you_mean
from testbed.study.crew import FLOWN
from testbed.study.page import StudyPage
from testbed.study.rows import METRICS, SET, last_error
from testbed.study.sweep import Swept
from testbed.study.table import StudyTable, metric_names, read_table

MOST_GROUPS = 24  # of runs, to be shown one by one
MOST_TROUBLES = 5


@dataclass(frozen=True, slots=True)
class Group:
    """Runs that differ in their seeds, or in their points, if these are many.

    Args:
        case: theirs; empty where the study has none.
        point: values of what varies, by key; empty where they differ.
        runs: how many there are.
        flown: how many of them were flown to their end.
        numbers: for each metric the median, the smallest and the largest of the runs that have it;
            None where none has it.
    """

    case: str
    point: Mapping[str, Any]
    runs: int
    flown: int
    numbers: Mapping[str, tuple[float, float, float] | None]


@dataclass(frozen=True, slots=True)
class Summary:
    """What a study's end is told as.

    Args:
        metrics: names of the numbers that are shown.
        unknown: what the page asks for and no run has, and what it may have meant.
        groups: the runs, in order of the first of each.
        troubles: the first runs that were not flown to their end, as rows.
    """

    metrics: tuple[str, ...]
    unknown: Mapping[str, str]
    groups: tuple[Group, ...]
    troubles: tuple[Mapping[str, Any], ...]


def summarise(swept: Swept) -> Summary:
    """The summary of a study's file.

    Raises:
        InputError: it cannot be read.
    """
    known = metric_names(swept.path)
    page = swept.study.page
    wanted = page.study.metrics or last_error(known)
    unknown = {name: did_you_mean(name, known) for name in wanted if name not in known}
    metrics = tuple(name for name in wanted if name in known)
    sets = tuple(f"{SET}{key}" for key in page.vary)
    columns = ("case", "seed", *sets, "outcome", *(f"{METRICS}{name}" for name in metrics))
    table = read_table(swept.path, columns)
    return Summary(metrics, unknown, _groups(page, table, sets, metrics), _troubles(swept, table))


def _groups(
    page: StudyPage, table: StudyTable, sets: Sequence[str], metrics: Sequence[str]
) -> tuple[Group, ...]:
    cases = table.columns["case"].tolist()
    points = list(zip(*(table.columns[name].tolist() for name in sets), strict=True))
    points = points or [()] * len(cases)
    if len(set(zip(cases, points, strict=True))) > MOST_GROUPS:
        points = [()] * len(cases)
    members: dict[tuple[str, tuple[Any, ...]], list[int]] = {}
    for index, key in enumerate(zip(cases, points, strict=True)):
        members.setdefault(key, []).append(index)
    flown = table.columns["outcome"] == FLOWN
    return tuple(
        Group(
            case,
            dict(zip(page.vary, point, strict=True)) if point else {},
            len(own),
            int(flown[own].sum()),
            {name: _spread(table.columns[f"{METRICS}{name}"][own]) for name in metrics},
        )
        for (case, point), own in members.items()
    )


def _spread(values: Any) -> tuple[float, float, float] | None:  # noqa: ANN401 - an array (runs,)
    some = values[~np.isnan(values)]
    if not some.size:
        return None
    return float(np.median(some)), float(some.min()), float(some.max())


def _troubles(swept: Swept, table: StudyTable) -> tuple[Mapping[str, Any], ...]:
    bad = np.flatnonzero(table.columns["outcome"] != FLOWN)[:MOST_TROUBLES]
    if not bad.size:
        return ()
    texts = read_table(swept.path, ("outcome", "error", "command")).columns
    return tuple(
        {
            "run": int(texts["run"][row]),
            "outcome": texts["outcome"][row],
            "error": texts["error"][row],
            "command": texts["command"][row],
        }
        for row in bad
    )


def to_document(swept: Swept, summary: Summary) -> dict[str, Any]:
    """The end of a study as JSON."""
    facts = read_table(swept.path, ()).facts
    return {
        "schema": 1,
        "study": swept.study.name,
        "file": str(swept.path),
        "complete": facts["complete"] == "true",
        "versions": json.loads(facts["versions.json"]),
        "runs": sum(swept.outcomes.values()),
        "flown_now": swept.flown,
        "outcomes": dict(swept.outcomes),
        "groups": [
            {
                "case": group.case,
                "set": dict(group.point),
                "runs": group.runs,
                "flown": group.flown,
                "metrics": {
                    name: None
                    if spread is None
                    else dict(zip(("median", "smallest", "largest"), spread, strict=True))
                    for name, spread in group.numbers.items()
                },
            }
            for group in summary.groups
        ],
        "unknown_metrics": list(summary.unknown),
        "troubles": [dict(each) for each in summary.troubles],
    }
