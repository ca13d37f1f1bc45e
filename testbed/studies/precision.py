"""How well a study with `until` knows its number: flights and interval of each point."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.pool.flight_task import COMPLETED
from testbed.studies.journal import METRICS, SET
from testbed.studies.point_runs import PointRuns
from testbed.studies.study_schema import StudyConfig
from testbed.studies.table import StudyTable

MAX_NAMED = 5  # points in a line


@dataclass(frozen=True, slots=True)
class PointPrecision:
    """Mean of a metric at a point, with an interval that holds at every number of flights.

    Args:
        case: empty where the study has none.
        point: values of the keys that vary.
        flights: number of flights.
        lost: how many of them were not completed, or have no such number.
        mean: of the others; NaN without any.
        half_width: of the interval around it; infinite for few values, 0 where no seed changes it.
        reached: whether the interval is as narrow as the study asks for.
    """

    case: str
    point: Mapping[str, Any]
    flights: int
    lost: int
    mean: float
    half_width: float
    reached: bool


def point_precisions(config: StudyConfig, table: StudyTable) -> tuple[PointPrecision, ...]:
    """Return the precision at each point of a complete study; empty without `until`.

    Args:
        config: of the study.
        table: its rows, with the columns of its settings, outcomes and of the metric of `until`.
    """
    until = config.study.until
    if until is None or not len(table.columns["run"]):
        return ()
    numbers = table.columns.get(f"{METRICS}{until.metric}")
    if numbers is None:
        numbers = np.full(len(table.columns["run"]), math.nan)
    seeds = len(config.study.seeds)
    points = table.columns["run"] // seeds
    found = []
    for rows in np.split(np.arange(len(points)), np.flatnonzero(np.diff(points)) + 1):
        runs = PointRuns(seeds, until)
        if len(rows) == 1:
            runs.settle()  # the rule asks for more flights of any other point
        for seed, row in enumerate(rows.tolist()):
            completed = table.columns["outcome"][row] == COMPLETED
            runs.add(seed, float(numbers[row]) if completed else None)
        first = int(rows[0])
        found.append(
            PointPrecision(
                str(table.columns["case"][first]),
                {key: table.columns[f"{SET}{key}"][rows[:1]].tolist()[0] for key in config.vary},
                len(rows),
                len(rows) - runs.values,
                runs.mean,
                runs.half_width,
                runs.precise and runs.values > 0,
            )
        )
    return tuple(found)


def precision_notes(config: StudyConfig, found: Sequence[PointPrecision]) -> Iterator[str]:
    """Yield lines on points that are not known as well as asked, and on those with lost flights."""
    until = config.study.until
    if until is None:
        return
    kinds: dict[str, list[str]] = {}
    for each in found:
        lost = f", {each.lost} without the number" if each.lost else ""
        if each.reached and each.lost:
            kind = "mean over the flights that have the number"
            text = f"{each.flights - each.lost} of {each.flights}"
        elif each.lost == each.flights:
            kind, text = "no mean: no flight has the number", f"{each.flights} flights"
        elif math.isinf(each.half_width):
            kind, text = "no interval", f"{each.flights} flights{lost}"
        elif each.half_width == 0.0 and not each.reached:
            kind, text = "no interval: all numbers are equal", f"{each.flights} flights{lost}"
        elif not each.reached:
            kind = f"not within ± {until.half_width:g} with all seeds"
            text = f"± {each.half_width:.2g} after {each.flights} flights{lost}"
        else:
            continue
        kinds.setdefault(kind, []).append(f"{_setting(each)}: {text}")
    for kind, points in kinds.items():
        more = f"; and {len(points) - MAX_NAMED} more points" if len(points) > MAX_NAMED else ""
        yield f"{kind}: {'; '.join(points[:MAX_NAMED])}{more}"


def _setting(each: PointPrecision) -> str:
    values = [
        f"{key} = {value:g}" if isinstance(value, float) else f"{key} = {value}"
        for key, value in each.point.items()
    ]
    return ", ".join(filter(None, (each.case, *values))) or "the scenario"
