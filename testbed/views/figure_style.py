"""How a figure goes to print: width, title, font, and the names that stand in it.

Every command that draws a figure has these as options, by `testbed.cli.figure_options`.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from testbed.views.panels import Panel, PanelGrid

TEXT_PT, PAPER_TEXT_PT = 12.0, 8.0  # of figures; of those with a width
MIN_PANEL_IN = 2.9  # width of a panel of a paper, below which panels stand in one column
MAX_HEIGHT_IN = 9.0  # of the same, so that it is no longer than a page
LEAST_HEIGHT_IN = 0.8  # of a panel of it
TITLES_IN = 0.8  # height of title and subtitle with text of 12 points
NEAR = 3  # names in the error of an unknown one


@dataclass(frozen=True, slots=True)
class FigureStyle:
    """How a figure is drawn.

    Args:
        width_in: inches, with text of `PAPER_TEXT_PT`; None: as wide as its panels need, with text
            of `TEXT_PT`.
        titled: draw title and subtitle.
        font: family of the text; "": Matplotlib's own.
        labels: what stands in the figure in place of a text, or of a name in it.
    """

    width_in: float | None = None
    titled: bool = True
    font: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)

    @property
    def text_pt(self) -> float:
        """Size of the text, points; lines and marks have the same scale."""
        return TEXT_PT if self.width_in is None else PAPER_TEXT_PT

    def lay_out(self, grid: PanelGrid) -> PanelGrid:
        """Return a figure with its labels and its width."""
        if self.labels:
            grid = renamed(grid, _renaming(self.labels))
        if self.width_in is not None:
            grid = fit_width(grid, self.width_in, titled=self.titled)
        return grid


DEFAULT_STYLE = FigureStyle()


def fit_width(grid: PanelGrid, width_in: float, *, titled: bool) -> PanelGrid:
    """Return a figure for a paper, of a width in inches, with text of `PAPER_TEXT_PT`.

    Its panels are in one column where it is narrow. Without a title it is lower.
    """
    scale = PAPER_TEXT_PT / TEXT_PT
    rows, widths = grid.rows, grid.widths
    height_in = grid.inches[1] - TITLES_IN
    if len(widths) > 1 and width_in < len(widths) * MIN_PANEL_IN:
        columns = [[row[k] for row in rows if k < len(row)] for k in range(len(widths))]
        together = all(map(_one_axis, columns))
        panels = [panel for line in (columns if together else rows) for panel in line]
        height_in *= len(panels) / len(rows)
        rows, widths = [[panel] for panel in panels], (1.0,)
    most_in = max(MAX_HEIGHT_IN, LEAST_HEIGHT_IN * len(rows))
    height_in = min(scale * height_in, most_in) + scale * TITLES_IN * titled
    return replace(grid, rows=rows, widths=widths, inches=(width_in, height_in))


def shares_axis(panel: Panel, below: Panel) -> bool:
    """Return whether two panels have the same horizontal axis, which one of them can label."""
    limits = panel.x_limits is not None and panel.x_limits == below.x_limits
    same = (panel.x_label, panel.x_log) == (below.x_label, below.x_log)
    return limits and same and panel.drawn and below.drawn and not panel.x_ticks


def _one_axis(column: list[Panel]) -> bool:
    return len(column) > 1 and all(map(shares_axis, column[:-1], column[1:]))


# Fields of panels and their parts that hold texts of the figure.
_TEXTS = frozenset(
    {"title", "subtitle", "x_label", "y_label", "label", "name", "note", "text", "texts"}
    | {"x_ticks", "y_ticks", "contour_label", "outside_label", "edge_label"}
)
_PARTS = frozenset({"rows", "lines", "bands", "spans", "heat", "field", "words"})


def texts_of(grid: PanelGrid) -> Iterator[str]:
    """Yield all texts of a figure."""
    found: list[str] = []

    def keep(text: str) -> str:
        found.append(text)
        return text

    renamed(grid, keep)
    yield from filter(None, found)


def renamed(part: Any, rename: Callable[[str], str]) -> Any:  # noqa: ANN401 - any part of a figure
    """Return a part of a figure with other texts."""
    if isinstance(part, str):
        return rename(part)
    if isinstance(part, list | tuple):
        return [renamed(each, rename) for each in part]
    if not is_dataclass(part):
        return part  # the position of a tick
    new = {
        each.name: renamed(getattr(part, each.name), rename)
        for each in fields(part)
        if each.name in _TEXTS | _PARTS
    }
    return replace(part, **new)  # type: ignore[type-var]  # an instance


def unknown_labels(names: Iterable[str], grids: Iterable[PanelGrid]) -> dict[str, str]:
    """Return the names that are neither a text of one of the figures nor a name in one.

    Returns:
        The nearest texts and words of the figures, by name.
    """
    texts = dict.fromkeys(text for grid in grids for text in texts_of(grid))
    words = (word for text in texts for word in re.split(r"[,:>·\s]+", text))
    known = dict.fromkeys((*texts, *(word for word in words if len(word) > 1)))
    out = {}
    for name in names:
        if not any(_whole(name).search(text) for text in texts):
            near = difflib.get_close_matches(name, known, n=NEAR, cutoff=0.4)
            out[name] = " or ".join(map(repr, near or [*texts][:NEAR]))
    return out


def _whole(name: str) -> re.Pattern[str]:
    """Return the pattern of a name that is not a part of a longer one."""
    return re.compile(rf"(?<![\w.-]){re.escape(name)}(?![\w-]|\.\w)")


def _renaming(labels: Mapping[str, str]) -> Callable[[str], str]:
    # in one pass, longest first: a label is not renamed again
    names = sorted(labels, key=len, reverse=True)
    any_name = re.compile("|".join(_whole(name).pattern for name in names))
    return lambda text: any_name.sub(lambda found: labels[found[0]], text)


def wrapped(text: str, letters: float) -> str:
    """Break a text at spaces, and keys behind dots, into lines of at most this length if possible.

    Lines that it has stay apart.
    """
    out = []
    for line in text.split("\n"):
        parts = re.split(r"(?<=\s)|(?<=\.)(?=[A-Za-z_*])", line)
        lines = [""]
        for part in parts:
            if lines[-1] and len(lines[-1]) + len(part.rstrip()) > letters:
                lines.append("")
            lines[-1] += part
        out += [each.rstrip() for each in lines]
    return "\n".join(out)
