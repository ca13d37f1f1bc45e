"""Draw panel grids as files or SVG text; the only module that imports Matplotlib.

No display is needed and no global state is changed. The same grid gives the same bytes, whatever
settings of Matplotlib the user has.
"""

from __future__ import annotations

import io
import locale
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.errors import InputError, needs_extra
from testbed.core.files import write_file
from testbed.views.figure_style import (
    DEFAULT_STYLE,
    TEXT_PT,
    TITLES_IN,
    FigureStyle,
    renamed,
    shares_axis,
    wrapped,
)
from testbed.views.panels import GREY, GRID, FieldMap, Heatmap, Line, Panel, PanelGrid


def _import_whatever_is_set() -> None:
    """Import Matplotlib, which fails where settings name what is not here: a backend, a locale."""
    names = "MPLBACKEND", "MATPLOTLIBRC", "LC_ALL"
    users = {name: os.environ[name] for name in names if name in os.environ}
    # all variables of the user; none; the locale that Python has, which a setting lets it set again
    for variables in (users, {}, {"LC_ALL": locale.setlocale(locale.LC_CTYPE)}):
        for name in names:
            os.environ.pop(name, None)
        os.environ.update(variables)
        try:
            import matplotlib  # noqa: F401
        except ImportError:
            raise
        except Exception:  # any of its own
            for name in [each for each in sys.modules if each.partition(".")[0] == "matplotlib"]:
                del sys.modules[name]  # a part of it
        else:
            return
        finally:
            os.environ.pop("LC_ALL", None)
            os.environ.update(users)


with needs_extra("report", "figures"):
    _import_whatever_is_set()
    import matplotlib
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import (
        FixedLocator,
        FuncFormatter,
        LogLocator,
        MaxNLocator,
        NullFormatter,
        NullLocator,
    )

DOTS_PER_INCH = 100  # of the layout
SVG_DPI = 72.0  # in which Matplotlib draws SVG
DEFAULT_FONT = "DejaVu Sans"  # comes with Matplotlib
PNG_DOTS_PER_INCH = 200  # with text of 12 points; more where it is smaller
LEGEND_IN = 0.35  # height of a legend row, inches
KEY_IN, LETTER_IN = 0.8, 0.095  # width of a legend key and of a letter, inches
TICK_LETTER_IN = 0.08  # width of a letter of a text in place of a number
MAX_TICK = 30  # letters of a line of such a text
MIN_ROOM_IN = 1.5  # width of a panel's title at least
TICKS_IN, AXIS_IN = 0.35, 0.25  # height of the numbers of an axis and of its label, inches
TITLE_PT, NAME_PT = 6.0, 12.5  # distance of a title, and height of a line of names of spans
SMALL_PT = 10.5  # size of the smallest text: 7 points in a paper
LEAST_RANGE = 1e-3  # of an axis, as a part of its numbers: less would show rounding
MAX_DECADES = 4.0  # of a logarithmic axis with ticks within decades, as plain numbers
HEAT_COLOURS = "cividis"  # the same order for colour-blind readers, and in grey
HEAT_STEPS = 32
FIELD_COLOURS = "viridis"  # as safe, and without the greys of the hatched area
DEGREE_STEPS = (1, 1.5, 3, 4.5, 9, 10)  # of ticks: 15, 30, 45, 90 degrees
MIN_DEGREES = 45.0  # of an axis with them
# Text on a cell, by its lightness; not exactly black and white, which a dark page inverts.
ON_LIGHT, ON_DARK = "#010101", "#fefefe"
SHADE, HATCH, EDGE = "#97979c", "#b6b6ba", "#d55e01"  # of the hatched area of a map
POSITION_DECIMALS = 6  # of panels, in widths and heights of the figure
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
    "axes.formatter.useoffset": False,  # numbers stand at the axis in full, without "+1" above it
    "axes.formatter.limits": (-30, 30),
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.fontsize": 11.5,
    "svg.hashsalt": "testbed",
    "pdf.fonttype": 42,  # text stays text
}


# Sizes that `STYLE` leaves at Matplotlib's defaults, points; with those of `STYLE` they are scaled.
SIZES: dict[Any, Any] = {
    "axes.linewidth": 0.8,
    "axes.labelpad": 4.0,
    **{f"{axis}tick.major.{size}": 3.5 for axis in "xy" for size in ("size", "pad")},
    **{f"{axis}tick.major.width": 0.8 for axis in "xy"},
    **{f"{axis}tick.minor.size": 2.0 for axis in "xy"},
    **{f"{axis}tick.minor.width": 0.6 for axis in "xy"},
}


