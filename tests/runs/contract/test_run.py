"""Runs in one process: repeated to the bit, inputs of the law, endings with complete files."""

import functools
import inspect
import io
import json
import os
import pkgutil
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from cases import ALL
from forked import run_program
from places import SHARED
from run_flight import (
    NOISY,
    Collector,
    arrays,
    fingerprint,
    fly_samples,
    fly_with_recorder,
    recorder,
    short,
)
from waiting import TIMEOUT_S, until

import testbed
from testbed.core.flags import LimiterFlag
from testbed.flight import loop
from testbed.logs import mcap_file
from testbed.logs.file_record import RECORD_NAME
from testbed.logs.read import read_log, samples
from testbed.plan.world import build
from testbed.runs import stop_request
from testbed.scenario import load_scenario
from testbed.sensors.estimators import StateEstimators

HERE = SHARED
ROOT = HERE.parents[1]


# determinism


def test_run_is_repeated_to_the_bit():
    """In this process and in a new one, without sensor errors and with them.

    A new one is that of test_directory_locale_hashes_and_other_runs_beside, too.
    """
    bits = [fingerprint(fly_samples(*noise, seconds=4.0)) for noise in ((), NOISY)]
    assert [fingerprint(fly_samples(*noise, seconds=4.0)) for noise in ((), NOISY)] == bits
    if not ALL:
        return
    code = (
        "from run_flight import *; print("
        "*(fingerprint(fly_samples(*noise, seconds=4.0)) for noise in ((), NOISY)))"
    )
    path = os.pathsep.join([str(HERE), str(ROOT)])
    variables = {**os.environ, "PYTHONPATH": path}
    fresh = subprocess.check_output([sys.executable, "-c", code], env=variables, text=True)
    assert fresh.split() == bits


def test_seed_changes_only_sensor_errors():
    one, two = fly_samples(*NOISY, seconds=2), fly_samples(*NOISY, "scenario.seed=2", seconds=2)
    assert (one[0].estimate.position_ned != two[0].estimate.position_ned).all()
    assert np.array_equal(one[0].truth.position_ned, two[0].truth.position_ned)
    assert (one[-1].truth.position_ned != two[-1].truth.position_ned).all()
    exact = [fingerprint(fly_samples(f"scenario.seed={seed}", seconds=2)) for seed in (1, 2)]
    assert exact[0] == exact[1]


@pytest.mark.parametrize("log_hz", [10, 100])
def test_log_rate_changes_no_flight(log_hz):
    """Also of unsynchronised aircraft, with sensor errors and packet loss."""
    knobs = (*NOISY, "rates.synchronous=false", "network.loss=0.3")
    usual = {frame.tick: frame for frame in fly_samples(*knobs, seconds=3)}
    other = {
        frame.tick: frame for frame in fly_samples(*knobs, f"rates.log_hz={log_hz}", seconds=3)
    }
    shared = sorted(usual.keys() & other.keys())
    assert len(shared) >= 16
    for tick in shared:
        one, two = (dict(arrays(frames_of[tick])) for frames_of in (usual, other))
        for name, array in one.items():
            assert np.array_equal(array, two[name], equal_nan=True), (tick, name)


def test_samples_come_at_the_log_rate_and_are_finite():
    seen = fly_samples("rates.log_hz=10", seconds=2)
    assert [frame.tick for frame in seen] == list(range(0, 201, 10))
    assert [frame.time_s for frame in seen] == [tick / 100 for tick in range(0, 201, 10)]
    for frame in seen:
        for name, array in arrays(frame):
            if name.removeprefix("air.") in ("state_of_charge", "battery_voltage"):
                assert np.isnan(array).all(), "a Rascal has no battery"
            elif name == "formation.age_s":
                # all followers use the leader's messages, and of the others those it has a gain for
                used = [[1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0]]
                assert np.array_equal(np.isfinite(array), np.array(used, dtype=bool))
            else:
                assert np.isfinite(array).all(), (frame.time_s, name)


# inputs of the law


