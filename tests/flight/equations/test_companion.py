"""Latencies of companion computers: late states, late commands, closed forms of their effect."""

import numpy as np
import pytest

import testbed
from testbed.core.records import AIRCRAFT, allocate
from testbed.flight.companion import Companions
from testbed.flight.schedule import make_clock
from testbed.plan.companions import build_companions
from testbed.plan.measured_fleet import resolve
from testbed.scenario import load_scenario, loads, set_duration

SPEED = 22.0
ROWS = np.array([0, 1], dtype=np.intp)
SCENARIO = """
scenario: {schema: 2, name: late, duration_s: 60}
leader:
  aircraft: rascal110
  start: {altitude_m: 150}
  path: {kind: virtual, speed_mps: 22, curve: {kind: straight}}
fleet:
  - {name: uav1, aircraft: rascal110, vehicle: unicycle, start_m: [-10, 5, 0]}
formation: {offsets_m: {uav1: [-5, 5, 0]}, leader_gains: {uav1: 1}}
"""


class Watcher:
    def begin(self, info):
        self.frames = []

    def observe(self, sample):
        self.frames.append(sample)

    def end(self, summary, events):
        """Nothing is left to do."""


def simulate(scenario):
    watcher = Watcher()
    assert testbed.run(scenario, write=False, observers=[watcher]).outcome == "completed"
    return watcher.frames


def clock(**rates):
    chosen = {"physics_hz": 200, "autopilot_hz": 50, "control_hz": 25, "broadcast_hz": 25}
    return make_clock(**(chosen | rates), log_hz=25, aircraft=3)


def straight(now):
    """Motion at the time `now` of three aircraft on curves whose velocity is known."""
    return np.array([[10.0 * now, k, -100.0 + now * now] for k in range(3)])


@pytest.mark.parametrize("latency_s", [0.0, 0.02, 0.1, 0.013, 0.237])
def test_companion_has_the_state_of_one_latency_ago(latency_s):
    """At ticks of the autopilots and between them; along the velocity from the last of them."""
    aircraft = allocate(AIRCRAFT, 3)
    own = Companions(aircraft, clock(), latency_s, 0.0)
    for tick in range(200):
        now = tick / 200
        aircraft["estimate"]["position_ned"] = straight(now)
        aircraft["estimate"]["velocity_ned"] = [10.0, 0.0, 2.0 * now]
        aircraft["estimate"]["airspeed"] = now
        if tick % 4 == 0:
            own.store_states(now)
        own.receive_states(now)
        had = own.aircraft["estimate"]
        late = now - latency_s
        measured = now if latency_s == 0.0 else max(np.floor(late * 50 + 1e-9) / 50, 0.0)
        expected = straight(measured)
        expected[:, 0] = 10.0 * late
        expected[:, 2] += 2.0 * measured * (late - measured)
        assert had["position_ned"] == pytest.approx(expected, abs=1e-9)
        assert had["airspeed"] == pytest.approx(measured, abs=1e-12)


@pytest.mark.parametrize("latency_s", [0.0, 0.02, 0.06, 0.03, 0.1])
def test_autopilot_has_the_command_of_one_latency_ago(latency_s):
    """Control at 25 Hz, 5 ms after the autopilots' ticks; the leader's guidance is not late."""
    aircraft = allocate(AIRCRAFT, 3)
    link = Companions(aircraft, clock(), 0.0, latency_s)
    send, sent = link.send_commands(ROWS), []
    for tick in range(200):
        now = tick / 200
        aircraft["control"]["roll"][0] = now
        if tick % 8 == 1:
            aircraft["control"]["roll"][1:] = [now, -now]
            send(now)
            sent.append(now)
        if tick % 4 == 0 and sent:
            link.deliver_commands(now)
            arrived = [each for each in sent if each + latency_s <= now + 1e-9] or sent[:1]
            expected = [now, arrived[-1], -arrived[-1]]
            assert aircraft["command"]["roll"] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("overrides", "ahead_s"),
    [
        (["controller.companion.state_latency_s=0.2"], 0.2),
        (["controller.companion.state_latency_s=0.123", "rates.synchronous=false"], 0.123),
        (["controller.companion.state_latency_s=0.1", "network.delay_s=0.1"], 0.0),
        (["controller.companion.state_latency_s=0.05", "network.delay_s=0.2"], -0.15),
    ],
)
def test_late_own_state_puts_the_follower_ahead(overrides, ahead_s):
    """By V d; messages that are as late put it as far behind."""
    last = simulate(loads(SCENARIO, ["scenario.seed=3", *overrides]))[-1]
    assert last.formation.error_ned[0] == pytest.approx([SPEED * ahead_s, 0.0, 0.0], abs=1e-6)


def test_late_commands_leave_the_earlier_ones():
    """0.08 s are two periods of 25 Hz; what the autopilots have is logged as their command."""
    scenario = load_scenario("simulation-3", ["controller.companion.command_latency_s=0.08"])
    frames = simulate(set_duration(scenario, 2.0))
    control, command = (
        np.array([frame.records[0][name]["pitch"].copy() for frame in frames])
        for name in ("control", "command")
    )
    assert np.ptp(control[:, 1:]) > 0.0
    assert np.array_equal(command[2:, 1:], control[:-2, 1:])
    assert np.array_equal(command[:, 0], control[:, 0])


def test_no_latency_builds_no_companion():
    scenario = loads(SCENARIO)
    none = build_companions(scenario, resolve(scenario), clock(), allocate(AIRCRAFT, 2), None)
    assert none is None
