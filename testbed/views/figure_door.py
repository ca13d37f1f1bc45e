"""The only place that knows Matplotlib: a sheet of panels becomes a file.

No display is needed and no global state is touched. The same sheet gives the same bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from testbed.views.panels import Panel, Sheet

WIDTH, HEIGHT, DOTS_PER_INCH = 1600, 1000, 100  # pixels of a PNG
PANELS = (0.0, 0.035, 1.0, 0.885)  # left, bottom, width, height: what titles and legend leave
# What would differ between two files of the same sheet: when it was drawn.
UNDATED: dict[str, dict[str, Any]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
STYLE: dict[Any, Any] = {
    "font.size": 12.0,
    "axes.titlesize": 13.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.fontsize": 11.5,
    "svg.hashsalt": "testbed",
    "pdf.fonttype": 42,  # letters stay letters
}


def draw(sheet: Sheet, path: Path) -> None:
    """Write a sheet as PNG (1600 × 1000), PDF or SVG, as the name's ending says.

    Raises:
        OSError: it cannot be written.
    """
    with matplotlib.rc_context(STYLE):
        size = (WIDTH / DOTS_PER_INCH, HEIGHT / DOTS_PER_INCH)
        layout = ConstrainedLayoutEngine(rect=PANELS, wspace=0.04, hspace=0.06)
        figure = Figure(figsize=size, dpi=DOTS_PER_INCH, layout=layout)
        figure.text(0.012, 0.968, sheet.title, size=17, weight="bold", va="center")
        figure.text(0.012, 0.937, sheet.subtitle, size=12.5, va="center", color="#404040")
        axes = figure.subplots(
            len(sheet.rows), len(sheet.widths), squeeze=False, width_ratios=sheet.widths
        )
        named: dict[str, Any] = {}
        for row, panels in zip(axes, sheet.rows, strict=True):
            for ax, panel in zip(row, panels, strict=True):
                _fill(ax, panel)
                for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                    named.setdefault(label, handle)
        if named:  # one legend for all: a curve means the same everywhere
            figure.legend(
                named.values(), named.keys(), loc="lower left", ncols=len(named),
                bbox_to_anchor=(0.004, 0.0), borderaxespad=0.2,
            )  # fmt: skip
        ending = path.suffix.lower()
        figure.savefig(path, format=ending[1:], metadata=UNDATED[ending])


def _fill(ax: Axes, panel: Panel) -> None:
    ax.set_title(panel.title)
    ax.set_xlabel(panel.x_label)
    ax.set_ylabel(panel.y_label)
    if not panel.drawn:
        ax.text(0.5, 0.5, panel.note, transform=ax.transAxes, ha="center", va="center")
        ax.set_xticks([])
        ax.set_yticks([])
        return
    if panel.x_log:
        ax.set_xscale("log")
    if panel.y_log:
        ax.set_yscale("log")
    for band in panel.bands:
        ax.fill_between(
            band.x, band.low, band.high, color=band.colour, alpha=0.25, lw=0, label=band.label
        )
    for line in panel.lines:
        mark: dict[str, Any] = {"lw": line.width}
        if line.dots:
            mark = {"ls": "none", "marker": "o", "ms": 4.0}
        ax.plot(line.x, line.y, color=line.colour, label=line.label or None, **mark)
    ax.set(xlim=panel.x_limits, ylim=panel.y_limits)
