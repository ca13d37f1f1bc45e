"""A metric against each parameter: curves with intervals over levels, scatters over numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, BoolArray
from testbed.reports.figure_spec import FigureSpec
from testbed.reports.plot_selection import STYLES
from testbed.reports.study.study_data import (
    PERCENT,
    Parameter,
    StudyData,
    axis_label,
    format_level,
    metric_title,
    named_level,
    running_quantiles,
)
from testbed.views.panels import BLACK, DASHED, DASHES, Band, Line, Panel

MAX_DOTS = 1500  # of a scatter
MIN_RUNNING = 30  # flights of a scatter with running quantiles
WINDOW = 0.15  # share of the flights in the window of a running quantile
QUANTILES = (0.1, 0.5, 0.9)
MAX_STRONG_BANDS = 3  # of more in a panel, bands are paler, because they cross
MAX_FACETS = 4  # panels of a parameter, for levels of the others; of more, their mean is drawn
ROW_IN = 3.4  # height of a row of panels, inches
MARGIN, LOG_MARGIN = 0.06, 1.2  # of a vertical axis: part of the range, factor
LOG_RATIO = 50.0  # of the largest to the smallest number, above which an axis is logarithmic
EMPTY_NOTE = "no completed flights"


@dataclass(frozen=True)
class CurveGroup:
    """Flights that make one curve of a panel."""

    name: str
    flights: BoolArray  # (R,)
    colour: str
    marker: str
    label: str
    shift: float  # sideways, where levels are not numbers


def needs_log_axis(values: Array) -> bool:
    """Return whether all numbers are above 0 and span a wide range."""
    known = values[np.isfinite(values)]
    return bool(known.size and known.min() > 0.0 and known.max() > LOG_RATIO * known.min())


def decimate_evenly(count: int) -> NDArray[np.intp]:
    """Select up to `MAX_DOTS` indices below `count`, evenly spaced, with first and last."""
    if count <= MAX_DOTS:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, MAX_DOTS).round().astype(np.intp))


def in_pairs(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Arrange panels in rows of two, or one alone."""
    return [[*panels[k : k + 2]] for k in range(0, len(panels), 2)]


def share_vertical_axis(panels: Sequence[Panel]) -> list[Panel]:
    """Give panels of one metric the same vertical axis, so that they can be compared."""
    curves = [line.y for panel in panels for line in panel.lines]
    curves += [end for panel in panels for band in panel.bands for end in (band.low, band.high)]
    drawn = np.concatenate([np.ravel(each) for each in curves]) if curves else np.empty(0)
    drawn = drawn[np.isfinite(drawn)]
    if not drawn.size:
        return list(panels)
    low, high = float(drawn.min()), float(drawn.max())
    if low > 0.0 and any(panel.y_log for panel in panels):
        limits = low / LOG_MARGIN, high * LOG_MARGIN
        return [replace(panel, y_log=True, y_limits=limits) for panel in panels]
    margin = MARGIN * ((high - low) or abs(high) or 1.0)
    return [replace(panel, y_log=False, y_limits=(low - margin, high + margin)) for panel in panels]


@dataclass(frozen=True)
class Facet:
    """Flights that one panel of a parameter shows."""

    title: str  # levels of the other parameters, or what is averaged
    flights: BoolArray  # (R,)


