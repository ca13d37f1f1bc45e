"""Figures of a report: panels with a title and a caption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from testbed.views.panels import Panel, Panel3D, PanelGrid

WIDTH_IN = 11.0  # of all figures


@dataclass(frozen=True, slots=True)
class FigureSpec:
    """Content of a figure."""

    title: str
    caption: str
    rows: Sequence[Sequence[Panel | Panel3D]]
    height_in: float
    widths: Sequence[float] = (1.0,)  # of the columns, relative
    # whether the caption must name the followers that are drawn of many
    needs_selection_note: bool = True


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure ready to draw."""

    name: str  # of its file and its anchor, unique in a report
    title: str
    caption: str  # also its text description
    grid: PanelGrid


def make_figure(name: str, spec: FigureSpec, subtitle: str, note: str = "") -> Figure:
    """Make a figure; `note` is appended to the caption."""
    size_in = (WIDTH_IN, spec.height_in)
    grid = PanelGrid(spec.title, subtitle, spec.rows, spec.widths, size_in)
    return Figure(name, spec.title, spec.caption + note, grid)
