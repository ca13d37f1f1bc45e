"""Figures: distinct colours, labels that do not cover each other, readable axes."""

import contextlib
import io
import itertools
import os
import sys

import matplotlib
import numpy as np
import pytest
from cases import in_full
from fresh import run_fresh
from matplotlib.layout_engine import ConstrainedLayoutEngine
from places import ROOT

from testbed.reports.figure_spec import stack_names
from testbed.views import matplotlib_backend
from testbed.views.panels import BLACK, ON_DARK, ON_WHITE, Line, Panel, PanelGrid, Span, rgb
from testbed.views.scene import BACKDROP

# linear sRGB to cones and to Oklab (B. Ottosson, 2020)
TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
TO_OKLAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
# linear sRGB as seen without red, and without green cones (Machado and others, 2009)
WITHOUT_RED = np.array(
    [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ]
)
WITHOUT_GREEN = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)


def linear(colours):
    share = np.array([rgb(each) for each in colours]) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def least_distance(values):
    """Return the smallest distance of any two linear colours (n, 3) in Oklab, percent."""
    lab = 100.0 * np.cbrt(values @ TO_CONES.T) @ TO_OKLAB.T
    distance = np.linalg.norm(lab[:, None] - lab, axis=-1)
    return distance[np.triu_indices(len(lab), 1)].min()


@pytest.mark.parametrize(
    ("colours", "background"),
    [([*ON_WHITE.values()], "#ffffff"), (ON_DARK, "#{:02x}{:02x}{:02x}".format(*BACKDROP))],
    ids=["white", "dark"],
)
def test_colours_differ_for_all_readers(colours, background):
    values = linear(colours)
    assert least_distance(values) > 9.0
    for seen in (WITHOUT_RED, WITHOUT_GREEN):
        assert least_distance(np.clip(values @ seen.T, 0.0, 1.0)) > 6.0
        assert least_distance(np.clip(values[:6] @ seen.T, 0.0, 1.0)) > 7.0
    luminance = np.append(values, linear([background]), axis=0) @ [0.2126, 0.7152, 0.0722] + 0.05
    contrast = luminance[:-1] / luminance[-1]
    assert np.maximum(contrast, 1.0 / contrast).min() >= 2.95


def drawn(*panels, inches=(11.0, 4.0)):
    """Lay out panels one below the other; return the figure and its axes."""
    grid = PanelGrid("title", "subtitle", [[each] for each in panels], (1.0,), inches)
    with matplotlib.rc_context(matplotlib_backend.STYLE):
        figure = matplotlib_backend._figure(grid, titled=False)  # noqa: SLF001
        figure.draw_without_rendering()
    return figure, figure.axes


def ramp(low, high, label=""):
    return Line(np.linspace(0.0, 1000.0, 50), np.linspace(low, high, 50), BLACK, label)


def test_window_names_are_above_curves_and_apart():
    names = ["rectangles", "circles", "first-leg", "second-leg", "a-long-name-of-a-window"]
    spans = [Span(90.0 * k, 90.0 * k + 80.0, name) for k, name in enumerate(names * 2)]
    panel = Panel("speed", "", "m", [ramp(0.0, 1.0)], spans=stack_names(spans, 1000.0))
    _, (axes,) = drawn(panel)
    texts = [each for each in axes.texts if each.get_text()]
    assert len(texts) == len(spans)
    boxes = [each.get_window_extent() for each in (*texts, axes._left_title)]  # noqa: SLF001
    assert min(box.y0 for box in boxes) >= axes.get_window_extent().y1
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


@pytest.mark.parametrize(
    ("low", "high", "step"), [(-179.0, 180.0, 90.0), (-48.0, 50.0, 30.0), (-6.0, 4.0, 2.0)]
)
def test_angles_have_ticks_at_parts_of_a_right_angle(low, high, step):
    _, (axes,) = drawn(Panel("", "", "°", [ramp(low, high)], y_degrees=True), inches=(11.0, 2.2))
    ticks = [each for each in axes.get_yticks() if low <= each <= high]
    assert len(ticks) >= 3
    assert {*np.diff(ticks)} == {step} and not any(each % step for each in ticks)


@pytest.mark.parametrize(
    ("limits", "labels"),
    [
        ((0.3, 20.0), ["0.5", "1", "2", "5", "10", "20"]),
        ((28.0, 31.0), ["28", "29", "30", "31"]),
        ((0.002, 40.0), None),
    ],
)
def test_logarithmic_axes_have_plain_numbers(limits, labels):
    panel = Panel("", "", "m", [ramp(*limits)], y_log=True, y_limits=limits)
    _, (axes,) = drawn(panel)
    low, high = limits
    texts = [
        tick.label1.get_text()
        for tick in (*axes.yaxis.get_major_ticks(), *axes.yaxis.get_minor_ticks())
        if low <= tick.get_loc() <= 1.0001 * high and tick.label1.get_text()
    ]
    if labels is None:  # many decades: powers of ten
        assert len(texts) >= 3 and all("10^" in each for each in texts)
    else:
        assert {*labels} <= {*texts} and all(float(each) for each in texts)


