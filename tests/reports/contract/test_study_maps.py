"""Maps of studies: cells of irregular points, the contour, the boundary of lost flights."""

import math
from dataclasses import replace

import numpy as np
import pytest
from commands import call_command
from PIL import Image
from report_pages import stands_alone
from study_samples import METRIC, flights_of, study_of, write_study

from testbed.core.errors import InputError
from testbed.reports.html import figure_html, render_page, save_figures
from testbed.reports.study import latex_table, study_figures, study_page, tables
from testbed.reports.study.maps import study_map
from testbed.views.figure_style import FigureStyle
from testbed.views.matplotlib_backend import figure_svg

X, Y = "network.delay_s", "air.wind.speed_mps"
N = 16  # steps of the full grid along each axis
RADIUS = 0.62  # of the circle beyond which flights are lost


def radius(i, k):
    """Distance of a node from the corner, in widths of the map."""
    return math.hypot(i, k) / N


def is_kept(i, k, contour):
    """The nodes of every fourth column and row, and all near a circle."""
    near = any(abs(radius(i, k) - at) < 1.6 / N for at in (contour, RADIUS))
    return near or (i % 4 == 0 and k % 4 == 0)


def map_of(contour=0.4, seeds=1, share=1.0):
    """A map whose metric is the distance from a corner; flights far from it are lost."""
    table, lost = [], set()
    for i in range(N + 1):
        for k in range(N + 1):
            for seed in range(seeds) if is_kept(i, k, contour) else ():
                if radius(i, k) > RADIUS and seed < share * seeds:
                    lost.add(len(table))
                point = {X: 0.1 * i / N, Y: 2.0 + 8.0 * k / N}
                table.append(("", seed, point, radius(i, k) + seed))
    made = study_of(flights_of(table, lost), design="map", statistic="mean")
    return replace(made, refined_metric=METRIC, contour=contour)


def field_of(study):
    spec = study_map(study, METRIC)
    ((panel,),) = spec.rows
    return panel.field, panel, spec


def test_cells_have_the_colour_of_their_point():
    field, panel, _ = field_of(map_of())
    assert field.values.shape == (2 * N, 2 * N)
    assert field.x[[0, -1]] == pytest.approx([0.0, 0.1]) and len(field.x) == 2 * N + 1
    assert field.y[[0, -1]] == pytest.approx([2.0, 10.0])
    # near the contour as it is, far from it as large as four steps
    for (i, k), size in (((6, 2), 1), ((0, 0), 4), ((4, 0), 4)):
        cell = field.values[max(2 * k - size, 0) : 2 * k + size, max(2 * i - size, 0) : 2 * i]
        near = [radius(i, k) - size / N, radius(i, k) + size / N]
        assert np.all((cell >= near[0]) & (cell <= near[1]))
    assert np.all(field.values[:3, :3] == 0.0)
    dots = next(line for line in panel.lines if line.label.startswith("point with completed"))
    assert len(dots.x) < 0.5 * (N + 1) ** 2


def test_contours_are_where_the_functions_cross():
    """Of a linear metric exactly, of lost flights within a step; of another value elsewhere."""
    field, _, spec = field_of(map_of())
    for of, at, expected, steps in (
        (field.level, 0.4, 0.4, 0.1),
        (field.outside, 0.5, RADIUS, 0.7),
    ):
        found = crossings(of, at)
        assert len(found) > N // 3
        assert found == pytest.approx(expected, abs=steps / N)
    assert crossings(field.level, 0.3).max() < 0.36
    assert "contour" not in spec.caption and field.contour == 0.4
    assert field.contour_label == "mean RMS error, laps: 0.4 m"


def crossings(values, at):
    """Distances from the corner at which rows of node values cross a number."""
    found = []
    for k, row in enumerate(values):
        for i in np.flatnonzero((row[:-1] < at) & (row[1:] >= at)):
            part = (at - row[i]) / (row[i + 1] - row[i])
            found.append(radius(i + part, k))
    return np.array(found)


def test_area_is_lost_from_half_of_the_flights_on():
    few, many = (field_of(map_of(seeds=4, share=share))[0] for share in (0.25, 0.5))
    assert few.outside.max() == 0.25 and many.outside.max() == 0.5
    assert many.outside_label == "lost: at least half of the flights"
    # the mean over the seeds that were completed
    assert few.values[0, 0] == pytest.approx(1.5)
    assert few.values[-1, -1] == pytest.approx(radius(N, N) + 2.0)


def test_boundary_is_between_neighbouring_points():
    """Of each row of the map; seen from the side of the completed flights."""
    study = map_of()
    table = tables.boundary(study)
    assert table.columns[:2] == (Y, f"completed at {X}")
    assert len(table.rows) > N // 3
    for level, completed, beyond, outcome in table.rows:
        k = (float(level) - 2.0) * N / 8.0
        inside, outside = (radius(10.0 * N * float(at), k) for at in (completed, beyond))
        assert inside <= RADIUS < outside and outside - inside < 4.5 / N
        assert outcome == "lost"
    assert tables.boundary(replace(study, design="factorial")) is None


def test_boundary_is_along_the_axis_it_crosses():
    """Flights of the upper half are lost: no row has both kinds, each column has."""
    rows = [("", 1, {X: 0.1 * i, Y: float(k)}, 1.0) for i in range(5) for k in range(4)]
    lost = {n for n, row in enumerate(rows) if row[2][Y] >= 2.0}
    table = tables.boundary(study_of(flights_of(rows, lost), design="map"))
    assert table.columns[:3] == (X, f"completed at {Y}", "not completed at")
    assert [row[1:] for row in table.rows] == 5 * [("1", "2", "lost")]


