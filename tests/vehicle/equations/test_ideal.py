"""The ideal vehicle flies the extended unicycle: closed forms, invariants, order of convergence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference import adapters
from reference.unicycle import Unicycle, unicycle
from scipy.spatial.transform import Rotation

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, body_rates, euler_rates, flight_path_angle, wrap_pi
from testbed.core.records import AIRCRAFT, FOLLOWER, VehicleState, allocate, fields_of
from testbed.flight.vehicles import UnicycleVehicles
from testbed.vehicle.unicycle import is_finite, make_unicycles, stop_unicycles

RATE = 200
DT = 1.0 / RATE
STILL = np.zeros(3)


def velocity_of(speed, course, climb_angle):
    level = np.cos(climb_angle)
    return np.stack(
        [
            speed * level * np.cos(course),
            speed * level * np.sin(course),
            -speed * np.sin(climb_angle),
        ],
        axis=-1,
    )


def random_unicycles(rng, n):
    speed = rng.uniform(12.0, 32.0, n)
    velocity = velocity_of(speed, rng.uniform(-math.pi, math.pi, n), rng.uniform(-0.5, 0.5, n))
    return unicycle(rng.normal(0.0, 300.0, (n, 3)), velocity)


def random_commands(rng, n):
    turn = np.column_stack([np.zeros(n), rng.normal(0.0, 0.3, (n, 2))])
    return rng.uniform(12.0, 32.0, n), turn


def orthonormality(state):
    product = state.rotation.transpose(0, 2, 1) @ state.rotation
    return np.abs(product - np.eye(3)).max()


def turning_flight(start, command, pole, turn_rate, course, duration):
    """North and east as n + i e of a level turn in which the speed follows its command.

    The integral of (u + (s0 − u) e^(−p t)) e^(i (σ0 + σ̇ t)).
    """
    turning, fading = 1j * turn_rate, 1j * turn_rate - pole
    steady = command * (np.exp(turning * duration) - 1.0) / turning
    return np.exp(1j * course) * (
        steady + (start - command) * (np.exp(fading * duration) - 1.0) / fading
    )


@pytest.mark.parametrize("duration", [300.0, 3600.0])
def test_constant_turn_is_the_closed_form_helix(duration):
    """Four turns, two of them climbing: with the first component of (26) γ stays as it is."""
    speed = np.array([22.0, 16.0, 22.0, 30.0])
    course = np.array([0.3, -2.0, 3.0, 1.0])
    gamma = np.array([0.0, 0.0, 0.08, -0.03])
    rate = np.array([22.0 / 120.0, -0.4, 0.21, -0.1])
    turn = np.column_stack([-rate * np.sin(gamma), 0.0 * rate, rate * np.cos(gamma)])
    start = np.array([[10.0, -20.0, -100.0]] * 4)
    ticks = round(duration * RATE)
    begun = unicycle(start, velocity_of(speed, course, gamma))
    state = adapters.advance_ticks(begun, speed, turn, np.full(4, 0.64), DT, ticks)

    angle = course + rate * duration
    radius = speed * np.cos(gamma) / rate
    expected = start + np.column_stack(
        [
            radius * (np.sin(angle) - np.sin(course)),
            radius * (np.cos(course) - np.cos(angle)),
            -speed * np.sin(gamma) * duration,
        ]
    )
    # Simpson: 22 m/s · (0.4 · 0.005)⁴ / 2880 is 1e-13 m/s. The rest is rounding: after an hour's
    # 720,000 steps of 1e-16 rad, should all agree, the direction is off by 8e-11 rad, on 108 km
    tolerance = 1e-9 if duration <= 300.0 else 4e-6
    assert state.position == pytest.approx(expected, abs=tolerance)
    result = state.rotation[:, :, 0]
    assert result == pytest.approx(velocity_of(1.0, angle, gamma), abs=1e-10)


def test_speed_is_exact_and_turns_of_fourth_order():
    speed, command, pole, rate, course, duration = 16.0, 28.0, 0.64, 0.35, 0.7, 8.0
    exact = turning_flight(speed, command, pole, rate, course, duration)
    errors = []
    for step in (0.8, 0.4, 0.2):
        state = unicycle(np.zeros((1, 3)), velocity_of(np.array([speed]), course, 0.0))
        for _ in range(round(duration / step)):
            turn = np.array([[0.0, 0.0, rate]])
            state = adapters.advance(state, np.array([command]), turn, np.array([pole]), step)
        after = command + (speed - command) * math.exp(-pole * duration)
        assert state.speed[0] == pytest.approx(after, rel=1e-13)
        errors.append(abs(state.position[0, 0] + 1j * state.position[0, 1] - exact))
        assert state.position[0, 2] == 0.0
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(4.0, abs=0.05)


def test_motion_satisfies_the_differential_equations():
    """Small steps either way: central differences of one flight give (1)-(3)."""
    rng = np.random.default_rng(3)
    n, small = 200, 1e-4
    state, (command, turn) = random_unicycles(rng, n), random_commands(rng, n)
    pole, turn[:, 0] = rng.uniform(0.3, 1.0, n), rng.normal(0.0, 0.1, n)
    after = adapters.advance(state, command, turn, pole, small)
    before = adapters.advance(state, command, turn, pole, -small)

    def slope(name):
        return (getattr(after, name) - getattr(before, name)) / (2.0 * small)

    skew = np.cross(turn[:, np.newaxis, :], np.eye(3)).transpose(0, 2, 1)
    # differences err by small² of third derivatives and by 300 m · 1e-16 / small
    assert slope("position") == pytest.approx(
        state.speed[:, np.newaxis] * state.rotation[:, :, 0], abs=1e-6
    )
    assert slope("speed") == pytest.approx(pole * (command - state.speed), abs=1e-7)
    assert slope("rotation") == pytest.approx(state.rotation @ skew, abs=1e-7)


def test_signs_of_turns_right_and_up():
    state = unicycle(np.zeros((3, 3)), np.array([[20.0, 0.0, 0.0]] * 3))
    turn = np.array([[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]])
    after = adapters.advance(state, np.full(3, 20.0), turn, np.ones(3), 0.5)
    s, c = math.sin(0.1), math.cos(0.1)
    assert after.rotation[:, :, 0] == pytest.approx(np.array([[1, 0, 0], [c, 0, -s], [c, s, 0]]))


def test_turn_does_not_depend_on_roll_of_the_frame():
    """ω comes in the zero-roll frame of y, and R may have rolled: y must not notice."""
    rng = np.random.default_rng(4)
    state, (command, turn) = random_unicycles(rng, 50), random_commands(rng, 50)
    roll = Rotation.from_rotvec(np.outer(rng.uniform(-3.0, 3.0, 50), [1.0, 0.0, 0.0])).as_matrix()
    rolled = state._replace(rotation=state.rotation @ roll)
    one = adapters.advance(state, command, turn, np.ones(50), 0.1)
    two = adapters.advance(rolled, command, turn, np.ones(50), 0.1)
    assert two.position == pytest.approx(one.position, abs=1e-11)
    assert two.rotation[:, :, 0] == pytest.approx(one.rotation[:, :, 0], abs=1e-14)
    assert np.abs(two.rotation[:, :, 1] - one.rotation[:, :, 1]).max() > 0.1


def test_rotations_stay_rotations_for_an_hour():
    rng = np.random.default_rng(5)
    state, pole = random_unicycles(rng, 1), np.array([0.64])
    worst = 0.0
    for _ in range(3600):
        state = adapters.advance_ticks(state, *random_commands(rng, 1), pole, DT, RATE)
        worst = max(worst, orthonormality(state))
    assert worst < 1e-12
    assert np.linalg.det(state.rotation[0]) == pytest.approx(1.0, abs=1e-12)


def test_spoilt_frame_returns_to_a_rotation():
    """The Newton step, where the rounding it is there for is made a million times larger."""
    rng = np.random.default_rng(6)
    state = random_unicycles(rng, 20)
    spoilt = state._replace(rotation=state.rotation + rng.normal(0.0, 1e-8, (20, 3, 3)))
    assert orthonormality(spoilt) > 1e-9
    for turn in (np.zeros((20, 3)), rng.normal(0.0, 400.0, (20, 3))):
        after = adapters.advance(spoilt, state.speed, turn, np.ones(20), DT)
        assert orthonormality(after) < 1e-14


def test_ticks_are_steps():
    rng = np.random.default_rng(7)
    state, (command, turn) = random_unicycles(rng, 5), random_commands(rng, 5)
    pole = rng.uniform(0.3, 1.0, 5)
    steps = state
    for _ in range(7):
        steps = adapters.advance(steps, command, turn, pole, DT)
    for one, two in zip(
        steps, adapters.advance_ticks(state, command, turn, pole, DT, 7), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_reported_motion_is_derivative_of_the_flight():
    rng = np.random.default_rng(8)
    n, small = 100, 1e-4
    wind = np.array([[3.0, -2.0, 0.5]])
    state, (command, turn) = random_unicycles(rng, n), random_commands(rng, n)
    pole = rng.uniform(0.3, 1.0, n)

    def seen(state):
        return adapters.report(state, command, turn, pole, wind)

    now = seen(state)
    after = seen(adapters.advance(state, command, turn, pole, small))
    before = seen(adapters.advance(state, command, turn, pole, -small))
    slope = (after.velocity_ned - before.velocity_ned) / (2.0 * small)
    assert slope == pytest.approx(now.acceleration_ned, abs=1e-6)

    turning = wrap_pi(after.euler - before.euler) / (2.0 * small)
    rates = euler_rates(now.euler, now.rates_body)
    assert rates[:, 0] == pytest.approx(0.0, abs=1e-14)
    assert rates[:, 1:] == pytest.approx(turning[:, 1:], abs=1e-6)
    # a coordinated turn: tan φ is the horizontal acceleration across the velocity over g
    course, gamma = now.euler[:, 2], flight_path_angle(now.velocity_ned)
    right = np.column_stack([-np.sin(course), np.cos(course)])
    across = (now.acceleration_ned[:, :2] * right).sum(axis=1)
    assert np.tan(now.euler[:, 0]) == pytest.approx(across / GRAVITY, abs=1e-12)
    assert now.euler[:, 1] == pytest.approx(gamma, abs=1e-14)
    relative = np.linalg.norm(now.velocity_ned - wind, axis=1)
    assert now.airspeed == pytest.approx(relative, rel=1e-14)
    np.testing.assert_array_equal(now.equivalent_airspeed, now.airspeed)


def make_fleet(n, wind=STILL):
    """N ideal followers behind a leader, and the records that they read and write."""
    position = np.column_stack([np.zeros(n), 50.0 * np.arange(n), np.full(n, -100.0)])
    aircraft, followers = allocate(AIRCRAFT, n + 1), allocate(FOLLOWER, n)
    aircraft["wind"]["wind_ned"] = wind
    records = make_unicycles(position, np.tile([22.0, 0.0, 0.0], (n, 1)), np.full(n, 0.64))
    return UnicycleVehicles(records, RATE, aircraft, np.arange(1, n + 1)), aircraft, followers


def steer(fleet, followers, speed, omega):
    followers["speed_command"], followers["omega"] = speed, omega
    (step,) = fleet.steering_steps(followers, (np.zeros(1), np.zeros(3)))
    step(0.0)


def truth_of(aircraft):
    return VehicleState(*(each[1:].copy() for each in fields_of(VehicleState, aircraft["truth"])))


def test_fleet_flies_straight_before_first_command():
    fleet, aircraft, followers = make_fleet(2, wind=np.array([5.0, 0.0, 0.0]))
    fleet.step(RATE, None)
    state = truth_of(aircraft)
    assert state.position_ned == pytest.approx(np.array([[22.0, 0, -100], [22.0, 50, -100]]))
    assert state.airspeed == pytest.approx(17.0)
    np.testing.assert_array_equal(state.acceleration_ned, 0.0)
    assert not fleet.air_steps
    air = aircraft["air"][1:]
    assert not any(air[name].any() for name in ("alpha", "beta", "propeller_rps"))
    assert np.isnan(air["state_of_charge"]).all()

    steer(fleet, followers, [25.0, 20.0], [[0.0, 0.0, 0.1], [0.0, 0.05, 0.0]])
    for _ in range(10):
        fleet.step(RATE // 10, None)
    after = truth_of(aircraft)
    speed = np.linalg.norm(after.velocity_ned, axis=1)
    fade = math.exp(-0.64)
    assert speed == pytest.approx([25.0 - 3.0 * fade, 20.0 + 2.0 * fade])
    assert after.euler[0, 2] == pytest.approx(0.1)
    assert after.euler[1, 1] == pytest.approx(0.05)
    assert after.position_ned[1, 2] < -100.0
    assert not aircraft["truth"]["position_ned"][0].any()  # the leader is not theirs


def test_a_level_turn_by_hand():
    # 22 m/s on 120 m: σ̇ = 0.18333 rad/s, tan φ = 22² / (120 · 9.80665) = 0.411285
    fleet, aircraft, followers = make_fleet(1)
    steer(fleet, followers, 22.0, [0.0, 0.0, 22.0 / 120.0])
    fleet.step(0, None)
    state = truth_of(aircraft)
    assert np.tan(state.euler[0, 0]) == pytest.approx(0.411285, abs=1e-6)
    assert state.acceleration_ned[0] == pytest.approx([0.0, 22.0**2 / 120.0, 0.0])
    assert euler_rates(state.euler, state.rates_body)[0] == pytest.approx([0.0, 0.0, 22.0 / 120.0])


def test_the_leader_is_steered_by_its_own_inputs():
    aircraft, followers = allocate(AIRCRAFT, 2), allocate(FOLLOWER, 1)
    records = make_unicycles(np.zeros((1, 3)), np.array([[22.0, 0.0, 0.0]]), np.ones(1))
    leader = UnicycleVehicles(records, RATE, aircraft, np.zeros(1, dtype=np.intp))
    followers["speed_command"] = 99.0
    (step,) = leader.steering_steps(followers, (np.array([25.0]), np.array([0.0, 0.1, 0.2])))
    step(0.0)
    assert records["speed_command"].tolist() == [25.0]
    assert records["omega"].tolist() == [[0.0, 0.1, 0.2]]


def test_lost_unicycle_keeps_finite_motion():
    fleet, aircraft, followers = make_fleet(3)
    steer(fleet, followers, [25.0, math.nan, 25.0], np.zeros(3))
    start = truth_of(aircraft)
    fleet.step(RATE, None)
    assert aircraft["stopped"].tolist() == [False, False, True, False]
    at = truth_of(aircraft)
    fleet.remove(np.array([False, True, True, False]))
    fleet.step(RATE, None)
    after = truth_of(aircraft)
    assert aircraft["stopped"].tolist() == [False, True, True, False]
    for name in VehicleState._fields:
        ours, first, last = (getattr(each, name) for each in (after, start, at))
        np.testing.assert_array_equal(ours[0], last[0], err_msg=name)
        np.testing.assert_array_equal(ours[1], first[1], err_msg=name)
    assert after.position_ned[2, 0] > at.position_ned[2, 0] + 20.0
    # a lost aircraft takes no commands
    steer(fleet, followers, 16.0, [0.0, 0.0, 1.0])
    fleet.step(RATE, None)
    np.testing.assert_array_equal(truth_of(aircraft).euler[:2], after.euler[:2])
    # and the others do not notice
    alone, untouched, wanted = make_fleet(3)
    steer(alone, wanted, 25.0, np.zeros(3))
    alone.step(2 * RATE, None)
    for ours, theirs in zip(after, truth_of(untouched), strict=True):
        assert ours[2] == pytest.approx(theirs[2], rel=1e-14)


def test_stopped_unicycles_stay_stopped():
    records = make_unicycles(np.zeros((4, 3)), np.tile([22.0, 0.0, 0.0], (4, 1)), np.ones(4))
    first = records.copy()
    records["position"][1, 2] = np.inf
    records["speed"][2] = np.nan
    records["rotation"][3, 1, 1] = np.nan
    assert [is_finite(each) for each in records] == [True, False, False, False]
    stop_unicycles(records, first, np.array([False, True, True, True]))
    assert all(is_finite(each) for each in records)
    assert records["stopped"].tolist() == [False, True, True, True]
    records["position"][1] = 7.0
    stop_unicycles(records, first, np.ones(4, dtype=bool))
    assert (records["position"][1] == 7.0).all()


def test_invalid_unicycle_is_an_error():
    position = np.zeros((2, 3))
    velocity = np.array([[22.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(InputError, match="ideal vehicle 1 .* write a positive speed"):
        make_unicycles(position, velocity, np.ones(2))
    with pytest.raises(InputError, match="speed pole .* is 0 1/s; write a positive"):
        make_unicycles(position[:1], velocity[:1], np.array([0.0]))


def test_unicycles_begin_without_roll():
    rng = np.random.default_rng(11)
    velocity = rng.normal(0.0, 15.0, (20, 3))
    position = rng.normal(0.0, 300.0, (20, 3))
    records, theirs = make_unicycles(position, velocity, np.ones(20)), unicycle(position, velocity)
    for name in Unicycle._fields:
        np.testing.assert_array_equal(records[name], getattr(theirs, name))
    np.testing.assert_array_equal(records["speed_command"], theirs.speed)
    assert not records["omega"].any()


def test_a_vertical_flight_has_a_frame():
    state = unicycle(np.zeros((2, 3)), np.array([[0.0, 0.0, -20.0], [0.0, 0.0, 20.0]]))
    assert orthonormality(state) < 1e-15
    assert np.linalg.det(state.rotation) == pytest.approx(1.0)
    for each in adapters.report(state, np.ones(2), np.ones((2, 3)), np.ones(2), STILL):
        assert np.isfinite(each).all()


def test_body_rates_undo_euler_rates():
    rng = np.random.default_rng(9)
    euler, rates = rng.uniform(-1.4, 1.4, (200, 3)), rng.normal(0.0, 1.0, (200, 3))
    assert body_rates(euler, euler_rates(euler, rates)) == pytest.approx(rates, abs=1e-13)