def test_long_legend_leaves_panels_their_height():
    few, many = (
        drawn(Panel("", "", "m", [ramp(0.0, k, f"curve number {k}") for k in range(count)]))[1][0]
        for count in (2, 30)
    )
    assert many.get_window_extent().height > 0.95 * few.get_window_extent().height


def test_last_digits_of_the_layout_do_not_show(monkeypatch):
    """The layout's solver sorts by addresses in memory, so that sums round in other orders."""
    panels = [Panel(name, "", "m", [ramp(0.0, 1.0, name)]) for name in ("east", "north")]
    grid = PanelGrid("", "", [panels], (1.0, 1.0), (8.0, 4.0))
    first, lay_out = matplotlib_backend.figure_svg(grid), ConstrainedLayoutEngine.execute

    def rounded_otherwise(engine, figure):
        grids = lay_out(engine, figure)
        for ax in figure.axes:
            ax._set_position(ax.get_position(original=True).bounds + np.full(4, 2e-15))
        return grids

    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", rounded_otherwise)
    assert matplotlib_backend.figure_svg(grid) == first


DRAW = """
import hashlib, sys
from pathlib import Path
import numpy as np
from testbed.views.matplotlib_backend import figure_svg, save_figure
from testbed.views.panels import BLACK, FieldMap, Line, Panel, PanelGrid

x = np.linspace(0.0, 30.0, 50)
line = Line(x, np.sin(x), BLACK, "mean_error, 90° − $", marker="o")
panel = Panel("error_m", "time, s", "°", lines=[line])
grid = PanelGrid("a_b", "50 % of 10^3", [[panel]], (1.0,), (4.0, 3.0))
digest = hashlib.sha256(figure_svg(grid).encode())
for name in ("f.png", "f.pdf", "f.svg"):
    save_figure(grid, Path(sys.argv[1]) / name)
    digest.update((Path(sys.argv[1]) / name).read_bytes())
import matplotlib
print(digest.hexdigest(), matplotlib.rcParams["font.size"])
"""
HOSTILE = """
text.usetex: True
path.sketch: 1, 100, 2
axes.spines.left: False
axes.xmargin: 0.5
axes.prop_cycle: cycler(color=['red'])
axes.formatter.use_locale: True
axes.formatter.limits: -1, 1
font.size: 30
font.family: monospace
lines.antialiased: False
savefig.bbox: tight
savefig.facecolor: green
figure.dpi: 30
figure.constrained_layout.use: True
image.cmap: jet
pdf.compression: 0
svg.fonttype: path
toolbar: None
"""
USERS = {
    "hostile": (
        HOSTILE + "backend: TkAgg",
        {
            **{"MATPLOTLIBRC": "matplotlibrc", "MPLBACKEND": "nonsense"},
            **{"TZ": "Asia/Kathmandu", "FORCE_COLOR": "1"},
        },
    ),
    "damaged": (
        "\0nothing: [",
        {
            **{"MPLBACKEND": "QtAgg", "DISPLAY": ""},
            **{"TZ": "Asia/Kathmandu", "LC_ALL": "de_DE", "FORCE_COLOR": "1"},
        },
    ),
    # Matplotlib cannot be imported with this file where the locale is not installed
    "locale": (HOSTILE, {"LC_ALL": "xx_XX"}),
}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Digest of the figures as this process draws them."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out:
        patch.setattr(sys, "argv", ["", tmp_path_factory.mktemp("plain")])
        exec(DRAW, {})
    return out.getvalue().split()[0]


@pytest.mark.parametrize(
    "name", ["hostile", *(pytest.param(each, marks=in_full) for each in ("damaged", "locale"))]
)
def test_settings_of_the_user_change_no_byte(name, plain, tmp_path):
    """Neither of a file and of variables, nor of the place, nor is the file's setting lost."""
    settings, variables = USERS[name]
    (tmp_path / "matplotlibrc").write_text(settings)
    others = {k: v for k, v in os.environ.items() if not k.startswith("MPL")}
    program = f"import sys\nsys.argv = ['', {str(tmp_path)!r}]\n{DRAW}"
    code, output, errors = run_fresh(
        program, folder=tmp_path, paths=[ROOT], env={**others, **variables}
    )
    assert code == 0, errors
    digest, size = output.split()
    assert digest == plain
    assert size == ("30.0" if "font.size" in settings else "10.0"), "the user's settings are lost"