@pytest.fixture(scope="module")
def page():
    """Of a map."""
    return render_page(study_page(map_of()))


def test_page_has_the_map_and_no_biased_figure(page):
    text, page = page, stands_alone(page)
    names = [each.rpartition("-windows")[0] for each in page.figures]
    assert names == ["map"]
    assert "What matters" not in text
    other = replace(map_of(), design="factorial")
    assert "map" not in [each.name.split("-")[0] for each in study_figures(other)]


def test_map_without_lost_flights_or_contour():
    study = replace(map_of(), contour=None)
    kept = replace(study.flights, completed=np.ones_like(study.flights.completed))
    field, panel, _ = field_of(replace(study, flights=kept))
    assert field.contour is None and field.outside.max() == 0.0
    svg = figure_svg(next(study_figures(replace(study, flights=kept))).grid)
    assert "boundary" not in svg and "point with completed" in svg
    assert {line.label for line in panel.lines} == {"point with completed flights"}


@pytest.mark.parametrize("keep", [np.s_[:1], np.s_[:3]])
def test_map_of_too_few_points_is_left_out(keep):
    """A study that has just begun, or all of whose flights were lost."""
    study = map_of()
    flights = study.flights
    part = {
        name: getattr(flights, name)[keep]
        for name in ("run", "case", "seed", "outcome", "error", "completed")
    }
    part["settings"] = {key: values[keep] for key, values in flights.settings.items()}
    part["metrics"] = {key: values[keep] for key, values in flights.metrics.items()}
    assert study_map(replace(study, flights=replace(flights, **part)), METRIC) is None
    nothing = replace(flights, completed=np.zeros_like(flights.completed))
    assert study_map(replace(study, flights=nothing), METRIC) is None


def test_map_for_a_paper_has_its_width(page, tmp_path):
    """The map of the page is the same each time that it is drawn."""
    figure = next(study_figures(map_of()))
    (path,) = save_figures([figure], tmp_path, "png", FigureStyle(width_in=3.5, titled=False))
    with Image.open(path) as picture:
        assert picture.width / picture.info["dpi"][0] == pytest.approx(3.5, abs=0.01)
    assert figure_html(figure) in page


def cases_of_map(near=6.0, seeds=1):
    """A map of two laws: the second has half the error, and is nearer where the first key is 0."""
    table, separation, random = [], [], np.random.default_rng(1)
    for case, factor in (("one", 1.0), ("two", 0.5)):
        for i, k in ((i, k) for i in range(5) for k in range(5)):
            for seed in range(seeds):
                noise = 0.01 * random.normal() if seeds > 1 else 0.0
                table.append((case, seed, {X: 0.1 * i, Y: float(k)}, factor * (1.0 + k) + noise))
                here = 6.0 if case == "one" or i else near - 0.1 * k
                separation.append(here + noise)
    study = study_of(flights_of(table), design="map", statistic="mean")
    metrics = {**study.flights.metrics, "min_separation_m": np.array(separation)}
    return replace(study, flights=replace(study.flights, metrics=metrics))


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without figures, which take most of the time."""
    monkeypatch.setattr("testbed.reports.study.page.study_figures", lambda study: iter(()))


@pytest.mark.parametrize("seeds", [1, 4])
def test_map_tells_what_got_worse_point_by_point(seeds, undrawn):
    study = cases_of_map(near=4.0, seeds=seeds)
    (row,) = tables.side_effects(study).rows
    assert row[:4] == ("two", "smallest separation, m", "5 of 25", f"{X} 0, {Y} 4")
    assert row[4:] == (pytest.approx(6.0, abs=0.02), pytest.approx(3.6, abs=0.02))
    text = render_page(study_page(study))
    assert "What got worse" in text and "5 of 25" in text
    harmless = cases_of_map(near=6.4, seeds=seeds)
    assert tables.side_effects(harmless) is None
    assert "What got worse" not in render_page(study_page(harmless))


def test_map_has_no_number_over_its_points(undrawn):
    """Points are chosen unevenly: cases are counted point by point, without a figure."""
    study = cases_of_map()
    (row,) = tables.cases(study).rows
    assert row == (METRIC, "two", 25, 25, 0)
    assert tables.cases(study).columns[2:] == ("points of both", "better", "worse")
    assert tables.overview(study).columns == ("metric", "case", "flights", "least", "largest")
    assert "lost or failed" not in " ".join(tables.losses(study).columns)
    names = [each.name.split("-")[0] for each in study_figures(study)]
    assert "map" in names and "cases" not in names
    text = render_page(study_page(study))
    assert "Cases are compared point by point" in text.replace("\n", " ")
    with pytest.raises(InputError, match="a table of a map would have one number for each case"):
        latex_table(study)


MAP_PAGE = """
study:
  schema: 1
  name: radio
  scenario: simulation-3
  design: map
  refine: {metric: windows.laps.mean_rms_m, levels: 1}
vary:
  network.delay_s: {from: 0, to: 0.2, count: 3}
  network.loss: {from: 0, to: 0.2, count: 3}
"""


def test_latex_table_of_a_map_is_refused(tmp_path):
    """Before anything is written."""
    path = write_study(tmp_path / "study.parquet", page=MAP_PAGE)
    command = ("study-report", path, "--latex", "t.tex")
    done = call_command(*command, cwd=tmp_path, code=2, columns=200)
    assert "error: --latex t.tex: a table of a map would have one number for" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["study.parquet"]
