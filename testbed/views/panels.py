"""What a still figure shows, as plain numbers: panels of lines and bands, in rows.

The door to the drawing library knows these and nothing of flying.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.state import Array

# Okabe and Ito's palette on white: told apart by colour-blind readers, and in grey by lightness.
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"
# Three more, darkened: on white every one of the six stands out by more than 3 to 1.
PURPLE, GOLD, SKY = "#a14a76", "#a87000", "#2f8fc4"
BLACK, GREY = "#000000", "#8c8c8c"
GRID = "#e3e3e3"
DASHED = "--"


@dataclass(frozen=True, slots=True)
class Line:
    """A curve; where it is not a number it is broken."""

    x: Array  # (k,)
    y: Array  # (k,)
    colour: str
    label: str = ""
    width: float = 1.0  # points
    dots: bool = False  # a dot at each number in place of a line through them
    dashes: str = "-"  # or DASHED
    marker: str = ""  # a shape that tells the curve apart where colours do not: "o", "s", "^", …
    marker_phase: float = 0.0  # 0..1 of the distance between two markers, where the first stands
    marks: int = 8  # about so many markers; 0: one at each number


@dataclass(frozen=True, slots=True)
class Band:
    """The surface between two curves."""

    x: Array  # (k,)
    low: Array  # (k,)
    high: Array  # (k,)
    colour: str
    label: str = ""
    opacity: float = 0.25  # 0..1


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of the horizontal axis, shaded and named."""

    start: float
    end: float
    name: str
    level: int = 0  # lines below the top at which the name stands


@dataclass(frozen=True, slots=True)
class Curve:
    """A curve in space; what it is a panel beside it says, by the same colour."""

    x: Array  # (k,)
    y: Array  # (k,)
    z: Array  # (k,)
    colour: str
    width: float = 1.0  # points


@dataclass(frozen=True, slots=True)
class Space:
    """Three axes, seen from above the nearest corner."""

    title: str
    x_label: str
    y_label: str
    z_label: str
    curves: Sequence[Curve]


@dataclass(frozen=True, slots=True)
class Heat:
    """A grid of cells, coloured by their numbers, on axes that count cells from 0."""

    values: Array  # (rows, columns); where it is not a number the cell is grey
    limits: tuple[float, float]  # where the colours begin and end
    label: str  # of the scale of colours
    texts: Sequence[Sequence[str]] = ()  # said inside the cells, row by row


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line] = ()
    bands: Sequence[Band] = ()
    x_log: bool = False
    y_log: bool = False
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None
    note: str = ""  # said inside the axes, where there is nothing to draw
    spans: Sequence[Span] = ()
    marks: Sequence[tuple[float, str]] = ()  # where vertical lines stand, and their colours
    equal: bool = False  # the same scale on both axes, which fit what is drawn
    x_ticks: Sequence[tuple[float, str]] = ()  # in place of numbers: where, and what is said there
    y_ticks: Sequence[tuple[float, str]] = ()
    heat: Heat | None = None  # below the lines

    @property
    def drawn(self) -> bool:
        """Whether there is a finite number to draw."""
        if self.heat is not None and bool(np.isfinite(self.heat.values).any()):
            return True
        return any(bool(np.isfinite(line.y).any()) for line in self.lines)


@dataclass(frozen=True, slots=True)
class Sheet:
    """A figure: rows of panels below a title."""

    title: str
    subtitle: str
    rows: Sequence[Sequence[Panel | Space]]
    widths: Sequence[float]  # of the columns, relative
    inches: tuple[float, float] = (16.0, 10.0)  # width, height


def each_once(values: ArrayLike) -> list[float]:
    """The numbers that differ, in order."""
    return [float(value) for value in np.unique(np.asarray(values, dtype=np.float64))]


def break_turns(angle: Array) -> Array:
    """Angles (K, ...) in degrees within ±180, not a number in frames where they jump round."""
    jump = np.abs(np.diff(angle, axis=0)) > 180.0
    out = angle.copy()
    out[1:][jump] = np.nan
    return out
