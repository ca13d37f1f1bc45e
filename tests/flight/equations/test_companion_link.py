"""Own states and commands of followers through MAVLink's fields: short flights, and refusals."""

import numpy as np
import pytest
from run_flight import Collector, fly_with_recorder, recorder, short

import testbed
from testbed.core.errors import InputError
from testbed.core.frames import euler_from_quaternion
from testbed.flight.loop import fly
from testbed.plan.world import build
from testbed.scenario import load_scenario, loads

LINK = "controller.companion.link=mavlink"
ENCODED = "network.encoding=follow-target"
SECONDS = 4.0


def flown(*changes, seconds=SECONDS):
    collector = Collector()
    world = build(short(*changes, seconds=seconds))
    assert fly(world, [collector], lambda now, due: False) == "completed"
    return world, collector.frames


@pytest.fixture(scope="module")
def linked():
    return flown(LINK, ENCODED)


def of(frames, kind, *names):
    """Return a field of AIRCRAFT in all samples, (T, N, ...)."""
    found = []
    for frame in frames:
        record = frame.records[0][kind]
        for name in names:
            record = record[name]
        found.append(np.array(record))
    return np.array(found)


def single(values):
    return values.astype(np.float32).astype(np.float64)


def taken(control):
    """Return pitch and roll, by hand, that a quaternion in single precision has."""
    roll, pitch = 0.5 * control["roll"], 0.5 * control["pitch"]
    w, x = np.cos(roll) * np.cos(pitch), np.sin(roll) * np.cos(pitch)
    y, z = np.cos(roll) * np.sin(pitch), -np.sin(roll) * np.sin(pitch)
    euler = euler_from_quaternion(single(np.stack([x, y, z, w], axis=-1)))
    return euler[..., 1], euler[..., 0]


def test_command_is_rounded_and_acts_at_the_next_tick(linked):
    """Samples are at the ticks of the control; in each the command before it acts still."""
    _, frames = linked
    control, command = of(frames, "control"), of(frames, "command")
    pitch, roll = taken(control[:-1, 1:])
    np.testing.assert_allclose(command["pitch"][1:, 1:], pitch, atol=1e-15)
    np.testing.assert_allclose(command["roll"][1:, 1:], roll, atol=1e-15)
    np.testing.assert_array_equal(command["throttle"][1:, 1:], single(control["throttle"][:-1, 1:]))
    assert np.any(command["pitch"][1:, 1:] != control["pitch"][:-1, 1:])
    np.testing.assert_array_equal(command[:, 0], control[:, 0])  # the leader's guidance


def test_trim_is_flown_until_the_first_command(linked):
    world, frames = linked
    trims = [
        (each.placement.pitch, each.placement.roll, each.controls.throttle)
        for each in world.fleet.trims[1:]
    ]
    first = of(frames[:1], "command")[0, 1:]
    assert [tuple(each) for each in first] == trims
    assert trims[0] != tuple(of(frames[:1], "control")[0, 1])


def test_latency_adds_to_the_next_tick():
    """0.04 s are a period of the control: the command before the one before acts."""
    _, frames = flown(LINK, ENCODED, "controller.companion.command_latency_s=0.04", seconds=2.0)
    control, command = of(frames, "control"), of(frames, "command")
    pitch, _ = taken(control[:-2, 1:])
    np.testing.assert_allclose(command["pitch"][2:, 1:], pitch, atol=1e-15)
    assert np.ptp(pitch) > 0.0


def test_followers_fly_as_in_guided(linked):
    _, frames = linked
    assert of(frames, "guided").tolist() == [[False, True, True, True]] * len(frames)
    _, direct = flown(ENCODED, seconds=0.2)
    assert not of(direct, "guided").any()


