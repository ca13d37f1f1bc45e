"""The points of a map: a metric and the share of lost flights over two parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array, BoolArray
from testbed.reports.study.study_data import Parameter, StudyData

LOST_SHARE = 0.5  # of the flights of a point, from which on it counts as lost


@dataclass(frozen=True)
class MapPoints:
    """Points of one group of flights on a plane.

    Args:
        x: (P,) values of the first parameter.
        y: (P,) values of the second one.
        values: (P,) the metric; NaN where no flight was completed.
        lost: (P,) share of the flights that were not completed, 0 to 1.
        outcomes: (P,) the most frequent outcome of those.
    """

    x: Array
    y: Array
    values: Array
    lost: Array
    outcomes: Sequence[str]


def map_axes(study: StudyData) -> tuple[Parameter, Parameter] | None:
    """Return the two parameters of a map; None of another study, and before both have values."""
    numeric = [each for each in study.flights.parameters if each.numeric]
    return (numeric[0], numeric[1]) if study.is_map and len(numeric) == 2 else None


def map_points(
    study: StudyData, metric: str, axes: tuple[Parameter, Parameter], where: BoolArray
) -> MapPoints:
    """Return the points of a group of flights (R,)."""
    x, y = axes
    flights = study.flights
    outcome = np.array(flights.outcome, dtype=object)
    rows: list[tuple[float, float, float, float]] = []
    outcomes: list[str] = []
    for i, k in sorted({*zip(x.index[where].tolist(), y.index[where].tolist(), strict=True)}):
        here = where & (x.index == i) & (y.index == k)
        ends = Counter(outcome[here & ~flights.completed].tolist())
        share = ends.total() / int(here.sum())
        value = study.centre(metric, here)
        rows.append((float(x.numbers[i]), float(y.numbers[k]), value, share))
        outcomes.append(ends.most_common(1)[0][0] if ends else "")
    at_x, at_y, values, lost = np.array(rows).T
    return MapPoints(at_x, at_y, values, lost, outcomes)