@contextmanager
def _settings(style: dict[Any, Any]) -> Iterator[None]:
    """Use Matplotlib's defaults with a style in the block, in place of the user's settings."""
    defaults: Any = matplotlib.rcParamsDefault
    with matplotlib.rc_context():
        # no backend is needed: each format has its canvas
        matplotlib.rcParams.update({k: defaults[k] for k in defaults if "backend" not in k})
        matplotlib.rcParams.update(style)
        yield


def _style(scale: float) -> dict[Any, Any]:
    """Return the style with all sizes times a factor."""
    if scale == 1.0:
        return STYLE
    sizes = {**SIZES, **STYLE}
    return {key: each * scale if isinstance(each, float) else each for key, each in sizes.items()}


def save_figure(grid: PanelGrid, path: Path, style: FigureStyle = DEFAULT_STYLE) -> None:
    """Write a figure as PNG, PDF or SVG, by the suffix of the path.

    Args:
        grid: to draw.
        path: of the file.
        style: of the figure.

    Raises:
        OSError: The file cannot be written.
    """
    ending = path.suffix.lower()
    scale = style.text_pt / TEXT_PT
    grid = style.lay_out(grid)
    width, height = grid.inches
    grid = replace(grid, inches=(width / scale, height / scale))
    with _settings(_style(scale) | _font(style.font)):
        figure = _figure(grid, titled=style.titled, scale=scale)
        with write_file(path) as file:
            figure.savefig(
                file, format=ending[1:], dpi=PNG_DOTS_PER_INCH / scale, metadata=UNDATED[ending]
            )  # fmt: skip


def _font(family: str) -> dict[Any, Any]:
    """Return the settings of a font, whose missing letters are Matplotlib's own."""
    if not family:
        return {}
    mathematics = dict.fromkeys(("rm", "sf", "tt", "cal"), family)
    mathematics |= {"it": f"{family}:italic", "bf": f"{family}:bold", "bfit": f"{family}:bold"}
    return {
        "font.family": [family, DEFAULT_FONT],
        "mathtext.fontset": "custom",
        **{f"mathtext.{name}": each for name, each in mathematics.items()},
    }


def check_font(family: str) -> None:
    """Check that a font is there.

    Raises:
        InputError: it is not; with those that are.
    """
    from matplotlib.font_manager import get_font_names

    known = sorted(get_font_names())
    if family not in known:
        raise InputError(f"{family}: is not installed (write one of {', '.join(known)})")


def _drawable(text: str) -> str:
    """Return a text whose parts in $...$ are as they stand where they are no mathematics."""
    return text.replace("$", r"\$") if mathematics_problem(text) else text


def mathematics_problem(text: str) -> str:
    """Return what is wrong with the parts of a text in $...$; "" if nothing is."""
    if text.count("$") < 2:
        return ""
    from matplotlib.mathtext import MathTextParser

    try:
        MathTextParser("path").parse(text)
    except ValueError as error:
        return str(error).strip().splitlines()[-1]
    return ""