def test_broadcast_is_the_decoded_own_state(linked):
    """A message has the rounding of telemetry and, of positions, that of the message."""
    _, frames = linked
    sent, known = of(frames, "estimate"), frames[-1].records[2]
    for sender in range(4):
        link = known[0, sender]
        at = round(float(link["stamp_s"]) * 25)
        apart = np.abs(link["position_ned"] - sent["position_ned"][at, sender])
        assert 0.0 < apart.max() < 0.02  # of two roundings to 1e-7 degrees
        velocity = sent["velocity_ned"][:, sender]
        np.testing.assert_array_equal(link["velocity_ned"], single(velocity[at]))
        mean = (single(velocity[at]) - single(velocity[at - 1])) / 0.04
        np.testing.assert_allclose(link["acceleration_ned"], mean, rtol=1e-6, atol=1e-9)
        assert np.any(np.abs(mean - sent["acceleration_ned"][at, sender]) > 1e-4)


def test_law_of_a_user_has_the_decoded_own_state(tmp_path):
    frames, received = fly_with_recorder(short(LINK, ENCODED, recorder(tmp_path), seconds=1.0))
    now, own, _ = received[-1]
    estimate = of(frames, "estimate")[round(now * 25), 1:]
    np.testing.assert_array_equal(own.velocity_ned, single(estimate["velocity_ned"]))
    assert np.any(own.velocity_ned != estimate["velocity_ned"])
    assert np.any(own.position_ned != estimate["position_ned"])


def test_imu_is_another_source_of_acceleration(linked):
    _, frames = flown(LINK, ENCODED, "controller.companion.acceleration=imu", seconds=1.0)
    link, estimate = frames[-1].records[2][0, 0], of(frames, "estimate")[:, 0]
    at = round(float(link["stamp_s"]) * 25)
    found, exact = link["acceleration_ned"], estimate["acceleration_ned"][at]
    assert 0.0 < np.abs(found - exact).max() < 0.01  # whole mG, twice rounded
    before = of(linked[1], "estimate")["acceleration_ned"][at, 0]
    np.testing.assert_array_equal(exact, before)  # as the leader's flight is the same


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ([], "FOLLOW_TARGET, too (write network.encoding: follow-target)"),
        ([ENCODED, "rates.broadcast_hz=5"], "write rates.broadcast_hz: 25, synchronous: true"),
        ([ENCODED, "rates.synchronous=false"], "and no network.broadcast"),
        ([ENCODED, "network.broadcast.uav1.period_s=0.1"], "and no network.broadcast"),
        (
            [ENCODED, "rates={physics_hz: 120, autopilot_hz: 60, control_hz: 30}"],
            "rates.control_hz: 30: MAVLink counts time in ms",
        ),
    ],
)
def test_link_that_cannot_be_flown_is_refused(changes, text):
    rates = {"rates.broadcast_hz=30": "rates={", "rates.log_hz=30": "rates={"}
    more = [key for key, when in rates.items() if any(each.startswith(when) for each in changes)]
    with pytest.raises(InputError) as caught:
        build(load_scenario("simulation-3", [LINK, *changes, *more]))
    assert str(caught.value).startswith("controller.companion.link: mavlink: ")
    assert text in str(caught.value)


def test_ideal_vehicles_have_no_link():
    scenario = loads(
        """
scenario: {schema: 2, name: ideal, duration_s: 1}
leader:
  aircraft: rascal110
  start: {altitude_m: 150}
  path: {kind: virtual, speed_mps: 22, curve: {kind: straight}}
fleet:
  - {name: uav1, aircraft: rascal110, vehicle: unicycle, start_m: [-10, 5, 0]}
formation: {offsets_m: {uav1: [-5, 5, 0]}, leader_gains: {uav1: 1}}
controller: {companion: {link: mavlink}}
network: {encoding: follow-target}
"""
    )
    with pytest.raises(InputError, match=r"uav1: an ideal vehicle has no autopilot \(write"):
        build(scenario)


def test_simulation_steps_the_same_flight(linked):
    """Step by step, and again from a saved state."""
    _, frames = linked
    scenario = short(LINK, ENCODED, seconds=SECONDS)
    with testbed.Simulation(scenario) as simulation:
        for _ in range(20):
            simulation.step()
        saved = simulation.save()
        for _ in range(2):
            simulation.restore(saved)
            for _ in range(20):
                sample = simulation.step()
            assert sample.time_s == 0.8
            expected = frames[20].truth.position_ned
            np.testing.assert_array_equal(sample.truth.position_ned, expected)
