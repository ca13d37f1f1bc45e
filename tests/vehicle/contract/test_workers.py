"""Flight models stepped by several processes: equal to the bit; no process remains."""

import functools
import os
import signal
import sys
from pathlib import Path

import pytest
from cases import ALL
from commands import children, environment
from forked import Forked
from run_flight import Collector, fingerprint
from waiting import TIMEOUT_S, until

import testbed
from testbed.logs.read import read_log
from testbed.scenario import load_scenario
from testbed.vehicle import workers
from testbed.vehicle.workers import default_processes

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")

SHORT = ["scenario.windows=null", "scenario.published=null"]
FAULTS = (
    "[{kind: surface-stuck, surface: elevator, position: -1, at_s: 1}, {kind: engine-out, at_s: 1}]"
)
LOST = "one is lost, unsynchronised, in turbulence"
PAGES = {
    "vee": ("vee-30", ["fleet.count=6", "scenario.duration_s=1.5"]),
    "turbulence and estimates": (
        "turbulence-moderate",
        ["scenario.duration_s=1.5", "leader.sensors=pixhawk", "fleet.*.sensors=pixhawk"],
    ),
    "unsynchronised messages": (
        "bursty-wifi",
        [
            "scenario.duration_s=2",
            "rates.log_hz=50",
            "network.broadcast={uav2: {period_s: 0.0173, phase_s: 0.004}}",
        ],
    ),
    LOST: (
        "engine-out-uav2",
        [
            *("scenario.duration_s=7", "rates.synchronous=false"),
            *("air.turbulence.model=dryden", f"fleet.uav2.faults={FAULTS}"),
        ],
    ),
    "a battery": (
        "experiment-3",
        [
            "scenario.duration_s=3.5",
            "fleet.uav2.faults=[{kind: battery-low, state_of_charge: 0.3, at_s: 2}]",
        ],
    ),
}


@functools.cache
def fly(case, processes):
    name, changes = PAGES[case]
    collector = Collector()
    run = testbed.run(
        load_scenario(name, [*SHORT, "scenario.engine=jsbsim", *changes]),
        write=False,
        observers=[collector],
        processes=processes,
    )
    return fingerprint(collector.frames), (run.outcome, int(collector.frames[-1].lost.sum()))


@pytest.mark.parametrize("case", PAGES if ALL else ["vee", LOST])
def test_number_of_processes_changes_no_flight(case):
    before = children(os.getpid())
    one = fly(case, 1)
    assert one[1] == ("completed", case == LOST)  # by a fault of the scenario
    assert all(fly(case, each) == one for each in (2, 3)[: 2 if ALL or case == "vee" else 1])
    assert not set(children(os.getpid())) - set(before)


def test_more_processes_than_aircraft():
    assert fly("vee", 50) == fly("vee", 1)


def test_default_number_of_processes(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    assert [default_processes(n) for n in (1, 4, 19, 20, 30, 60, 100)] == [1, 1, 1, 2, 3, 6, 8]
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert default_processes(100) == 1
    monkeypatch.setattr(workers.sys, "platform", "darwin")
    assert default_processes(100) == 1


@pytest.fixture
def flight(tmp_path):
    """Yield a run of two processes in flight, the id of the other process, and the log."""
    command = ["run", "vee-30", "--set", "fleet.count=6", "--set", "scenario.engine=jsbsim"]
    command += ["--processes", "2", "--out", "run"]
    with (tmp_path / "errors").open("w") as errors:
        process = Forked(
            "testbed.cli.main:main", *command, cwd=tmp_path, env=environment(120), stderr=errors
        )
    try:
        log = tmp_path / "run" / "run.mcap"
        # more than the header: the check of the aircraft in a child process has ended
        until(lambda: log.exists() and log.stat().st_size > 100_000)
        (other,) = children(process.pid)
        yield process, other, log
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def test_killed_process_ends_the_run_with_its_reason(flight):
    process, other, path = flight
    os.kill(other, signal.SIGKILL)
    assert process.wait(TIMEOUT_S) == 5
    output = (path.parents[1] / "errors").read_text()
    assert "a process that steps aircraft (4, 5, 6 of the flight models, from 0)" in output
    assert "ended with -9" in output and "--processes 1" in output
    assert "Traceback" not in output
    log = read_log(path)
    assert log.finished and "has ended with -9" in log.events[-1].text


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_all_processes_ends_the_run(flight, number):
    process, other, path = flight
    os.killpg(process.pid, number)
    assert process.wait(TIMEOUT_S) == 130
    assert read_log(path).finished
    assert not Path(f"/proc/{other}").exists()


def test_process_without_its_parent_ends(flight):
    process, other, _ = flight
    process.kill()
    assert process.wait(TIMEOUT_S) == -signal.SIGKILL
    until(lambda: not Path(f"/proc/{other}").exists())
