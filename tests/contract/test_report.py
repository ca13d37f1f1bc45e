"""The report: one page with every figure and the run's own numbers, whatever became of the run."""

import base64
import itertools
import json
import re
import shutil

import numpy as np
import pytest
from commands import call_command
from record_flight import event, run_frames, run_info
from report_pages import CHROMIUM, MOST_BYTES, NEEDS_CHROMIUM, Reader, browse, stands_alone
from run_flight import short

import testbed
from testbed.errors import InputError
from testbed.metrics import MetricsObserver
from testbed.metrics.document import complete
from testbed.record.read import read_log
from testbed.record.recorder import McapRecorder
from testbed.report import figures, read_flight, write_figures, write_page
from testbed.report.cast import SINGLE, WORST, cast_of
from testbed.report.drawing import AXIS_IN, LETTER_IN, LEVELS, placed
from testbed.report.figures import figures_of
from testbed.report.page import _head, page_of
from testbed.report.surroundings import STRETCHES, _windows
from testbed.report.thinning import BUCKETS, kept, percentiles
from testbed.views.panels import Span

ALWAYS = {"trajectory", "altitude", "commands"}
FOLLOWED = ALWAYS | {"corner", "relative", "relative-ned", "error", "speed", "barrier"}


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """A short flight with a bad radio, and the page of its report."""
    out = tmp_path_factory.mktemp("report") / "run"
    changes = ("log.mcap=true", "network.delay_s=0.05")
    changes += ("network.loss={kind: bernoulli, probability: 0.3}",)
    changes += (
        "scenario.portions={rectangles: [2, 8], circles: [8, 12]}",
        "air.wind={speed_mps: 3, from_deg: 240}",
    )
    testbed.run(short(*changes, seconds=12.0), out=out)
    write_page(read_flight(out), out / "report.html")
    return out


@pytest.fixture
def only(monkeypatch):
    """Leaves of the figures those of some names: to draw them all takes seconds."""
    every = figures.MAKERS

    def leave(*names):
        monkeypatch.setattr(figures, "MAKERS", [each for each in every if each[0] in names])

    return leave


def synthetic(folder, count=60, followers=3, *, ended=True, info=None, **how):
    """The log of a made-up run."""
    folder.mkdir(exist_ok=True)
    log, meter = McapRecorder(folder / "run.mcap"), MetricsObserver()
    info = info or run_info(followers, duration_s=60.0)
    for watcher in (log, meter):
        watcher.begin(info)
    for frame in run_frames(count, followers, **how):
        log.observe(frame)
        meter.observe(frame)
    nothing = {"links": {}, "all": {}}
    network = nothing | {"all": {"lost": {}, "mute": 0, "sent": 0, "overtaken": 0, "duplicated": 0}}
    network["all"] |= {"bursts": {"longest": 0}, "delay_s": None}
    summary = complete(
        meter.summary(), network=network, outside={}, outcome="interrupted", wall_s=1.0
    )
    log.end(summary if ended else {}, ())
    return folder


def test_the_page_stands_alone_and_has_every_figure(flown):
    text = (flown / "report.html").read_text(encoding="utf-8")
    page = stands_alone(text)
    assert set(page.figures) == FOLLOWED | {"network", "wind"}


def test_numbers_are_those_of_the_run(flown):
    metrics = json.loads((flown / "metrics.json").read_text())
    tables = Reader((flown / "report.html").read_text(encoding="utf-8")).tables
    cells = {row[0]: row[1:] for row in tables[0] if row}
    paper = metrics["published"]
    for k, name in enumerate(("uav1", "uav2", "uav3")):
        expected = []
        for portion, numbers in metrics["portions"].items():
            ours, theirs = numbers["rms_m"][name], paper["rms_m"][portion][k]
            expected += [f"{ours:.2f}", f"{theirs:g}", f"{ours / theirs:.2f}"]
        assert cells[name] == expected
    means = [f"{each['mean_rms_m']:.2f}" for each in metrics["portions"].values()]
    assert cells["mean"][::3] == means
    engaged = {row[0]: row[1] for row in tables[1]}
    for name, at in metrics["engaged_at_s"].items():
        assert engaged[name] == ("never" if at is None else f"{at:.1f}")
    links = {row[0]: row[1:3] for row in tables[3]}
    together = metrics["network"]["all"]
    share = f"{100 * together['delivered_share']:.1f}"
    assert links["all"] == [f"{together['sent']:,}", share]


