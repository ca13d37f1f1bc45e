"""Pages flown by the stand-in for ArduPlane, and what is left of it afterwards."""

import contextlib
import os
import socket
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from run_flight import Collector

import testbed
from testbed.errors import PartnerLost
from testbed.scenario import loads, shorten
from testbed.sim.world import build
from testbed.state import FbwaCommand

STAND_IN = Path(__file__).with_name("arduplane_stand_in.py")
# Test processes have neighbouring numbers; each has four instances of its own.
FIRST = 8 + 4 * (os.getpid() % 60)
SOON = 400 + 60  # packets: boots last a multiple of 2 s at 200 Hz, and this is 0.3 s later
PAGE = """
scenario: {schema: 1, name: two, duration_s: 3600}
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


def ardupilot(place=0, **keys):
    """What stands under `autopilot`, as an override has it."""
    told = {"kind": "ardupilot", "instance": FIRST + place, **keys}
    return "{" + ", ".join(f"{key}: {value}" for key, value in told.items()) + "}"


@pytest.fixture
def binary(tmp_path, monkeypatch):
    """The stand-in as a program; temporary folders are made beside it."""
    program = tmp_path / "arduplane"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{STAND_IN}" "$@"\n')
    program.chmod(0o755)
    (tmp_path / "folders").mkdir()
    monkeypatch.setenv("ARDUPLANE", str(program))
    monkeypatch.delenv("STAND_IN", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "folders"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "folders"))
    yield program
    assert not running(), "a process is left"
    assert not list((tmp_path / "folders").iterdir()), "a folder is left"
    for place in range(4):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.bind(("127.0.0.1", 9002 + 10 * (FIRST + place)))
        with socket.socket() as tcp:
            assert tcp.connect_ex(("127.0.0.1", 5760 + 10 * (FIRST + place))), "a port is left"


def running():
    """Numbers of the stand-ins of this test process."""
    own = {f"-I{FIRST + place}".encode() for place in range(4)}
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if own & set(words):
                found.append(int(folder.name))
    return found


def page(seconds, *overrides, **keys):
    return shorten(loads(PAGE, [f"leader.autopilot={ardupilot(**keys)}", *overrides]), seconds)


def fly(scenario):
    seen = Collector()
    flown = testbed.run(scenario, write=False, observers=[seen])
    assert flown.outcome == "flown"
    return seen.frames


def complaint(scenario, kind=PartnerLost):
    with pytest.raises(kind) as caught:
        testbed.run(scenario, write=False)
    return str(caught.value)


def level(scenario):
    """Fly with the sticks held: what partners said, and the truth at the end."""
    said = []
    world = build(scenario)
    vehicles, partners = world.vehicles, world.partners
    still = np.zeros(len(world.names))
    try:
        for partner in partners:
            partner.begin(lambda: None)
        for tick, due, ticks, legs in world.clock.schedule(world.duration_s):
            if due.autopilot:
                vehicles.act(vehicles.read(), FbwaCommand(still, still, still + 0.3))
                for partner in partners:
                    said += partner.news(world.clock.time_s(tick))
            vehicles.step(ticks, legs)
    finally:
        for partner in partners:
            partner.close()
    return said, vehicles.read()
