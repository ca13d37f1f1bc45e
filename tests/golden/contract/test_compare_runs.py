"""Comparison of two runs: differences, their times, printed text and exit codes."""

import json
import subprocess

import numpy as np
import pytest
from cases import ALL
from commands import call_command, refuse_all
from record_flight import event, record, run_info, run_samples
from snapshot import check_snapshot

from testbed.core.errors import InputError
from testbed.golden.compare_runs import MetricPair, compare_runs
from testbed.logs.read import read_log
from testbed.metrics.observer import MetricsObserver
from testbed.reports import compare_figure, read_run, run_labels
from testbed.scenario import dump, load_scenario
from testbed.views.viewer import rerun_program

FRAMES = 120  # 4.8 s: both windows of the made-up run
AT, TIME_S = 70, 2.8  # a frame, and its time


def frames(*, moved_m=0.0):
    """A made-up flight in which uav2 is this much farther east in one frame."""
    for k, frame in enumerate(run_samples(FRAMES)):
        if k == AT and moved_m:
            position = frame.truth.position_ned.copy()
            position[2, 1] += moved_m
            truth = frame.truth._replace(position_ned=position)
            frame = frame._replace(truth=truth, estimate=truth)
        yield frame


def run(folder, seen, info=None, *, change=(), events=()):
    """The path of a log with the metrics of its frames, changed."""
    folder.mkdir()
    info, seen = info or run_info(), list(seen)
    meter = MetricsObserver()
    meter.begin(info)
    for frame in seen:
        meter.observe(frame)
    summary = {**meter.summary(), "outcome": "completed"}
    for key, value in change:
        *parts, last = key.split("/")
        place = summary
        for part in parts:
            place = place[part]
        place[last] = value
    return record(folder / "run.mcap", seen, info, summary=summary, events=events)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return run(tmp_path_factory.mktemp("first") / "run", frames())


def compared(one, other, **options):
    return compare_runs(read_log(one), read_log(other), **options)


def test_compare_same_flight_is_the_same(log, tmp_path):
    """Versions and numbers of the wall clock decide nothing."""
    info = run_info(versions={"testbed": "0.1", "jsbsim": "1.3.3"})
    again = run(tmp_path / "run", frames(), info, change=[("wall_s", 9.0), ("commanded", {})])
    found = compared(log, again)
    assert found.same
    assert found.compared > 100
    assert found.versions == ("testbed from 0.0 to 0.1",)
    assert [each.first_s for each in found.positions] == [None] * 4


def test_compare_last_bit_of_a_sample_is_found(log, tmp_path):
    east = read_log(log).truth.position_ned[AT, 2, 1]
    moved = run(tmp_path / "run", frames(moved_m=np.spacing(east)))
    found = compared(log, moved)
    assert not found.same_samples
    assert not found.same
    assert {each.name: each.first_s for each in found.positions}["uav2"] == TIME_S
    assert [each.first_s for each in found.positions].count(None) == 3


def off_slot(frame):
    """A frame in which uav2 is 3 m farther from its slot."""
    error = frame.formation.error_ned.copy()
    error[1] *= 1.0 + 3.0 / np.linalg.norm(error[1])
    return frame._replace(formation=frame.formation._replace(error_ned=error))


def test_compare_figure_draws_both_errors(log, tmp_path):
    other = run(tmp_path / "run", map(off_slot, frames()))
    first, second = read_run(log), read_run(other)
    grid = compare_figure(first, second, run_labels(first, second, ("a", "b")))
    assert [panels[0].title for panels in grid.rows] == ["uav1", "uav2", "uav3"]
    assert not grid.title
    for name, (panel,) in zip(first.followers, grid.rows, strict=True):
        one, two = panel.lines
        assert (one.label, two.label, two.dashes) == ("a", "b", "--")  # of one scenario
        farther = 3.0 if name == "uav2" else 0.0
        assert two.y == pytest.approx(one.y + farther, rel=1e-12)
        row = first.followers.index(name)
        assert np.array_equal(one.y, first.error[np.isin(first.log.time_s, one.x), row])
    assert len({panel.y_limits for (panel,) in grid.rows}) == 1