def parameters(study: StudyData, metric: str) -> FigureSpec | None:
    """Draw a panel for each parameter and the levels of the others."""
    flights = study.flights
    if not flights.parameters or study.is_map:  # more points where the metric changes
        return None
    of_parameters: list[list[Panel]] = []
    grouped_by, several, averaged = "", False, False
    for each in flights.parameters:
        scattered = each.continuous and study.random
        groups, by, others = _groups(study, each)
        grouped_by = grouped_by or by
        facets = _facets(study, [] if scattered else others)
        several |= len(facets) > 1
        averaged |= len(facets) == 1 and bool(facets[0].title)
        draw = _scatter if scattered else _curves
        of_parameters.append([draw(study, metric, each, groups, facet) for facet in facets])
    shared = iter(share_vertical_axis([panel for panels in of_parameters for panel in panels]))
    of_parameters = [[next(shared) for _ in panels] for panels in of_parameters]
    if several:  # a row of its own for each parameter
        rows = [row for panels in of_parameters for row in in_pairs(panels)]
    else:
        rows = in_pairs([panel for panels in of_parameters for panel in panels])
    caption = [f"{metric} against each parameter"]
    caption.append(f"; one curve for each of the {grouped_by}" if grouped_by else "")
    caption.append("; a panel for each level of the other parameters." if several else ".")
    if any(not (each.continuous and study.random) for each in flights.parameters):
        caption.append(
            f" Markers: {study.statistic} over {study.unit_name}; shaded, or as vertical lines: its"
            f" {PERCENT} % interval (bootstrap). A black cross: flights at this level were lost or"
            " failed, and are excluded."
        )
    if averaged:
        caption.append(
            f" Where a panel says so, each of the {study.unit_name} is taken as its mean over the"
            " parameters that are named."
        )
    if any(each.continuous and study.random for each in flights.parameters):
        caption.append(
            f" Dots are flights, at most {MAX_DOTS:,} of them, evenly selected; lines are running"
            " quantiles, 10, 50 and 90 % (with several cases, 50 % only), over the nearest"
            f" {WINDOW:.0%} of the flights."
        )
    if len(flights.cases) > len(STYLES):
        caption.append(f" The first {len(STYLES)} of {len(flights.cases)} cases are drawn.")
    title = f"{metric_title(metric)}, against parameters"
    return FigureSpec(title, "".join(caption), rows, ROW_IN * len(rows) + 0.3)


def _facets(study: StudyData, others: Sequence[Parameter]) -> list[Facet]:
    """Return the panels of a parameter: one for each set of levels of the others, or their mean."""
    everything = np.ones(study.flights.run.size, dtype=np.bool_)
    if not others:
        return [Facet("", everything)]
    count = math.prod(len(each.levels) for each in others)
    if study.random or count > MAX_FACETS:
        names = [each.label for each in others]
        return [Facet(f"mean over {', '.join(names)}", everything)]
    facets = []
    for levels in product(*(range(len(each.levels)) for each in others)):
        chosen = list(zip(others, levels, strict=True))
        names = [named_level(each.label, each.levels[k]) for each, k in chosen]
        here = np.logical_and.reduce([each.index == k for each, k in chosen])
        facets.append(Facet("\n".join(names), here))
    return facets


def _groups(
    study: StudyData, parameter: Parameter
) -> tuple[list[CurveGroup], str, Sequence[Parameter]]:
    """Group the flights by case, or with one case and two parameters by the other parameter.

    Returns:
        The groups, in words what they are ("" for a single group), and the parameters that differ
        within a group.
    """
    flights = study.flights
    others = [each for each in flights.parameters if each is not parameter]
    groups = flights.groups
    if parameter is not flights.law and len(flights.by_case) < len(groups) <= len(STYLES):
        spacing = 0.5 / len(groups)
        middle = 0.5 * (len(groups) - 1)
        of_laws = [
            CurveGroup(
                each.name, each.flights, *STYLES[k], each.label, shift=spacing * (k - middle)
            )
            for k, each in enumerate(groups)
        ]
        by = "cases and laws" if len(flights.by_case) > 1 else "laws"
        return of_laws, by, [each for each in others if each is not flights.law]
    names: Sequence[str] = flights.cases
    labels: Sequence[str] = flights.case_labels
    index, by = flights.case_index, "cases"
    if len(flights.cases) == 1:
        other = others[0] if len(others) == 1 and not study.random else None
        if other is None or len(other.levels) > len(STYLES):
            everything = np.ones(flights.run.size, dtype=np.bool_)
            return [CurveGroup("", everything, *STYLES[0], "", shift=0.0)], "", others
        levels = [format_level(level) for level in other.levels]
        names = [f"{other.key} {level}" for level in levels]
        labels = [named_level(other.label, level) for level in other.levels]
        index, by, others = other.index, "levels of the other parameter", []
    count = min(len(names), len(STYLES))
    spacing = 0.5 / max(count, 2)
    # beside curves of cases and laws, cases alone have other colours
    first = len(groups) if len(groups) > len(flights.by_case) else 0
    styles = STYLES[first:] if first + count <= len(STYLES) else STYLES
    of_names = [
        CurveGroup(
            names[k], index == k, *styles[k], labels[k], shift=spacing * (k - 0.5 * (count - 1))
        )
        for k in range(count)
    ]
    return of_names, by, others


