"""Two runs compared: what is the same, what is not, from when on, and how scripts are told."""

import json
import subprocess

import numpy as np
import pytest
from commands import call_command
from record_flight import event, record, run_frames, run_info

from testbed.metrics import MetricsObserver
from testbed.record.read import read_log
from testbed.scenario import dump, load
from testbed.study.two_runs import Pair, compare_runs
from testbed.views.viewer import program

FRAMES = 120  # 4.8 s: both portions of the made-up run
AT, TIME_S = 70, 2.8  # a frame, and its time


def frames(*, moved_m=0.0):
    """A made-up flight in which uav2 is this much farther east in one frame."""
    for k, frame in enumerate(run_frames(FRAMES)):
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
    summary = {**meter.summary(), "outcome": "flown", "network": {}}
    for key, value in change:
        *parts, last = key.split("/")
        place = summary
        for part in parts:
            place = place[part]
        place[last] = value
    return record(folder / "run.mcap", seen, info, summary=summary, events=events)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return run(tmp_path_factory.mktemp("first") / "run", frames())


def compared(one, other, **how):
    return compare_runs(read_log(one), read_log(other), **how)


def test_the_same_flight_twice_is_the_same(flown, tmp_path):
    info = run_info(versions={"testbed": "0.1", "jsbsim": "1.3.3"})
    again = run(tmp_path / "run", frames(), info, change=[("wall_s", 9.0), ("pace", {"kept": 1})])
    found = compared(flown, again)
    assert found.same
    assert found.numbers > 100
    assert found.versions == ("testbed from 0.0 to 0.1",)
    assert [each.first_s for each in found.apart] == [None] * 4


def test_a_last_bit_of_one_frame_is_found_with_its_time(flown, tmp_path):
    east = read_log(flown).truth.position_ned[AT, 2, 1]
    moved = run(tmp_path / "run", frames(moved_m=np.spacing(east)))
    found = compared(flown, moved)
    assert not found.same_frames
    assert not found.same
    assert {each.name: each.first_s for each in found.apart}["uav2"] == TIME_S
    assert [each.first_s for each in found.apart].count(None) == 3


def test_aircraft_are_as_far_apart_as_they_are(flown, tmp_path):
    found = compared(flown, run(tmp_path / "run", frames(moved_m=3.0)))
    [uav2] = [each for each in found.apart if each.largest_m > 0.0]
    assert (uav2.name, uav2.at_s, uav2.first_s) == ("uav2", TIME_S, TIME_S)
    assert uav2.largest_m == pytest.approx(3.0, rel=1e-12)  # two roundings of some 100 m


def test_within_a_share_metrics_agree_and_frames_are_not_asked(flown, tmp_path):
    rms = read_log(flown).metrics["portions"]["first"]["rms_m"]["uav1"]
    key = "portions/first/rms_m/uav1"
    moved = run(tmp_path / "run", frames(moved_m=1e-9), change=[(key, rms * 1.01)])
    assert compared(flown, moved, within=0.011).same
    tight = compared(flown, moved, within=0.009)
    assert not tight.same
    assert tight.moved == (Pair(key, rms, rms * 1.01),)


@pytest.mark.parametrize(
    ("first", "second", "within", "agree"),
    [
        (1.0, 1.0, 0.0, True),
        (1.0, 1.0 + 2**-52, 0.0, False),
        (100.0, 99.0, 0.0101, True),
        (100.0, 99.0, 0.0099, False),
        (0.0, 1e-300, 0.5, False),  # no share of anything is nothing
        (None, None, 0.0, True),
        (None, 0.0, 0.5, False),
        (True, 1, 0.5, False),
        ("flown", "lost", 0.5, False),
        (3, 3.0, 0.0, True),
    ],
)
def test_numbers_agree_within_a_share_of_the_larger(first, second, within, agree):
    assert Pair("key", first, second).agrees(within) is agree
    assert Pair("key", second, first).agrees(within) is agree


def test_numbers_in_lists_are_numbers(flown, tmp_path):
    moved = run(tmp_path / "run", frames(), change=[("portions/first/window_s", [1.0, 2.0002])])
    found = compared(flown, moved)
    assert found.moved == (Pair("portions/first/window_s/1", 2.0, 2.0002),)
    assert compared(flown, moved, within=0.001).same


