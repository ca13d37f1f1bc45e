"""Scenarios flown by the stand-in for ArduPlane, and checks that nothing of it remains."""

import contextlib
import os
import socket
import sys
import tempfile
from pathlib import Path

import pytest
from commands import environment
from forked import Forked
from places import SHARED
from run_flight import Collector

import testbed
from testbed.cli.main import main
from testbed.core.errors import ExternalProgramLost
from testbed.core.records import FbwaCommand, VehicleState, fields_of
from testbed.plan.world import build
from testbed.scenario import loads, set_duration

STAND_IN = SHARED / "arduplane_stand_in.py"
# Parallel test processes have consecutive numbers; each has four instances of its own.
FIRST = 8 + 4 * (os.getpid() % 60)
SOON = 400 + 60  # packets: startup lasts a multiple of 2 s at 200 Hz, and this is 0.3 s later
SCENARIO = """
scenario: {schema: 2, name: two, duration_s: 3600}
leader:
  aircraft: rascal110
  path:
    kind: mission
    airspeed_mps: 22
    legs: [{kind: waypoints, points_m: [[2000, 0, 100], [4000, 0, 100]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-10, 5, 0]}
formation:
  offsets_m: {uav1: [-10, 5, 0]}
  leader_gains: {uav1: 1}
"""


def ardupilot(number=0, **keys):
    """Return the value of `autopilot`, as in an override."""
    autopilot = {"kind": "ardupilot", "instance": FIRST + number, **keys}
    return "{" + ", ".join(f"{key}: {value}" for key, value in autopilot.items()) + "}"


@pytest.fixture
def binary(tmp_path, monkeypatch):
    """Provide the stand-in as a program, with temporary folders beside it."""
    program = tmp_path / "arduplane"
    program.write_text(
        f'#!/bin/sh\nNUMBA_DISABLE_JIT=1 exec "{sys.executable}" "{STAND_IN}" "$@"\n'
    )
    program.chmod(0o755)
    (tmp_path / "folders").mkdir()
    monkeypatch.setenv("ARDUPLANE", str(program))
    monkeypatch.delenv("ARDUPLANE_STAND_IN", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "folders"))
    # a stand-in that ignores SIGTERM, as ArduPlane does at times, is killed sooner
    monkeypatch.setattr("testbed.ardupilot.sitl_process._GRACE_S", 0.2)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "folders"))
    yield program
    assert not running(), "a process is left"
    assert not list((tmp_path / "folders").iterdir()), "a folder is left"
    for number in range(4):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.bind(("127.0.0.1", 9002 + 10 * (FIRST + number)))
        with socket.socket() as tcp:
            assert tcp.connect_ex(("127.0.0.1", 5760 + 10 * (FIRST + number))), "a port is left"


def running():
    """Return the process numbers of this test's stand-ins."""
    own = {f"-I{FIRST + number}".encode() for number in range(4)}
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if own & set(words) and not any(b"child_guard" in word for word in words):
                found.append(int(folder.name))
    return found


def run_in_child(folder):
    """Start a run with an ArduPlane in a process group of its own."""
    (folder / "two.yaml").write_text(SCENARIO)
    words = "run", "two.yaml", "--set", f"leader.autopilot={ardupilot()}"
    return Forked("arduplanes:main_here", *words, cwd=folder, env=environment(80))


def main_here():
    """Run a command with temporary files in the folder of this process's environment."""
    tempfile.tempdir = os.environ["TMPDIR"]
    main()


def make_scenario(seconds, *overrides, **keys):
    autopilot = f"leader.autopilot={ardupilot(**keys)}"
    return set_duration(loads(SCENARIO, [autopilot, *overrides]), seconds)


def fly(scenario):
    collector = Collector()
    result = testbed.run(scenario, write=False, observers=[collector])
    assert result.outcome == "completed"
    return collector.frames


def error_of(scenario, kind=ExternalProgramLost):
    with pytest.raises(kind) as caught:
        testbed.run(scenario, write=False)
    return str(caught.value)


LEVEL = FbwaCommand(pitch=0.0, roll=0.0, throttle=0.3)


def fly_level(scenario):
    """Fly with a constant command; return the events, and the truth at the end."""
    events = []
    world = build(scenario)
    (vehicles,), processes = world.vehicles, world.external_processes
    world.aircraft["command"] = LEVEL
    try:
        for process in processes:
            process.start(lambda: None)
        for tick, due, ticks, needed in world.clock.schedule(world.duration_s, all_motions=True):
            if due.autopilot:
                world.aircraft["estimate"] = world.aircraft["truth"]
                vehicles.autopilot_step()
                for process in processes:
                    events += process.pop_events(world.clock.time_s(tick))
            vehicles.step(ticks, needed)
    finally:
        for process in processes:
            process.close()
    return events, fields_of(VehicleState, world.aircraft["truth"])