@pytest.mark.parametrize("late", [0, 5])
def test_law_receives_own_estimate_and_messages(late, tmp_path):
    """UAV 1 has sensor errors: it and the others use its estimate of `late` periods ago."""
    changes = "fleet.0.sensors=gps-ins", f"network.delay_s={late * 0.04}"
    frames, received = fly_with_recorder(short(recorder(tmp_path), *changes, seconds=3))
    assert len(received) == len(frames) == 76
    for k, (now, own, inbox) in enumerate(received):
        estimated, truth = frames[k].estimate, frames[k].truth
        assert now == frames[k].time_s
        assert not own.wind_ned.any()  # there is none
        for name in type(estimated)._fields:
            assert np.array_equal(getattr(own, name), getattr(estimated, name)[1:]), name
        assert (own.position_ned[0] != truth.position_ned[1]).all()
        assert np.array_equal(own.position_ned[1:], truth.position_ned[2:])
        others = ~np.eye(4, dtype=bool)[1:]  # a follower's own row is written without a radio
        assert (inbox.stamp_s[~others] == now).all()
        if k < late:
            assert not inbox.failed.any()
            known = inbox._replace(failed=inbox.stamp_s)
            assert all(np.isnan(array[others]).all() for array in known)
            continue
        sent = frames[k - late]
        assert (inbox.stamp_s[others] == sent.time_s).all()
        assert inbox.received_s == pytest.approx(np.full((3, 4), now), abs=1e-9)
        for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler"):
            found = getattr(inbox, name)
            expected = np.broadcast_to(getattr(sent.estimate, name), found.shape)
            assert np.array_equal(found[others], expected[others]), name
            assert (found[1:, 1] != getattr(sent.truth, name)[1]).any(), name


def test_messages_come_at_the_broadcast_rate(tmp_path):
    changes = "rates.broadcast_hz=10", "rates.control_hz=50"
    _, received = fly_with_recorder(short(recorder(tmp_path), *changes, seconds=2))
    ages = {round(float((now - inbox.stamp_s).max()), 6) for now, _, inbox in received}
    assert ages == {0.0, 0.02, 0.04, 0.06, 0.08}


def test_without_messages_followers_fly_level_at_trim():
    """All commands derive from the inbox."""
    late = "network.delay_s=60"
    last = fly_samples(late, seconds=20)[-1]
    commanded = last.formation
    assert (commanded.limiter_flags == LimiterFlag.LEADER_TIMEOUT).all()
    assert commanded.course_desired == pytest.approx(np.full(3, np.pi / 2.0), abs=1e-9)
    assert commanded.course == pytest.approx(commanded.course_desired, abs=0.01)
    assert (commanded.flight_path_angle_desired == 0.0).all()
    trim_airspeed = build(short(late)).formation.built_control.config.trim_airspeed
    assert commanded.airspeed_command == pytest.approx(trim_airspeed, rel=1e-12)
    assert last.truth.airspeed[1:] == pytest.approx(trim_airspeed, abs=0.1)
    # a degree or two of bank, with which they steer the last third of a degree of course away
    assert last.truth.euler[1:, 0] == pytest.approx(np.zeros(3), abs=0.04)
    assert np.isnan(commanded.age_s).all()


# from Python


def test_run_by_name_with_overrides_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    watcher = Collector()
    result = testbed.run(
        "simulation-3", ["formation.k=2"], write=False, observers=[Stopper(after=5), watcher]
    )
    assert result.directory is None
    assert list(tmp_path.iterdir()) == []
    assert (result.outcome, result.exit_code) == ("interrupted", 130)
    assert result.scenario.formation.k == 2
    assert watcher.summary == result.metrics


def test_run_directory_has_scenario_log_and_metrics(tmp_path):
    scenario = short("log.mcap=true", seconds=2)
    watcher = Collector()
    result = testbed.run(scenario, out=tmp_path / "run", observers=[watcher])
    names = {path.name for path in result.directory.iterdir()}
    assert names == {"run.mcap", "scenario.resolved.yaml", "metrics.json", RECORD_NAME}
    assert result.exit_code == 0
    assert json.loads((result.directory / "metrics.json").read_text()) == result.metrics
    resolved = result.directory / "scenario.resolved.yaml"
    again = Collector()
    testbed.run(resolved, ["log.mcap=false"], write=False, observers=[again])
    assert fingerprint(again.frames) == fingerprint(watcher.frames)
    log = read_log(result.directory / "run.mcap")
    assert log.finished
    assert log.info.scenario_yaml == resolved.read_text()
    assert log.info.integrators["rate_rotational"] == "Adams-Bashforth 2"
    assert fingerprint(samples(log)) == fingerprint(watcher.frames)


# endings


