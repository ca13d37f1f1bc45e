"""Summary of a study: outcomes, and metrics by case and point."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from testbed.metrics.summary import METRICS as SLOT_METRICS
from testbed.metrics.summary import count_out_of_slot
from testbed.pool.flight_task import COMPLETED
from testbed.scenario.problems import did_you_mean
from testbed.studies.journal import METRICS, SET, default_metric
from testbed.studies.precision import PointPrecision, point_precisions
from testbed.studies.study_schema import StudyConfig
from testbed.studies.sweep import SweepResult
from testbed.studies.table import StudyTable, metric_columns, read_table

MAX_GROUPS = 24  # above which a case is one group
MAX_FAILURES = 5


@dataclass(frozen=True, slots=True)
class RunGroup:
    """Runs of a case and a point; of a case, if there are many points.

    Args:
        case: empty where the study has none.
        point: values of the keys that vary; empty if the group has several points.
        runs: number of runs.
        completed: number of completed ones.
        metrics: for each metric its median, minimum and maximum over the runs that have it; None if
            none has.
    """

    case: str
    point: Mapping[str, Any]
    runs: int
    completed: int
    metrics: Mapping[str, tuple[float, float, float] | None]


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a study.

    Args:
        metrics: names of the metrics in it.
        unknown_metrics: names in the study file that no run has, each with a suggestion.
        groups: in order of their first runs.
        failures: the first runs that were not completed, or violate a bound, as rows.
        out_of_slot: number of completed runs that end with a follower out of its slot.
        precisions: of a study with `until`, for each point.
    """

    metrics: tuple[str, ...]
    unknown_metrics: Mapping[str, str]
    groups: tuple[RunGroup, ...]
    failures: tuple[Mapping[str, Any], ...]
    out_of_slot: int
    precisions: tuple[PointPrecision, ...] = ()


def summarise(result: SweepResult) -> Summary:
    """Summarise the result file of a study.

    Raises:
        InputError: it cannot be read.
    """
    known = metric_columns(result.path)
    config = result.study.config
    wanted = config.study.shown_metrics or default_metric(known)
    unknown = {name: did_you_mean(name, known) for name in wanted if name not in known}
    metrics = tuple(name for name in wanted if name in known)
    sets = tuple(f"{SET}{key}" for key in config.vary)
    read = (*metrics, *(name for _, name in config.study.deciding_metrics))
    columns = ("case", "seed", *sets, "outcome", "error", *(f"{METRICS}{name}" for name in read))
    table = read_table(result.path, columns)
    groups = _group_runs(config, table, sets, metrics)
    out_of_slot = _count_out_of_slot(result, known)
    failures = _find_failures(result, table)
    precisions = point_precisions(config, table)
    return Summary(metrics, unknown, groups, failures, out_of_slot, precisions)


def _count_out_of_slot(result: SweepResult, known: Sequence[str]) -> int:
    names = [name for name in known if name.startswith(SLOT_METRICS)]
    columns = read_table(result.path, ("outcome", *(f"{METRICS}{name}" for name in names))).columns
    metrics = {name: columns[f"{METRICS}{name}"].astype(np.float64) for name in names}
    return count_out_of_slot(metrics, columns["outcome"] == COMPLETED)


def _group_runs(
    config: StudyConfig, table: StudyTable, sets: Sequence[str], metrics: Sequence[str]
) -> tuple[RunGroup, ...]:
    cases = table.columns["case"].tolist()
    points = list(zip(*(table.columns[name].tolist() for name in sets), strict=True))
    points = points or [()] * len(cases)
    if len(set(zip(cases, points, strict=True))) > MAX_GROUPS:
        points = [()] * len(cases)
    members: dict[tuple[str, tuple[Any, ...]], list[int]] = {}
    for index, key in enumerate(zip(cases, points, strict=True)):
        members.setdefault(key, []).append(index)
    completed = table.columns["outcome"] == COMPLETED
    return tuple(
        RunGroup(
            case,
            dict(zip(config.vary, point, strict=True)) if point else {},
            len(rows),
            int(completed[rows].sum()),
            {name: _median_and_range(table.columns[f"{METRICS}{name}"][rows]) for name in metrics},
        )
        for (case, point), rows in members.items()
    )


def _median_and_range(values: Any) -> tuple[float, float, float] | None:  # noqa: ANN401 - (runs,)
    known = values[~np.isnan(values)]
    if not known.size:
        return None
    return float(np.median(known)), float(known.min()), float(known.max())


def _find_failures(result: SweepResult, table: StudyTable) -> tuple[Mapping[str, Any], ...]:
    outcomes, errors = table.columns["outcome"], table.columns["error"]
    failed = np.flatnonzero((outcomes != COMPLETED) | (errors != ""))[:MAX_FAILURES]
    if not failed.size:
        return ()
    texts = read_table(result.path, ("outcome", "error", "command")).columns
    return tuple(
        {
            "run": int(texts["run"][row]),
            "outcome": texts["outcome"][row],
            "error": texts["error"][row],
            "command": texts["command"][row],
        }
        for row in failed
    )


def to_document(result: SweepResult, summary: Summary) -> dict[str, Any]:
    """Return the summary as plain data for JSON."""
    table = read_table(result.path, ())
    return {
        "schema": 2,
        "study": result.study.name,
        "file": str(result.path),
        "complete": table.complete,
        "versions": table.json("versions.json"),
        "runs": sum(result.outcomes.values()),
        "new_runs": result.new_runs,
        "outcomes": dict(result.outcomes),
        "unexpected": result.unexpected,
        "out_of_slot": summary.out_of_slot,
        "groups": [
            {
                "case": group.case,
                "set": dict(group.point),
                "runs": group.runs,
                "completed": group.completed,
                "metrics": {
                    name: None
                    if numbers is None
                    else dict(zip(("median", "min", "max"), numbers, strict=True))
                    for name, numbers in group.metrics.items()
                },
            }
            for group in summary.groups
        ],
        "until": [_plain(each) for each in summary.precisions],
        "unknown_metrics": list(summary.unknown_metrics),
        "failures": [dict(each) for each in summary.failures],
    }


def _plain(precision: PointPrecision) -> dict[str, Any]:
    """Return a precision as JSON has it: without a number where there is none."""
    plain = asdict(precision)
    numbers = {
        name: plain[name] if math.isfinite(plain[name]) else None for name in ("mean", "half_width")
    }
    return {"case": plain.pop("case"), "set": plain.pop("point"), **plain, **numbers}
