"""Reports of studies: known results, a page without external resources, losses."""

import csv
import io
import json
import math
import re
from dataclasses import replace
from html import unescape
from itertools import product

import numpy as np
import pytest
from cases import ALL, in_full
from commands import call_command, refuse_all
from matplotlib.figure import Figure
from report_pages import CHROMIUM, NEEDS_CHROMIUM, browse, stands_alone
from rich.console import Console
from study_samples import METRIC, PAGE, drawn, factorial, flights_of, study_of, write_study

from testbed.cli.study_report import find_study_file, read_study
from testbed.reports.html import render_page, save_figures
from testbed.reports.study import figures, latex_table, study_page, tables
from testbed.reports.study.page import print_summary
from testbed.reports.study.parameter_plots import parameters
from testbed.reports.study.report_table import format_cell, format_number
from testbed.reports.study.study_data import IntervalEstimate, axis_label, named_level
from testbed.views.figure_style import FigureStyle, fit_width
from testbed.views.matplotlib_backend import figure_svg

SLUG = "windows-laps-mean_rms_m"


@pytest.fixture(scope="module")
def study():
    """A factorial study."""
    return factorial()


@pytest.fixture(scope="module")
def made():
    """A smaller one, and its page."""
    study = factorial() if ALL else factorial(cases=("calm", "gusty"), losses=(0.0, 0.1), speeds=2)
    return study, render_page(study_page(study))


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without figures, which take most of the time."""
    monkeypatch.setattr("testbed.reports.study.page.study_figures", lambda study: iter(()))


def test_report_stands_alone_with_every_figure(made):
    study, text = made
    page = stands_alone(text)
    assert page.figures == [f"{name}-{SLUG}" for name in ("parameters", "heat", "cases", "spread")]
    assert "What &lt;b&gt;matters" in text and "<b>matters" not in text
    assert not re.search(r"[\s\"(>]nan\b", text)
    for row in tables.worst(study).rows:
        assert row[-1] in unescape(text)


def test_report_has_the_statistics_of_the_rows(made):
    study, text = made
    page = stands_alone(text)
    ((metric, case, count, middle, least, *_), *_) = page.tables[0][1:]
    flights = study.flights
    law = next(each for each in flights.parameters if each.key == "controller.law")
    mine = flights.completed & (flights.case_index == 0) & (law.index == 0)
    by_seed = [flights.metrics[METRIC][mine & (flights.seed == seed)].mean() for seed in range(6)]
    assert (metric, case, int(count)) == (METRIC, "calm, paper", mine.sum())
    assert middle.split()[0] == format_number(float(np.median(by_seed)))
    assert least == format_number(float(flights.metrics[METRIC][mine].min()))


def test_cases_are_compared_in_pairs_of_flights(study):
    table = tables.cases(study)
    for k, row in enumerate(table.rows[1:], 1):
        assert row[3].value == pytest.approx(0.5 * k, abs=0.02)  # as they were made
        assert row[3].low < 0.5 * k < row[3].high
        assert (row[4], row[5]) == ("worse", 6)
    assert table.rows[0][5] == 6
    # the effect of a seed exceeds that of a case, and cancels in the difference
    assert table.rows[1][3].high - table.rows[1][3].low < 0.05
    assert table.rows[1][2].high - table.rows[1][2].low > 0.2


def two_cases(seeds, nearer=2.0, uneven=False):
    """Cases of which the second has a smaller error, and comes nearer."""
    random = np.random.default_rng(5)
    rows, separation = [], []
    for (k, case), loss, seed in product(enumerate(("a", "b")), (0.0, 0.2), range(seeds)):
        if uneven and loss and seed > 3:
            continue  # fewer seeds at this point
        rows.append((case, seed, {"network.loss": loss}, 2.0 - k + 0.01 * random.normal()))
        separation.append(6.0 + 3.0 * loss - nearer * k + 0.1 * random.normal())
    study = study_of(flights_of(rows), uneven=uneven)
    metrics = {**study.flights.metrics, "min_separation_m": np.array(separation)}
    return replace(study, flights=replace(study.flights, metrics=metrics))


@pytest.mark.parametrize("uneven", [False, True])
def test_worse_numbers_are_told_beside_the_metric(uneven, undrawn):
    study = two_cases(6, uneven=uneven)
    assert tables.cases(study).rows[1][4] == "better"
    (row,) = tables.side_effects(study).rows
    assert row[:2] == ("b", "smallest separation, m")
    assert (row[2], row[3]) == (pytest.approx(6.3, abs=0.1), pytest.approx(4.3, abs=0.1))
    assert row[4].value == pytest.approx(-2.0, abs=0.1) and row[4].count == 6
    page = render_page(study_page(study))
    assert "paired over 6 seeds" in page
    console = Console(width=120, file=io.StringIO(), record=True)
    print_summary(study, console)
    text = console.export_text()
    assert "what got worse" in text and "smallest separation, m" in text
    harmless = two_cases(6, nearer=0.0, uneven=uneven)
    assert tables.side_effects(harmless) is None
    assert "What got worse" not in render_page(study_page(harmless))


def test_worse_numbers_need_three_seeds(undrawn):
    study = two_cases(2)
    assert tables.side_effects(study).rows == []
    assert tables.cases(study).rows[1][4] == "too few"
    text = "2 seeds are too few for an interval (fly 3 or more)"
    assert text in render_page(study_page(study))
    console = Console(width=120, file=io.StringIO(), record=True)
    print_summary(study, console)
    assert text in console.export_text().replace("\n", " ")


def test_one_seed_has_verdicts_of_one_flight():
    study = two_cases(1)
    row = tables.cases(study).rows[1]
    assert (row[4], row[5]) == ("better, of one flight", 1) and math.isnan(row[3].low)
    assert tables.side_effects(study).rows[0][4].count == 1


def test_effects_are_those_of_the_samples(study):
    found = {row[1:3]: row[3:] for row in tables.effects(study).rows}
    loss, law = found["calm, paper", "network.loss"], found["calm", "controller.law"]
    assert loss[1] - loss[0] == pytest.approx(1.2, abs=0.1)
    assert law[1] - law[0] == pytest.approx(0.3, abs=0.1)
    assert loss[2] > 5.0 * law[2] and loss[3] > 0.5 and math.isnan(law[3])


def test_losses_are_counted_and_first_of_the_worst(study):
    found = {(row[0], row[1]): row[2:] for row in tables.losses(study).rows}
    assert found["all", ""][:3] == (324, 322, 2)
    assert found["case", "calm"][:3] == (108, 106, 2)
    assert sum(row[2] for (what, _), row in found.items() if what == "network.loss") == 2
    worst = tables.worst(study).rows
    assert [row[0] for row in worst[:2]] == ["3", "40"]
    values = [row[2] for row in worst[2:]]
    assert values == sorted(values, reverse=True) and values[0] == np.nanmax(
        study.flights.metrics[METRIC]
    )


def test_parameter_plot_has_curves_bands_crosses(study):
    drawing = parameters(study, METRIC)
    panel = drawing.rows[0][0]
    assert panel.x_label == "network.loss" and panel.y_label == "mean RMS error, laps, m"
    assert panel.title == "air.wind.speed_mps 0"
    calm = panel.lines[0]
    loss, wind, law = study.flights.parameters
    here = (study.flights.case_index == 0) & (loss.index == 1) & (law.index == 0)
    here &= wind.index == 0
    found = study.estimate(METRIC, here, "network.loss/0.1/calm, paper")
    assert (calm.x[1], calm.y[1]) == (0.1, found.value)
    assert (panel.bands[0].low[1], panel.bands[0].high[1]) == (found.low, found.high)
    (crosses,) = [line for line in panel.lines if line.marker == "x"]
    assert crosses.x.tolist() == [0.0, 0.1]


def test_parameter_plot_averages_nothing_in_silence(study):
    """A panel for each level of the other parameters; of too many, a title names the mean."""
    panels = [panel for row in parameters(study, METRIC).rows for panel in row]
    titles = [panel.title for panel in panels]
    assert titles[:3] == [f"air.wind.speed_mps {speed}" for speed in (0, 4, 8)]
    assert titles[3:6] == [f"network.loss {loss}" for loss in (0, 0.1, 0.3)]
    assert titles[6:] == ["mean over network.loss, air.wind.speed_mps"]
    calm = [panel.lines[0].y[0] for panel in panels[:3]]
    assert np.diff(calm) == pytest.approx(0.5, abs=0.05)  # speed / 8, in steps of 4 m/s


def test_cases_are_drawn_at_every_point():
    """Each row is a point, and all points together; ends of intervals are strokes."""
    table = []
    for (k, case), wind, seed in product(enumerate(("a", "b")), (0.0, 4.0), range(5)):
        value = 1.0 + 0.2 * k + 0.1 * wind * k + 0.01 * seed
        table.append((case, seed, {"air.wind.speed_mps": wind}, value))
    study = study_of(flights_of(table))
    left, right = figures.cases(study, METRIC).rows[0]
    assert [text for _, text in left.y_ticks] == ["all points", "speed_mps 0", "speed_mps 4"]
    dots = {line.label: line for line in left.lines if line.dots}
    assert dots["a"].x == pytest.approx([1.02] * 3) and dots["b"].x[2] == pytest.approx(1.62)
    strokes = [line for line in left.lines if line.marker == "|"]
    assert len(strokes) == 6 and all(line.x[0] < line.x[1] for line in strokes)
    (difference,) = [line for line in right.lines if line.dots]
    assert difference.x == pytest.approx([0.4, 0.2, 0.6])


def test_maps_of_a_row_have_one_colour_bar(monkeypatch):
    """As they have one scale."""
    bars = []
    bar = Figure.colorbar
    monkeypatch.setattr(Figure, "colorbar", lambda *a, **more: (bars.append(a), bar(*a, **more))[1])
    made = figures.study_figures(two_laws("case"))
    (heat,) = [each for each in made if each.name.startswith("heat")]
    figure_svg(heat.grid)
    assert 0 < len(bars) < sum(map(len, heat.grid.rows))
    assert len(bars) <= 2 * len(heat.grid.rows)


def test_figures_of_a_paper_have_its_width(study, tmp_path):
    """In inches, with panels in one column, and no title."""
    (figure,) = [each for each in figures.study_figures(study) if each.name.startswith("cases")]
    (path,) = save_figures([figure], tmp_path, "svg", FigureStyle(width_in=3.5, titled=False))
    text = path.read_text()
    assert f'width="{3.5 * 72:g}pt"' in text and "by case -->" not in text
    narrow = fit_width(figure.grid, 3.5, titled=False)
    assert [len(row) for row in narrow.rows] == [1, 1] and narrow.inches[0] == 3.5
    broad = fit_width(figure.grid, 7.0, titled=True)
    assert broad.rows == figure.grid.rows
    assert broad.inches == pytest.approx((7.0, figure.grid.inches[1] * 8 / 12))
    (wide,) = save_figures([figure], tmp_path / "wide", "svg")
    assert f'width="{11 * 72}pt"' in wide.read_text() and "by case -->" in wide.read_text()


def test_latex_table_has_cases_points_and_metrics(study):
    table = latex_table(two_laws("case"))
    lines = table.splitlines()
    assert lines[0].startswith("% made-up: median over seeds [95 % interval], 24 of 24 flights")
    assert lines[1] == r"\begin{tabular}{lllr}" and lines[-1] == r"\end{tabular}"
    head = r"Case & air.wind.speed\_mps & network.loss & Mean RMS error, laps (m) \\"
    assert lines[3] == head and lines[5].startswith("chase & 0 & 0 & 2.00 ")
    assert len(lines) == 3 + 2 + 12 + 2
    # of more than 60 points those of cases and laws; 54 cases and points are few
    assert latex_table(study).count("&") == 4 * (54 + 1)
    assert latex_table(drawn()).count("\\\\") == 2
    odd = replace(two_laws("case"), metrics=("a_b%&#",))
    metrics = odd.flights.metrics | {"a_b%&#": odd.flights.metrics[METRIC]}
    odd = replace(odd, flights=replace(odd.flights, metrics=metrics))
    assert r"A b\%\&\#" in latex_table(odd)


def test_labels_stand_for_cases_and_keys(study, undrawn):
    """In figures, tables and LaTeX; the numbers are those without labels."""
    plain = study
    labels = {"calm": "still air", "gusty": "$w_{20}$ = 8 m/s"}
    flights = replace(plain.flights, case_label=labels, key_label={"network.loss": "loss, %"})
    study = replace(plain, flights=flights)
    assert [row[1].replace("still air", "calm") for row in tables.cases(study).rows][0] == "calm"
    for one, other in zip(tables.cases(plain).rows, tables.cases(study).rows, strict=True):
        assert one[2:] == other[2:]
    page = render_page(study_page(study))
    assert "network.loss" not in page and "still air" in page and ">calm<" not in page
    assert "late" in page  # has no label
    drawn = "".join(map(repr, figures.study_figures(study)))
    assert "network.loss" not in drawn and "still air" in drawn and "'calm" not in drawn
    drawing = parameters(study, METRIC)
    assert drawing.rows[0][0].x_label == "loss, %"
    assert (named_level("loss, %", 3), named_level("law", "a")) == ("loss 3 %", "law a")
    assert {line.label.partition(",")[0] for line in drawing.rows[0][0].lines} >= {*labels.values()}
    assert [text for _, text in figures.cases(study, METRIC).rows[0][0].y_ticks][0] != "calm"
    law = two_laws("case")
    labels = {"chase": "[1] chase & hold, $k_1 = 2$"}
    table = latex_table(replace(law, flights=replace(law.flights, case_label=labels)))
    assert r"{[}1] chase \& hold, $k_1 = 2$ & 0 & 0" in table


def test_wrong_mathematics_of_a_label_is_text():
    study = two_cases(1)
    study = replace(study, flights=replace(study.flights, case_label={"b": r"$\wrong$"}))
    figure = next(figures.study_figures(study))
    assert r"$\wrong$" in figure_svg(figure.grid)


def test_missing_metric_is_said_and_others_are_drawn(tmp_path):
    """A study of an earlier version may name one; a wrong --metric is an error."""
    page = PAGE.replace("mean_rms_m]", "mean_rms_m, max_error_m, min_separation_m]")
    path = write_study(tmp_path / "study.parquet", page=page)
    done = call_command(
        "study-report", path, "--figures", "f", "--json", "it.json", "--latex", "t.tex",
        cwd=tmp_path, code=0, columns=200,
    )  # fmt: skip
    assert "no flight has a number max_error_m: left out" in done.stdout
    assert "No flight has a number max_error_m" in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "it.json").read_text())["missing_metrics"] == ["max_error_m"]
    drawn = {each.name for each in (tmp_path / "f").iterdir()}
    assert {f"parameters-{SLUG}.png", "parameters-min_separation_m.png"} <= drawn
    assert "Smallest separation (m)" in (tmp_path / "t.tex").read_text()
    study = read_study(path, metrics=(), statistic="median")
    assert study.metrics == (METRIC, "min_separation_m") and study.missing == ("max_error_m",)


def test_heat_maps_have_every_pair(study):
    maps = [panel for row in figures.heat_maps(study, METRIC).rows for panel in row]
    first, other = maps[0], maps[6]
    assert (first.x_label, first.y_label) == ("network.loss", "air.wind.speed_mps")
    assert other.y_label == "controller.law" and first.heat.values.shape == (3, 3)
    assert len(maps) == 6 + 3 + 3  # a pair without the law for each case and law
    grown = np.diff(first.heat.values, axis=0)
    assert grown == pytest.approx(0.5, abs=0.12)
    assert sum("lost" in text for row in first.heat.texts for text in row) == 2


@pytest.mark.parametrize(
    ("metric", "label"),
    [
        ("windows.circles.mean_rms_m", "mean RMS error, circles, m"),
        ("windows.laps.rms_m.uav1", "RMS error, uav1, laps, m"),
        ("min_separation_m", "smallest separation, m"),
        ("wind.uav1.rms_mps", "rms, wind, uav1, m/s"),
        ("saturations.uav1.seconds", "saturations, uav1, seconds"),
    ],
)
def test_labels_of_metrics_are_words_with_a_unit(metric, label):
    assert axis_label(metric) == label


def test_panels_of_a_metric_share_a_vertical_axis():
    """One parameter moves the metric by a factor of 100, the other by 3 %."""
    table = []
    for strong, weak, seed in product((0.0, 1.0), (0.0, 1.0), range(4)):
        point = {"network.delay_s": strong, "air.wind.speed_mps": weak}
        table.append(("", seed, point, 0.5 * 100.0**strong * (1.0 + 0.03 * weak)))
    rows = parameters(study_of(flights_of(table)), METRIC).rows
    panels = [panel for row in rows for panel in row]
    assert len(panels) == 2 and all(panel.y_log for panel in panels)
    low, high = panels[0].y_limits
    assert panels[1].y_limits == (low, high) and low < 0.5 < 51.5 < high


def two_laws(kind):
    """The metric rises with the wind for one law and falls for the other; by key or by case."""
    table = []
    for law, wind, seed in product(("chase", "steady"), (0.0, 4.0, 8.0), range(4)):
        value = 2.0 + (0.1 if law == "chase" else -0.1) * wind + 0.001 * seed
        point = {"air.wind.speed_mps": wind, "network.loss": 0.1 * (seed % 2)}
        point |= {"controller.law": law} if kind == "key" else {}
        table.append((law if kind == "case" else "", seed, point, value))
    return study_of(flights_of(table))


@pytest.mark.parametrize("kind", ["key", "case"])
def test_laws_are_kept_apart(kind, undrawn):
    """Pooled, the rank correlation would be 0 and every cell of the map 2."""
    study = two_laws(kind)
    effects = {row[1:3]: row[3:] for row in tables.effects(study).rows}
    ranks = [effects[law, "air.wind.speed_mps"][3] for law in ("chase", "steady")]
    assert ranks == pytest.approx([1.0, -1.0], abs=0.1)
    maps = [panel for row in figures.heat_maps(study, METRIC).rows for panel in row][:2]
    assert [panel.title for panel in maps] == ["chase", "steady"]
    for panel, sign in zip(maps, (1.0, -1.0), strict=True):
        assert panel.heat.values[0] == pytest.approx(
            2.0 + sign * np.array([0.0, 0.4, 0.8]), abs=0.01
        )
    assert maps[0].heat.limits == maps[1].heat.limits
    assert [row[1] for row in tables.overview(study).rows] == ["chase", "steady"]
    curves = parameters(study, METRIC).rows[0][0].lines
    assert [line.label for line in curves] == ["chase", "steady"]
    cards = re.findall(r"<li><b>(.*?)</b><span>(.*?)</span>", study_page(study).head)
    assert [text.rpartition("; ")[2] for _, text in cards[:2]] == ["chase", "steady"]


def test_rows_of_one_and_two_panels_are_drawn():
    """The mean over five winds in the first row, and in the second a panel for each loss."""
    table = []
    for case, loss, wind, seed in product(("a", "b"), (0.0, 0.1), (0, 2, 4, 6, 8), range(2)):
        point = {"network.loss": loss, "air.wind.speed_mps": wind}
        table.append((case, seed, point, 1.0 + loss + 0.1 * wind + 0.1 * seed))
    figure = next(figures.study_figures(study_of(flights_of(table))))
    assert [len(row) for row in figure.grid.rows] == [1, 2]
    text = figure_svg(figure.grid)
    assert "network.loss 0<" in text and "network.loss 0.1<" in text


def test_terminal_tables_break_no_cell():
    console = Console(width=60, file=io.StringIO(), record=True)
    print_summary(two_laws("key"), console)
    text = console.export_text()
    assert " air.wind.speed_mps " in text and "…" not in text


def test_random_design_has_scatter_and_quantiles():
    study = drawn()
    drawing = parameters(study, METRIC)
    (dots, low, middle, high) = drawing.rows[0][0].lines
    assert dots.dots and dots.x.size == 299  # one was lost
    assert (low.y < middle.y).all() and (middle.y < high.y).all()
    # the median of 0.5 + 6 d² + gamma(2, 0.2), whose median is 0.336
    assert middle.y == pytest.approx(0.836 + 6.0 * middle.x**2, abs=0.25)
    rank = {row[1]: row[5] for row in tables.effects(study).rows}
    assert rank["network.delay_s"] > 0.8 and abs(rank["air.sigma"]) < 0.15
    assert study.unit_name == "drawn points"
    names = {figure.name.partition("-")[0] for figure in figures.study_figures(study)}
    assert names == {"parameters", "heat", "spread"}
    assert drawing.rows[0][1].x_log and not drawing.rows[0][0].x_log


def test_report_of_many_flights_is_small():
    study = drawn(5_000)
    drawing = parameters(study, METRIC)
    assert sum(line.x.size for line in drawing.rows[0][0].lines) <= 6_000
    assert figures.distributions(study, METRIC).rows[0][0].lines[0].x.size <= 3_000


@pytest.mark.parametrize("lost", [range(4), ()], ids=["all lost", "nothing varied"])
def test_report_of_edge_cases_is_written(lost):
    table = [("", seed, {"a": 1.0}, 2.0) for seed in range(4)]
    study = study_of(flights_of(table, lost), design="", question="", statistic="mean")
    page = stands_alone(render_page(study_page(study)))
    assert page.figures == []
    assert page.tables[0][1][-1] in ("–", "2.00")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (math.nan, "–"), (0.01234, "0.0123"), (12.345, "12.3"), (1234567.0, "1.23e+06")],
)
def test_numbers_have_three_digits(value, text):
    assert format_number(value) == text
    assert format_cell(IntervalEstimate(value, math.nan, math.nan, 2)) == text


def test_command_writes_report_tables_and_json(tmp_path, undrawn):
    write_study(tmp_path / "logs/studies/radio/20260101T000000Z-aa/study.parquet", lost=(4,))
    done = call_command(
        "study-report", "radio", "--out", "it.html", "--tables", "csv", "--json", "it.json",
        cwd=tmp_path, code=0, columns=200,
    )  # fmt: skip
    command = "testbed run simulation-3 --set network.delay_s=0.1 --seed 2"
    assert "1 lost or failed" in done.stdout and command in done.stdout
    text = (tmp_path / "it.html").read_text("utf-8")
    assert command in text and "What does it cost?" in text and "schema: 1" in text
    with (tmp_path / "csv/overview.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["metric"], row["flights"], float(row["least"])) == (METRIC, "5", 1.0)
    assert {"median [95 %] low", "median [95 %] high"} < set(row)
    found = json.loads((tmp_path / "it.json").read_text())
    assert (found["runs"], found["planned"]) == (6, 6)
    assert found["tables"]["overview"][0]["largest"] == 6.0
    assert found["tables"]["losses"][0]["lost"] == 1


def test_flights_that_left_the_formation_are_counted(undrawn):
    study = drawn(count=8, lost=(1, 2, 3, 4, 5))
    ends = ["formation_lost", "separation_lost", "separation_lost", "failed", "envelope_exceeded"]
    since = np.array([math.nan] * 7 + [3.0])
    lost_at = np.array([math.nan] * 6 + [2.0, math.nan])  # by a fault, in a completed flight
    more = {"recovery.uav1.in_slot_since_s": since, "max_error_m.uav1": np.ones(8)}
    more |= {"recovery.uav2.in_slot_since_s": since, "max_error_m.uav2": np.full(8, math.nan)}
    flights = replace(
        study.flights,
        outcome=["completed", *ends, "completed", "completed"],
        metrics=study.flights.metrics | more | {"lost_at_s.uav1": lost_at},
    )
    text = unescape(render_page(study_page(replace(study, flights=flights))))
    counts = (
        "1 lost or failed, 1 left the formation, 2 lost separation, 1 in overspeed or stall, 1 "
        "completed with a follower out of its slot at the end"
    )
    assert f"not completed: {counts}" in text
    assert counts.replace(", ", " · ") in text


def test_unfinished_study_is_reported_as_such(tmp_path, undrawn):
    path = write_study(tmp_path / "study.parquet", runs=4)
    study = read_study(path, metrics=("min_separation_m",), statistic="mean")
    assert study.metrics == ("min_separation_m",)
    assert (study.planned, study.flights.run.size) == (6, 4)
    assert "The study has not ended" in render_page(study_page(study))
    assert find_study_file(str(tmp_path)) == path


def test_without_metrics_last_window_is_reported(tmp_path):
    page = PAGE.replace("  metrics: [windows.laps.mean_rms_m]\n", "")
    path = write_study(tmp_path / "study.parquet", page=page)
    assert read_study(path, metrics=(), statistic="median").metrics == (METRIC,)


def test_bad_input_error_has_the_remedy(tmp_path):
    write_study(tmp_path / "study.parquet")
    write_study(tmp_path / "empty.parquet", runs=0)
    refuse_all("study_report", tmp_path)


@in_full  # that of test_report.py shows figures of the same kind
@pytest.mark.skipif(CHROMIUM is None, reason=NEEDS_CHROMIUM)
def test_browser_shows_every_figure_without_errors(made, tmp_path):
    assert len(browse(made[1], tmp_path)[0]) == 4