def test_the_page_holds_the_page_that_was_flown(flown):
    page = Reader((flown / "report.html").read_text(encoding="utf-8"))
    (saved,) = [link for link in page.links if link.startswith("data:text/yaml")]
    resolved = (flown / "scenario.resolved.yaml").read_bytes()
    assert base64.b64decode(saved.partition("base64,")[2]) == resolved


def test_the_same_run_gives_the_same_bytes(flown, only):
    only("trajectory", "network")  # of every kind of panel, line, band and mark one
    first = (flown / "report.html").read_text("utf-8")
    again = page_of(read_flight(flown / "run.mcap"))
    drawn = re.findall(r"<figure .*?</figure>", again, re.S)
    assert len(drawn) == 2 and all(each in first for each in drawn)
    for text in drawn:
        again = again.replace(text, "")
    assert again == re.sub(r"<figure .*?</figure>", "", first, flags=re.S)


def test_curves_are_those_of_the_log(flown):
    flight = read_flight(flown)
    sheets = {figure.name: figure.sheet for figure in figures_of(flight)}
    lines = {line.label: line for line in sheets["error"].rows[0][0].lines}
    log = flight.log
    for i, name in enumerate(flight.followers):
        distance = np.linalg.norm(log.formation.error_ned[:, i], axis=-1)
        # as many frames as are drawn one by one
        assert log.tick.size <= 4 * BUCKETS
        np.testing.assert_array_equal(lines[name].x, log.time_s)
        np.testing.assert_allclose(lines[name].y, distance, rtol=1e-14)  # a sum's other order
    forward = sheets["relative"].rows[0][0].lines
    velocity = log.truth.velocity_ned[-1, 0] / np.linalg.norm(log.truth.velocity_ned[-1, 0])
    apart = log.truth.position_ned[-1, 1] - log.truth.position_ned[-1, 0]
    assert forward[0].y[-1] == pytest.approx(apart @ velocity, abs=1e-9)  # of coordinates of 1 km


@pytest.mark.parametrize(("ending", "start"), [("pdf", b"%PDF-"), ("png", b"\x89PNG")])
def test_the_command_writes_the_page_and_the_figures(flown, tmp_path, only, ending, start):
    only("altitude")
    done = call_command(
        "report", flown, "--out", "it.html", "--figures", "drawn", "--format", ending,
        cwd=tmp_path, code=0, columns=200,
    )  # fmt: skip
    files = {file.name: file.read_bytes() for file in (tmp_path / "drawn").iterdir()}
    assert set(files) == {f"altitude.{ending}"}
    assert all(data.startswith(start) for data in files.values())
    assert Reader((tmp_path / "it.html").read_text("utf-8")).figures == ["altitude"]
    assert "it.html" in done.stdout and "1 in drawn" in done.stdout
    flight = read_flight(flown)
    again = write_figures(flight, tmp_path / "again", ending)
    assert [path.read_bytes() for path in again] == [files[path.name] for path in again]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "neither a run directory"),
        (["{run}", "--out", "page.txt"], "write a name that ends in .html"),
        (["{run}", "--format", "pdf"], "is that of --figures DIR"),
        (["{run}", "--figures", "f", "--format", "gif"], "write one of png, pdf, svg"),
        (["{run}", "--out", "gone/page.html"], "there is no folder"),
        (["{run}", "--figures", "{run}/run.mcap"], "cannot be written"),
    ],
)
def test_what_cannot_be_done_is_refused(flown, tmp_path, only, arguments, said):
    only("altitude")
    asked = [each.format(run=flown) for each in arguments]
    asked += [] if "--out" in asked else ["--out", "page.html"]
    done = call_command("report", *asked, cwd=tmp_path, code=2, columns=200)
    assert said in done.stderr


