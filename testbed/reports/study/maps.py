"""A metric over two parameters of a study whose points are a part of a grid.

Each point is a cell as large as the distance to its neighbours: nothing between points is made up.
Contours are those of a linear interpolation between the points (Delaunay triangles).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from testbed.core.records import Array
from testbed.reports.figure_spec import FigureSpec
from testbed.reports.study.map_points import LOST_SHARE, MapPoints, map_axes, map_points
from testbed.reports.study.parameter_plots import in_pairs
from testbed.reports.study.study_data import (
    FlightGroup,
    Parameter,
    StudyData,
    axis_label,
    metric_title,
    metric_words,
)
from testbed.views.panels import BLACK, FieldMap, Line, Panel

LOG_RATIO = 10.0  # of the largest to the smallest value, from which on colours are logarithmic
PANEL_IN = 5.2  # height of a row
MARKERS = ("x", "^", "s", "v", "D", "P")  # of outcomes
FLOWN = "point with completed flights"


def study_map(study: StudyData, metric: str) -> FigureSpec | None:
    """Draw the metric over the two parameters of a map."""
    axes = map_axes(study)
    if axes is None:
        return None
    x, y = axes
    panels: list[Panel] = []
    for group in study.flights.groups:
        panel = _panel(study, metric, x, y, group)
        if panel is not None:
            panels.append(panel)
    fields = [panel.field for panel in panels if panel.field is not None]
    if not fields:
        return None
    low = min(field.limits[0] for field in fields)
    high = max(field.limits[1] for field in fields)
    logarithmic = low > 0.0 and high >= LOG_RATIO * low
    limits = low, high if high > low else low + 1.0
    panels = [
        replace(panel, field=replace(field, limits=limits, logarithmic=logarithmic))
        for panel, field in zip(panels, fields, strict=True)
    ]
    caption = (
        f"{metric} over two parameters. A cell has the colour of the point in it (dot or mark),"
        f" and is as large as the distance to its neighbours: the {study.statistic} of the"
        " completed flights of the point. Hatched: at least half of its flights were not"
        " completed; marks say how most of those ended. Lines are interpolated between points."
    )
    rows = in_pairs(panels)
    return FigureSpec(f"{metric_title(metric)}, map", caption, rows, PANEL_IN * len(rows) + 0.9)


def _panel(
    study: StudyData, metric: str, x: Parameter, y: Parameter, group: FlightGroup
) -> Panel | None:
    points = map_points(study, metric, (x, y), group.flights)
    known = points.values[np.isfinite(points.values) & (points.lost < LOST_SHARE)]
    if len(np.unique(points.x)) < 2 or len(np.unique(points.y)) < 2 or not known.size:
        return None
    grid_x, grid_y = _grid(points.x), _grid(points.y)
    field = _field(points, grid_x, grid_y)
    words, unit = metric_words(metric)
    contour = study.contour if metric == study.refined_metric else None
    amount = "" if contour is None else f"{contour:g} {unit}".rstrip()
    ends = sorted({each for each, lost in zip(points.outcomes, points.lost, strict=True) if lost})
    how = ends[0].replace("_", " ") if len(ends) == 1 else "not completed"
    return Panel(
        group.label,
        x.label,
        y.label,
        _dots(points, ends),
        x_limits=(float(grid_x[0]), float(grid_x[-1])),
        y_limits=(float(grid_y[0]), float(grid_y[-1])),
        field=replace(
            field,
            limits=(float(known.min()), float(known.max())),
            label=axis_label(metric),
            contour=contour,
            contour_label=f"{words}: {amount}",
            outside_label=f"{how}: at least half of the flights",
            edge_label="boundary of completed flights",
        ),
    )


def _grid(values: Array) -> Array:
    """Return the numbers of the finest grid on which all values are."""
    levels = np.unique(values)
    count = round(float((levels[-1] - levels[0]) / np.diff(levels).min()))
    return np.linspace(levels[0], levels[-1], count + 1)


def _field(points: MapPoints, grid_x: Array, grid_y: Array) -> FieldMap:
    """Return cells and contours, without labels and limits."""
    at = np.column_stack([_steps(points.x, grid_x), _steps(points.y, grid_y)])
    shown = np.isfinite(points.values) & (points.lost < LOST_SHARE)
    # cells of half a step, so that each lies nearer to one point than to all others
    corners_x, corners_y = _half_steps(grid_x), _half_steps(grid_y)
    columns: Array = np.arange(0.25, len(grid_x) - 1, 0.5)
    rows: Array = np.arange(0.25, len(grid_y) - 1, 0.5)
    values = np.empty((len(rows), len(columns)))
    for i, row in enumerate(rows.tolist()):
        # below the hatched area the colour is that of the nearest point that has one
        values[i] = points.values[shown][_nearest(at[shown], columns, row)]
    nodes = np.meshgrid(np.arange(float(len(grid_x))), np.arange(float(len(grid_y))))
    level = _interpolate(at[shown], points.values[shown], nodes)
    return FieldMap(
        corners_x, corners_y, values, (0.0, 1.0), "", False, grid_x, grid_y,
        level, None, "", _interpolate(at, points.lost, nodes), "", "",
    )  # fmt: skip


def _steps(values: Array, grid: Array) -> Array:
    """Return values (P,) in whole steps of a grid from its first number."""
    steps: Array = np.rint((values - grid[0]) / (grid[1] - grid[0]))
    return steps


def _half_steps(grid: Array) -> Array:
    """Return the numbers of a grid and those half-way between them."""
    return np.linspace(grid[0], grid[-1], 2 * len(grid) - 1)


def _nearest(at: Array, columns: Array, row: float) -> NDArray[np.intp]:
    """Return for each cell of a row the nearest point, by the larger of both distances.

    Args:
        at: (P, 2) of the points, in steps.
        columns: (C,) of the cells.
        row: of the cells.
    """
    across, up = np.abs(at[:, :1] - columns), np.abs(at[:, 1:] - row)
    # of several the nearest one on the straight line
    found: NDArray[np.intp] = np.argmin(
        np.maximum(across, up) + 1e-3 * np.hypot(across, up), axis=0
    )
    return found


def _interpolate(at: Array, values: Array, nodes: Sequence[Array]) -> Array:
    """Interpolate linearly between points (P, 2) at nodes; NaN beyond them."""
    if len(np.unique(at[:, 0])) < 2 or len(np.unique(at[:, 1])) < 2:
        return np.full(nodes[0].shape, np.nan)
    found: Array = LinearNDInterpolator(at, values)(*nodes)
    return found


def _dots(points: MapPoints, ends: Sequence[str]) -> list[Line]:
    """Mark the points: completed ones, and others by how most of their flights ended."""
    kept = points.lost < LOST_SHARE
    lines = [Line(points.x[kept], points.y[kept], BLACK, FLOWN, dots=True, marker=".")]
    for k, end in enumerate(ends):
        here = ~kept & np.array([each == end for each in points.outcomes])
        if here.any():
            marker, name = MARKERS[k % len(MARKERS)], end.replace("_", " ")
            lines.append(
                Line(points.x[here], points.y[here], BLACK, name, dots=True, marker=marker)
            )
    return lines
