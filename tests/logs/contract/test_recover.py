"""Recovering runs that were cut short: the log is completed and nothing of it is lost."""

import json
import os
import shutil
import signal
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from commands import call_command, environment
from forked import Forked
from waiting import TIMEOUT_S

import testbed
from testbed.core.records import VehicleState
from testbed.logs.mcap_file import LogError
from testbed.logs.read import read_log, replay, samples
from testbed.logs.recorder import McapRecorder
from testbed.metrics.observer import MetricsObserver
from testbed.reports import figures
from testbed.runs.recover import _is_complete, recover
from testbed.scenario import load_scenario

MAGIC, CHUNK = 8, 6  # bytes of MCAP's magic, and the opcode of a chunk
HEAD = struct.Struct("<BQ")  # of a record: opcode, and length of the rest
CUTS = int(os.environ.get("TESTBED_CUTS", "2"))
CHANGES = [
    "scenario.duration_s=14",
    "scenario.windows={early: [3, 7], late: [7, 14]}",
    "scenario.published=null",
    "network.loss=0.1",
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The directory of a completed run."""
    out = tmp_path_factory.mktemp("whole") / "run"
    scenario = load_scenario(
        "simulation-3", [*CHANGES, "network.transmitter_off_s={leader: [[3, 5]]}"]
    )
    testbed.run(scenario, out=out)
    return out


@pytest.fixture
def cut(whole, tmp_path):
    """Copy the run with its log cut at a fraction of its length, and without metrics.json."""

    def at(fraction):
        out = tmp_path / f"cut-{fraction:.4f}"
        shutil.copytree(whole, out)
        (out / "metrics.json").unlink()
        data = (out / "run.mcap").read_bytes()
        (out / "run.mcap").write_bytes(data[: round(fraction * len(data))])
        return out

    return at


def test_recover_keeps_everything_before_cut(whole, cut):
    """Samples and events to the bit, and the metrics computed from these samples."""
    rng = np.random.default_rng(5)
    full = read_log(whole / "run.mcap")
    for fraction in rng.uniform(0.2, 0.97, CUTS):
        run = cut(fraction)
        before = read_log(run / "run.mcap")
        assert not before.finished
        found = recover(run)
        assert found.was_cut and found.lost_bytes == before.lost_bytes
        after = read_log(run / "run.mcap")
        assert after.finished and after.metrics["outcome"] == "interrupted"
        count = len(before.tick)
        assert count > 20 and np.array_equal(after.tick, full.tick[:count])
        for field in VehicleState._fields:
            ours, theirs = (getattr(log.truth, field) for log in (after, full))
            np.testing.assert_array_equal(ours, theirs[:count])
        assert after.events[:-1] == before.events
        assert "recovered: the log was cut after" in after.events[-1].text
        meter = MetricsObserver()
        meter.begin(full.info)
        for sample, _ in zip(samples(full), range(count), strict=False):
            meter.observe(sample)
        expected, metrics = meter.summary(), json.loads((run / "metrics.json").read_text())
        for key in ("simulated_s", "windows", "min_separation_m", "followers"):
            if key in expected:
                assert metrics[key] == expected[key], key
        assert metrics["network"] is None and metrics["wall_s"] is None and metrics["recovered"]
        assert {each.name for each in run.iterdir()} == {each.name for each in whole.iterdir()}


def test_recover_command_reports_result(cut, monkeypatch):
    monkeypatch.setattr(figures, "MAKERS", ())  # a report without figures, which take seconds
    run = cut(0.6)
    output = call_command("recover", run, cwd=run.parent, code=0, columns=100).stdout
    assert "interrupted" in output and "run.mcap: finished" in output
    kept = (run / "run.mcap").read_bytes()
    output = call_command("recover", run, cwd=run.parent, code=0, columns=100).stdout
    assert "complete, nothing to recover" in output
    assert (run / "run.mcap").read_bytes() == kept
    call_command("report", run, cwd=run.parent, code=0, columns=100)


def test_recover_writes_missing_metrics_of_log(whole, cut):
    """The run was killed after it finished the log and before it wrote the metrics."""
    run = cut(1.0)
    kept = (run / "run.mcap").read_bytes()
    assert not recover(run).was_cut
    metrics = json.loads((run / "metrics.json").read_text())
    wall_clock = {"wall_s": None, "real_time_factor": None}
    assert metrics == json.loads((whole / "metrics.json").read_text()) | wall_clock
    assert (run / "run.mcap").read_bytes() == kept


@pytest.mark.parametrize("metrics", [{}, None])
def test_finished_log_without_metrics_is_cut(metrics, whole, tmp_path):
    """Empty metrics, as of an interrupted ending, count as none."""
    log, run = read_log(whole / "run.mcap"), tmp_path / "run"
    run.mkdir()
    recorder = McapRecorder(run / "run.mcap")
    rest = replay(log, [recorder])
    if metrics is not None:
        recorder._file.attachment("metrics.json", "application/json", json.dumps(metrics).encode())
    recorder.end({}, rest)
    assert read_log(run / "run.mcap").finished
    error = call_command("compare", run, whole, "--numbers", cwd=run, code=2, columns=500).stderr
    assert error.count("\n") == 1 and "finish it with `testbed recover" in error
    assert recover(run).was_cut
    after = read_log(run / "run.mcap")
    assert after.metrics["recovered"] and after.tick.size == log.tick.size
    assert json.loads((run / "metrics.json").read_text())["outcome"] == "interrupted"


def test_killed_recover_leaves_nothing_to_clean_up(cut):
    """What it leaves is removed by the next one."""
    run = cut(0.6)
    names, log = {each.name for each in run.iterdir()}, (run / "run.mcap").read_bytes()
    code = (
        "import os, sys; from testbed.runs import recover as module;"
        "module._is_complete = lambda *logs: os.kill(os.getpid(), 9); module.recover(sys.argv[2])"
    )
    process = Forked("forked:execute", code, run, cwd=run.parent, env=environment(80))
    assert process.wait(TIMEOUT_S) == -signal.SIGKILL and (run / "run.mcap").read_bytes() == log
    (left,) = {each.name for each in run.iterdir()} - names
    assert left.startswith(".testbed-")
    assert recover(run).was_cut
    assert {each.name for each in run.iterdir()} == names | {"metrics.json"}


def test_recover_log_without_samples_unchanged(cut):
    run = cut(1.0)
    log = (run / "run.mcap").read_bytes()
    at = MAGIC
    while log[at] != CHUNK:
        at += HEAD.size + HEAD.unpack_from(log, at)[1]
    (run / "run.mcap").write_bytes(log[: at + 60])  # within the head of the first chunk
    kept = (run / "run.mcap").read_bytes()
    output = call_command("recover", run, cwd=run.parent, code=2, columns=100).stderr
    assert "run.mcap: was cut before its first sample" in output
    assert (run / "run.mcap").read_bytes() == kept


@pytest.mark.parametrize("fails", ["damage", "disk", "content"])
def test_recover_failure_leaves_log_unchanged(fails, cut, monkeypatch):
    run = cut(0.6)
    log = run / "run.mcap"
    if fails == "damage":
        data = bytearray(log.read_bytes())
        at = MAGIC
        while data[at] != CHUNK:
            at += HEAD.size + HEAD.unpack_from(data, at)[1]
        # within the compressed data: some bytes of a file are not used
        data[at + (HEAD.size + HEAD.unpack_from(data, at)[1]) // 2] ^= 0xFF
        log.write_bytes(data)
    kept, names = log.read_bytes(), {each.name for each in run.iterdir()}
    if fails == "disk":

        def full(*paths):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
    if fails == "content":
        monkeypatch.setattr("testbed.runs.recover._is_complete", lambda *logs: False)
    with pytest.raises(LogError, match=r"run\.mcap"):
        recover(run)
    assert log.read_bytes() == kept
    assert {each.name for each in run.iterdir()} == names


def test_flipped_bits_are_never_read_as_numbers(tmp_path):
    """At 50 places of the compressed data, drawn by a seed; zstd itself notices a part of them."""
    testbed.run(
        "simulation-3",
        ["scenario.windows={}", "scenario.published=null"],
        duration_s=3.0,
        out=tmp_path / "run",
    )
    log = tmp_path / "run" / "run.mcap"
    whole, places, at = log.read_bytes(), [], MAGIC
    while at + HEAD.size < len(whole):
        kind, length = HEAD.unpack_from(whole, at)
        if kind == CHUNK:  # times, size, CRC, the name of the compression, size: 8+8+8+4+(4+4)+8
            places += range(at + HEAD.size + 44, at + HEAD.size + length)
        at += HEAD.size + length
    assert len(places) > 10_000 and read_log(log).finished
    rng = np.random.default_rng(447)
    for place in rng.choice(places, 50, replace=False).tolist():
        data = bytearray(whole)
        data[place] ^= 1 << int(rng.integers(8))
        log.write_bytes(data)
        with pytest.raises(LogError, match=r"run\.mcap"):
            read_log(log)


def test_log_without_a_sample_is_not_complete():
    """The event is that of the recovery, which the new log has in addition."""

    def log(samples, events, *, finished=True):
        found = {"finished": finished, "metrics": {}, "events": [None] * events}
        return SimpleNamespace(**found, tick=np.arange(samples))

    assert _is_complete(log(9, 4), log(9, 3, finished=False))
    for count, events in ((8, 4), (10, 4), (9, 3), (9, 5)):
        assert not _is_complete(log(count, events), log(9, 3, finished=False))
    assert not _is_complete(log(9, 4, finished=False), log(9, 3, finished=False))
