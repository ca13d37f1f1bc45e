"""One step of the law: inputs, limits, symmetries and the equilibrium on a helix."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import (
    HIGH,
    LOW,
    NOW,
    PAPERS_MU,
    assert_same,
    choose,
    leaves,
    make_law,
    make_middle,
    middle,
    mixed_options,
    reorder,
    results,
    same,
    some_of,
    states,
    step,
)
from reference import formation_barrier as barrier_functions
from reference import formation_control_function as control_functions
from reference.adapters import law_records, neighbour_records
from reference.formation_leader_filter import Memory

from testbed.core.flags import LimiterFlag
from testbed.core.frames import wrap_pi
from testbed.core.records import Messages
from testbed.formation import leader_filter as leading
from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.formation.control_step import Hbh23Law

NORTH = np.array([1.0, 0.0, 0.0])


def test_without_delay_receipt_equals_timestamp():
    rng = np.random.default_rng(20)
    law = make_law(3, rng)
    own, inbox, memory = states(3, rng)
    inbox = inbox._replace(received_s=inbox.stamp_s)
    ours = results(step(law, NOW, own, inbox, memory))
    theirs = results(step(replace(law, from_timestamp=True), NOW, own, inbox, memory))
    assert_same(ours, theirs, rtol=0, atol=0)


def test_without_gains_leader_velocity_is_followed():
    # β_i = 0 removes only the position feedback: (7), (10), (22) use the leader's message
    rng = np.random.default_rng(23)
    law = make_law(2, rng, gains=np.zeros((2, 3, 3)), offsets=np.zeros((3, 3)))
    own, inbox, memory = states(2, rng)
    output, _ = step(law, NOW, own, inbox, memory)
    leader = inbox.velocity_ned[:, 0]
    speed = np.linalg.norm(leader, axis=1)
    assert output.direction == pytest.approx(leader / speed[:, None], abs=1e-15)
    assert output.speed_desired == pytest.approx(speed)


# limiter_flags and bounds


def level_flight(law, rng, *, leader, own_speed):
    """Level and steady flight north at these speeds (n,)."""
    n = len(law.k)
    own, inbox, memory = states(n, rng)
    inbox.velocity_ned[:, 0] = np.asarray(leader)[:, None] * NORTH
    inbox.acceleration_ned[:] = 0.0
    inbox.euler[:] = 0.0
    inbox.euler_rates[:] = 0.0
    own.velocity_ned[:] = np.asarray(own_speed)[:, None] * NORTH
    own.airspeed[:] = own.velocity_ned[:, 0]
    return own, inbox, memory._replace(acceleration=np.zeros((n, 3)))


def followers_of_velocity(n, rng, **changes):
    return make_law(n, rng, gains=np.zeros((n, n + 1, 3)), offsets=np.zeros((n + 1, 3)), **changes)


def test_limiter_flags_report_limits():
    rng = np.random.default_rng(24)
    law = followers_of_velocity(3, rng)
    # within all limits; leader too slow; own speed beyond the bound
    args = level_flight(law, rng, leader=[22.0, 15.0, 22.0], own_speed=[22.0, 20.0, 31.0])
    output, _ = step(law, NOW, *args)
    assert output.limiter_flags.tolist() == [
        0,
        LimiterFlag.SPEED_DESIRED_CLAMPED,
        LimiterFlag.OUTSIDE_SPEED_SET,
    ]
    lowest = law.speeds.desired_min[1]
    assert LOW < lowest < 22.0
    assert output.speed_desired == pytest.approx([22.0, lowest, 22.0], abs=1e-12)
    assert output.limiter_flags.dtype == np.uint8


def test_airspeed_bounds_are_shifted_by_the_wind():
    """7 m/s of headwind: 22 m/s of the leader over the ground are 29 m/s of airspeed."""
    rng = np.random.default_rng(46)
    ground = followers_of_velocity(2, rng)
    air = replace(ground, bounds_of_airspeed=True)
    own, inbox, memory = level_flight(ground, rng, leader=[22.0, 22.9], own_speed=[22.0, 22.0])
    own = own._replace(airspeed=own.airspeed + 7.0)
    calm, _ = step(ground, NOW, own, inbox, memory)
    assert calm.limiter_flags.tolist() == [0, 0]
    output, _ = step(air, NOW, own, inbox, memory)
    # S is (9, 23) over the ground now, and S_d ends `HIGH − desired_max` below 23
    highest = ground.speeds.desired_max - 7.0
    assert output.limiter_flags.tolist() == [int(22.0 > highest[0]), int(22.9 > highest[1])]
    assert output.limiter_flags[1] == LimiterFlag.SPEED_DESIRED_CLAMPED
    assert output.speed_desired == pytest.approx(np.minimum([22.0, 22.9], highest), abs=1e-12)
    # without wind they are the same bounds
    own = own._replace(airspeed=own.airspeed - 7.0)
    ours, theirs = (results(step(law, NOW, own, inbox, memory)) for law in (ground, air))
    assert_same(ours, theirs, rtol=1e-13, atol=0)


def test_turn_gain_grows_with_desired_speed_squared():
    """c = 0.05 + 3e-4·22²; flying straight where y_d lies across, (15) is c itself."""
    rng = np.random.default_rng(47)
    law = followers_of_velocity(2, rng, c=same(0.05, 2), c_speed=np.array([0.0, 3e-4]))
    own, inbox, memory = level_flight(law, rng, leader=[22.0, 22.0], own_speed=[22.0, 22.0])
    own.velocity_ned[:] = [0.0, -22.0, 0.0]  # west; the leader flies north, to the right
    output, _ = step(law, NOW, own, inbox, memory)
    assert output.omega[:, 2] == pytest.approx([0.05, 0.05 + 3e-4 * 484.0], abs=1e-15)


def test_followers_with_different_options():
    """Each follower steps as in a law whose followers all have its options."""
    rng = np.random.default_rng(48)
    functions = [PAPERS_MU, example_1(2.5e5, 1.0, 0.8), EXAMPLE_2, EXAMPLE_3]
    barriers = [
        SpeedBarrier(4, 0.02),
        SpeedBarrier(5, 0.05),
        SpeedBarrier(6, 1.0),
        SpeedBarrier(7, 0.0),
    ]
    for _ in range(10):
        law = make_law(4, rng, mu=functions, barrier=barriers, **mixed_options(4, rng))
        args = states(4, rng, never=0.1, old=0.1)
        together = results(step(law, NOW, *args))
        for i in range(4):
            alike = replace(
                law,
                **{
                    name: np.array([getattr(law, name)[i]] * 4)
                    for name in (
                        "c_speed",
                        "horizontal",
                        "with_acceleration",
                        "acceleration_source",
                        "acceleration_blend",
                        "angular_acceleration_source",
                        "turn_rate_blend",
                        "lost_leader_turn_rate",
                    )
                },
                control_function=control_functions.per_agent([functions[i]] * 4),
                barrier=barrier_functions.per_agent([barriers[i]] * 4),
            )
            for name, array in results(step(alike, NOW, *args)).items():
                np.testing.assert_array_equal(array[i], together[name][i], err_msg=name)


# the composition


def helix(n, gamma, turn, sigma, offsets):
    """Leader and slots on a steady helix: position, velocity, acceleration (n + 1, 3), and ω."""
    cs, ss, cg, sg = np.cos(sigma), np.sin(sigma), np.cos(gamma), np.sin(gamma)
    matrix = np.array([[cg * cs, -ss, sg * cs], [cg * ss, cs, sg * ss], [-sg, 0.0, cg]])
    omega = np.array([0.0, 0.0, turn])
    chi = offsets @ matrix.T
    position = np.array([40.0, -30.0, -100.0]) + chi
    velocity = 22.0 * matrix[:, 0] + np.cross(omega, chi)
    return position, velocity, np.cross(omega, velocity), omega


SLOTS = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0], [9.0, 0.0, 4.0]])


@pytest.mark.parametrize("source", [leading.BROADCAST, leading.TURN], ids=["broadcast", "turn"])
@pytest.mark.parametrize("gamma", [0.0, 0.3, -0.25])
def test_follower_in_its_slot_commands_a_steady_helix(source, gamma):
    """Leader and slots turn about one axis, so every rate is known and every error is zero.

    Then s_d = s, u = s, y_d = y and ω is the rate of the follower's own helix. Of the middle loop,
    (19) is γ, (20) is the bank of a coordinated turn at the follower's own speed, and (21) is its
    feed-forward. The bank of a leader in a coordinated turn gives the same acceleration as its
    message.
    """
    n, turn, sigma = 3, 0.2, 2.9
    law = make_law(
        n,
        np.random.default_rng(37),
        offsets=SLOTS,
        acceleration_blend=np.ones((n, 3)),
        acceleration_source=np.full(n, source),
        angular_acceleration_source=np.full(n, leading.ROLL_RATE),  # ω̇_g is zero here
    )
    position, velocity, acceleration, omega = helix(n, gamma, turn, sigma, law.offsets)
    speed = np.linalg.norm(velocity[1:], axis=1)
    own, _, _ = states(n, np.random.default_rng(38))
    own = own._replace(
        position_ned=position[1:].copy(),
        velocity_ned=velocity[1:].copy(),
        acceleration_ned=acceleration[1:].copy(),
        airspeed=speed + 2.0,
    )
    now = np.full((n, n + 1), NOW)
    bank = np.arctan(turn * 22.0 * np.cos(gamma) / leading.PAPER_GRAVITY)
    attitude = np.tile([bank, gamma, sigma], (n, n + 1, 1))
    rates = np.tile(omega, (n, n + 1, 1))
    received = (np.stack([each] * n) for each in (position, velocity, acceleration))
    inbox = Messages(now, now, *received, attitude, rates)
    output, after = step(law, NOW, own, inbox, law.start(own))

    gamma = np.arcsin(-velocity[1:, 2] / speed)
    assert output.speed_desired == pytest.approx(speed, rel=1e-13)
    assert output.speed == pytest.approx(speed, rel=1e-12)
    assert output.direction == pytest.approx(velocity[1:] / speed[:, None], abs=1e-13)
    own_turn = np.column_stack([np.zeros((n, 2)), turn * np.cos(gamma)])
    assert output.omega == pytest.approx(own_turn, abs=1e-13)
    assert (output.limiter_flags == 0).all()
    assert after.acceleration == pytest.approx(np.tile(acceleration[0], (n, 1)), abs=1e-13)

    loop = make_middle(n)
    command, memory, diagnosis = middle(loop, own, output, loop.start())
    assert diagnosis.airspeed_command == pytest.approx(speed + 2.0, rel=1e-12)
    assert (diagnosis.limiter_flags == 0).all()
    assert command.pitch == pytest.approx(gamma, abs=1e-12)
    assert command.roll == pytest.approx(np.arctan(turn * speed * np.cos(gamma) / 9.81), abs=1e-12)
    own_bank = np.cos(own.euler[:, 0]) ** -2 - 1.0
    assert command.throttle == pytest.approx(
        np.clip(0.22 + 0.12 * own_bank + 0.1 * (speed + 2.0 - 22.0), 0.0, 1.0), abs=1e-12
    )
    for integral in memory[:4]:
        assert integral == pytest.approx(np.zeros(n), abs=1e-12)


# symmetries


def test_order_of_followers_has_no_effect():
    rng = np.random.default_rng(28)
    n, order = 5, np.array([3, 0, 4, 1, 2])
    for _ in range(20):
        law = make_law(n, rng, **mixed_options(n, rng))
        own, inbox, memory = states(n, rng, never=0.1, old=0.1)
        ours = results(step(law, NOW, own, inbox, memory))
        theirs = results(step(*reorder_at(NOW, law, own, inbox, memory, order)))
        expected = {name: array[order] for name, array in ours.items()}
        all_rows = np.concatenate([[0], order + 1])
        for name in ("memory.held_position", "memory.held_time_s"):
            expected[name] = expected[name][:, all_rows]
        # sums over neighbours run in another order; (14) magnifies that where D is small
        assert_same(theirs, expected, rtol=1e-9, atol=1e-11)


def reorder_at(now, law, own, inbox, memory, order):
    law, *known = reorder(law, own, inbox, memory, order)
    return law, now, *known


def test_one_follower_steps_as_among_others():
    """To the bit, with the same messages of the others."""
    rng = np.random.default_rng(29)
    n = 7
    for _ in range(5):
        law = make_law(n, rng, **mixed_options(n, rng))
        known = states(n, rng, never=0.1, old=0.1)
        together = results(step(law, NOW, *known))
        for rows in (*([i] for i in range(n)), [5, 1], [0, 2, 3, 6]):
            part = (choose(each, rows) for each in known)
            for name, array in results(step(some_of(law, rows), NOW, *part)).items():
                np.testing.assert_array_equal(array, together[name][rows], err_msg=name)


def test_rotation_about_the_vertical_and_translation():
    rng = np.random.default_rng(30)
    n, angle, shift = 4, 2.2, np.array([300.0, -700.0, 40.0])
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    level = np.ones((n, n + 1, 3)) * rng.uniform(0.2, 1.0, (n, n + 1, 1))
    for _ in range(20):
        # gains and averages per axis would not turn with the world
        options = {
            **mixed_options(n, rng),
            "acceleration_blend": np.ones((n, 3)) * rng.uniform(0.1, 1.0, (n, 1)),
        }
        law = make_law(n, rng, gains=level, **options)
        own, inbox, memory = states(n, rng, low=LOW + 0.5, high=HIGH - 0.5, old=0.05)
        straight = results(step(law, NOW, own, inbox, memory))
        own = own._replace(
            position_ned=own.position_ned @ turn.T + shift,
            velocity_ned=own.velocity_ned @ turn.T,
            acceleration_ned=own.acceleration_ned @ turn.T,
            euler=own.euler + [0.0, 0.0, angle],
        )
        inbox = inbox._replace(
            position_ned=inbox.position_ned @ turn.T + shift,
            velocity_ned=inbox.velocity_ned @ turn.T,
            acceleration_ned=inbox.acceleration_ned @ turn.T,
            euler=inbox.euler + [0.0, 0.0, angle],
        )
        memory = memory._replace(acceleration=memory.acceleration @ turn.T)
        turned = results(step(law, NOW, own, inbox, memory))
        for name in ("inputs.direction", "memory.acceleration"):
            straight[name] = straight[name] @ turn.T
        name = "memory.timeout_course"
        straight[name] = wrap_pi(straight[name] + angle)
        # positions of 700 m carry 1e-13 m; (14) magnifies that where D is small
        assert_same(turned, straight, rtol=1e-8, atol=1e-10)


# purity


def test_step_modifies_no_input():
    rng = np.random.default_rng(31)
    law = make_law(3, rng, **mixed_options(3, rng))
    args = (law, *states(3, rng, never=0.2))
    before = [{name: np.copy(a) for name, a in leaves(record)} for record in args]
    step(args[0], NOW, *args[1:])
    for record, copies in zip(args, before, strict=True):
        for name, array in leaves(record):
            np.testing.assert_array_equal(array, copies[name], err_msg=name)


def test_step_uses_only_the_followers_own_row():
    """A change of one follower's inputs changes only its own command."""
    rng = np.random.default_rng(32)
    n = 4
    law = make_law(n, rng, **mixed_options(n, rng))
    own, inbox, memory = states(n, rng)
    calm = results(step(law, NOW, own, inbox, memory))
    others = np.arange(n) != 2
    moved = 0
    for record in (own, inbox, memory):
        for name, array in leaves(record):
            array[2] += 0.5
            shaken = results(step(law, NOW, own, inbox, memory))
            array[2] -= 0.5
            moved += any((values[2] != calm[result][2]).any() for result, values in shaken.items())
            for result, values in shaken.items():
                np.testing.assert_array_equal(
                    values[others], calm[result][others], err_msg=f"{name} -> {result}"
                )
    assert moved > 8


def test_initial_memory_has_no_message():
    law = make_law(3, np.random.default_rng(33))
    kernel_law = Hbh23Law(law_records(law), neighbour_records(law, law.start(None)))
    records = kernel_law.start(None)
    known = ("acceleration", "speed_rate", "gamma_dot", "omega_dot")
    for name in Memory._fields:
        ours = getattr(law.start(None), name)
        theirs = getattr(records, name) if name.startswith("held") else records.leader[name]
        for value in (ours, theirs):
            assert len(value) == 3
            assert (value == 0.0).all() if name in known else np.isnan(value).all(), name
