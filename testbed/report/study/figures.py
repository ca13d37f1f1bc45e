"""The figures of a study in their order, each a sheet of panels with a caption."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np

from testbed.report.cast import LOOKS
from testbed.report.drawing import Drawing
from testbed.report.shell import Figure
from testbed.report.study import against
from testbed.report.study.grid import number
from testbed.report.study.numbers import PERCENT, Estimate, student
from testbed.report.study.rows import Parameter, Study
from testbed.report.study.tables import levels_of
from testbed.state import Array
from testbed.views.panels import BLACK, Heat, Line, Panel, Sheet, Space

MOST_METRICS = 4  # that are drawn; all are in the tables
MOST_PAIRS = 6
FEWEST_CELLS = 5  # flights in a cell of a heat map of drawn points, on average
FEWEST_SPREAD = 10  # flights of a case whose distribution is drawn

Maker = Callable[[Study, str], Drawing | None]


def figures_of(study: Study) -> Iterator[Figure]:
    """All figures that the study has something for, metric by metric."""
    makers: Sequence[tuple[str, Maker]] = (
        ("parameters", against.parameters),
        ("heat", heat),
        ("cases", cases),
        ("spread", spread),
    )
    for metric in study.metrics[:MOST_METRICS]:
        slug = re.sub(r"[^A-Za-z0-9_]+", "-", metric)
        for name, make in makers:
            drawing = make(study, metric)
            if drawing is not None:
                subtitle = f"{study.name} · {study.rows.run.size:,} flights of {study.scenario}"
                sheet = Sheet(drawing.title, subtitle, drawing.rows, drawing.widths, drawing.inches)
                yield Figure(f"{name}-{slug}", drawing.title, drawing.caption, sheet)


def heat(study: Study, metric: str) -> Drawing | None:
    """The metric over pairs of parameters."""
    rows = study.rows
    pairs = list(combinations(rows.parameters, 2))[:MOST_PAIRS]
    panels: list[Panel] = []
    for pair in pairs:
        found = _cells(study, metric, *pair)
        if found is not None:
            panels.append(found)
    if not panels:
        return None
    lines = _in_twos(panels)
    text = (
        f"{study.statistic.capitalize()} of {metric} over pairs of parameters, over everything"
        " else; brighter is larger. Below a number is how many flights of the cell were lost or"
        " failed, if any; grey: none was flown well."
    )
    if any(each.continuous for each in rows.parameters):
        text += " Of a parameter with many numbers there are groups of equally many flights."
    count = len(list(combinations(rows.parameters, 2)))
    if count > MOST_PAIRS:
        text += f" Of {count} pairs these are the first {MOST_PAIRS}."
    widths = (1.0,) if len(panels) == 1 else (1.0, 1.0)
    tallest = max(len(panel.y_ticks) for panel in panels)
    height = (1.3 + 0.5 * max(tallest, 4)) * len(lines)
    return Drawing(f"{metric} over pairs", text, lines, height, widths)


def _in_twos(panels: Sequence[Panel]) -> list[list[Panel | Space]]:
    lines: list[list[Panel | Space]] = [[*panels[k : k + 2]] for k in range(0, len(panels), 2)]
    return lines


def _cells(study: Study, metric: str, across: Parameter, up: Parameter) -> Panel | None:
    columns, lines = list(levels_of(across)), list(levels_of(up))
    if study.random and study.rows.run.size < FEWEST_CELLS * len(columns) * len(lines):
        return None
    values = np.full((len(lines), len(columns)), np.nan)
    texts = [[""] * len(columns) for _ in lines]
    for i, (_, below) in enumerate(lines):
        for k, (_, beside) in enumerate(columns):
            here = below & beside
            values[i, k] = study.centre(metric, here)
            bad = int((here & ~study.rows.good).sum())
            texts[i][k] = number(float(values[i, k])) + (f"\n{bad} lost" if bad else "")
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    return Panel(
        "",
        across.key,
        up.key,
        heat=Heat(values, (low, high if high > low else low + 1.0), against.axis_of(metric), texts),
        x_ticks=[(k + 0.5, name.replace(" to ", "\nto ")) for k, (name, _) in enumerate(columns)],
        y_ticks=[(i + 0.5, name) for i, (name, _) in enumerate(lines)],
    )


def cases(study: Study, metric: str) -> Drawing | None:
    """Every case with its interval, and its difference to the first."""
    rows = study.rows
    if len(rows.cases) < 2:
        return None
    each = [
        study.estimate(metric, rows.case_index == k, f"all/{name}")
        for k, name in enumerate(rows.cases)
    ]
    less = [student(study.differences(metric, k)) for k in range(1, len(rows.cases))]
    names = [(float(-k), name) for k, name in enumerate(rows.cases)]
    limits = (-len(rows.cases) + 0.4, 0.6)
    label = against.axis_of(metric)
    panels = [
        Panel(
            f"{study.statistic} of a case", label, "", _forest(each, 0),
            y_ticks=names, y_limits=limits,
        ),
        Panel(
            f"mean difference to {rows.cases[0]}", f"less {rows.cases[0]}: {label}", "",
            _forest(less, 1), y_ticks=names, y_limits=limits, marks=[(0.0, BLACK)],
        ),
    ]  # fmt: skip
    text = (
        f"Left: {study.statistic} of {metric} of each case over {study.unit_name} with its"
        f" {PERCENT} % interval (bootstrap). Right: how much more than {rows.cases[0]}, the mean of"
        f" the differences of the same point and seed with Student's {PERCENT} % interval; one"
        " that holds 0, the dotted line, does not tell them apart."
    )
    height = 1.5 + 0.36 * len(rows.cases)
    return Drawing(f"{metric} by case", text, [panels], height, (1.0, 1.0))


def _forest(found: Sequence[Estimate], first: int) -> list[Line]:
    """A dot for each, from the top down, on the stretch of its interval."""
    colour = LOOKS[0][0]
    lines = [
        Line(np.array([each.low, each.high]), np.full(2, -float(k)), colour, width=2.2)
        for k, each in enumerate(found, first)
        if np.isfinite(each.low)
    ]
    at = np.array([each.value for each in found])
    rows = -np.arange(first, first + len(found), dtype=np.float64)
    return [*lines, Line(at, np.where(np.isfinite(at), rows, np.nan), colour, dots=True)]


def spread(study: Study, metric: str) -> Drawing | None:
    """The distribution of the metric, case by case."""
    rows, values = study.rows, study.rows.metrics[metric]
    lines: list[Line] = []
    for k, name in enumerate(rows.cases[: len(LOOKS)]):
        mine = np.sort(values[(rows.case_index == k) & rows.good & np.isfinite(values)])
        every = int((rows.case_index == k).sum())
        if mine.size < FEWEST_SPREAD:
            continue
        at = against.fewer(mine.size)
        lines.append(_steps(mine[at], (at + 1.0) / every, *LOOKS[k], label=name))
    if not lines:
        return None
    known = np.concatenate([line.x for line in lines])
    panel = Panel(
        "", against.axis_of(metric), "share of flights", lines,
        y_limits=(0.0, 1.02), x_log=against.wide(known),
    )  # fmt: skip
    text = (
        f"Share of all flights of a case whose {metric} is this large or less. A curve that ends"
        " below 1 lacks flights that were lost or failed."
    )
    return Drawing(f"Distribution of {metric}", text, [[panel]], 3.6)


def _steps(x: Array, y: Array, colour: str, marker: str, *, label: str) -> Line:
    return Line(np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], colour, label, 1.5, marker=marker)