def test_a_run_without_a_log_is_refused(flown, tmp_path):
    shutil.copy(flown / "metrics.json", tmp_path)
    done = call_command("report", tmp_path, cwd=tmp_path, code=2, columns=200)
    assert "no run.mcap in there" in done.stderr


def test_a_run_that_ended_before_its_first_frame_is_refused(tmp_path):
    with pytest.raises(InputError, match="no frame was logged"):
        read_flight(synthetic(tmp_path / "run", count=0))


@pytest.mark.parametrize(
    ("how", "named"),
    [
        ({"count": 1}, FOLLOWED),
        ({"followers": 0}, ALWAYS),
        ({"gone_from": 0}, FOLLOWED),
        ({"gone_from": 30, "noisy_from": 10}, FOLLOWED | {"estimates"}),
        ({"events": [event(3), event(9, '<&">', "error")]}, FOLLOWED),
        ({"info": run_info(portions={}, scenario_name='<i>&"', scenario_yaml="")}, FOLLOWED),
        ({"ended": False}, FOLLOWED),
    ],
    ids=["one frame", "alone", "lost at once", "lost", "events", "bare", "cut short"],
)
def test_odd_runs_have_a_page(tmp_path, only, how, named):
    flight = read_flight(synthetic(tmp_path / "run", **how))
    # a made-up run has wind, and ages of what was used, without sense
    assert {figure.name for figure in figures_of(flight)} - {"wind", "network"} == named
    only("error", "altitude")
    text = page_of(flight)
    page = Reader(text)
    assert set(page.figures) == named & {"error", "altitude"}
    assert not re.search(r"[\s\"(>]nan\b", text)
    assert "<i>" not in text


