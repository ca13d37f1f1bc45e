"""Figures as plain numbers: colours, and grids of panels with lines, bands and heat maps.

`matplotlib_backend` draws them. Neighbours in the order of colours differ most. All have a contrast
of at least 3 to 1 with their background. The first on each are Okabe and Ito's; each of the others
was chosen as far as possible from those before it, in Oklab as seen with full, without red and
without green cones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.records import Array

Colour = tuple[int, int, int]  # red, green, blue, 0..255

# on white, by name
ON_WHITE = {
    "blue": "#0072b2",
    "orange": "#d55e00",
    "green": "#009e73",
    "pink": "#a50f5a",
    "violet": "#a078ff",
    "brown": "#5a2800",
    "navy": "#0000b4",
    "purple": "#6900ff",
    "plum": "#4b0069",
    "rust": "#964b00",
}
# on dark, of which a report uses as many as there are on white, by the same names
ON_DARK = (
    "#56b4e9",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#8f6bff",
    "#f0e442",
    "#00e1a5",
    "#a54b0f",
    "#b400c3",
    "#f05a3c",
    "#e1c3ff",
    "#96ffa5",
    "#96b478",
    "#782dff",
    "#5a87d2",
    "#c31e5a",
    "#d23ca5",
    "#b4d269",
    "#c3a5b4",
    "#3c9600",
)


def rgb(colour: str) -> Colour:
    """Convert a colour written as #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


BLUE, ORANGE, GREEN, PINK, VIOLET, BROWN = list(ON_WHITE.values())[:6]
BLACK, GREY = "#000000", "#8c8c8c"
GRID = "#e3e3e3"
PATH = "#c4c4c4"  # of the commanded path, below all other curves
DASHED, DOTTED, DASH_DOTTED = "--", ":", "-."
DASHES = ("-", DASHED, DASH_DOTTED)  # of curves that are seen over each other, where they are equal


@dataclass(frozen=True, slots=True)
class Line:
    """A curve, with gaps where it is NaN."""

    x: Array  # (k,)
    y: Array  # (k,)
    colour: str
    label: str = ""
    width: float = 1.0  # points
    dots: bool = False  # a dot at each number in place of a line
    hollow: bool = False  # dots that show what they cover
    dashes: str = "-"  # or DASHED, DOTTED, DASH_DOTTED
    marker: str = ""  # distinguishes curves without colours: "o", "s", "^", …
    marker_phase: float = 0.0  # 0..1 of the distance between two markers, position of the first
    marks: int = 8  # approximate number of markers; 0: one at each number


@dataclass(frozen=True, slots=True)
class Band:
    """The area between two curves."""

    x: Array  # (k,)
    low: Array  # (k,)
    high: Array  # (k,)
    colour: str
    label: str = ""
    opacity: float = 0.25  # 0..1


@dataclass(frozen=True, slots=True)
class Span:
    """A shaded and named interval of the horizontal axis."""

    start: float
    end: float
    name: str
    level: int = 0  # text lines below the top at which the name stands


@dataclass(frozen=True, slots=True)
class Word:
    """A text beside a curve, in place of a legend entry; right and above its place."""

    x: float
    y: float
    text: str
    colour: str = BLACK


@dataclass(frozen=True, slots=True)
class Heatmap:
    """A grid of cells coloured by their values; the axes count cells from 0."""

    values: Array  # (rows, columns); NaN: a grey cell
    limits: tuple[float, float]  # of the colour scale
    label: str  # of the colour scale
    texts: Sequence[Sequence[str]] = ()  # inside the cells, row by row


@dataclass(frozen=True, slots=True)
class FieldMap:
    """A quantity over a plane, with contours and an area in which it has no meaning.

    Corners are those of a grid, along both axes; a cell lies between them.
    """

    x: Array  # (columns + 1,) corners
    y: Array  # (rows + 1,) corners
    values: Array  # (rows, columns) of cells; NaN: without colour
    limits: tuple[float, float]  # of the colour scale
    label: str  # of the colour scale
    logarithmic: bool  # colour scale
    nodes_x: Array  # (k,) of the contours
    nodes_y: Array  # (m,)
    level: Array  # (m, k) quantity of the contour at nodes; NaN: unknown
    contour: float | None  # its value; None: none is drawn
    contour_label: str
    outside: Array  # (m, k) at nodes; the area where it is 0.5 or more is hatched, and has an edge
    outside_label: str
    edge_label: str


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
    note: str = ""  # text inside the axes when there is nothing to draw
    spans: Sequence[Span] = ()
    marks: Sequence[tuple[float, str]] = ()  # positions and colours of vertical lines
    equal: bool = False  # the same scale on both axes, which fit the lines
    x_ticks: Sequence[tuple[float, str]] = ()  # positions and texts in place of numbers
    y_ticks: Sequence[tuple[float, str]] = ()
    y_degrees: bool = False  # ticks at parts of a right angle
    words: Sequence[Word] = ()
    heat: Heatmap | None = None  # below the lines
    field: FieldMap | None = None  # below the lines

    @property
    def drawn(self) -> bool:
        """Whether there is a finite number to draw."""
        if self.heat is not None and bool(np.isfinite(self.heat.values).any()):
            return True
        if self.field is not None:
            return True
        return any(bool(np.isfinite(line.y).any()) for line in self.lines)


@dataclass(frozen=True, slots=True)
class PanelGrid:
    """A figure: rows of panels below a title."""

    title: str
    subtitle: str
    rows: Sequence[Sequence[Panel]]
    widths: Sequence[float]  # of the columns, relative
    inches: tuple[float, float] = (16.0, 10.0)  # width, height


def unique_values(values: ArrayLike) -> list[float]:
    """List the distinct numbers in order."""
    return [float(value) for value in np.unique(np.asarray(values, dtype=np.float64))]


def break_at_wrap(angle: Array) -> Array:
    """Copy angles (K, ...) in degrees within ±180, with NaN where they wrap around."""
    jump = np.abs(np.diff(angle, axis=0)) > 180.0
    out = angle.copy()
    out[1:][jump] = np.nan
    return out