@pytest.mark.parametrize("ending", ["pdf", "svg", "png"] if ALL else ["pdf", "svg"])
def test_compare_figure_is_written(log, tmp_path, ending):
    file = tmp_path / f"a.{ending}"
    done = call_command(
        "compare", log, log, "--figure", file, cwd=tmp_path, code=0, columns=200
    ).stdout
    assert [line.split()[0] for line in done.splitlines()] == ["solid", "dashed", "figure"]
    written = file.read_bytes()
    starts = {"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}
    assert written.startswith(starts[ending])
    if ending == "svg":
        assert b'width="252pt"' in written  # a column of 3.5 inches


def test_compare_figure_needs_common_time(log, tmp_path):
    late = run(tmp_path / "run", list(frames())[100:])
    early = run(tmp_path / "early", list(frames())[:90])
    with pytest.raises(InputError, match="have no time in common"):
        compare_figure(read_run(early), read_run(late), ("a", "b"))


def test_compare_largest_distance_and_its_time(log, tmp_path):
    found = compared(log, run(tmp_path / "run", frames(moved_m=3.0)))
    [uav2] = [each for each in found.positions if each.largest_m > 0.0]
    assert (uav2.name, uav2.at_s, uav2.first_s) == ("uav2", TIME_S, TIME_S)
    assert uav2.largest_m == pytest.approx(3.0, rel=1e-12)  # two roundings of some 100 m


def test_compare_tolerance_ignores_samples(log, tmp_path):
    """With a tolerance, only metrics decide."""
    rms = read_log(log).metrics["windows"]["first"]["rms_m"]["uav1"]
    key = "windows/first/rms_m/uav1"
    moved = run(tmp_path / "run", frames(moved_m=1e-9), change=[(key, rms * 1.01)])
    assert compared(log, moved, tolerance=0.011).same
    tight = compared(log, moved, tolerance=0.009)
    assert not tight.same
    assert tight.differing == (MetricPair(key, rms, rms * 1.01),)


@pytest.mark.parametrize(
    ("first", "second", "tolerance", "agree"),
    [
        (1.0, 1.0, 0.0, True),
        (1.0, 1.0 + 2**-52, 0.0, False),
        (100.0, 99.0, 0.0101, True),
        (100.0, 99.0, 0.0099, False),
        (0.0, 1e-300, 0.5, False),  # relative to the larger
        (None, None, 0.0, True),
        (None, 0.0, 0.5, False),
        (True, 1, 0.5, False),
        ("completed", "lost", 0.5, False),
        (3, 3.0, 0.0, True),
    ],
)
def test_metric_pair_agrees_within_tolerance(first, second, tolerance, agree):
    assert MetricPair("key", first, second).agrees(tolerance) is agree
    assert MetricPair("key", second, first).agrees(tolerance) is agree


def test_compare_numbers_inside_lists(log, tmp_path):
    moved = run(tmp_path / "run", frames(), change=[("windows/first/window_s", [1.0, 2.0002])])
    found = compared(log, moved)
    assert found.differing == (MetricPair("windows/first/window_s/1", 2.0, 2.0002),)
    assert compared(log, moved, tolerance=0.001).same


def test_compare_events_samples_and_followers(log, tmp_path):
    """Each of them alone makes two runs differ."""
    _, gust = event(AT, "a gust")
    events = compared(log, run(tmp_path / "gust", frames(), events=(gust,)))
    assert (events.same, events.same_samples, events.same_events) == (False, True, False)
    shorter = compared(log, run(tmp_path / "short", list(frames())[:-1]))
    assert (shorter.same, shorter.sample_counts) == (False, (FRAMES, FRAMES - 1))
    assert [each.first_s for each in shorter.positions] == [None] * 4
    fewer = compared(log, run(tmp_path / "fewer", run_samples(FRAMES, 2), run_info(2)))
    assert not fewer.same
    assert [each.name for each in fewer.positions] == ["leader", "uav1", "uav2"]
    assert any(pair.key.endswith("/uav3") and pair.second is None for pair in fewer.differing)


def test_compare_scenario_keys_are_listed(tmp_path):
    """They decide nothing."""
    texts = [
        dump(load_scenario("simulation-3", changes)) for changes in ((), ("network.delay_s=0.25",))
    ]
    logs = [
        run(tmp_path / f"{k}", frames(), run_info(make_yaml=lambda text=text: text))
        for k, text in enumerate(texts)
    ]
    found = compared(*logs)
    assert found.scenario == ("network.delay_s from 0 to 0.25",)
    assert found.same
    unread = run(tmp_path / "old", frames(), run_info(make_yaml=lambda: "scenario: {schema: 0}"))
    [line] = compared(logs[0], unread).scenario
    assert "cannot read" in line


@pytest.fixture
def compare(log, tmp_path):
    """Run `testbed compare` in a folder with runs of several names."""
    near = [(key, 1.25) for key in ("min_separation_m", "windows/first/min_separation_m")]
    run(tmp_path / "moved", frames(moved_m=3.0), change=near)
    (tmp_path / "same").mkdir()
    (tmp_path / "same" / "run.mcap").write_bytes(log.read_bytes())
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "run.mcap").write_bytes(log.read_bytes())

    def command(*arguments, code):
        return call_command("compare", "first", *arguments, cwd=tmp_path, code=code, columns=100)

    return command


def test_compare_command_prints_and_exits(compare, tmp_path):
    check_snapshot("compare_same", compare("same", "--numbers", code=0).stdout)
    done = compare("moved", "--numbers", "--json", "what.json", code=3)
    check_snapshot("compare_moved", done.stdout)
    document = json.loads((tmp_path / "what.json").read_text())
    assert document["same"] is False
    (worse,) = document["worse"]
    assert (worse["key"], worse["after"]) == ("separation_in_windows_m", 1.25)
    assert worse["one_flight"] and worse["difference"]["low"] is None
    printed = compare("moved", "--numbers", "--json", "-", code=3)
    assert json.loads(printed.stdout) == document


def test_compare_command_different_lengths(compare, tmp_path):
    """Positions are compared where both runs have samples."""
    run(tmp_path / "short", list(frames())[:-20])
    check_snapshot("compare_short", compare("short", "--numbers", code=3).stdout)


def test_compare_command_cut_run_has_no_metrics(compare, log, tmp_path):
    data = log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    errors = compare("cut.mcap", "--numbers", code=2).stderr
    assert "error: cut.mcap: this run has no metrics" in errors and "leave out --numbers" in errors


@pytest.mark.usefixtures("compare")
def test_compare_command_options_excluding_each_other(tmp_path):
    refuse_all("compare", tmp_path)


def test_compare_command_overlay_has_both_runs(compare, tmp_path):
    """Without --numbers, both runs are written into one recording."""
    compare("moved", "--rrd", str(tmp_path / "both.rrd"), code=0)
    entities = subprocess.run(
        [rerun_program(), "rrd", "print", str(tmp_path / "both.rrd")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for letter in "AB":
        for name in ("leader", "uav1", "uav2", "uav3"):
            assert f"/world/aircraft/{letter}.{name}" in entities