def test_events_frames_and_followers_count(flown, tmp_path):
    _, gust = event(AT, "a gust")
    happened = compared(flown, run(tmp_path / "gust", frames(), events=(gust,)))
    assert (happened.same, happened.same_frames, happened.same_events) == (False, True, False)
    shorter = compared(flown, run(tmp_path / "short", list(frames())[:-1]))
    assert (shorter.same, shorter.frames) == (False, (FRAMES, FRAMES - 1))
    assert [each.first_s for each in shorter.apart] == [None] * 4
    fewer = compared(flown, run(tmp_path / "fewer", run_frames(FRAMES, 2), run_info(2)))
    assert not fewer.same
    assert [each.name for each in fewer.apart] == ["leader", "uav1", "uav2"]
    assert any(pair.key.endswith("/uav3") and pair.second is None for pair in fewer.moved)


def test_what_differs_on_the_page_is_told_and_decides_nothing(tmp_path):
    pages = [dump(load("simulation-3", changes)) for changes in ((), ("network.delay_s=0.25",))]
    logs = [
        run(tmp_path / f"{k}", frames(), run_info(scenario_yaml=page))
        for k, page in enumerate(pages)
    ]
    found = compared(*logs)
    assert found.page == ("network.delay_s from 0 to 0.25",)
    assert found.same
    unread = run(tmp_path / "old", frames(), run_info(scenario_yaml="scenario: {schema: 0}"))
    [line] = compared(logs[0], unread).page
    assert "cannot read" in line


@pytest.fixture
def desk(flown, tmp_path):
    """Runs by name, and a command that compares them."""
    run(tmp_path / "moved", frames(moved_m=3.0), change=[("min_separation_m", 1.25)])
    (tmp_path / "same").mkdir()
    (tmp_path / "same" / "run.mcap").write_bytes(flown.read_bytes())

    def compare(*arguments, code):
        return call_command("compare", flown, *arguments, cwd=tmp_path, code=code, columns=100)

    return compare


def test_scripts_are_told_by_the_exit_code(desk, tmp_path):
    assert "the same" in desk("same", "--numbers", code=0).stdout
    done = desk("moved", "--numbers", "--json", "what.json", code=3)
    lines = done.stdout.splitlines()
    assert any("smallest separation, m" in line and "1.250" in line for line in lines)
    assert f" uav2 up to 3 m apart, at {TIME_S} s; not the same from {TIME_S} s on" in lines
    assert "different:" in lines[-1]
    document = json.loads((tmp_path / "what.json").read_text())
    assert document["same"] is False
    assert document["metrics_moved"]["min_separation_m"][1] == 1.25
    assert document["apart"][2]["name"] == "uav2"
    printed = desk("moved", "--numbers", "--json", "-", code=3)
    assert json.loads(printed.stdout) == document


def test_a_run_cut_short_has_no_metrics_to_compare(desk, flown, tmp_path):
    data = flown.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    said = desk("cut.mcap", "--numbers", code=2).stderr
    assert "error: cut.mcap: this run has no metrics" in said and "leave --numbers out" in said


def test_of_runs_of_unlike_length_the_motion_is_compared_where_both_have_it(desk, tmp_path):
    run(tmp_path / "short", list(frames())[:-20])
    said = desk("short", "--numbers", code=3).stdout
    shared = FRAMES - 20
    last = (shared - 1) / 25
    assert (
        f" motion   the same to the last bit in the {shared} frames of both, 0 to {last:g} s"
        in said
    )
    assert f"{FRAMES} and {shared} frames" in said
    said = desk("moved", "--numbers", code=3).stdout
    assert f" motion   1 of 4 aircraft moved otherwise in the {FRAMES} frames of both" in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("same", "--within", "0.1"), "--numbers too"),
        (("same", "--json", "it.json"), "--numbers too"),
        (("same", "--numbers", "--rrd", "it.rrd"), "leave --numbers out"),
        (("same", "--numbers", "--within", "2"), "0.01 for 1 %"),
        (("same", "--numbers", "--within", "-1"), "0.01 for 1 %"),
        (("same", "--numbers", "--json", "no/it.json"), "no folder"),
        (("no-such-run", "--numbers"), "no-such-run"),
    ],
)
def test_what_says_nothing_together_is_refused(desk, arguments, message):
    assert message in desk(*arguments, code=2).stderr


def test_without_numbers_both_runs_are_laid_over_one_another(desk, tmp_path):
    desk("moved", "--rrd", str(tmp_path / "both.rrd"), code=0)
    said = subprocess.run(
        [program(), "rrd", "print", str(tmp_path / "both.rrd")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for run_of in "AB":
        for name in ("leader", "uav1", "uav2", "uav3"):
            assert f"/world/aircraft/{run_of}.{name}" in said