def test_a_killed_run_says_so_and_is_counted_again(flown, tmp_path, only):
    only("error")
    whole = (flown / "run.mcap").read_bytes()
    begins, ends = 2.0, 12.0  # the first window, and the last
    for part in range(30, 99):  # a slow run has other chunks than a fast one
        (tmp_path / "run.mcap").write_bytes(whole[: part * len(whole) // 100])
        times = read_log(tmp_path / "run.mcap").time_s
        if times.size and begins < times[-1] < ends:
            break
    flight = read_flight(tmp_path)
    assert flight.outcome == "cut short"
    assert 0.0 < flight.metrics["simulated_s"] < 12.0
    assert "The log was never closed" in page_of(flight)
    assert flight.metrics["simulated_s"] == flight.log.time_s[-1]
    # a window that was flown in part is held against nobody's numbers
    ends = flight.log.time_s[-1] + 1.5 / flight.log.info.frame_rate_hz  # the frame after it
    flown_to_the_end = [end <= ends for _, end in flight.log.info.portions.values()]
    assert not all(flown_to_the_end)
    text = page_of(flight)
    assert "flown: " in text and ("<br>ratio<" in text) is any(flown_to_the_end)
    assert "not flown to the end, so not compared" in text.lower()


def test_what_is_ill_is_marked_with_a_word(tmp_path, only):
    only("altitude")
    well = read_flight(synthetic(tmp_path / "well", info=run_info(wingspan_m=(1e-6,) * 4)))
    cards = re.findall(r"<li.*?</li>", _head(well))
    assert [("class" in card, "<em>" in card) for card in cards[-3:]] == [
        (False, False),
        (True, True),  # nobody engages in a made-up run
        (False, False),
    ]
    assert "never: uav1, uav2, uav3" in cards[-2]
    info = run_info(wingspan_m=(1e6, 2e6, 3.0, 2.0))
    ill = read_flight(synthetic(tmp_path / "ill", info=info, gone_from=30))
    close, _, lost = re.findall(r"<li.*?</li>", _head(ill))[-3:]
    assert '<li class="bad">' in close and "closer than a wingspan, " in close
    assert '<li class="bad"><b>1</b>' in lost and "uav3 at 1.2 s" in lost


def test_names_of_portions_do_not_meet():
    spans = [Span(10.0 * k, 10.0 * k + 10.0, f"portion-{k}") for k in range(60)]
    drawn = placed(spans, 600.0)
    assert [each.start for each in drawn] == [each.start for each in spans]
    per_letter = LETTER_IN / AXIS_IN * 600.0
    for one, other in itertools.combinations([each for each in drawn if each.name], 2):
        apart = abs(one.start - other.start) >= len(one.name) * per_letter
        assert apart or one.level != other.level
    assert {each.level for each in drawn if each.name} == set(range(LEVELS))
    few = placed(spans[:60:20], 600.0)
    assert [each.level for each in few] == [0, 0, 0]


def test_of_many_followers_the_worst_are_drawn_over_a_band_of_all(tmp_path, only):
    flight = read_flight(synthetic(tmp_path / "run", count=200, followers=20, gone_from=100))
    cast = cast_of(flight)
    square = np.nanmean(flight.error**2, axis=0)
    worst = sorted(np.argsort(-square)[:WORST])
    assert [part.row for part in cast.parts] == worst
    assert len(flight.followers) > SINGLE and cast.crowd == 20
    rows = sum(len(figure.sheet.rows) for figure in figures_of(flight))
    only("speed")  # whose rows have most curves
    text = page_of(flight)
    plot = re.search(r"<svg .*</svg>", text, re.S)[0]
    # of a longer run a curve of mere noise has 4 points in each bucket, here there are 200
    assert rows / 3 * 4 * BUCKETS / 200 * len(plot.encode()) < 0.9 * MOST_BYTES
    assert "5 to 95 % of all" in text
    only("error")
    (figure,) = figures_of(flight)
    panel = figure.sheet.rows[0][0]
    low, high = np.nanpercentile(flight.error, [5, 95], axis=1)
    np.testing.assert_allclose(panel.bands[0].low, low, rtol=1e-12)
    np.testing.assert_allclose(panel.bands[0].high, high, rtol=1e-12)


def test_of_many_followers_the_worst_are_listed_and_all_unfold(tmp_path, only):
    only("altitude")
    flight = read_flight(synthetic(tmp_path / "run", count=200, followers=20))
    text = page_of(flight)
    for name in ("errors", "followers"):
        part = text.split(f'<section id="{name}">')[1].split("</section>")[0]
        worst, everyone = part.split("<details><summary>All 20 followers</summary>")
        listed = set(re.findall(r'<th scope="row">(uav\d+)</th>', worst))
        assert len(listed) == 12
        assert listed < set(re.findall(r"uav\d+", everyone.split("</details>")[0]))
    few = read_flight(synthetic(tmp_path / "few", count=50, followers=3))
    assert "<details>" not in page_of(few)


def test_thinning_keeps_extremes_ends_and_gaps():
    values = np.random.default_rng(1).standard_normal(27_001)
    values[[100, 20_000]] = 9.0, -9.0
    values[5_000:5_003] = np.nan
    at = kept(values)
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


def test_means_and_extremes_are_of_the_whole_run():
    time, values = np.arange(1050.0), np.arange(2100.0).reshape(1050, 2)
    values[-1, 0] = 9e9
    values[3] = np.nan
    middle, mean, largest = _windows(time, values)
    assert len(middle) <= STRETCHES and largest[-1, 0] == 9e9
    frames = -(-1050 // STRETCHES)
    np.testing.assert_allclose(mean[0], np.nanmean(values[:frames], axis=0))
    np.testing.assert_allclose(mean[-1, 1], values[frames * (len(mean) - 1) :, 1].mean())
    assert middle[-1] == time[frames * (len(mean) - 1) :].mean()


def test_percentiles_leave_out_what_is_not_a_number():
    values = np.array([[1.0, np.nan, 3.0, 2.0], [np.nan] * 4, [np.nan, 5.0, np.nan, np.nan]])
    low, middle = percentiles(values, (0.0, 0.5))
    np.testing.assert_array_equal(low, [1.0, np.nan, 5.0])
    np.testing.assert_array_equal(middle, [2.0, np.nan, 5.0])


@pytest.mark.skipif(CHROMIUM is None, reason=NEEDS_CHROMIUM)
def test_a_browser_shows_every_figure_and_has_nothing_to_say(flown, tmp_path):
    measured = browse((flown / "report.html").read_text("utf-8"), tmp_path)
    assert set(measured) == FOLLOWED | {"network", "wind"}
