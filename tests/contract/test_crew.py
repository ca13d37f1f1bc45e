"""Flight models that several processes step: the same to the bit, and nobody is left behind."""

import functools
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import children, environment
from patience import PATIENCE_S, until

import testbed
from testbed.record.read import read_log
from testbed.scenario import load
from testbed.vehicle import crew
from testbed.vehicle.crew import crew_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")

SHORT = ["scenario.portions=null", "scenario.published=null"]
BREAKS = (
    "[{kind: surface-stuck, surface: elevator, position: -1, at_s: 1}, {kind: engine-out, at_s: 1}]"
)
PAGES = {
    "vee": ("vee-30", ["fleet.count=6", "scenario.duration_s=4"]),
    "turbulence and estimates": (
        "turbulence-moderate",
        ["scenario.duration_s=3", "leader.sensors=pixhawk", "fleet.*.sensors=pixhawk"],
    ),
    "one is lost": (
        "engine-out-uav2",
        ["scenario.duration_s=12", f"fleet.uav2.faults={BREAKS}"],
    ),
    "moments of their own": (
        "bursty-wifi",
        [
            "scenario.duration_s=4",
            "rates.log_hz=40",
            "network.broadcast={uav2: {period_s: 0.0173, phase_s: 0.004}}",
        ],
    ),
    "one is lost amid others' moments": (
        "engine-out-uav2",
        ["scenario.duration_s=12", "rates.synchronous=false", f"fleet.uav2.faults={BREAKS}"],
    ),
    "a battery": (
        "experiment-3",
        [
            "scenario.duration_s=6",
            "fleet.uav2.faults=[{kind: battery-low, state_of_charge: 0.3, at_s: 2}]",
        ],
    ),
}


class Keeper:
    """Keeps everything about everybody."""

    def begin(self, info):
        """Nothing was seen."""
        self.seen, self.said, self.lost = [], [], 0

    def observe(self, frame):
        """Keep it."""
        records = (frame.truth, frame.estimate, frame.air, frame.surfaces, frame.formation)
        arrays = [array for record in records for array in record]
        self.seen.append(np.concatenate([np.ravel(array) for array in (*arrays, frame.lost)]))
        self.lost = int(frame.lost.sum())
        self.said += [(event.time_s, event.text) for event in frame.events]

    def end(self, summary, events):
        """Nothing."""


@functools.cache
def flown(case, processes):
    name, changes = PAGES[case]
    keeper = Keeper()
    run = testbed.run(
        load(name, [*SHORT, *changes]), write=False, observers=[keeper], processes=processes
    )
    return np.array(keeper.seen), keeper.said, (run.outcome, keeper.lost)


@pytest.mark.parametrize("case", PAGES)
def test_who_steps_an_aircraft_changes_nothing(case):
    before = children(os.getpid())
    seen, said, outcome = flown(case, 1)
    assert outcome == ("flown", case.startswith("one is lost"))  # whose loss was foreseen
    for processes in (2, 3):
        again, same, ended = flown(case, processes)
        np.testing.assert_array_equal(again, seen)
        assert (same, ended) == (said, outcome)
    assert not set(children(os.getpid())) - set(before)


def test_more_processes_than_aircraft():
    seen, *_ = flown("vee", 50)
    np.testing.assert_array_equal(seen, flown("vee", 1)[0])


def test_few_aircraft_are_stepped_by_one(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    assert [crew_of(n) for n in (1, 4, 19, 20, 30, 60, 100)] == [1, 1, 1, 2, 3, 6, 8]
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert crew_of(100) == 1
    monkeypatch.setattr(crew.sys, "platform", "darwin")
    assert crew_of(100) == 1


@pytest.fixture
def flight(tmp_path):
    """A run of two processes in flight, and the other one's id."""
    command = ["run", "vee-30", "--set", "fleet.count=6", "--processes", "2", "--out", "run"]
    with subprocess.Popen(
        [sys.executable, "-m", "testbed", *command],
        cwd=tmp_path,
        env=environment(120),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            log = tmp_path / "run" / "run.mcap"
            # more than the header: aircraft, which were tried out in a child, too, are in flight
            until(lambda: log.exists() and log.stat().st_size > 100_000)
            (other,) = children(process.pid)
            yield process, other, log
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


def test_a_process_that_is_killed_ends_the_run_with_a_word(flight):
    process, other, path = flight
    os.kill(other, signal.SIGKILL)
    _, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 5
    assert "a process that steps aircraft (4, 5, 6 of the flight models, from 0)" in said
    assert "ended with -9" in said and "--processes 1" in said
    assert "Traceback" not in said
    log = read_log(path)
    assert log.finished and "has ended with -9" in log.events[-1].text


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_all_of_them_ends_the_run_in_order(flight, number):
    process, other, path = flight
    os.killpg(process.pid, number)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert read_log(path).finished
    assert not Path(f"/proc/{other}").exists()


def test_without_its_parent_a_process_ends(flight):
    process, other, _ = flight
    process.kill()
    process.wait(timeout=PATIENCE_S)
    until(lambda: not Path(f"/proc/{other}").exists())