def figure_svg(grid: PanelGrid) -> str:
    """Draw a figure as SVG text without titles, on a transparent background; text stays text."""
    text = io.StringIO()
    with _settings({**STYLE, "svg.fonttype": "none"}):
        figure = _figure(grid, titled=False)
        # Matplotlib would draw a figure with a layout twice, first to lay it out.
        FigureCanvasSVG(figure)
        figure.dpi = SVG_DPI
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
        figure.set_layout_engine(None)
        figure.savefig(text, format="svg", metadata=UNDATED[".svg"], transparent=True)
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
    content = renamed(content, _drawable)
    width, height = content.inches  # and all lengths below: before they are scaled
    layout = _RoundedLayout(wspace=0.04, hspace=0.06)
    figure = Figure(figsize=(scale * width, scale * height), dpi=DOTS_PER_INCH, layout=layout)
    # one legend for all panels: a label means the same in each
    named: dict[str, Any] = {}
    grid = figure.add_gridspec(len(content.rows), len(content.widths), width_ratios=content.widths)
    # maps that share a scale, in a row or in the only column
    heats: dict[tuple[int, tuple[float, float], str], list[Axes]] = {}
    rooms = _label_rooms(content, titled=titled)
    for i, panels in enumerate(content.rows):
        beneath = content.rows[i + 1] if i + 1 < len(content.rows) else ()
        for k, panel in enumerate(panels):
            ax = figure.add_subplot(grid[i, k])
            _fill(ax, panel, scale)
            _label(ax, panel, rooms[k], scale)
            if k < len(beneath) and shares_axis(panel, beneath[k]):
                ax.set_xlabel("")
                ax.tick_params(axis="x", labelbottom=False)
            if k and panel.y_label == panels[k - 1].y_label:
                ax.set_ylabel("")
            above = content.rows[i - 1] if i else ()
            if k < len(above) and panel.title == above[k].title:
                ax.set_title("")
            coloured = panel.heat or panel.field
            if coloured is not None and panel.drawn:
                row = i if len(content.widths) > 1 else 0
                key = row, coloured.limits, coloured.label
                heats.setdefault(key, []).append(ax)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                named.setdefault(label, handle)
            if panel.field is not None:
                named |= _field_legend(panel.field, scale)
    for (_, _, label), axes in heats.items():
        up = rooms[0][1] * (len(axes) if len(content.widths) == 1 else 1)
        bar = figure.colorbar(axes[0].collections[0], ax=axes, label=wrapped(label, up))
        if isinstance(axes[0].collections[0].norm, LogNorm):
            _set_plain_log_ticks(bar.ax.yaxis)
    longest = max(map(len, named), default=0)
    abreast = max(int(width / (KEY_IN + LETTER_IN * longest)), 1)
    rows = -(-len(named) // abreast)
    height += max(rows - 1, 0) * LEGEND_IN  # a long legend makes no panel flatter
    figure.set_size_inches(scale * width, scale * height)
    if titled:
        first, second = 1.0 - 0.32 / height, 1.0 - 0.63 / height
        figure.text(0.012, first, content.title, size=17 * scale, weight="bold", va="center")
        figure.text(
            0.012, second, content.subtitle, size=12.5 * scale, va="center", color="#404040"
        )
    top = TITLES_IN / height if titled else 0.0
    bottom = rows * LEGEND_IN / height
    layout.set(rect=(0.0, bottom, 1.0, 1.0 - bottom - top))
    if named:
        figure.legend(
            named.values(), named.keys(), loc="lower left", ncols=-(-len(named) // rows),
            bbox_to_anchor=(0.004, 0.0), borderaxespad=0.2,
        )  # fmt: skip
    return figure


def _label_rooms(content: PanelGrid, *, titled: bool) -> list[tuple[float, float]]:
    """Return how many letters fit below and beside the panels of each column, about."""
    width, height = content.inches
    shares = [share / sum(content.widths) for share in content.widths]
    rows = len(content.rows)
    high = (height - TITLES_IN * titled - LEGEND_IN) / rows - TICKS_IN - AXIS_IN / rows
    rooms = []
    for k, share in enumerate(shares):
        ticks = [text for row in content.rows if k < len(row) for _, text in row[k].y_ticks]
        longest = min(max(map(len, ticks), default=0), MAX_TICK)
        beside = TICKS_IN + TICK_LETTER_IN * longest if longest else KEY_IN
        across = max(width * share - beside, MIN_ROOM_IN)
        rooms.append((across / LETTER_IN, high / LETTER_IN))
    return rooms


def _label(ax: Axes, panel: Panel, room: tuple[float, float], scale: float) -> None:
    """Write title and labels of a panel, in lines that fit."""
    across, up = room
    names = max((span.level + 1 for span in panel.spans if span.name), default=0)
    ax.set_title(wrapped(panel.title, across), pad=scale * (TITLE_PT + NAME_PT * names))
    ax.set_xlabel(wrapped(panel.x_label, across))
    ax.set_ylabel(wrapped(panel.y_label, up))


def _fill(ax: Axes, panel: Panel, scale: float = 1.0) -> None:
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
            span.name, (span.start, 1.0), (1.0, scale * (3.0 + NAME_PT * span.level)),
            xycoords=ax.get_xaxis_transform(), textcoords="offset points",
            va="bottom", size=SMALL_PT * scale, annotation_clip=False,
        )  # fmt: skip
    for at, colour in panel.marks:
        ax.axvline(at, color=colour, lw=0.9, ls=(0, (1, 2)))
    for band in panel.bands:
        ax.fill_between(
            band.x, band.low, band.high, color=band.colour, alpha=band.opacity, lw=0,
            label=band.label,
        )  # fmt: skip
    for line in panel.lines:
        shown = bool(np.isfinite(line.y).any())  # else a legend entry would have no mark
        ax.plot(
            line.x,
            line.y,
            color=line.colour,
            label=line.label if line.label and shown else None,
            **_line_style(line, scale),
            clip_on=panel.field is None,
            zorder=4 if panel.field is not None else None,
        )
    for word in panel.words:
        ax.annotate(
            word.text, (word.x, word.y), (2.0 * scale, 2.0 * scale), textcoords="offset points",
            color=word.colour, size=SMALL_PT * scale, annotation_clip=False,
        )  # fmt: skip
    if panel.equal:
        ax.set_aspect("equal", adjustable="datalim")
        return
    if panel.heat is not None:
        _fill_heat(ax, panel.heat, scale)
    if panel.field is not None:
        _fill_field(ax, panel.field, scale)
    if panel.y_ticks and not panel.x_ticks:
        ax.locator_params(axis="x", nbins=5)  # few: long numbers need space
    for axis, ticks in ((ax.xaxis, panel.x_ticks), (ax.yaxis, panel.y_ticks)):
        if ticks:
            axis.set_ticks([at for at, _ in ticks], [wrapped(text, MAX_TICK) for _, text in ticks])
            axis.set_minor_locator(NullLocator())
    ax.set(xlim=panel.x_limits, ylim=panel.y_limits)
    low, high = ax.get_ylim()
    least = LEAST_RANGE * max(abs(low), abs(high))
    if not (panel.y_limits or panel.y_log) and high - low < least:
        ax.set_ylim(0.5 * (low + high - least), 0.5 * (low + high + least))
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


def _fill_heat(ax: Axes, heat: Heatmap, scale: float) -> None:
    colours = matplotlib.colormaps[HEAT_COLOURS].resampled(HEAT_STEPS).with_extremes(bad=GREY)
    low, high = heat.limits
    ax.pcolormesh(
        np.ma.masked_invalid(heat.values), cmap=colours, vmin=low, vmax=high, lw=0.6, ec=ON_DARK
    )
    for (i, k), value in np.ndenumerate(heat.values):
        if heat.texts:
            red, green, blue, _ = colours((value - low) / (high - low))
            light = 0.299 * red + 0.587 * green + 0.114 * blue > 0.5
            ax.text(
                k + 0.5, i + 0.5, heat.texts[i][k], ha="center", va="center", size=11 * scale,
                color=ON_LIGHT if light else ON_DARK,
            )  # fmt: skip
    ax.grid(False)
    ax.yaxis.labelpad = 9.0 * scale  # an underscore of a key is at the side of the numbers


def _fill_field(ax: Axes, field: FieldMap, scale: float) -> None:
    scaling = (LogNorm if field.logarithmic else Normalize)(*field.limits)
    ax.pcolormesh(
        field.x, field.y, np.ma.masked_invalid(field.values), cmap=FIELD_COLOURS, norm=scaling,
        rasterized=True,
    )  # fmt: skip
    nodes = field.nodes_x, field.nodes_y
    if (field.outside >= 0.5).any():
        with matplotlib.rc_context({"hatch.linewidth": 0.8 * scale, "hatch.color": HATCH}):
            ax.contourf(*nodes, field.outside, levels=[0.5, 1.5], colors=[SHADE], hatches=["//"])
    if field.contour is not None:
        drawn = ax.contour(
            *nodes, np.ma.masked_invalid(field.level), levels=[field.contour],
            colors=[ON_DARK], linewidths=[1.8 * scale],
        )  # fmt: skip
        drawn.set_path_effects(_halo(scale))
    if (field.outside >= 0.5).any() and (field.outside < 0.5).any():
        ax.contour(
            *nodes, field.outside, levels=[0.5], colors=[EDGE], linewidths=[2.6 * scale]
        )  # fmt: skip
    ax.grid(False)
    ax.yaxis.labelpad = 9.0 * scale


def _halo(scale: float) -> list[Any]:
    """Return the effect by which a pale line stands out on every colour."""
    return [withStroke(linewidth=3.6 * scale, foreground=ON_LIGHT)]


def _field_legend(field: FieldMap, scale: float) -> dict[str, Any]:
    out: dict[str, Any] = {}
    if field.contour is not None:
        out[field.contour_label] = Line2D(
            [], [], color=ON_DARK, lw=1.8 * scale, path_effects=_halo(scale)
        )
    if (field.outside >= 0.5).any():
        with matplotlib.rc_context({"hatch.linewidth": 0.8 * scale}):
            out[field.outside_label] = Patch(fc=SHADE, ec=HATCH, hatch="///", lw=0)
        out[field.edge_label] = Line2D([], [], color=EDGE, lw=2.6 * scale)
    return out


def _line_style(line: Line, scale: float) -> dict[str, Any]:
    if line.dots:
        return {
            "ls": "none",
            "marker": line.marker or "o",
            "ms": scale * (8.0 if line.marker == "x" else 6.5 if line.hollow else 4.0),
            **({"mfc": "none"} if line.hollow else {}),
        }
    style: dict[str, Any] = {"lw": scale * line.width, "ls": line.dashes, "solid_capstyle": "butt"}
    if line.marker:
        spacing = max(len(line.x) // line.marks, 1) if line.marks else 1
        style |= {
            "marker": line.marker,
            "ms": scale * (10.0 if line.marker == "|" else 5.0),
            "mfc": "none",
        }
        style["markevery"] = (int(line.marker_phase * spacing), spacing)
    return style