def _curves(
    study: StudyData,
    metric: str,
    parameter: Parameter,
    groups: Sequence[CurveGroup],
    facet: Facet,
) -> Panel:
    lines: list[Line] = []
    bands: list[Band] = []
    values: list[Array] = []
    crosses: list[tuple[float, float]] = []
    for group in groups:
        of_group = group.flights & facet.flights
        estimates = [
            study.estimate(
                metric,
                of_group & (parameter.index == k),
                f"{parameter.key}/{format_level(level)}/{group.name}",
            )
            for k, level in enumerate(parameter.levels)
        ]
        x = parameter.numbers + (0.0 if parameter.numeric else group.shift)
        y, low, high = (
            np.array([getattr(each, name) for each in estimates])
            for name in ("value", "low", "high")
        )
        if parameter.numeric:
            dashes = DASHES[len(values) % len(DASHES)]
            lines.append(
                Line(
                    x,
                    y,
                    group.colour,
                    group.label,
                    1.6,
                    dashes=dashes,
                    marker=group.marker,
                    marks=0,
                )
            )
            if np.isfinite(low).any():
                opacity = 0.25 if len(groups) <= MAX_STRONG_BANDS else 0.12
                bands.append(Band(x, low, high, group.colour, opacity=opacity))
        else:
            lines.append(Line(x, y, group.colour, group.label, dots=True, marker=group.marker))
            lines += [
                Line(np.full(2, at), np.array(ends), group.colour, width=2.0)
                for at, *ends in zip(x, low, high, strict=True)
                if np.isfinite(ends).all()
            ]
        values.append(y)
        for k, at in enumerate(x):
            incomplete = of_group & (parameter.index == k) & ~study.flights.completed
            if incomplete.any() and np.isfinite(y[k]):
                crosses.append((float(at), float(y[k])))
    if crosses:
        at, y = np.array(crosses).T
        lines.append(Line(at, y, BLACK, "flights lost or failed", dots=True, marker="x"))
    ticks = [(float(k), format_level(level)) for k, level in enumerate(parameter.levels)]
    limits = (-0.5, len(parameter.levels) - 0.5)
    return Panel(
        facet.title,
        parameter.label,
        axis_label(metric),
        lines,
        bands,
        x_log=parameter.logarithmic,
        y_log=needs_log_axis(np.concatenate(values)),
        x_limits=None if parameter.numeric else limits,
        x_ticks=() if parameter.numeric else ticks,
        note=EMPTY_NOTE,
    )


def _scatter(
    study: StudyData,
    metric: str,
    parameter: Parameter,
    groups: Sequence[CurveGroup],
    facet: Facet,
) -> Panel:
    x, y = parameter.numbers[parameter.index], study.flights.metrics[metric]
    lines: list[Line] = []
    known = study.flights.completed & np.isfinite(y)
    single = len(groups) == 1
    for group in groups:
        rows = np.flatnonzero(group.flights & facet.flights & known)
        rows = rows[np.argsort(x[rows], kind="stable")]
        dots = rows[decimate_evenly(rows.size)]
        lines.append(Line(x[dots], y[dots], group.colour, group.label, dots=True))
        if rows.size < MIN_RUNNING:
            continue
        window = max(int(WINDOW * rows.size), MIN_RUNNING // 3)
        middle, quantiles = running_quantiles(x[rows], y[rows], QUANTILES, window=window)
        at = decimate_evenly(middle.size)
        for share, values in zip(QUANTILES, quantiles, strict=True):
            if single or share == 0.5:
                colour = BLACK if single else group.colour
                dashes = "-" if share == 0.5 else DASHED
                label = f"{share:.0%}" if single else ""
                lines.append(Line(middle[at], values[at], colour, label, 1.8, dashes=dashes))
    return Panel(
        facet.title, parameter.label, axis_label(metric), lines,
        x_log=parameter.logarithmic, y_log=needs_log_axis(y[known]), note=EMPTY_NOTE,
    )  # fmt: skip
