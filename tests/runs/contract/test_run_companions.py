"""Runs whose followers are flown by companions in processes of their own."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cases import ALL, in_full
from commands import environment
from forked import Forked
from run_flight import Collector, short
from waiting import TIMEOUT_S

from testbed.core.errors import ExternalProgramLost, InputError
from testbed.plan.world import build
from testbed.runs import companion_processes
from testbed.runs import run as module
from testbed.runs.companion_run import check_companions
from testbed.runs.external_options import ExternalOptions
from testbed.runs.run import run

LONG = "TESTBED_COMPANIONS" in os.environ
SECONDS = 160.0 if LONG else 3.0
MAVLINK = ("controller.companion.link=mavlink", "network.encoding=follow-target")
LOSSY = (
    *("network.delay_s=0.05", "network.jitter={spread_s: 0.03}"),
    *("network.loss=0.2", "network.duplicate=0.1"),
)
# two followers, of which the second hears the first
TWO = (
    "scenario.published=null",
    "fleet=[{name: uav1, aircraft: rascal110, start_m: [-25, 15, 0]}, "
    "{name: uav2, aircraft: rascal110, start_m: [-25, -15, -10]}]",
    "formation.offsets_m={uav1: [-5, 5, 0], uav2: [-5, -5, -4]}",
    "formation.leader_gains={uav1: 1, uav2: 1}",
    "formation.neighbour_gains={uav2: {uav1: 1}}",
)
FLEET, NAMES = (TWO, ("uav1", "uav2"))
if LONG or ALL:
    FLEET, NAMES = ((), ("uav1", "uav2", "uav3"))
# the first of the two alone, where nothing depends on another follower
ONE = (
    "scenario.published=null",
    "fleet=[{name: uav1, aircraft: rascal110, start_m: [-25, 15, 0]}]",
    "formation.offsets_m={uav1: [-5, 5, 0]}",
    "formation.leader_gains={uav1: 1}",
    "formation.neighbour_gains={}",
)
LOCKSTEP = ExternalOptions(companions=True)
APART_M = (100.0, -100.0, 5.0)  # of the local origins of neighbouring rows


def scenario(*changes, seconds=SECONDS, fleet=FLEET):
    return short(*fleet, *MAVLINK, *changes, seconds=seconds)


def flown(flight, external=None, **options):
    """Return the run and its samples."""
    collector = Collector()
    given = {} if external is None else {"external": external}
    return run(flight, write=False, observers=[collector], **given, **options), collector.frames


def numbers(frames):
    """Return positions, commands and errors (T, …) of all samples."""
    position = [frame.truth.position_ned for frame in frames]
    command = [np.stack(frame.command) for frame in frames]
    error = [frame.formation.error_ned for frame in frames]
    return np.array(position), np.array(command), np.array(error)


class ForkedCompanion(Forked):
    """A companion that no guard ends, as Python takes longer to start than it to fly."""

    stdin = None

    def __init__(self, command, *, stdout, **_):
        super().__init__(
            *("testbed.cli.main:main", *command[command.index("companion") :]),
            cwd=tempfile.gettempdir(),
            env=environment(100),
            stdout=stdout,
            stderr=stdout,
        )

    def wait(self, timeout=TIMEOUT_S):
        return super().wait(TIMEOUT_S)


@pytest.fixture
def forked(monkeypatch):
    """Fork companions; in `make check-all` they are started as always."""
    if not (LONG or ALL):
        replaced = SimpleNamespace(**vars(subprocess) | {"Popen": ForkedCompanion})
        monkeypatch.setattr(companion_processes, "subprocess", replaced)


@pytest.fixture(scope="module")
def in_process():
    return flown(scenario(*LOSSY))


@pytest.fixture
def own_origins(monkeypatch):
    """Give each autopilot another origin of its local frame."""

    def build_apart(*given, **named):
        world = build(*given, **named)
        for row, vehicle in enumerate(world.external_control.vehicles):
            vehicle.local_origin_ned = tuple(row * each for each in APART_M)
        return world

    monkeypatch.setattr(module, "build", build_apart)


def test_lockstep_is_the_flight_in_process(in_process, own_origins, forked):
    """To the bit, through a bad network, with another local origin on each aircraft."""
    expected, frames = in_process
    found, others = flown(short(*FLEET, *LOSSY, seconds=SECONDS), LOCKSTEP)
    for one, other in zip(numbers(frames), numbers(others), strict=True):
        np.testing.assert_array_equal(one, other)
    assert found.metrics["network"] == expected.metrics["network"]
    # each sample but the last is answered
    counts = [found.metrics["commanded"][name]["commands"] for name in NAMES]
    assert counts == [len(frames) - 1] * len(NAMES)
    assert "commanded" not in expected.metrics
    links = frames[-1].links
    assert (links.delivered < links.sent).any()


LOCAL_POSITION = """
    import sys

    import numpy as np
    from testbed.companion import autopilot_state
    from testbed.core.geodetic import geodetic_from_ned, longitude_e7
    from testbed.core.records import NedOrigin

    State = autopilot_state.AutopilotState
    velocity = State._local

    def local(self, fields):
        velocity(self, fields)
        ned = np.array([fields[name] for name in "xyz"])
        latitude, longitude, height = geodetic_from_ned(ned, NedOrigin()).tolist()
        own = self.own[0]
        own["lat"], own["lon"] = round(latitude * 1e7), int(longitude_e7(longitude))
        own["alt"] = round(height * 1e3)

    State._local = local
    from testbed.cli.main import main

    main()