class Stopper:
    """Sends this process a signal after some samples, once or more, and again at the end."""

    def __init__(self, *, after, number=signal.SIGINT, times=1, at_end=False):
        self._after, self._number, self._times, self._at_end = after, number, times, at_end
        self.sent = False

    def begin(self, info):
        if self._after == 0:
            signal.raise_signal(self._number)

    def observe(self, sample):
        self._after -= 1
        if self._after == 0:
            self.sent = True
            for _ in range(self._times):
                signal.raise_signal(self._number)

    def end(self, summary, events):
        if self._at_end:
            signal.raise_signal(self._number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after", [0, 30])
def test_signal_ends_the_run_with_complete_files(tmp_path, number, after):
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    result = testbed.run(
        short("log.mcap=true"),
        out=tmp_path / "run",
        observers=[Stopper(after=after, number=number)],
    )
    assert (result.outcome, result.exit_code) == ("interrupted", 130)
    log = read_log(tmp_path / "run" / "run.mcap")
    assert log.finished
    assert len(log.tick) == after
    assert log.metrics["outcome"] == "interrupted"
    assert result.metrics["simulated_s"] == pytest.approx(max(0, after - 1) / 25.0)
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == before


def test_signal_while_kernels_compile_ends_the_run(tmp_path, monkeypatch):
    """The kernels that are left are not compiled, and all files are complete."""
    monkeypatch.setattr(loop, "prepare", lambda calls, progress, check: [interrupt(), check()])
    interrupt = functools.partial(signal.raise_signal, signal.SIGINT)
    settled = []
    monkeypatch.setattr(StateEstimators, "warm_up", lambda *_: settled.append(True))
    result = testbed.run(short("log.mcap=true"), out=tmp_path / "run")
    assert (result.outcome, settled) == ("interrupted", [])
    assert read_log(tmp_path / "run" / "run.mcap").metrics["outcome"] == "interrupted"
    assert (tmp_path / "run" / "metrics.json").exists()


SWALLOWED = """
import os, signal, sys
from testbed.cli import main as cli

# as from a terminal; the parent of the tests may have set it to be ignored
signal.signal(signal.SIGINT, signal.default_int_handler)

def loads_a_library():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        signal.sigtimedwait([], 1)
    except:  # as some do
        print("swallowed")
    sys.argv = ["testbed", "run", "simulation-3", "--quiet", "--out", "run"]
    app()

app, cli.app = cli.app, loads_a_library
cli.main()
"""


def test_ctrl_c_swallowed_by_a_library_ends_the_run(tmp_path):
    code, printed, errors = run_program(SWALLOWED, folder=tmp_path)
    assert printed == "swallowed\n"
    assert code == 130, errors
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["simulated_s"] == 0.0


def assert_interrupted(out, samples):
    """All files of a run are complete, and it was interrupted after so many samples."""
    metrics = json.loads((out / "metrics.json").read_text())
    log = read_log(out / "run.mcap")
    assert log.finished and len(log.tick) == samples
    assert metrics["outcome"] == log.metrics["outcome"] == "interrupted"
    assert metrics["simulated_s"] == pytest.approx((samples - 1) / 25.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_within_a_second_are_one(tmp_path, number):
    stopper = Stopper(after=9, times=3, number=number, at_end=True)
    result = testbed.run(short("log.mcap=true"), out=tmp_path / "run", observers=[stopper])
    assert result.outcome == "interrupted"
    assert_interrupted(tmp_path / "run", 9)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_later_signal_ends_at_once_with_all_files(tmp_path, number, monkeypatch):
    monkeypatch.setattr("testbed.runs.stop_request.GRACE_S", 0.0)
    stopper = Stopper(after=9, times=2, number=number)
    with pytest.raises(KeyboardInterrupt):
        testbed.run(short("log.mcap=true"), out=tmp_path / "run", observers=[stopper])
    assert_interrupted(tmp_path / "run", 9)


@pytest.mark.parametrize(
    "interrupted",
    [
        "metrics.observer.summarise",
        "logs.mcap_file.McapWriter.attachment",
        "logs.mcap_file.McapWriter.close",
        "runs.run.finalise",
        "runs.run.write_json",
    ],
)
def test_later_signal_does_not_interrupt_ending(tmp_path, monkeypatch, interrupted):
    """It raises KeyboardInterrupt after all files are written."""
    monkeypatch.setattr("testbed.runs.stop_request.GRACE_S", 0.0)
    stopper = Stopper(after=9)
    original = pkgutil.resolve_name(f"testbed.{interrupted}")
    sent = []

    def signalled(*arguments, **options):
        if stopper.sent:
            sent.append(signal.raise_signal(signal.SIGINT))
        return original(*arguments, **options)

    monkeypatch.setattr(f"testbed.{interrupted}", signalled)
    with pytest.raises(KeyboardInterrupt):
        testbed.run(short("log.mcap=true"), out=tmp_path / "run", observers=[stopper])
    assert sent
    assert_interrupted(tmp_path / "run", 9)


def test_later_signal_interrupts_end_of_an_observer(tmp_path, monkeypatch):
    """Only this one: it may hang."""
    monkeypatch.setattr("testbed.runs.stop_request.GRACE_S", 0.0)
    stopper, after = Stopper(after=9, at_end=True), Collector()
    with pytest.raises(KeyboardInterrupt):
        testbed.run(short("log.mcap=true"), out=tmp_path / "run", observers=[after, stopper])
    assert after.summary["outcome"] == "interrupted"
    assert_interrupted(tmp_path / "run", 9)


def test_log_without_metrics_counts_as_cut(tmp_path):
    """An observer that cannot begin leaves a finished log, but never one with empty metrics."""

    class CannotBegin(Collector):
        def begin(self, info):
            raise RuntimeError("no viewer")

    with pytest.raises(RuntimeError, match="no viewer"):
        testbed.run(short("log.mcap=true"), out=tmp_path / "run", observers=[CannotBegin()])
    assert not (tmp_path / "run" / "metrics.json").exists()
    assert "metrics.json" not in mcap_file.read(tmp_path / "run" / "run.mcap").attachments


class Broken(Collector):
    """Raises at its third sample."""

    def observe(self, sample):
        super().observe(sample)
        if len(self.frames) == 3:
            raise RuntimeError("disk full")


def test_observer_that_raises_ends_the_run_as_failed(tmp_path):
    out, bystander = tmp_path / "run", Collector()
    with pytest.raises(RuntimeError, match="disk full"):
        testbed.run(short("log.mcap=true"), out=out, observers=[bystander, Broken()])
    assert json.loads((out / "metrics.json").read_text())["outcome"] == "failed"
    log = read_log(out / "run.mcap")
    assert log.finished
    assert any("disk full" in event.text for event in log.events)
    assert bystander.summary["outcome"] == "failed"


def test_run_outside_the_main_thread():
    results = []
    thread = threading.Thread(
        target=lambda: results.append(testbed.run(short(seconds=1), write=False))
    )
    thread.start()
    thread.join(TIMEOUT_S)
    assert [result.outcome for result in results] == ["completed"]


def test_package_shows_its_public_names(monkeypatch):
    assert dir(testbed) == sorted({*testbed.__all__, "law"})
    monkeypatch.delitem(sys.modules, "testbed.law", raising=False)
    monkeypatch.delattr(testbed, "law", raising=False)
    assert testbed.law.Inbox._fields[0] == "stamp_s"
    assert " at 0x" not in str(inspect.signature(testbed.run))


def test_run_is_printed_as_a_short_table(tmp_path):
    """Outcome, RMS errors by follower and window, separation, directory: ten lines at most."""
    names = [f"uav{k}" for k in range(1, 9)]
    windows = {
        f"w{k}": {
            "window_s": [10.0 * k, 10.0 * k + 10.0],
            "covered_s": 10.0 if k < 3 else 4.0,
            "complete": k < 3,
            "rms_m": {name: k + 0.1 * i for i, name in enumerate(names)},
            "mean_rms_m": None,
        }
        for k in range(6)
    }
    head = {"scenario": "here <b>", "seed": 1, "outcome": "lost", "simulated_s": 90.0}
    facts = {"max_error_m": dict.fromkeys(names, 12.0), "min_separation_m": 5.0}
    metrics = {**head, **facts, "windows": windows}
    run = testbed.Run(load_scenario("own-law-repulsion"), metrics, tmp_path)
    lines = repr(run).splitlines()
    assert lines[0] == "here <b> · lost · 90 s · seed 1"
    assert lines[1].split() == [
        *("RMS", "error,", "4", "worst,", "m", "w0", "w1", "w2", "w3", "and", "2", "more")
    ]
    assert lines[2].split() == "0–10 s 10–20 s 20–30 s 30–40 s, 4 s flown".split()
    assert [line.split()[0] for line in lines[3:7]] == names[4:]  # those with the largest errors
    assert lines[6].split() == ["uav8", "0.70", "1.70", "2.70", "3.70"]
    assert lines[7].split() == ["mean", "of", "8", *"––––"]
    assert lines[8:] == ["smallest separation 5.00 m", str(tmp_path)]
    html = run._repr_html_()
    assert "<td>uav8</td><td>0.70</td>" in html and "here &lt;b&gt;" in html
    short = testbed.Run(run.scenario, metrics | {"windows": {}}, None)
    assert len(repr(short).splitlines()) == 7 and "12.00" in repr(short)


def test_stop_that_waits_says_where_it_is(monkeypatch):
    monkeypatch.setattr(stop_request, "GRACE_S", 0.02)
    # what takes text out of it, as capfd, would be where the process is
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with pytest.raises(KeyboardInterrupt), stop_request.stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        until(lambda: "\n" in said.getvalue()[1:])
        assert "test_run.py:" in said.getvalue() or "waiting.py:" in said.getvalue()
        assert stop()
        os.kill(os.getpid(), signal.SIGINT)
    said.seek(0)
    said.truncate()
    with stop_request.stop_on_signals() as stop:  # a run that ends in time says nothing
        os.kill(os.getpid(), signal.SIGTERM)
        stop.begin_ending()
        time.sleep(0.05)
    assert said.getvalue() == ""
