"""The figures of a study in their order."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from testbed.core.records import Array, BoolArray
from testbed.reports.figure_spec import Figure, FigureSpec, make_figure
from testbed.reports.plot_selection import STYLES
from testbed.reports.study.maps import study_map
from testbed.reports.study.parameter_plots import (
    decimate_evenly,
    in_pairs,
    needs_log_axis,
    parameters,
)
from testbed.reports.study.report_table import format_number
from testbed.reports.study.study_data import (
    PERCENT,
    FlightGroup,
    IntervalEstimate,
    Parameter,
    StudyData,
    axis_label,
    estimate_of,
    metric_title,
    metric_words,
    named_level,
)
from testbed.reports.study.tables import level_groups
from testbed.views.panels import BLACK, DASHES, Heatmap, Line, Panel

MAX_METRICS = 4  # drawn; the tables have all
MAX_MAPS = 12  # panels of a figure; the maps of one pair are drawn in any case
MIN_CELL_FLIGHTS = 5  # average number of flights in a cell of a heat map of drawn points
MAX_POINT_ROWS = 12  # of the figure of cases
MIN_CASE_FLIGHTS = 10  # of a case whose distribution is drawn

Maker = Callable[[StudyData, str], FigureSpec | None]


def study_figures(study: StudyData) -> Iterator[Figure]:
    """Yield the figures for which the study has data, metric by metric."""
    makers: Sequence[tuple[str, Maker]] = (
        ("parameters", parameters),
        ("heat", heat_maps),
        ("map", study_map),
        ("cases", cases),
        ("spread", distributions),
    )
    subtitle = f"{study.name} · {study.flights.run.size:,} flights of {study.scenario}"
    for metric in study.metrics[:MAX_METRICS]:
        slug = re.sub(r"[^A-Za-z0-9_]+", "-", metric)
        for name, make in makers:
            spec = make(study, metric)
            if spec is not None:
                yield make_figure(f"{name}-{slug}", spec, subtitle)


def heat_maps(study: StudyData, metric: str) -> FigureSpec | None:
    """Draw the metric over pairs of parameters."""
    if study.is_map:
        return None
    flights = study.flights
    parameters = flights.parameters
    pairs = list(combinations(parameters, 2))
    panels: list[Panel] = []
    drawn_pairs = 0
    for pair in pairs:
        groups = flights.by_case if flights.law in pair else flights.groups
        if panels and len(panels) + len(groups) > MAX_MAPS:
            break
        panels += _heat_map_row(study, metric, pair, groups)
        drawn_pairs += 1
    if not panels:
        return None
    caption = (
        f"{study.statistic.capitalize()} of {metric} over pairs of parameters, and over all values"
        " of the others; brighter is larger. Below a number: how many flights of the cell were"
        " lost or failed. Grey: no flight of the cell was completed."
    )
    if any(each.continuous for each in parameters):
        caption += " Parameters with many numbers are divided into groups of equal size."
    if flights.groups_title:
        caption += (
            f" Each {flights.groups_title.replace(', ', ' and ')} has a map of its own; the maps of"
            " a pair have one colour scale."
        )
    if len(pairs) > drawn_pairs:
        caption += f" These are the first {drawn_pairs} of {len(pairs)} pairs."
    rows = in_pairs(panels)
    tallest = max(len(panel.y_ticks) for panel in panels)
    height_in = (1.3 + 0.5 * max(tallest, 4)) * len(rows)
    title = f"{metric_title(metric)}, over pairs of parameters"
    return FigureSpec(title, caption, rows, height_in)


def _heat_map_row(
    study: StudyData,
    metric: str,
    pair: tuple[Parameter, Parameter],
    groups: Sequence[FlightGroup],
) -> list[Panel]:
    """Draw the maps of a pair of parameters, one for each group, with one colour scale."""
    found = [_heat_map(study, metric, *pair, group) for group in groups]
    panels = [panel for panel in found if panel is not None]
    heats = [panel.heat for panel in panels if panel.heat is not None]
    if not heats:
        return []
    low = min(heat.limits[0] for heat in heats)
    high = max(heat.limits[1] for heat in heats)
    limits = low, high if high > low else low + 1.0
    return [
        replace(panel, heat=replace(heat, limits=limits))
        for panel, heat in zip(panels, heats, strict=True)
    ]


def _heat_map(
    study: StudyData, metric: str, x: Parameter, y: Parameter, group: FlightGroup
) -> Panel | None:
    columns, rows = list(level_groups(x)), list(level_groups(y))
    flights = study.flights
    count = int(group.flights.sum())
    if study.random and count < MIN_CELL_FLIGHTS * len(columns) * len(rows):
        return None
    values = np.full((len(rows), len(columns)), np.nan)
    texts = [[""] * len(columns) for _ in rows]
    for i, (_, of_row) in enumerate(rows):
        for k, (_, of_column) in enumerate(columns):
            here = of_row & of_column & group.flights
            values[i, k] = study.centre(metric, here)
            incomplete = int((here & ~flights.completed).sum())
            lost = f"\n{incomplete} lost" if incomplete else ""
            texts[i][k] = format_number(float(values[i, k])) + lost
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    limits = float(known.min()), float(known.max())
    return Panel(
        group.label,
        x.label,
        y.label,
        heat=Heatmap(values, limits, axis_label(metric), texts),
        x_ticks=[(k + 0.5, name.replace(" to ", "\nto ")) for k, (name, _) in enumerate(columns)],
        y_ticks=[(i + 0.5, name) for i, (name, _) in enumerate(rows)],
    )


def cases(study: StudyData, metric: str) -> FigureSpec | None:
    """Draw every case with its interval, and its difference from the first; also at each point."""
    flights = study.flights
    if len(flights.cases) < 2 or study.is_map:  # the points of a map are chosen unevenly
        return None
    first, count = flights.case_labels[0], min(len(flights.cases), len(STYLES))
    places = _places(study)
    one_row_each = len(places) == 1  # cases one below the other, else in the row of a point
    spacing = 1.0 if one_row_each else 0.7 / count
    shift = 0.0 if one_row_each else -0.5 * spacing * (count - 1)
    values: list[Line] = []
    differences: list[Line] = []
    for k, name in enumerate(flights.cases[:count]):
        own = flights.case_index == k
        rows: Array = -np.arange(len(places), dtype=np.float64) - shift - spacing * k
        estimates = [
            study.estimate(metric, own & here, f"all/{name}{at and f'/{at}'}")
            for at, here in places
        ]
        style = STYLES[0 if one_row_each else k]
        label = "" if one_row_each else flights.case_labels[k]
        values += _interval_lines(estimates, rows, *style, label=label)
        if k:
            pairs = [estimate_of(study.change(metric, k, here)) for _, here in places]
            differences += _interval_lines(pairs, rows, *style, label=label)
        elif one_row_each:  # of the first from itself
            zero = np.zeros(1)
            differences.append(Line(zero, zero, style[0], dots=True, hollow=True, marker=style[1]))
    if one_row_each:
        ticks = [(float(-k), name) for k, name in enumerate(flights.case_labels[:count])]
    else:
        ticks = [(float(-k), at or "all points") for k, (at, _) in enumerate(places)]
    limits = (ticks[-1][0] - 0.6, 0.6)
    label, (_, unit) = axis_label(metric), metric_words(metric)
    of_what = "a case" if one_row_each else "each case, by point"
    panels = [
        Panel(
            f"{study.statistic} of {of_what}", label, "", values,
            y_ticks=ticks, y_limits=limits,
        ),
        Panel(
            f"mean difference from {first}", f"difference, {unit}" if unit else "difference", "",
            differences, y_ticks=ticks, y_limits=limits, marks=[(0.0, BLACK)],
        ),
    ]  # fmt: skip
    caption = (
        f"Left: {study.statistic} of {metric} of each case over {study.unit_name} with its"
        f" {PERCENT} % interval (bootstrap), between two strokes. Right: the difference from"
        f" {first}, the mean of the differences at the same point and seed with Student's"
        f" {PERCENT} % interval. A difference whose interval contains 0 (dotted line) is not"
        " significant."
    )
    if not one_row_each:
        caption += " All points: each of the seeds is taken as its mean over the points."
    if len(flights.cases) > count:
        caption += f" The first {count} of {len(flights.cases)} cases are drawn."
    rows_in = 0.36 * len(ticks) if one_row_each else max(0.36, 0.17 * count) * len(ticks)
    return FigureSpec(f"{metric_title(metric)}, by case", caption, [panels], 1.9 + rows_in)


def _places(study: StudyData) -> list[tuple[str, BoolArray]]:
    """Return names and flights (R,) of the rows of a figure of cases: all, and every point."""
    flights = study.flights
    everything = [("", np.ones(flights.run.size, dtype=np.bool_))]
    points = sorted(set(flights.point.tolist()))
    if study.random or not 1 < len(points) <= MAX_POINT_ROWS:
        return everything
    keys = [each.label for each in flights.parameters]
    ends = [
        each.label if each.label != each.key else each.key.rpartition(".")[2]
        for each in flights.parameters
    ]
    names = ends if len(set(ends)) == len(ends) else keys
    for point in points:
        here = flights.point == point
        one = int(np.flatnonzero(here)[0])
        levels = [each.levels[each.index[one]] for each in flights.parameters]
        text = ", ".join(map(named_level, names, levels))
        everything.append((text, here))
    return everything


def _interval_lines(
    estimates: Sequence[IntervalEstimate], rows: Array, colour: str, marker: str, *, label: str
) -> list[Line]:
    """Make a marker with its horizontal interval in each row, whose ends are strokes."""
    lines = [
        Line(np.array([each.low, each.high]), np.full(2, row), colour, "", 1.6, marker="|", marks=0)
        for each, row in zip(estimates, rows, strict=True)
        if np.isfinite(each.low)
    ]
    at = np.array([each.value for each in estimates])
    shown = np.where(np.isfinite(at), rows, np.nan)
    return [*lines, Line(at, shown, colour, label, dots=True, marker=marker)]


def distributions(study: StudyData, metric: str) -> FigureSpec | None:
    """Draw the cumulative distribution of the metric, by case and law."""
    if study.is_map:  # see `cases`
        return None
    flights, values = study.flights, study.flights.metrics[metric]
    lines: list[Line] = []
    groups = flights.groups
    for k, group in enumerate(groups[: len(STYLES)]):
        of_case = group.flights
        name = group.label or flights.case_labels[0]
        known = np.sort(values[of_case & flights.completed & np.isfinite(values)])
        if known.size < MIN_CASE_FLIGHTS:
            continue
        at = decimate_evenly(known.size)
        steps = _steps(known[at], (at + 1.0) / int(of_case.sum()), *STYLES[k], label=name)
        lines.append(replace(steps, dashes=DASHES[k % len(DASHES)], marker_phase=k / len(groups)))
    if not lines:
        return None
    drawn = np.concatenate([line.x for line in lines])
    panel = Panel(
        "", axis_label(metric), "share of flights", lines,
        y_limits=(0.0, 1.02), x_log=needs_log_axis(drawn),
    )  # fmt: skip
    caption = (
        f"Share of all flights of a case whose {metric} is at most the value on the horizontal"
        " axis. A curve that ends below 1 lacks flights that were lost or failed."
    )
    title = f"{metric_title(metric)}, distribution"
    return FigureSpec(title, caption, [[panel]], 3.6)


def _steps(x: Array, y: Array, colour: str, marker: str, *, label: str) -> Line:
    return Line(np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], colour, label, 1.5, marker=marker)
