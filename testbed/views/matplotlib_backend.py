"""Draw panel grids as files or SVG text; the only module that imports Matplotlib.

No display is needed and no global state is changed. The same grid gives the same bytes.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.errors import needs_extra
from testbed.core.files import write_file
from testbed.views.panels import GREY, GRID, Heatmap, Line, Panel, Panel3D, PanelGrid

with needs_extra("report", "figures"):
    import matplotlib
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.ticker import (
        FixedLocator,
        FuncFormatter,
        LogLocator,
        MaxNLocator,
        NullFormatter,
        NullLocator,
    )
    from mpl_toolkits.mplot3d import Axes3D

DOTS_PER_INCH = 100  # of the layout
PNG_DOTS_PER_INCH, PRINT_DOTS_PER_INCH = 200, 400
TEXT_PT = 12.0
TITLES_IN, LEGEND_IN = 0.8, 0.35  # height of the titles and of a legend row, inches
KEY_IN, LETTER_IN = 0.8, 0.095  # width of a legend key and of a letter, inches
TITLE_PT, NAME_PT = 6.0, 12.5  # distance of a title, and height of a line of names of spans
MAX_DECADES = 4.0  # of a logarithmic axis with ticks within decades, as plain numbers
HEAT_COLOURS = "cividis"  # the same order for colour-blind readers, and in grey
HEAT_STEPS = 32
DEGREE_STEPS = (1, 1.5, 3, 4.5, 9, 10)  # of ticks: 15, 30, 45, 90 degrees
MIN_DEGREES = 45.0  # of an axis with them
# Text on a cell, by its lightness; not exactly black and white, which a dark page inverts.
ON_LIGHT, ON_DARK = "#010101", "#fefefe"
POSITION_DECIMALS = 6  # of panels, in widths and heights of the figure
CLEAR = (1.0, 1.0, 1.0, 0.0)
# Without the date, the only thing that differs between two files of the same grid.
UNDATED: dict[str, dict[str, Any]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
STYLE: dict[Any, Any] = {
    "font.size": TEXT_PT,
    "axes.titlesize": 13.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.fontsize": 11.5,
    "svg.hashsalt": "testbed",
    "pdf.fonttype": 42,  # text stays text
}


def save_figure(grid: PanelGrid, path: Path, *, text_pt: float | None = None) -> None:
    """Write a figure as PNG, PDF or SVG, by the suffix of the path.

    Args:
        grid: to draw.
        path: of the file.
        text_pt: for a paper: without titles, and with text of this size in points.

    Raises:
        OSError: The file cannot be written.
    """
    ending = path.suffix.lower()
    print_style: dict[Any, Any] = {}
    if text_pt is not None:
        names = ("font.size", "axes.titlesize", "legend.fontsize")
        print_style = {**dict.fromkeys(names, text_pt), "grid.linewidth": 0.4}
        print_style |= dict.fromkeys(
            ("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.5
        )
    dots = PNG_DOTS_PER_INCH if text_pt is None else PRINT_DOTS_PER_INCH
    with matplotlib.rc_context({**STYLE, **print_style}):
        figure = _figure(grid, titled=text_pt is None, scale=(text_pt or TEXT_PT) / TEXT_PT)
        with write_file(path) as file:
            figure.savefig(file, format=ending[1:], dpi=dots, metadata=UNDATED[ending])


def figure_svg(grid: PanelGrid) -> str:
    """Draw a figure as SVG text without titles, on a transparent background; text stays text."""
    text = io.StringIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "none"}):
        _figure(grid, titled=False).savefig(
            text, format="svg", metadata=UNDATED[".svg"], transparent=True
        )
    return text.getvalue()


class _RoundedLayout(ConstrainedLayoutEngine):
    """A constrained layout, rounded.

    Its solver sorts by addresses in memory: positions differ in their last digits from process to
    process, and with them the names of clip paths in SVG, which are digests of positions.
    """

    def execute(self, fig: Figure) -> Any:  # noqa: ANN401 - the parent's
        grids = super().execute(fig)
        for ax in fig.axes:
            ax.set_position(np.round(ax.get_position(original=True).bounds, POSITION_DECIMALS))
            ax.set_in_layout(True)  # which a position that is set ends
        return grids


def _figure(content: PanelGrid, *, titled: bool, scale: float = 1.0) -> Figure:
    """Draw a grid of panels; `scale` is of its text, which needs the space."""
    legend_in = LEGEND_IN * scale
    width, height = content.inches
    layout = _RoundedLayout(wspace=0.04, hspace=0.06)
    figure = Figure(figsize=content.inches, dpi=DOTS_PER_INCH, layout=layout)
    # one legend for all panels: a label means the same in each
    named: dict[str, Any] = {}
    grid = figure.add_gridspec(len(content.rows), len(content.widths), width_ratios=content.widths)
    for i, panels in enumerate(content.rows):
        for k, panel in enumerate(panels):
            if isinstance(panel, Panel3D):
                ax: Any = figure.add_subplot(grid[i, k], projection=Axes3D.name)
                _fill_3d(ax, panel)
            else:
                ax = figure.add_subplot(grid[i, k])
                _fill(ax, panel)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                named.setdefault(label, handle)
    longest = max(map(len, named), default=0)
    abreast = max(int(width / (scale * (KEY_IN + LETTER_IN * longest))), 1)
    rows = -(-len(named) // abreast)
    height += max(rows - 1, 0) * legend_in  # a long legend makes no panel flatter
    figure.set_size_inches(width, height)
    if titled:
        figure.text(0.012, 1.0 - 0.32 / height, content.title, size=17, weight="bold", va="center")
        below = 1.0 - 0.63 / height
        figure.text(0.012, below, content.subtitle, size=12.5, va="center", color="#404040")
    top = TITLES_IN / height if titled else 0.0
    bottom = rows * legend_in / height
    layout.set(rect=(0.0, bottom, 1.0, 1.0 - bottom - top))
    if named:
        figure.legend(
            named.values(), named.keys(), loc="lower left", ncols=min(len(named), abreast),
            bbox_to_anchor=(0.004, 0.0), borderaxespad=0.2,
        )  # fmt: skip
    return figure


def _fill(ax: Axes, panel: Panel) -> None:
    named = [span for span in panel.spans if span.name]
    name_lines = max((span.level + 1 for span in named), default=0)
    ax.set_title(panel.title, pad=TITLE_PT + NAME_PT * name_lines)
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
    for span in panel.spans:
        ax.axvspan(span.start, span.end, color=GREY, alpha=0.13, lw=0)
        ax.axvline(span.start, color=GREY, lw=0.5)  # the end of the span before
        ax.annotate(
            span.name, (span.start, 1.0), (1.0, 3.0 + NAME_PT * span.level),
            xycoords=ax.get_xaxis_transform(), textcoords="offset points",
            va="bottom", size=10.5, annotation_clip=False,
        )  # fmt: skip
    for at, colour in panel.marks:
        ax.axvline(at, color=colour, lw=0.9, ls=(0, (1, 2)))
    for band in panel.bands:
        ax.fill_between(
            band.x, band.low, band.high, color=band.colour, alpha=band.opacity, lw=0,
            label=band.label,
        )  # fmt: skip
    for line in panel.lines:
        ax.plot(line.x, line.y, color=line.colour, label=line.label or None, **_line_style(line))
    if panel.equal:
        ax.set_aspect("equal", adjustable="datalim")
        return
    if panel.heat is not None:
        _fill_heat(ax, panel.heat)
    if panel.y_ticks and not panel.x_ticks:
        ax.locator_params(axis="x", nbins=5)  # few: long numbers need space
    for axis, ticks in ((ax.xaxis, panel.x_ticks), (ax.yaxis, panel.y_ticks)):
        if ticks:
            axis.set_ticks([at for at, _ in ticks], [text for _, text in ticks])
            axis.set_minor_locator(NullLocator())
    ax.set(xlim=panel.x_limits, ylim=panel.y_limits)
    low, high = ax.get_ylim()
    if panel.y_degrees and abs(high - low) >= MIN_DEGREES:
        ax.yaxis.set_major_locator(MaxNLocator(5, steps=DEGREE_STEPS))
    for axis, logarithmic in ((ax.xaxis, panel.x_log), (ax.yaxis, panel.y_log)):
        if logarithmic and not isinstance(axis.get_major_locator(), FixedLocator):
            _set_plain_log_ticks(axis)


def _set_plain_log_ticks(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis as 0.5, 1 and 20 if it has few decades."""
    low, high = sorted(axis.get_view_interval())
    decades = np.log10(high / low)
    if decades > MAX_DECADES:
        return
    parts = (1.0, 2.0, 5.0) if decades <= 2.0 else (1.0, 3.0) if decades <= 3.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=parts))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _fill_heat(ax: Axes, heat: Heatmap) -> None:
    colours = matplotlib.colormaps[HEAT_COLOURS].resampled(HEAT_STEPS).with_extremes(bad=GREY)
    low, high = heat.limits
    mesh = ax.pcolormesh(
        np.ma.masked_invalid(heat.values), cmap=colours, vmin=low, vmax=high, lw=0.6, ec=ON_DARK
    )
    for (i, k), value in np.ndenumerate(heat.values):
        if heat.texts:
            red, green, blue, _ = colours((value - low) / (high - low))
            light = 0.299 * red + 0.587 * green + 0.114 * blue > 0.5
            ax.text(
                k + 0.5, i + 0.5, heat.texts[i][k], ha="center", va="center", size=11,
                color=ON_LIGHT if light else ON_DARK,
            )  # fmt: skip
    ax.grid(False)
    ax.figure.colorbar(mesh, ax=ax, label=heat.label)


def _line_style(line: Line) -> dict[str, Any]:
    if line.dots:
        return {
            "ls": "none",
            "marker": line.marker or "o",
            "ms": 8.0 if line.marker == "x" else 4.0,
        }
    style: dict[str, Any] = {"lw": line.width, "ls": line.dashes, "solid_capstyle": "butt"}
    if line.marker:
        spacing = max(len(line.x) // line.marks, 1) if line.marks else 1
        style |= {"marker": line.marker, "ms": 5.0, "mfc": "none"}
        style["markevery"] = (int(line.marker_phase * spacing), spacing)
    return style


def _fill_3d(ax: Any, panel: Panel3D) -> None:  # noqa: ANN401 - mplot3d has no types
    ax.set_title(panel.title, loc="left")
    ax.locator_params(nbins=5)
    ax.set(xlabel=panel.x_label, ylabel=panel.y_label, zlabel=panel.z_label)
    ax.view_init(elev=24.0, azim=-58.0)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color(CLEAR)
    for curve in panel.curves:
        ax.plot(curve.x, curve.y, curve.z, color=curve.colour, lw=curve.width)
