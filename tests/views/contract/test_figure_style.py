"""Figures for print: width, size of text, labels, axes without offsets, legends with marks."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest

from testbed.views import matplotlib_backend
from testbed.views.figure_style import (
    FigureStyle,
    fit_width,
    shares_axis,
    unknown_labels,
    wrapped,
)
from testbed.views.panels import BLACK, Line, Panel, PanelGrid, Span, Word

X = np.linspace(0.0, 10.0, 30)


def curve(label="", low=0.0, high=1.0):
    return Line(X, np.linspace(low, high, len(X)), BLACK, label)


def panel(y_label="error, m", title="", **more):
    given = {"lines": [curve("uav1"), curve("uav1 > uav2")], "x_limits": (0.0, 10.0)} | more
    return Panel(title, "time, s", y_label, **given)


def drawn(grid, style):
    """Return the axes of a figure as `save_figure` draws them, and all its texts."""
    scale = style.text_pt / 12.0
    laid_out = style.lay_out(grid)
    laid_out = replace(laid_out, inches=tuple(each / scale for each in laid_out.inches))
    with matplotlib.rc_context(matplotlib_backend._style(scale)):
        figure = matplotlib_backend._figure(laid_out, titled=style.titled, scale=scale)
        figure.draw_without_rendering()
    texts = [each for each in figure.findobj(matplotlib.text.Text) if each.get_text()]
    return figure.axes, texts


PAPER = FigureStyle(width_in=3.5, titled=False)


def test_text_of_a_column_has_seven_points():
    """Names of windows, ticks, legend, texts beside curves."""
    full = panel(spans=[Span(1.0, 4.0, "laps")], words=[Word(1.0, 0.5, "0.1")], title="above")
    _, texts = drawn(PanelGrid("t", "s", [[full, full]], (1.0, 1.0), (11.0, 5.0)), PAPER)
    assert {"laps", "0.1", "above", "uav1"} <= {each.get_text() for each in texts}
    assert min(each.get_size() for each in texts) >= 7.0


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0006), (3e7, 3.00001e7), (1e-6, 2e-6)])
def test_numbers_of_an_axis_are_whole(low, high):
    """Nothing above the axis must be added to them, or multiplied with them."""
    grid = PanelGrid("", "", [[panel(lines=[curve("", low, high)])]], (1.0,))
    ((axes,), _) = drawn(grid, PAPER)
    assert axes.yaxis.get_offset_text().get_text() == ""
    ticks = [float(each.get_text().replace("−", "-")) for each in axes.get_yticklabels()]
    assert np.ptp(ticks) > 0.0 and np.ptp(axes.get_ylim()) >= 0.999e-3 * high


def test_legend_has_no_entry_without_a_mark():
    nothing = Line(X, np.full(len(X), np.nan), BLACK, "uav3")
    grid = PanelGrid("", "", [[panel(lines=[curve("uav1"), nothing])]], (1.0,))
    ((axes,), _) = drawn(grid, PAPER)
    assert axes.get_legend_handles_labels()[1] == ["uav1"]


def test_axis_is_labelled_once():
    """By the last of the panels that share it; and of panels beside each other by the first."""
    rows = [[panel("a, m"), panel("a, m")], [panel("b, m"), panel("b, m", x_limits=(0.0, 5.0))]]
    axes, _ = drawn(PanelGrid("", "", rows, (1.0, 1.0)), FigureStyle())
    assert [each.get_xlabel() for each in axes] == ["", "time, s", "time, s", "time, s"]
    assert [each.get_ylabel() for each in axes] == ["a, m", "", "b, m", ""]
    assert not shares_axis(panel(), panel(lines=()))


def test_title_beside_long_names_is_not_cut():
    """It has the width of the axes."""
    ticks = [(0.2, "message loss 0.2, wind 6 m/s"), (0.8, "all")]
    full = panel("", "mean difference from the law of [HBH23]", y_ticks=ticks)
    axes, texts = drawn(PanelGrid("", "", [[full]], (1.0,), (11.0, 4.0)), PAPER)
    title = next(each for each in texts if "mean" in each.get_text())
    assert title.get_window_extent().x1 <= axes[0].figure.bbox.x1


def test_narrow_figure_is_one_column_of_a_page():
    """Panels that share an axis stay together; panels are lowered to the height of a page."""
    rows = [[panel(f"{k}{n}", x_limits=(0.0, 1.0 + k)) for k in range(3)] for n in range(5)]
    narrow = fit_width(PanelGrid("", "", rows, (1.0,) * 3, (16.0, 16.0)), 3.5, titled=False)
    assert [each.y_label for (each,) in narrow.rows][:6] == ["00", "01", "02", "03", "04", "10"]
    assert narrow.inches == (3.5, 12.0)  # 0.8 each
    few = fit_width(PanelGrid("", "", rows[:3], (1.0,) * 3, (16.0, 16.0)), 3.5, titled=False)
    assert few.inches == (3.5, 9.0)


def test_labels_replace_texts_and_names_in_one_pass():
    labels = {"uav1": "uav2", "uav2": "$u_2$", "error, m": "Fehler in m", "laps": "Runden"}
    grid = PanelGrid("uav1 flies", "", [[panel(spans=[Span(0.0, 1.0, "laps")])]], (1.0,))
    style = FigureStyle(labels=labels)
    named = style.lay_out(grid)
    ((one,),) = named.rows
    assert named.title == "uav2 flies" and one.y_label == "Fehler in m"
    assert [each.label for each in one.lines] == ["uav2", "uav2 > $u_2$"]
    assert one.spans[0].name == "Runden" and not one.x_ticks
    ticks = style.lay_out(replace(grid, rows=[[panel(x_ticks=[(0.5, "uav1")])]])).rows[0][0]
    assert [*map(tuple, ticks.x_ticks)] == [(0.5, "uav2")]


@pytest.mark.parametrize(
    ("name", "near"),
    [("uav11", "'uav1'"), ("eror, m", "'error, m'"), ("av1", "'uav1'"), ("uav", "'uav1'")],
)
def test_unknown_label_is_named_with_the_nearest(name, near):
    """A part of a name is no name."""
    grid = PanelGrid("", "", [[panel()]], (1.0,))
    assert near in unknown_labels([name, "uav1", "time, s"], [grid])[name]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("controller.estimators.leader_angular", ["controller.estimators.", "leader_angular"]),
        ("mean RMS error, circles, m", ["mean RMS error, circles,", "m"]),
        ("network.delay_s 0.25", ["network.delay_s 0.25"]),
        ("one\ntwo", ["one", "two"]),
    ],
)
def test_long_labels_break_at_spaces_and_dots(text, lines):
    assert wrapped(text, 24).split("\n") == lines
