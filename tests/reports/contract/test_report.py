"""Reports of runs: figures, numbers of the run, edge cases, killed runs."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, some
from commands import call_command, refuse_all
from record_flight import event, run_info
from report_pages import (
    CHROMIUM,
    MAX_BYTES,
    NEEDS_CHROMIUM,
    Reader,
    browse,
    stands_alone,
)
from run_flight import short
from written_runs import synthetic

import testbed
from testbed.core.errors import InputError
from testbed.logs.file_record import RECORD_NAME
from testbed.logs.read import read_log
from testbed.reports import figures, read_run, run_figures, run_page, save_figures, write_page
from testbed.reports.figures_control_network_wind import AGE_INTERVALS, interval_statistics
from testbed.reports.html import render_page
from testbed.reports.latex import run_latex
from testbed.reports.page import head_html
from testbed.reports.plot_selection import (
    BUCKETS,
    MAX_SINGLE,
    WORST,
    decimate,
    percentiles,
    select_followers,
)
from testbed.scenario.arguments import with_changes

ALWAYS = {"trajectory", "altitude", "commands"}
FOLLOWED = ALWAYS | {"corner", "relative", "relative-ned", "error", "speed", "barrier"}


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """Directory of a short run with losses, and its report."""
    out = tmp_path_factory.mktemp("report") / "run"
    changes = ("log.mcap=true", "network.delay_s=0.05")
    changes += ("network.loss={kind: bernoulli, probability: 0.3}",)
    changes += (
        "scenario.windows={rectangles: [2, 8], circles: [8, 12]}",
        "air.wind={speed_mps: 3, from_deg: 240}",
        "scenario.published.differs=[]",  # compared all the same
    )
    testbed.run(short(*changes, seconds=12.0), out=out)
    write_page(run_page(read_run(out)), out / "report.html")
    return out


@pytest.fixture
def only(monkeypatch):
    """Draw only the figures with some names: drawing all takes seconds."""
    makers = figures.MAKERS

    def select(*names):
        monkeypatch.setattr(figures, "MAKERS", [each for each in makers if each[0] in names])

    return select


def test_report_stands_alone_with_every_figure(flown):
    text = (flown / "report.html").read_text(encoding="utf-8")
    page = stands_alone(text)
    assert set(page.figures) == FOLLOWED | {"network", "wind"}
    assert "eqs. (30) and (31); the error in percent" in text


def test_report_has_the_numbers_of_the_run(flown):
    metrics = json.loads((flown / "metrics.json").read_text())
    tables = Reader((flown / "report.html").read_text(encoding="utf-8")).tables
    cells = {row[0]: row[1:] for row in tables[0] if row}
    paper = metrics["published"]
    for k, name in enumerate(("uav1", "uav2", "uav3")):
        expected = []
        for window, numbers in metrics["windows"].items():
            ours, theirs = numbers["rms_m"][name], paper["rms_m"][window][k]
            expected += [f"{ours:.2f}", f"{theirs:g}", f"{ours / theirs:.2f}"]
        assert cells[name] == expected
    means = [f"{each['mean_rms_m']:.2f}" for each in metrics["windows"].values()]
    assert cells["mean"][::3] == means
    engaged = {row[0]: row[1] for row in tables[1]}
    for name, at in metrics["joined_at_s"].items():
        assert engaged[name] == ("never" if at is None else f"{at:.1f}")
    links = {row[0]: row[1:3] for row in tables[4]}
    together = metrics["network"]["all"]
    share = f"{100 * together['delivered_share']:.1f}"
    assert links["all"] == [f"{together['sent']:,}", share]


def test_report_has_the_scenario_as_flown(flown):
    page = Reader((flown / "report.html").read_text(encoding="utf-8"))
    (saved,) = [link for link in page.links if link.startswith("data:text/yaml")]
    resolved = (flown / "scenario.resolved.yaml").read_bytes()
    assert base64.b64decode(saved.partition("base64,")[2]) == resolved


def test_same_run_gives_same_bytes(flown, only):
    # together all kinds of panels, lines, bands and marks
    names = ("trajectory", "network") if ALL else ("network",)
    only(*names)
    first = (flown / "report.html").read_text("utf-8")
    again = render_page(run_page(read_run(flown / "run.mcap")))
    drawn = re.findall(r"<figure .*?</figure>", again, re.S)
    assert len(drawn) == len(names) and all(each in first for each in drawn)
    for text in drawn:
        again = again.replace(text, "")
    assert again == re.sub(r"<figure .*?</figure>", "", first, flags=re.S)


def test_curves_have_the_values_of_the_log(flown):
    run = read_run(flown)
    grids = {figure.name: figure.grid for figure in run_figures(run)}
    lines = {line.label: line for line in grids["error"].rows[0][0].lines}
    log = run.log
    for i, name in enumerate(run.followers):
        distance = np.linalg.norm(log.formation.error_ned[:, i], axis=-1)
        # few enough samples to draw all
        assert log.tick.size <= 4 * BUCKETS
        np.testing.assert_array_equal(lines[name].x, log.time_s)
        np.testing.assert_allclose(lines[name].y, distance, rtol=1e-14)  # a sum's other order
    forward = grids["relative"].rows[0][0].lines
    velocity = log.truth.velocity_ned[-1, 0] / np.linalg.norm(log.truth.velocity_ned[-1, 0])
    apart = log.truth.position_ned[-1, 1] - log.truth.position_ned[-1, 0]
    assert forward[0].y[-1] == pytest.approx(apart @ velocity, abs=1e-9)  # of coordinates of 1 km


def test_part_of_a_run_is_drawn(flown, only):
    """From 5 s to 9 s: curves, windows and events of that time, numbers of the whole run."""
    only("trajectory", "altitude", "error")
    whole, run = read_run(flown), read_run(flown, begin_s=5.0, end_s=9.0)
    trajectory, altitude, error = (figure.grid for figure in run_figures(run))
    inside = (whole.log.time_s >= 5.0) & (whole.log.time_s <= 9.0)
    panel = error.rows[0][0]
    np.testing.assert_array_equal(panel.lines[0].x, whole.log.time_s[inside])
    np.testing.assert_array_equal(panel.lines[0].y, whole.error[inside, 0])
    assert panel.x_limits == (5.0, 9.0)
    assert [(span.start, span.name) for span in panel.spans] == [
        (5.0, "rectangles"),
        (8.0, "circles"),
    ]
    assert all(5.0 <= time_s <= 9.0 for time_s, _ in panel.marks)
    assert altitude.subtitle.endswith("seed 1 · 5 to 9 s")
    assert "leader, path" not in [line.label for line in trajectory.rows[0][0].lines]
    assert run.metrics == whole.metrics
    only()
    assert "The figures show 5 to 9 s" in render_page(run_page(run))


def test_first_lap_ends_after_a_full_circle(flown, only):
    """A leader that turns at 1 rad/s has turned a full circle at 6.28 s."""
    only("first-lap")
    run = read_run(flown)
    assert not list(run_figures(run)), "12 s are no lap"
    time, truth = run.log.time_s, run.log.truth
    velocity = truth.velocity_ned.copy()
    velocity[:, 0, :2] = 20.0 * np.stack((np.cos(time), -np.sin(time)), axis=1)
    log = replace(run.log, truth=truth._replace(velocity_ned=velocity))
    (figure,) = run_figures(replace(run, log=log))
    above, distance = figure.grid.rows[0]
    end = time[time >= 2.0 * np.pi][0]
    assert f"a full circle at {end:.1f} s" in figure.caption
    curves = {line.label: line for line in distance.lines if line.label}
    assert set(curves) == set(run.followers) and curves["uav1"].x[-1] == end
    leader = {line.label: line for line in above.lines}["leader"]
    np.testing.assert_array_equal(leader.x, truth.position_ned[time <= end, 0, 1])


@pytest.mark.parametrize(("ending", "start"), some([("pdf", b"%PDF-"), ("png", b"\x89PNG")], 1))
def test_command_writes_report_and_figures(flown, tmp_path, only, ending, start):
    only("altitude")
    done = call_command(
        "report", flown, "--out", "it.html", "--figures", "drawn", "--format", ending,
        cwd=tmp_path, code=0, columns=200,
    )  # fmt: skip
    files = {file.name: file.read_bytes() for file in (tmp_path / "drawn").iterdir()}
    assert files.pop(RECORD_NAME)
    assert set(files) == {f"altitude.{ending}"}
    assert all(data.startswith(start) for data in files.values())
    assert Reader((tmp_path / "it.html").read_text("utf-8")).figures == ["altitude"]
    assert "it.html" in done.stdout and "1 in drawn" in done.stdout
    run = read_run(flown)
    again = save_figures(run_figures(run), tmp_path / "again", ending)
    assert [path.read_bytes() for path in again] == [files[path.name] for path in again]


def test_latex_has_errors_beside_published_ones(flown, tmp_path, only):
    """A window cut short, and one whose numbers are of another set-up, have none."""
    only("altitude")
    words = ("report", flown, "--out", "it.html", "--latex", "t.tex")
    done = call_command(*words, cwd=tmp_path, code=0, columns=200)
    table = (tmp_path / "t.tex").read_text("utf-8")
    assert "LaTeX    t.tex" in done.stdout
    run = read_run(flown)
    assert table == run_latex(run) and r"\begin{tabular}{llrrrrr}" in table
    window, numbers = next(iter(run.metrics["windows"].items()))
    cells = [window, "simulated", *(f"{each:.2f}" for each in numbers["rms_m"].values())]
    assert f"{' & '.join(cells)} & {numbers['mean_rms_m']:.2f}" in table
    published = {"source": "a paper", "rms_m": {window: [1.25, 2.0, 3.0]}, "mean_rms_m": {}}
    complete = {window: numbers | {"complete": True}}
    metrics = {**run.metrics, "published": published, "windows": complete}
    beside = run_latex(replace(run, metrics=metrics))
    assert " & published & 1.25 & 2 & 3 & -- & -- " in beside and "published: a paper" in beside
    with pytest.raises(InputError, match="has no windows"):
        run_latex(replace(run, metrics={**run.metrics, "windows": {}}))


def test_command_bad_input_is_an_error(tmp_path):
    synthetic(tmp_path / "run")
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "metrics.json").write_text("{}")
    (tmp_path / "list.yaml").write_text("[uav1]\n")
    (tmp_path / "labels.yaml").write_text('uav1: "$u_1$"\nuav9: left\ntime: t\n"eror": error\n')
    (tmp_path / "wrong.yaml").write_text('uav1: $\\wrong$\ncourse: 7\nuav2: ""\n')
    refuse_all("report", tmp_path)


def test_log_without_samples_is_an_error(tmp_path):
    with pytest.raises(InputError, match="the log has no samples"):
        read_run(synthetic(tmp_path / "run", count=0))


@pytest.mark.parametrize(
    ("how", "named"),
    [
        ({"count": 1}, FOLLOWED),
        ({"followers": 0}, ALWAYS),
        ({"lost_from": 0}, FOLLOWED),
        ({"lost_from": 30, "noisy_from": 10}, FOLLOWED | {"estimates"}),
        ({"events": [event(3), event(9, '<&">', "error")]}, FOLLOWED),
        ({"info": run_info(windows={}, scenario_name='<i>&"', make_yaml=str)}, FOLLOWED),
        ({"ended": False}, FOLLOWED),
    ],
    ids=["one sample", "alone", "lost at once", "lost", "events", "bare", "cut short"],
)
def test_edge_cases_have_a_report(tmp_path, only, how, named):
    run = read_run(synthetic(tmp_path / "run", **how))
    # wind, message ages and turns of a synthetic run are arbitrary
    arbitrary = {"wind", "network", "first-lap"}
    assert {figure.name for figure in run_figures(run)} - arbitrary == named
    drawn = {"error", "altitude"} if ALL else {"error" if "error" in named else "altitude"}
    only(*drawn)
    text = render_page(run_page(run))
    page = Reader(text)
    assert set(page.figures) == named & drawn
    assert not re.search(r"[\s\"(>]nan\b", text)
    assert "<i>" not in text


def test_killed_run_has_computed_metrics(flown, tmp_path, only):
    only("error")
    whole = (flown / "run.mcap").read_bytes()
    begins, ends = 2.0, 12.0  # the first window, and the last
    for part in range(30, 99):  # a slow run has other chunks than a fast one
        (tmp_path / "run.mcap").write_bytes(whole[: part * len(whole) // 100])
        times = read_log(tmp_path / "run.mcap").time_s
        if times.size and begins < times[-1] < ends:
            break
    run = read_run(tmp_path)
    assert run.outcome == "cut short"
    assert 0.0 < run.metrics["simulated_s"] < 12.0
    assert run.metrics["simulated_s"] == run.log.time_s[-1]
    # incomplete windows are not compared with published numbers
    ends = run.log.time_s[-1] + 1.5 / run.log.info.sample_rate_hz  # one sample later
    flown_to_the_end = [end <= ends for _, end in run.log.info.windows.values()]
    assert not all(flown_to_the_end)
    text = render_page(run_page(run))
    assert "The run was killed" in text
    assert "covered: " in text and ("<br>ratio<" in text) is any(flown_to_the_end)
    assert "incomplete, not compared" in text.lower()


def test_expectation_is_of_the_whole_flight(flown):
    """It is left out of a flight with a shorter duration, and named so where a flight ended."""
    cut = read_run(flown)
    assert "Expected" not in head_html(cut)
    header = with_changes(cut.scenario.scenario, expectation="At most 1 m.")
    whole = replace(cut, scenario=with_changes(cut.scenario, scenario=header))
    assert "<p>Expected: At most 1 m.</p>" in head_html(whole)
    ended = replace(whole, metrics={**whole.metrics, "simulated_s": 11.0})
    assert "<p>Expected of the whole flight of 12 s: At most 1 m.</p>" in head_html(ended)


def test_problems_are_marked_in_words(tmp_path, only):
    only("altitude")
    well = read_run(synthetic(tmp_path / "well", info=run_info(wingspan_m=(1e-6,) * 4)))
    cards = re.findall(r"<li.*?</li>", head_html(well))
    assert [("class" in card, "<em>" in card) for card in cards[-3:]] == [
        (False, False),
        (True, True),  # no follower joins in a synthetic run
        (False, False),
    ]
    assert "never: uav1, uav2, uav3" in cards[-2]
    info = run_info(wingspan_m=(1e6, 2e6, 3.0, 2.0))
    ill = read_run(synthetic(tmp_path / "ill", info=info, lost_from=30))
    close, _, lost = re.findall(r"<li.*?</li>", head_html(ill))[-3:]
    assert '<li class="bad">' in close and "closer than a wingspan, " in close
    assert '<li class="bad"><b>1</b>' in lost and "uav3 at 1.2 s" in lost


def test_many_followers_are_a_band_and_the_worst(tmp_path, only):
    run = read_run(synthetic(tmp_path / "run", count=200, followers=20, lost_from=100))
    selection = select_followers(run)
    square = np.nanmean(run.error**2, axis=0)
    worst = sorted(np.argsort(-square)[:WORST])
    assert [part.row for part in selection.drawn] == worst
    assert len(run.followers) > MAX_SINGLE and selection.in_band == 20
    # the figure `corner` has only 24 s of the run
    rows = sum(len(each.grid.rows) for each in run_figures(run) if each.name != "corner")
    only("speed")  # with most curves in a row
    text = render_page(run_page(run))
    plot = re.search(r"<svg .*</svg>", text, re.S)[0]
    # a noisy curve of a long run has 4 points in each bucket; here it has 200 points
    assert rows / 3 * 4 * BUCKETS / 200 * len(plot.encode()) < 0.9 * MAX_BYTES
    assert "5 to 95 % of all" in text
    only("error")
    (figure,) = run_figures(run)
    panel = figure.grid.rows[0][0]
    low, high = np.nanpercentile(run.error, [5, 95], axis=1)
    np.testing.assert_allclose(panel.bands[0].low, low, rtol=1e-12)
    np.testing.assert_allclose(panel.bands[0].high, high, rtol=1e-12)


def test_many_followers_have_a_closed_table(tmp_path, only):
    only()
    run = read_run(synthetic(tmp_path / "run", count=200, followers=20))
    text = render_page(run_page(run))
    for name in ("errors", "followers"):
        part = text.split(f'<section id="{name}">')[1].split("</section>")[0]
        worst, full = part.split("<details><summary>All 20 followers</summary>")
        listed = set(re.findall(r'<th scope="row">(uav\d+)</th>', worst))
        assert len(listed) == 12
        assert listed < set(re.findall(r"uav\d+", full.split("</details>")[0]))
    few = read_run(synthetic(tmp_path / "few", count=50, followers=3))
    assert "<details>" not in render_page(run_page(few))


def test_decimate_keeps_extremes_ends_and_gaps():
    values = np.random.default_rng(1).standard_normal(27_001)
    values[[100, 20_000]] = 9.0, -9.0
    values[5_000:5_003] = np.nan
    at = decimate(values)
    assert at.size <= 4 * BUCKETS + 8
    assert {0, 100, 20_000, 27_000} <= set(at)
    assert np.isnan(values[at]).any()
    joined = ~np.isnan(values[at][:-1]) & ~np.isnan(values[at][1:])
    assert not (joined & (at[:-1] < 5_000) & (at[1:] > 5_002)).any()
    width = -(-27_001 // BUCKETS)
    for k in range(0, 27_001, width):
        inside = (at >= k) & (at < k + width)
        bucket = values[k : k + width]
        assert np.nanmin(values[at[inside]]) == np.nanmin(bucket)
        assert np.nanmax(values[at[inside]]) == np.nanmax(bucket)


def test_interval_statistics_cover_the_whole_run():
    time, values = np.arange(1050.0), np.arange(2100.0).reshape(1050, 2)
    values[-1, 0] = 9e9
    values[3] = np.nan
    middle, mean, largest = interval_statistics(time, values)
    assert len(middle) <= AGE_INTERVALS and largest[-1, 0] == 9e9
    samples = -(-1050 // AGE_INTERVALS)
    np.testing.assert_allclose(mean[0], np.nanmean(values[:samples], axis=0))
    np.testing.assert_allclose(mean[-1, 1], values[samples * (len(mean) - 1) :, 1].mean())
    assert middle[-1] == time[samples * (len(mean) - 1) :].mean()


def test_percentiles_ignore_nan():
    values = np.array([[1.0, np.nan, 3.0, 2.0], [np.nan] * 4, [np.nan, 5.0, np.nan, np.nan]])
    low, middle = percentiles(values, (0.0, 0.5))
    np.testing.assert_array_equal(low, [1.0, np.nan, 5.0])
    np.testing.assert_array_equal(middle, [2.0, np.nan, 5.0])


@pytest.mark.skipif(CHROMIUM is None, reason=NEEDS_CHROMIUM)
def test_browser_shows_every_figure_without_errors(flown, tmp_path):
    """On a telephone text of figures has 10 px or more; what scrolls has a shadow."""
    measured, found = browse((flown / "report.html").read_text("utf-8"), tmp_path)
    assert set(measured) == FOLLOWED | {"network", "wind"}
    assert np.quantile(found["heights"], 0.1) > 10.0  # exponents are smaller
    assert found["scrolled"] == found["shaded"] > len(FOLLOWED)
    assert found["over"] <= 0


def test_trajectory_shows_followers_beside_the_leader(flown, only):
    """At 3 m forward, 5 m right and 2 m above a leader that flies to the east."""
    only("trajectory")
    run = read_run(flown)
    truth, formation = run.log.truth, run.log.formation
    position, velocity = truth.position_ned.copy(), np.zeros_like(truth.velocity_ned)
    velocity[..., 1] = 20.0
    slot = position[:, :1] + [-5.0, 3.0, -2.0] + np.zeros_like(formation.slot_ned)
    position[:, 1:] = slot
    position[-1, 1] += [0.0, 0.0, 1.0]  # uav1 ends 1 m low
    log = replace(
        run.log,
        truth=truth._replace(position_ned=position, velocity_ned=velocity),
        formation=formation._replace(slot_ned=slot),
    )
    (figure,) = run_figures(replace(run, log=log))
    _, above, behind = figure.grid.rows[0]
    uav1, cross = behind.lines[1], behind.lines[-1]
    assert (uav1.label, uav1.x[-1]) == ("uav1", pytest.approx(5.0))
    assert uav1.y[-1] == pytest.approx(1.0) and uav1.y[-2] == pytest.approx(2.0)
    assert [cross.x, cross.y, cross.marker] == [pytest.approx([5.0]), pytest.approx([2.0]), "x"]
    assert above.lines[1].y[-1] == pytest.approx(3.0)


def test_links_have_colours_and_markers_of_no_follower(flown, only):
    only("network")
    (figure,) = run_figures(read_run(flown))
    lines = [line for (panel,) in figure.grid.rows for line in panel.lines if line.marker]
    looks = {line.label: (line.colour, line.marker) for line in lines}
    assert any(">" in name for name in looks) and "uav1" in looks
    for part in zip(*looks.values(), strict=True):
        assert len(set(part)) == len(looks)


def test_barrier_near_one_is_a_sentence(flown, only):
    """An own h is drawn from the samples in the log; without samples it is not."""
    only("barrier")
    run = read_run(flown)
    own = {"barriers": ((0, 0.0),) * 3}
    samples = (tuple(np.linspace(-1.0, 1.0, 201)),) * 3
    cases = (({}, 1, "0.9"), (own | {"barrier_samples": samples}, 2, "Below: the barrier"))
    for fields, rows, words in (*cases, (own, 1, "negative outside.")):
        log = replace(run.log, info=replace(run.log.info, **fields))
        (figure,) = run_figures(replace(run, log=log))
        assert len(figure.grid.rows) == rows and words in figure.caption