"""


@in_full  # companions with these positions are found by `test_lockstep_is_the_flight_in_process`
def test_local_positions_fly_another_formation(in_process, own_origins, tmp_path, monkeypatch):
    """Negative control: companions that take LOCAL_POSITION_NED leave their slots."""
    file = tmp_path / "local.py"
    file.write_text(textwrap.dedent(LOCAL_POSITION))
    monkeypatch.setattr(companion_processes, "PROGRAM", (sys.executable, str(file)))
    _, others = flown(scenario(*LOSSY, fleet=ONE), LOCKSTEP)
    right, wrong = (numbers(frames)[2][-1][:1] for frames in (in_process[1], others))
    apart = np.linalg.norm(wrong - right, axis=1)
    assert (apart > (50.0 if LONG else 0.5)).all()


@pytest.fixture
def started(monkeypatch):
    """Return the companions that a run has started."""
    found = []
    start = companion_processes.CompanionProcesses.start

    def noted(self, *given):
        start(self, *given)
        found.extend(self._processes)

    monkeypatch.setattr(companion_processes.CompanionProcesses, "start", noted)
    return found


class Killer:
    """Kills the companion of an aircraft after one second of flight."""

    def __init__(self, started, row):
        self._started, self._row, self.killed_s = started, row, None

    def begin(self, info):
        """Nothing is needed."""

    def observe(self, sample):
        if sample.time_s >= 1.0 and self.killed_s is None:
            self.killed_s = sample.time_s
            os.killpg(self._started[self._row].child.pid, signal.SIGKILL)

    def end(self, summary, events):
        """Nothing is left."""


def ended(processes):
    """Return whether all processes and their groups have ended."""
    until = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until:
        try:
            for each in processes:
                os.killpg(each.child.pid, 0)
        except ProcessLookupError:
            return all(each.child.returncode is not None for each in processes)
        time.sleep(0.02)
    return False


def test_dead_companion_ends_a_run_in_lockstep(started):
    """With the reason; the others are ended, too."""
    killer, flight = Killer(started, 1), scenario(seconds=20.0, fleet=ONE)
    with pytest.raises(ExternalProgramLost, match="uav1: its companion was ended by signal 9"):
        run(flight, write=False, observers=[killer], external=LOCKSTEP)
    assert killer.killed_s == pytest.approx(1.0)
    assert [each.name for each in started] == ["leader", "uav1"]
    assert ended(started)


def test_companion_that_cannot_start_says_why(started):
    """As where its own scenario is refused."""
    with pytest.raises(InputError, match=r"write rates\.broadcast_hz: 25"):
        run(short("rates.broadcast_hz=5", seconds=1.0), write=False, external=LOCKSTEP)
    assert started == []


def test_dead_companion_is_a_warning_in_real_time(started, forked):
    """Its aircraft circles after the failsafe; the flight goes on."""
    killer, paced = Killer(started, 2), ExternalOptions(companions=True, pace=1.0)
    collector = Collector()
    result = run(scenario(seconds=6.0), write=False, observers=[collector, killer], external=paced)
    frames = collector.frames
    assert result.outcome == "completed"
    texts = [(each.source, each.text) for frame in frames for each in frame.events]
    assert ("uav2", "its companion was ended by signal 9") in texts
    assert ("uav2", "receives no commands for 3 s: circles its position") in texts
    guided = np.array([frame.records[0]["guided"].copy() for frame in frames])
    assert np.delete(guided[:, 1:], 1, axis=1).all() and not guided[-1, 2]
    assert result.metrics["commanded"]["uav1"]["commands"] > 100
    assert ended(started)


def test_ports_of_companions_are_neighbours_and_free(monkeypatch):
    """The system gives none of them to another program before the companions open them."""
    given = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    assert max(companion_processes._PORTS) + 100 < given
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr(companion_processes, "_PORTS", range(port - 1, port + 1))
        with pytest.raises(InputError, match="no 2 neighbouring UDP ports are free"):
            companion_processes.free_ports(2)
    monkeypatch.undo()
    first = companion_processes.free_ports(3)
    for each in range(first, first + 3):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", each))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ((*MAVLINK, "rates.log_hz=5"), "rates.log_hz: companions step once for each sample"),
        ((*MAVLINK, "controller.companion.command_latency_s=0.1"), "its latencies are those of"),
        ((*MAVLINK, "network.clocks.uav1.offset_s=0.1"), "network.clocks: companions stamp"),
        ((*MAVLINK, "network.corrupt=0.1"), "network.corrupt: the frames of companions pass"),
    ],
)
def test_what_companions_cannot_fly_is_refused(changes, text):
    flight = short(*changes, seconds=1.0)
    with pytest.raises(InputError) as caught:
        check_companions(flight, build(flight))
    assert str(caught.value).startswith("--companions: ")
    assert text in str(caught.value)
