"""Runs that were cut short are finished from their logs, and nothing is lost on the way."""

import json
import os
import shutil
import struct

import numpy as np
import pytest
from commands import call_command

import testbed
from testbed.metrics import MetricsObserver
from testbed.record.door import LogError
from testbed.record.read import frames, read_log
from testbed.report import figures
from testbed.scenario import load
from testbed.sim.recover import recover
from testbed.state import VehicleState

MAGIC, CHUNK = 8, 6  # bytes that an MCAP file begins with, and the number of a chunk
HEAD = struct.Struct("<BQ")  # of a record: its number, and the length of the rest
CUTS = int(os.environ.get("TESTBED_CUTS", "4"))
PAGE = [
    "scenario.duration_s=60",
    "scenario.portions={early: [5, 12], late: [12, 60]}",
    "scenario.published=null",
    "network.loss=0.1",
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The directory of a run that came to its end."""
    out = tmp_path_factory.mktemp("whole") / "run"
    page = load("simulation-3", [*PAGE, "network.mute_s={leader: [[6, 9]]}"])
    testbed.run(page, out=out)
    return out


@pytest.fixture
def cut(whole, tmp_path):
    """A copy of the run, its log cut at a part of its length and its metrics not written."""

    def at(part):
        out = tmp_path / f"cut-{part:.4f}"
        shutil.copytree(whole, out)
        (out / "metrics.json").unlink()
        data = (out / "run.mcap").read_bytes()
        (out / "run.mcap").write_bytes(data[: round(part * len(data))])
        return out

    return at


def test_everything_that_was_whole_is_there(whole, cut):
    """Frames and events to the bit, and the metrics that these frames have."""
    rng = np.random.default_rng(5)
    full = read_log(whole / "run.mcap")
    for part in rng.uniform(0.2, 0.97, CUTS):
        run = cut(part)
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
        for frame, _ in zip(frames(full), range(count), strict=False):
            meter.observe(frame)
        expected, told = meter.summary(), json.loads((run / "metrics.json").read_text())
        for key in ("simulated_s", "portions", "min_separation_m", "followers"):
            if key in expected:
                assert told[key] == expected[key], key
        assert told["network"] is None and told["wall_s"] is None and told["recovered"]
        assert {each.name for each in run.iterdir()} == {each.name for each in whole.iterdir()}


def test_the_command_says_what_it_found(cut, monkeypatch):
    monkeypatch.setattr(figures, "MAKERS", ())  # of the report: to draw them takes seconds
    run = cut(0.6)
    said = call_command("recover", run, cwd=run.parent, code=0, columns=100).stdout
    assert "interrupted" in said and "run.mcap: finished" in said
    kept = (run / "run.mcap").read_bytes()
    said = call_command("recover", run, cwd=run.parent, code=0, columns=100).stdout
    assert "is whole, there is nothing to do" in said
    assert (run / "run.mcap").read_bytes() == kept
    call_command("report", run, cwd=run.parent, code=0, columns=100)


def test_metrics_that_were_not_written_any_more_are_those_of_the_finished_log(whole, cut):
    """Killed between the two."""
    run = cut(1.0)
    kept = (run / "run.mcap").read_bytes()
    assert not recover(run).was_cut
    told = json.loads((run / "metrics.json").read_text())
    of_the_day = {"wall_s": None, "real_time_factor": None}
    assert told == json.loads((whole / "metrics.json").read_text()) | of_the_day
    assert (run / "run.mcap").read_bytes() == kept


def test_a_log_without_a_frame_stays_as_it_is(cut):
    run = cut(1.0)
    log = (run / "run.mcap").read_bytes()
    at = MAGIC
    while log[at] != CHUNK:
        at += HEAD.size + HEAD.unpack_from(log, at)[1]
    (run / "run.mcap").write_bytes(log[: at + 60])  # half of the first one's head
    kept = (run / "run.mcap").read_bytes()
    said = call_command("recover", run, cwd=run.parent, code=2, columns=100).stderr
    assert "run.mcap: was cut before its first frame" in said
    assert (run / "run.mcap").read_bytes() == kept


@pytest.mark.parametrize("fails", ["damage", "disk", "content"])
def test_whatever_fails_the_old_log_stays(fails, cut, monkeypatch):
    run = cut(0.6)
    log = run / "run.mcap"
    if fails == "damage":
        data = bytearray(log.read_bytes())
        at = MAGIC
        while data[at] != CHUNK:
            at += HEAD.size + HEAD.unpack_from(data, at)[1]
        # amid what is packed: not every byte of a file counts
        data[at + (HEAD.size + HEAD.unpack_from(data, at)[1]) // 2] ^= 0xFF
        log.write_bytes(data)
    kept, names = log.read_bytes(), {each.name for each in run.iterdir()}
    if fails == "disk":

        def full(*paths):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
    if fails == "content":
        monkeypatch.setattr("testbed.sim.recover._as_long", lambda *logs: False)
    with pytest.raises(LogError, match=r"run\.mcap"):
        recover(run)
    assert log.read_bytes() == kept
    assert {each.name for each in run.iterdir()} == names
