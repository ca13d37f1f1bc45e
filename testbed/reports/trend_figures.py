"""Figures of numbers over commits: what golden tables compare, with one value for each commit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.reports.figure_spec import Figure, FigureSpec, make_figure
from testbed.reports.plot_selection import STYLES
from testbed.views.panels import DASHED, Line, Panel

MAX_TICKS = 8  # of the commits' axis
MAX_LABEL = 14  # letters of a tick

Values = Sequence[float | None]  # (K,), by commit


@dataclass(frozen=True, slots=True)
class TrendCurve:
    """A number over K commits.

    Args:
        panel: window; "" where the quantity has none.
        name: follower; "" where the quantity has one number.
        measured: (K,).
        golden: (K,) of the golden table at the time.
    """

    panel: str
    name: str
    measured: Values
    golden: Values


def trend_figures(
    scenario: str, labels: Sequence[str], quantities: Mapping[str, Sequence[TrendCurve]]
) -> Iterator[Figure]:
    """Yield a figure for each quantity: its curves over the commits.

    Args:
        scenario: name.
        labels: (K,) of the commits.
        quantities: curves, by the label of the quantity with its unit.
    """
    for label, curves in quantities.items():
        names = dict.fromkeys(curve.panel for curve in curves)
        by_panel = {name: [each for each in curves if each.panel == name] for name in names}
        panels = [_panel(name, label, own, labels) for name, own in by_panel.items()]
        caption = "Measured numbers; dashed: those of the golden table at the time."
        more = max(map(len, by_panel.values())) - len(STYLES)
        if more > 0:
            caption += f" Of up to {more} more in a panel the table has the numbers."
        title = f"{label[0].upper()}{label[1:]}"
        spec = FigureSpec(title, caption, [[panel] for panel in panels], 1.6 + 2.6 * len(panels))
        slug = re.sub(r"[^A-Za-z0-9_]+", "-", f"{scenario}-{label}").strip("-")
        span = f"{len(labels)} results, {labels[0]} to {labels[-1]}"
        yield make_figure(slug, spec, f"{scenario} · {span}; dashed: golden table")


def _panel(title: str, label: str, curves: Sequence[TrendCurve], labels: Sequence[str]) -> Panel:
    x = np.arange(len(labels), dtype=np.float64)
    lines = []
    for curve, (colour, marker) in zip(curves, STYLES, strict=False):
        lines.append(Line(x, _array(curve.golden), colour, width=0.8, dashes=DASHED))
        y = _array(curve.measured)
        lines.append(Line(x, y, colour, curve.name, 1.6, marker=marker, marks=0))
    limits = (-0.5, len(labels) - 0.5)
    across = "kept results, oldest first"
    return Panel(title, across, label, lines, x_ticks=_ticks(labels), x_limits=limits)


def _array(values: Values) -> Array:
    return np.array([math.nan if each is None else each for each in values])


def _ticks(labels: Sequence[str]) -> list[tuple[float, str]]:
    """Return evenly spaced ticks: what stands behind the last hyphen where that is unique."""
    ends = [label.rpartition("-")[2] for label in labels]
    texts = ends if len(set(ends)) == len(ends) else list(labels)
    step = -(-len(labels) // MAX_TICKS)
    chosen = range((len(labels) - 1) % step, len(labels), step)  # the newest among them
    return [(float(k), texts[k][-MAX_LABEL:]) for k in chosen]
