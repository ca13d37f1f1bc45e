"""What a follower makes of messages: the present, q̈_g and ω̇_g, [HBH23] sections 8.3 and 10."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import NOW, flags, make_law, states, step
from reference.adapters import (
    corrected,
    differentiate,
    turn_acceleration,
    velocity_frame,
    velocity_rates,
)
from reference.formation_leader_filter import Memory, course_acceleration, no_messages
from reference.formation_message_extrapolation import times

from testbed.core.frames import PAPER_GRAVITY
from testbed.core.records import Messages
from testbed.formation import leader_filter as leading
from testbed.formation.barrier import SpeedBarrier

EACH_SOURCE = [leading.NOTHING, leading.BROADCAST, leading.TURN]


# measurement correction


def one_message():
    # sent at 99.7, received at 99.9: used at 100 it is 0.1 s or 0.3 s old
    return Messages(
        np.array([[99.7]]),
        np.array([[99.9]]),
        np.array([[[5.0, 1.0, -100.0]]]),
        np.array([[[20.0, -10.0, 1.0]]]),
        np.array([[[2.0, 0.0, -4.0]]]),
        np.zeros((1, 1, 3)),
        np.zeros((1, 1, 3)),
    )


def test_extrapolation_along_the_velocity_by_hand():
    velocity_as_sent = pytest.approx([20.0, -10.0, 1.0], abs=0)
    receipt, velocity = corrected(one_message(), NOW, False, flags(False, 1))
    assert receipt[0, 0] == pytest.approx([7.0, 0.0, -99.9], abs=1e-11)
    assert velocity[0, 0] == velocity_as_sent
    stamped, velocity = corrected(one_message(), NOW, True, flags(False, 1))
    assert stamped[0, 0] == pytest.approx([11.0, -2.0, -99.7], abs=1e-11)
    assert velocity[0, 0] == velocity_as_sent


def test_extrapolation_along_a_parabola_by_hand():
    # ½·0.1²·(2, 0, −4) = (0.01, 0, −0.02) more, ½·0.3² nine times that; v + lag a
    receipt, velocity = corrected(one_message(), NOW, False, flags(True, 1))
    assert receipt[0, 0] == pytest.approx([7.01, 0.0, -99.92], abs=1e-11)
    assert velocity[0, 0] == pytest.approx([20.2, -10.0, 0.6], abs=1e-11)
    stamped, velocity = corrected(one_message(), NOW, True, flags(True, 1))
    assert stamped[0, 0] == pytest.approx([11.09, -2.0, -99.88], abs=1e-11)
    assert velocity[0, 0] == pytest.approx([20.6, -10.0, -0.2], abs=1e-11)


def test_parabola_is_followed_exactly_where_chosen():
    """A neighbour at constant acceleration, however old its message; the other agent goes on."""
    rng = np.random.default_rng(60)
    start, velocity, acceleration = rng.normal(0.0, 5.0, (3, 3))
    age = np.array([[0.4], [0.4]])
    then = NOW - age
    inbox = Messages(
        then,
        then,
        np.tile(start, (2, 1, 1)),
        np.tile(velocity, (2, 1, 1)),
        np.tile(acceleration, (2, 1, 1)),
        np.zeros((2, 1, 3)),
        np.zeros((2, 1, 3)),
    )
    position, moving = corrected(inbox, NOW, False, np.array([True, False]))
    assert position[0, 0] == pytest.approx(start + 0.4 * velocity + 0.08 * acceleration, abs=1e-11)
    assert moving[0, 0] == pytest.approx(velocity + 0.4 * acceleration, abs=1e-11)
    assert position[1, 0] == pytest.approx(start + 0.4 * velocity, abs=1e-11)
    assert np.array_equal(moving[1, 0], velocity)


def test_a_step_reckons_with_the_present():
    """A message of before, brought to now, is a message of now: to rounding, in the whole step."""
    rng = np.random.default_rng(61)
    for parabola in (False, True):
        law = make_law(3, rng, with_acceleration=flags(parabola, 3))
        own, inbox, memory = states(3, rng)
        position, velocity = corrected(inbox, NOW, False, flags(parabola, 3))
        now = np.full_like(inbox.stamp_s, NOW)
        fresh = inbox._replace(position_ned=position, velocity_ned=velocity, received_s=now)
        ours, _ = step(law, NOW, own, inbox, memory)
        theirs, _ = step(law, NOW, own, fresh, memory)
        for name in ours._fields:
            expected = pytest.approx(getattr(theirs, name), rel=1e-9, abs=1e-12)
            assert getattr(ours, name) == expected, name


# q̈_g


def message_at(stamp, speed, gamma):
    velocity = speed * np.array([[np.cos(gamma), 0.0, -np.sin(gamma)]])
    return np.array([stamp]), velocity


def remembered(*numbers):
    """Stamp, speed, γ and their rates in the last message used, with no average of q̈_g."""
    never = np.array([np.nan])
    nowhere, unsaid = np.full((1, 2, 3), np.nan), np.full((1, 2), np.nan)
    numbers = (np.array([v]) for v in numbers)
    return Memory(np.zeros((1, 3)), *numbers, *np.zeros((2, 1, 3)), never, never, nowhere, unsaid)


def test_differences_by_hand():
    # 22 → 22.1 m/s and 0.10 → 0.12 rad in 0.05 s: 2 m/s² and 0.4 rad/s; shares 0.5 and 0.25
    blend = np.array([[0.5, 0.25]])
    memory = remembered(99.90, 22.0, 0.10, 1.0, -0.2)
    speed, gamma, speed_rate, gamma_dot = differentiate(
        memory, *message_at(99.95, 22.1, 0.12), blend
    )
    assert (speed[0], gamma[0]) == pytest.approx((22.1, 0.12), rel=1e-14)
    assert speed_rate[0] == pytest.approx(0.5 * 1.0 + 0.5 * 2.0, abs=1e-9)
    assert gamma_dot[0] == pytest.approx(0.75 * -0.2 + 0.25 * 0.4, abs=1e-9)


def test_the_same_message_is_differentiated_once():
    blend = np.ones((1, 2))
    memory = remembered(99.95, 22.1, 0.12, 1.5, 0.3)
    for late in (99.95, 99.90):  # used before, or older than that
        _, _, speed_rate, gamma_dot = differentiate(memory, *message_at(late, 25.0, 0.2), blend)
        assert (speed_rate[0], gamma_dot[0]) == (1.5, 0.3)


def test_one_message_has_no_differences():
    _, _, speed_rate, gamma_dot = differentiate(
        no_messages(1, 2), *message_at(99.95, 22.0, 0.1), np.ones((1, 2))
    )
    assert (speed_rate[0], gamma_dot[0]) == (0.0, 0.0)


def test_differences_of_a_smooth_flight_are_its_rates():
    """ṡ_g = 0.5 cos t and γ̇_g = 0.1 cos t by differences of 0.04 s, half of that behind."""
    memory = no_messages(1, 2)
    for k in range(51):
        t = k * 0.04
        velocity = message_at(t, 22.0 + 0.5 * np.sin(t), 0.1 * np.sin(t))
        rates = differentiate(memory, *velocity, np.ones((1, 2)))
        memory = remembered(velocity[0][0], *(float(rate[0]) for rate in rates))
        if k:
            # the mean over the step is the value in its middle but for dt²/24
            assert rates[2][0] == pytest.approx(0.5 * np.cos(t - 0.02), abs=0.5 * 0.04**2 / 24)
            assert rates[3][0] == pytest.approx(0.1 * np.cos(t - 0.02), abs=0.1 * 0.04**2 / 24)


def test_turn_acceleration_is_that_of_the_velocity():
    """Any ṡ_g, γ̇_g and bank: its parts are ṡ along, s γ̇ up and s σ̇ cos γ across, by (22)-(24)."""
    rng = np.random.default_rng(62)
    n = 200
    speed, gamma = rng.uniform(18.0, 28.0, n), rng.uniform(-0.4, 0.4, n)
    sigma = rng.uniform(-np.pi, np.pi, n)
    speed_rate, gamma_dot = rng.normal(0.0, 1.0, n), rng.normal(0.0, 0.2, n)
    euler = np.column_stack([rng.uniform(-0.8, 0.8, n), gamma, sigma])
    parts = (np.cos(gamma) * np.cos(sigma), np.cos(gamma) * np.sin(sigma), -np.sin(gamma))
    velocity = speed[:, None] * np.column_stack(parts)
    ours = turn_acceleration(velocity_frame(velocity), speed, gamma, speed_rate, gamma_dot, euler)
    along = (ours * velocity).sum(axis=1) / speed
    turning, climbing = velocity_rates(velocity, ours)
    assert along == pytest.approx(speed_rate, abs=1e-13)
    assert climbing == pytest.approx(gamma_dot, abs=1e-13)
    # σ̇ = g tan φ / (s cos γ), for the attitude's pitch is γ here
    coordinated = PAPER_GRAVITY * np.tan(euler[:, 0]) / (speed * np.cos(gamma))
    assert turning == pytest.approx(coordinated, abs=1e-13)


@pytest.mark.parametrize("gamma", [0.0, 0.3, -0.25])
def test_turn_of_a_helix_is_its_acceleration(gamma):
    """Message after message along a helix: q̈_g as it is, with no share of the average in it."""
    rng = np.random.default_rng(63)
    speed, turn = 22.0, 0.25
    law = make_law(2, rng, acceleration_source=np.full(2, leading.TURN))
    own, inbox, _ = states(2, rng)
    bank = np.arctan(turn * speed * np.cos(gamma) / PAPER_GRAVITY)
    memory = law.start(own)
    for k in range(30):
        now = NOW + 0.04 * k
        sigma = 0.4 + turn * 0.04 * k
        parts = (np.cos(gamma) * np.cos(sigma), np.cos(gamma) * np.sin(sigma), -np.sin(gamma))
        inbox.stamp_s[:] = inbox.received_s[:] = now
        inbox.velocity_ned[:, 0] = speed * np.array(parts)
        inbox.euler[:, 0] = [bank, gamma, sigma]
        _, memory = step(law, now, own, inbox, memory)
        pull = speed * np.cos(gamma) * turn
        expected = pull * np.array([-np.sin(sigma), np.cos(sigma), 0.0])
        # speeds and angles round at 1e-15 over 0.04 s, times 22 m/s
        assert memory.acceleration == pytest.approx(np.tile(expected, (2, 1)), abs=1e-11)


def test_each_agent_uses_its_own_source():
    rng = np.random.default_rng(64)
    blend = rng.uniform(0.1, 0.9, (3, 3))
    law = make_law(3, rng, acceleration_source=np.array(EACH_SOURCE), acceleration_blend=blend)
    own, inbox, memory = states(3, rng)
    # no new differences, but new averages
    said_s = times(inbox, law.from_timestamp)[:, 0]
    memory = memory._replace(time_s=said_s - np.array([0.04, 0.04, 0.0]))
    _, after = step(law, NOW, own, inbox, memory)
    last, received = memory.acceleration, inbox.acceleration_ned[:, 0]
    assert after.acceleration[0] == pytest.approx((1 - blend[0]) * last[0], abs=1e-14)
    average = (1 - blend[1]) * last[1] + blend[1] * received[1]
    assert after.acceleration[1] == pytest.approx(average, abs=1e-14)
    speed = np.linalg.norm(inbox.velocity_ned[:, 0], axis=1)
    gamma = -np.arcsin(inbox.velocity_ned[:, 0, 2] / speed)
    frame = velocity_frame(np.ascontiguousarray(inbox.velocity_ned[:, 0]))
    rates = (memory.speed_rate, memory.gamma_dot)
    turn = turn_acceleration(frame, speed, gamma, *rates, inbox.euler[:, 0])
    assert after.acceleration[2] == pytest.approx(turn[2], rel=1e-12)


def test_an_average_takes_every_message_once():
    """However often the law steps between two messages; the first counts too."""
    rng = np.random.default_rng(74)
    law = make_law(2, rng, acceleration_source=np.full(2, leading.BROADCAST))
    own, inbox, memory = states(2, rng)
    said_s = times(inbox, law.from_timestamp)[1, 0]
    memory = memory._replace(time_s=np.array([np.nan, said_s - 0.1]))
    _, once = step(law, NOW, own, inbox, memory)
    assert (once.acceleration != memory.acceleration).all()
    _, twice = step(law, NOW + 0.04, own, inbox, once)
    assert np.array_equal(twice.acceleration, once.acceleration)


def test_leader_acceleration_enters_only_p_d_rate():
    """q̈_g enters ṗ_d and nothing else: s_d and y_d stay, u and ω move with it."""
    rng = np.random.default_rng(65)
    law = make_law(2, rng, acceleration_blend=np.ones((2, 3)))
    own, inbox, memory = states(2, rng, low=20.0, high=25.0)
    inbox.velocity_ned[:, 0] = own.velocity_ned
    memory = memory._replace(time_s=times(inbox, law.from_timestamp)[:, 0] - 0.04)
    calm, _ = step(law, NOW, own, inbox, memory)
    inbox.acceleration_ned[:, 0] += own.velocity_ned[:, [1, 0, 2]] * [-0.1, 0.1, 0.0]
    pulled, _ = step(law, NOW, own, inbox, memory)
    assert np.array_equal(pulled.direction, calm.direction)
    assert np.array_equal(pulled.speed_desired, calm.speed_desired)
    assert (abs(pulled.omega[:, 2] - calm.omega[:, 2]) > 0.01).all()


# ω̇_g


def test_a_course_is_bent_by_the_roll_rate_by_hand():
    # level at 20 m/s and 60° of bank, rolling in at 0.5 rad/s: 9.81·0.5/(20·¼) = 0.981
    speed, euler = np.full(2, 20.0), np.tile([np.pi / 3.0, 0.0, 0.0], (2, 1))
    bent = course_acceleration(speed, euler, np.array([0.5, 0.0]))
    assert bent == pytest.approx([0.981, 0.0], abs=1e-14)


def test_course_acceleration_is_derivative_of_rate():
    bank, attitude, speed, roll_rate, step = 0.5, 0.2, 23.0, 0.7, 1e-6

    def chi_dot(t):
        return PAPER_GRAVITY * np.tan(bank + roll_rate * t) / (speed * np.cos(attitude))

    ours = course_acceleration(
        np.array([speed]), np.array([[bank, attitude, 1.0]]), np.array([roll_rate])
    )
    # rounding of 0.2 over 1e-6
    difference = (chi_dot(step) - chi_dot(-step)) / (2.0 * step)
    assert ours[0] == pytest.approx(difference, abs=1e-9)


def test_a_leader_that_rolls_in_is_anticipated():
    """By hand: level north at 22 m/s, wings level, rolling right at 0.4 rad/s.

    σ̈_g = 9.81·0.4/22 = 0.178364 rad/s², and χ̈ = ω̇_g × υ = (−σ̈ r, σ̈ f) for a slot f ahead
    and r to the right. In the slot, as fast as the leader, ṗ_d is χ̈ alone: ṡ_d = −σ̈ r and
    ω3 = σ̈ f / s. With no barrier u = s + ṡ_d / p.
    """
    rng = np.random.default_rng(66)
    forward, right = np.array([-5.0, 8.0]), np.array([6.0, -3.0])
    offsets = np.zeros((3, 3))
    offsets[1:, 0], offsets[1:, 1] = forward, right
    law = make_law(
        2,
        rng,
        offsets=offsets,
        barrier=SpeedBarrier(7, 0.0),
        angular_acceleration_source=np.full(2, leading.ROLL_RATE),
    )
    own, inbox, memory = states(2, rng)
    north = np.tile([22.0, 0.0, 0.0], (3, 1))
    now = np.full((2, 3), NOW)
    inbox = Messages(
        now,
        now,
        np.stack([offsets] * 2),
        np.stack([north] * 2),
        *np.zeros((2, 2, 3, 3)),
        np.tile([0.4, 0.0, 0.0], (2, 3, 1)),
    )
    own = own._replace(position_ned=offsets[1:].copy(), velocity_ned=north[1:].copy())
    memory = memory._replace(acceleration=np.zeros((2, 3)))
    inputs, _ = step(law, NOW, own, inbox, memory)
    bending = 9.81 * 0.4 / 22.0
    assert bending == pytest.approx(0.178364, abs=1e-6)
    assert inputs.speed == pytest.approx(22.0 - bending * right / law.speed_pole, abs=1e-12)
    assert inputs.omega[:, 2] == pytest.approx(bending * forward / 22.0, abs=1e-14)
    assert inputs.omega[:, 1] == pytest.approx([0.0, 0.0], abs=1e-15)
    # the paper neglects it
    neglected, _ = step(
        replace(law, angular_acceleration_source=np.zeros(2, dtype=int)), NOW, own, inbox, memory
    )
    assert neglected.speed == pytest.approx([22.0, 22.0], abs=1e-12)
    assert neglected.omega == pytest.approx(np.zeros((2, 3)), abs=1e-15)


def test_differences_of_turn_rates_by_hand():
    """By hand: level north at 22 m/s, 0.10 → 0.12 rad/s in 0.05 s is 0.4 rad/s²; share 0.25.

    With an average of 0.2 rad/s² before, σ̈_g = 0.25 rad/s², and χ̈ = ω_g × (ω_g × υ) + ω̇_g × υ;
    the error (the slot's velocity is not the follower's) is cut by k = 0. A step later the same
    message changes nothing; after a timeout differences begin anew.
    """
    rng = np.random.default_rng(67)
    forward, right = np.array([-5.0, 8.0]), np.array([6.0, -3.0])
    offsets = np.zeros((3, 3))
    offsets[1:, 0], offsets[1:, 1] = forward, right
    law = make_law(
        2,
        rng,
        offsets=offsets,
        barrier=SpeedBarrier(7, 0.0),
        k=np.zeros(2),
        acceleration_source=np.full(2, leading.NOTHING),
        angular_acceleration_source=np.full(2, leading.DIFFERENCE),
        turn_rate_blend=np.full(2, 0.25),
    )
    turn, bend = 0.12, 0.25
    own, inbox, _ = states(2, rng)
    velocity = np.stack([22.0 - turn * right, turn * forward, np.zeros(2)], axis=1)
    own = own._replace(position_ned=offsets[1:].copy(), velocity_ned=velocity)
    inbox.stamp_s[:] = inbox.received_s[:] = NOW
    inbox.velocity_ned[:] = [22.0, 0.0, 0.0]
    inbox.euler[:], inbox.euler_rates[:] = 0.0, [0.0, 0.0, turn]
    memory = law.start(own)._replace(
        time_s=np.full(2, NOW - 0.05),
        speed=np.full(2, 22.0),
        gamma=np.zeros(2),
        omega=np.tile([0.0, 0.0, 0.10], (2, 1)),
        omega_dot=np.tile([0.0, 0.0, 0.2], (2, 1)),
    )
    inputs, after = step(law, NOW, own, inbox, memory)
    assert after.omega == pytest.approx(np.tile([0.0, 0.0, turn], (2, 1)), abs=1e-15)
    assert after.omega_dot == pytest.approx(np.tile([0.0, 0.0, bend], (2, 1)), abs=1e-11)
    # ṗ_d is χ̈ alone, and ṡ_d its part along the velocity
    chi_ddot = np.stack(
        [-(turn**2) * forward - bend * right, bend * forward - turn**2 * right], axis=1
    )
    along = (chi_ddot * velocity[:, :2]).sum(axis=1) / np.linalg.norm(velocity, axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    assert inputs.speed == pytest.approx(speed + along / law.speed_pole, abs=1e-10)
    _, again = step(law, NOW + 0.04, own, inbox, after)
    assert np.array_equal(again.omega_dot, after.omega_dot)
    inbox.received_s[:] = NOW - 100.0
    _, lost = step(law, NOW, own, inbox, after)
    assert (lost.omega_dot == 0.0).all()
