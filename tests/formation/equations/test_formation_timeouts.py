"""A follower whose leader or neighbours have timed out."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import (
    NOW,
    assert_same,
    flags,
    make_law,
    make_middle,
    middle,
    mixed_options,
    results,
    same,
    states,
    step,
)
from reference.formation_message_extrapolation import times
from reference.frames import velocity_frame

from testbed.core.flags import LimiterFlag
from testbed.core.records import Messages
from testbed.formation import leader_filter as leading

NEVER, LONG_AGO = "never", "long ago"
each_way = pytest.mark.parametrize("way", [NEVER, LONG_AGO])


def drop_messages(inbox, links, way):
    """Return an inbox without messages on these links: none ever, or none for 30 s."""
    dropped_inbox = Messages(*(each.copy() for each in inbox))
    if way == NEVER:
        for each in dropped_inbox:
            each[links] = np.nan
    else:
        dropped_inbox.received_s[links] -= 30.0
        dropped_inbox.stamp_s[links] -= 30.0
    return dropped_inbox


@each_way
def test_leader_timeout_flies_level_and_straight(way):
    rng = np.random.default_rng(21)
    law = make_law(3, rng, lost_leader_airspeed=np.array([20.0, 21.0, 22.0]))
    own, inbox, memory = states(3, rng, low=20.0, high=24.0)
    dropped_inbox = drop_messages(inbox, np.s_[1, 0], way)
    inputs, after = step(law, NOW, own, dropped_inbox, memory)
    speed = np.linalg.norm(own.velocity_ned[1])
    level = own.velocity_ned[1] * [1.0, 1.0, 0.0]
    # u over the ground that is 21 m/s in the air
    assert inputs.speed[1] == pytest.approx(21.0 + speed - own.airspeed[1], abs=1e-13)
    assert inputs.speed_desired[1] == inputs.speed[1]
    assert inputs.direction[1] == pytest.approx(level / np.linalg.norm(level), abs=1e-15)
    # (15) where ẏ_d = 0: c sin(γ_d − γ) upwards, nothing to the side
    gamma = np.arcsin(-own.velocity_ned[1, 2] / speed)
    assert inputs.omega[1] == pytest.approx([0.0, -law.c[1] * np.sin(gamma), 0.0], abs=1e-15)
    assert inputs.limiter_flags[1] == LimiterFlag.LEADER_TIMEOUT
    for name, array in results((inputs, after)).items():
        forgotten = name in ("memory.time_s", "memory.speed", "memory.gamma")
        if name in ("memory.timeout_since", "memory.timeout_course"):
            assert np.isnan(array[[0, 2]]).all(), name
        if name not in ("memory.held_position", "memory.held_time_s"):
            assert np.isnan(array[1]) if forgotten else np.isfinite(array[1]).all(), name
    # nothing of that leaks to the others
    received = results(step(law, NOW, own, inbox, memory))
    for name, array in results((inputs, after)).items():
        np.testing.assert_array_equal(array[[0, 2]], received[name][[0, 2]], err_msg=name)
    assert not (inputs.limiter_flags[[0, 2]] & LimiterFlag.LEADER_TIMEOUT).any()


@each_way
def test_leader_timeout_turns_at_the_set_rate(way):
    """Level flight at 22 m/s, 20° of bank: σ̇ = g tan 20°/22; (20) banks for that rate."""
    rng = np.random.default_rng(67)
    rate = 9.81 * np.tan(np.radians(20.0)) / 22.0
    law = make_law(
        2, rng, lost_leader_turn_rate=np.array([rate, -rate]), lost_leader_airspeed=same(22.0, 2)
    )
    own, inbox, memory = states(2, rng)
    course = np.array([0.7, -2.0])
    velocity = 22.0 * np.column_stack([np.cos(course), np.sin(course), np.zeros(2)])
    turning = np.array([rate, -rate])[:, None] * velocity[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]
    own = own._replace(
        velocity_ned=velocity,
        acceleration_ned=turning,
        airspeed=same(22.0, 2),
        euler=np.zeros((2, 3)),
    )
    inputs, _ = step(law, NOW, own, drop_messages(inbox, np.s_[:, 0], way), memory)
    assert inputs.speed == pytest.approx([22.0, 22.0], abs=1e-13)
    assert inputs.omega == pytest.approx(np.array([[0, 0, rate], [0, 0, -rate]]), abs=1e-15)
    loop = make_middle(2)
    command, _, diagnosis = middle(loop, own, inputs, loop.start())
    assert np.degrees(command.roll) == pytest.approx([20.0, -20.0], abs=1e-11)
    assert command.pitch == pytest.approx([0.0, 0.0], abs=1e-15)
    assert command.throttle == pytest.approx([0.22, 0.22], abs=1e-14)
    assert (diagnosis.limiter_flags == LimiterFlag.LEADER_TIMEOUT).all()


@each_way
@pytest.mark.parametrize("rate", [0.0, 0.15])
def test_course_in_a_timeout_is_that_at_its_start(way, rate):
    """Blown off it, or left with a bank, a follower turns back; in a circle it keeps its phase."""
    rng = np.random.default_rng(73)
    law = make_law(2, rng, lost_leader_turn_rate=same(rate, 2))
    own, inbox, memory = states(2, rng)
    own.velocity_ned[:] = [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0]]
    dropped_inbox = drop_messages(inbox, np.s_[:, 0], way)
    _, memory = step(law, NOW, own, dropped_inbox, memory)
    assert memory.timeout_since.tolist() == [NOW, NOW]
    assert memory.timeout_course == pytest.approx([0.0, np.pi / 2.0], abs=1e-15)
    off = 0.1
    own.velocity_ned[:] = 20.0 * np.array(
        [[np.cos(off), np.sin(off), 0.0], [-np.sin(off), np.cos(off), 0.0]]
    )
    inputs, after = step(law, NOW + 2.0, own, dropped_inbox, memory)
    wanted = np.array([0.0, np.pi / 2.0]) + 2.0 * rate
    assert np.arctan2(inputs.direction[:, 1], inputs.direction[:, 0]) == pytest.approx(
        wanted, abs=1e-13
    )
    # (15): c sin(σ_d − σ) + σ̇_d cos²(σ_d − σ) less what the rate takes of c, by hand
    gap = 2.0 * rate - off
    pull = (law.c + rate * np.sin(gap)) * np.sin(gap) + rate * np.cos(gap) ** 2
    assert inputs.omega[:, 2] == pytest.approx(pull, abs=1e-13)
    assert np.array_equal(after.timeout_since, memory.timeout_since)
    assert np.array_equal(after.timeout_course, memory.timeout_course)
    _, received = step(law, NOW + 2.04, own, inbox, after)
    assert np.isnan(received.timeout_since).all()
    assert np.isnan(received.timeout_course).all()


@each_way
def test_return_to_level_uses_gain_of_trim_speed(way):
    """c_i(t) = c + c_s s_d², with the s_d of a leader timeout."""
    rng = np.random.default_rng(68)
    law = make_law(2, rng, c=same(0.02, 2), c_speed=np.array([0.0, 4e-4]))
    own, inbox, memory = states(2, rng)
    own.velocity_ned[:] = [22.0 * np.cos(0.2), 0.0, -22.0 * np.sin(0.2)]
    inputs, _ = step(law, NOW, own, drop_messages(inbox, np.s_[:, 0], way), memory)
    s_d = law.lost_leader_airspeed + 22.0 - own.airspeed
    gain = 0.02 + np.array([0.0, 4e-4]) * s_d**2
    assert inputs.omega[:, 1] == pytest.approx(-gain * np.sin(0.2), rel=1e-12)


def test_messages_older_than_the_timeout_are_old():
    """By the time of receipt, whatever their stamps; exactly `leader_timeout_s` is not too old."""
    rng = np.random.default_rng(69)
    law = make_law(3, rng, leader_timeout_s=2.0)
    own, inbox, memory = states(3, rng)
    inbox.received_s[:, 0] = NOW - np.array([2.0, 2.0 + 1e-9, 0.0])
    inbox.stamp_s[:, 0] = NOW - np.array([2.1, 2.1, 60.0])
    inputs, _ = step(law, NOW, own, inbox, memory)
    assert (inputs.limiter_flags & LimiterFlag.LEADER_TIMEOUT != 0).tolist() == [False, True, False]


@each_way
def test_stale_neighbour_is_left_out_of_sum(way):
    rng = np.random.default_rng(22)
    law = make_law(3, rng, gains=rng.uniform(0.5, 1.0, (3, 4, 3)), neighbour_timeout_s=4.0)
    own, inbox, memory = states(3, rng)
    without = replace(law, gains=law.gains.copy())
    without.gains[0, 2] = 0.0
    ours = results(step(law, NOW, own, drop_messages(inbox, np.s_[0, 2], way), memory))
    theirs = results(step(without, NOW, own, inbox, memory))
    assert_same(ours, theirs, rtol=1e-12)
    received = step(law, NOW, own, inbox, memory)[0]
    assert abs(ours["inputs.direction"][0] - received.direction[0]).max() > 1e-3


def test_leader_memory_in_a_leader_timeout():
    """Averages are kept, differences begin with the first message after the timeout."""
    rng = np.random.default_rng(70)
    sources = [leading.BROADCAST, leading.TURN]
    blend = np.tile([0.4, 0.3, 0.2], (2, 1))
    law = make_law(2, rng, acceleration_source=np.array(sources), acceleration_blend=blend)
    own, inbox, memory = states(2, rng)
    _, after = step(law, NOW, own, drop_messages(inbox, np.s_[:, 0], LONG_AGO), memory)
    assert np.array_equal(after.acceleration, memory.acceleration)
    assert after.speed_rate.tolist() == after.gamma_dot.tolist() == [0.0, 0.0]
    _, again = step(law, NOW + 0.04, own, inbox, after)
    assert again.speed_rate.tolist() == again.gamma_dot.tolist() == [0.0, 0.0]
    assert np.array_equal(again.time_s, times(inbox, law.from_timestamp)[:, 0])


def test_after_a_timeout_the_law_is_the_same_again():
    """To the bit, without averages of q̈_g and ω̇_g, which lack the lost messages."""
    rng = np.random.default_rng(71)
    options = {**mixed_options(3, rng), "acceleration_blend": np.ones((3, 3))}
    options["acceleration_source"] = np.full(3, leading.BROADCAST)
    options["angular_acceleration_source"] = rng.integers(leading.NOTHING, leading.DIFFERENCE, 3)
    law = make_law(3, rng, **options)
    own, inbox, memory = states(3, rng)
    memory = memory._replace(time_s=times(inbox, law.from_timestamp)[:, 0] - 0.04)
    timed_out, after = step(law, NOW, own, drop_messages(inbox, np.s_[:, 0], LONG_AGO), memory)
    assert (timed_out.limiter_flags & LimiterFlag.LEADER_TIMEOUT).all()
    again, _ = step(law, NOW, own, inbox, after)
    always, _ = step(law, NOW, own, inbox, memory)
    for name in again._fields:
        ours, theirs = getattr(again, name), getattr(always, name)
        np.testing.assert_array_equal(ours, theirs, err_msg=name)


def test_a_leader_that_is_mute_for_two_seconds():
    """Muted in [1, 3) s: timed out 0.5 s after the message of 0.96 s, received again at 3 s."""
    rng = np.random.default_rng(72)
    n = 2
    law = make_law(n, rng, leader_timeout_s=0.5, horizontal=flags(False, n))
    flagged = []
    own, _, _ = states(n, rng)
    memory = law.start(own)
    velocity = np.tile([22.0, 0.0, 0.0], (n, n + 1, 1))
    for k in range(101):
        now = 0.04 * k
        stamps = np.full((n, n + 1), now)
        stamps[:, 0] = 0.04 * (24 if 25 <= k < 75 else k)
        inbox = Messages(
            stamps, stamps, stamps[:, :, None] * velocity, velocity, *np.zeros((3, n, n + 1, 3))
        )
        inputs, memory = step(law, now, own, inbox, memory)
        if (inputs.limiter_flags & LimiterFlag.LEADER_TIMEOUT).any():
            assert (inputs.limiter_flags & LimiterFlag.LEADER_TIMEOUT).all()
            flagged.append(now)
    # 0.96 + 0.5 = 1.46 s: the next control tick after it is 1.48 s
    assert (flagged[0], flagged[-1]) == pytest.approx((1.48, 2.96), abs=1e-12)
    assert len(flagged) == 38


# a neighbour that is held where it was


def places_of(inbox, horizontal):
    """R_gᵀ (q_j − q_g) of messages that arrive now; the leader has none."""
    level = np.where(horizontal[:, None], [1.0, 1.0, 0.0], 1.0)
    frame = velocity_frame(inbox.velocity_ned[:, 0] * level)
    place = (inbox.position_ned - inbox.position_ned[:, :1]) @ frame
    place[:, 0] = np.nan
    return place


def all_present(n, rng, **changes):
    """A law that holds timed-out neighbours, and states of n agents with present messages."""
    gains = rng.uniform(0.3, 1.0, (n, n + 1, 3))
    law = make_law(
        n,
        rng,
        **{**mixed_options(n, rng), "gains": gains, "hold_stale_neighbours": True, **changes},
    )
    own, inbox, memory = states(n, rng, low=19.0, high=27.0)
    inbox.stamp_s[:] = inbox.received_s[:] = NOW
    return law, own, inbox, memory


def test_new_message_updates_the_held_position():
    rng = np.random.default_rng(80)
    law, own, inbox, memory = all_present(4, rng, horizontal=np.arange(4) % 2 == 0)
    law.gains[1, 3] = 0.0
    law.gains[2, 4, :2] = 0.0  # the horizontal variant does not use that
    _, after = step(law, NOW, own, inbox, memory)
    expected = places_of(inbox, law.horizontal)
    said_s = times(inbox, law.from_timestamp).copy()
    said_s[:, 0] = np.nan
    for link in ((1, 3), (2, 4)):
        expected[link], said_s[link] = memory.held_position[link], memory.held_time_s[link]
    np.testing.assert_allclose(after.held_position, expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(after.held_time_s, said_s)
    # a law that leaves out timed-out neighbours stores no position
    _, dropped = step(replace(law, hold_stale_neighbours=False), NOW, own, inbox, memory)
    np.testing.assert_array_equal(dropped.held_position, memory.held_position)
    np.testing.assert_array_equal(dropped.held_time_s, memory.held_time_s)


@pytest.mark.parametrize("from_timestamp", [False, True])
def test_message_gives_a_held_position_once(from_timestamp):
    """An extrapolation of the same message has left the turn; only its time tells what is new."""
    rng = np.random.default_rng(85)
    law, own, inbox, memory = all_present(3, rng, horizontal=flags(False, 3))
    law = replace(law, from_timestamp=from_timestamp)
    _, first = step(law, NOW, own, inbox, memory)
    inbox.position_ned[:, 1:] += 3.0
    said_s, other = inbox.stamp_s, inbox.received_s
    if not from_timestamp:
        said_s, other = other, said_s
    other[:] = NOW + 0.2  # says nothing here
    said_s[:, 2] = NOW - 1.0  # what a slow path brought in after it
    said_s[:, 3] = np.nextafter(NOW, np.inf)
    _, after = step(law, NOW, own, inbox, first)
    np.testing.assert_array_equal(after.held_position[:, :3], first.held_position[:, :3])
    np.testing.assert_array_equal(after.held_time_s[:, :3], first.held_time_s[:, :3])
    new = places_of(inbox, law.horizontal)[:, 3]
    np.testing.assert_allclose(after.held_position[:, 3], new, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(after.held_time_s[:, 3], said_s[:, 3])


def test_held_position_is_that_at_the_step():
    """As reckoned then: both are brought to now along their velocities, from their receipt."""
    rng = np.random.default_rng(86)
    straight = {"with_acceleration": flags(False, 3), "horizontal": flags(False, 3)}
    law, own, inbox, memory = all_present(3, rng, **straight)
    inbox.received_s[:] -= rng.uniform(0.0, 0.3, (3, 4))
    memory.held_time_s[:] -= 1.0
    _, after = step(law, NOW, own, inbox, memory)
    lag = (NOW - inbox.received_s)[:, :, None]
    brought = inbox._replace(position_ned=inbox.position_ned + lag * inbox.velocity_ned)
    expected = places_of(brought, law.horizontal)
    np.testing.assert_allclose(after.held_position, expected, rtol=1e-13, atol=1e-13)


def test_neighbour_is_extrapolated_then_held():
    """Exactly `neighbour_timeout_s` is not too old; the leader's message has its own limit."""
    rng = np.random.default_rng(81)
    limits = {"neighbour_timeout_s": 2.0, "leader_timeout_s": 1.0}
    law, own, inbox, memory = all_present(2, rng, horizontal=flags(False, 2), **limits)
    _, first = step(law, NOW, own, inbox, memory)
    inbox.received_s[:, [0, 2]] = inbox.stamp_s[:, [0, 2]] = NOW + 2.0
    inbox.velocity_ned[:, 0] += 1.0
    extrapolated, last = step(law, NOW + 2.0, own, inbox, first)
    left_out, _ = step(replace(law, hold_stale_neighbours=False), NOW + 2.0, own, inbox, first)
    # until then it is used as by a law that does not hold, and its position is that of its message
    assert_same(results((extrapolated, last)), results((left_out, last)), rtol=0, atol=0)
    np.testing.assert_array_equal(last.held_position[:, 1], first.held_position[:, 1])
    assert (last.held_position[:, 2] != first.held_position[:, 2]).all()
    late = np.nextafter(NOW + 2.0, np.inf)
    held, after = step(law, late, own, inbox, last)
    np.testing.assert_array_equal(after.held_position, last.held_position)
    assert np.abs(held.direction - extrapolated.direction).max() > 1e-3
    # the rest of its message has no effect
    inbox.position_ned[:, 1] += 50.0
    inbox.velocity_ned[:, 1] *= -1.0
    again, _ = step(law, late, own, inbox, last)
    assert_same(results((again, after)), results((held, after)), rtol=0, atol=0)


def test_held_positions_wait_in_leader_timeout():
    """A neighbour first received then has none, and is left out when the leader is back."""
    rng = np.random.default_rng(87)
    limits = {"neighbour_timeout_s": 2.0, "leader_timeout_s": 1.0}
    law, own, inbox, memory = all_present(3, rng, **limits)
    memory.held_position[:, 1], memory.held_time_s[:, 1] = np.nan, np.nan
    inputs, after = step(law, NOW, own, drop_messages(inbox, np.s_[:, 0], LONG_AGO), memory)
    assert (inputs.limiter_flags == LimiterFlag.LEADER_TIMEOUT).all()
    np.testing.assert_array_equal(after.held_position, memory.held_position)
    np.testing.assert_array_equal(after.held_time_s, memory.held_time_s)
    inbox.received_s[:, 0] = inbox.stamp_s[:, 0] = NOW + 3.0
    back, later = step(law, NOW + 3.0, own, inbox, after)
    nothing = replace(law, gains=law.gains.copy())
    nothing.gains[:, 1] = 0.0
    without, _ = step(nothing, NOW + 3.0, own, inbox, after)
    assert_same(results((back, later)), results((without, later)), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(later.held_position, memory.held_position)


@each_way
def test_neighbour_held_in_slot_acts_as_the_leader(way):
    """Of (6) q_j − χ_j = q_g is left, and of its rate q̇_g: β_ij is added to β_i."""
    rng = np.random.default_rng(82)
    law, own, inbox, memory = all_present(3, rng)
    memory.held_position[:, 2] = law.offsets[2]
    joined = replace(law, gains=law.gains.copy())
    joined.gains[:, 0] += joined.gains[:, 2]
    joined.gains[:, 2] = 0.0
    held, _ = step(law, NOW, own, drop_messages(inbox, np.s_[:, 2], way), memory)
    pulled, _ = step(joined, NOW, own, inbox, memory)
    assert_same(held._asdict(), pulled._asdict(), rtol=1e-10, atol=1e-10)


@each_way
def test_held_neighbour_moves_as_a_slot(way):
    """Anywhere, it is where a message would have it that says R_g p and its rate by differences."""
    rng = np.random.default_rng(83)
    law, own, inbox, memory = all_present(3, rng)
    memory.held_position[:, 2] = rng.normal(0.0, 10.0, (3, 3))
    level = np.where(law.horizontal[:, None], [1.0, 1.0, 0.0], 1.0)
    velocity = inbox.velocity_ned[:, 0] * level
    speed = np.linalg.norm(velocity, axis=1)
    course, gamma = np.arctan2(velocity[:, 1], velocity[:, 0]), -np.arcsin(velocity[:, 2] / speed)
    rates = inbox.euler_rates[:, 0]

    def chi(dt):
        sigma = course + dt * rates[:, 2]
        up = gamma + dt * rates[:, 1] * level[:, 2]
        ahead = np.stack([np.cos(up) * np.cos(sigma), np.cos(up) * np.sin(sigma)], axis=1)
        frame = velocity_frame(np.column_stack([ahead, -np.sin(up)]))
        return (frame @ memory.held_position[:, 2, :, None])[:, :, 0]

    in_place = Messages(*(each.copy() for each in inbox))
    in_place.position_ned[:, 2] = inbox.position_ned[:, 0] + chi(0.0)
    in_place.velocity_ned[:, 2] = velocity + (chi(1e-4) - chi(-1e-4)) / 2e-4
    held, _ = step(law, NOW, own, drop_messages(inbox, np.s_[:, 2], way), memory)
    received, _ = step(law, NOW, own, in_place, memory)
    assert np.abs(held.omega).max() > 0.01
    # differences of 1e-4 s err by 1e-8 of a rate of some 10 m/s
    assert_same(held._asdict(), received._asdict(), rtol=1e-6, atol=1e-6)


@each_way
def test_neighbour_without_position_is_left_out(way):
    rng = np.random.default_rng(84)
    law, own, inbox, memory = all_present(3, rng)
    memory.held_position[:, 2], memory.held_time_s[:, 2] = np.nan, np.nan
    dropped_inbox = drop_messages(inbox, np.s_[:, 2], way)
    held, after = step(law, NOW, own, dropped_inbox, memory)
    dropped, _ = step(replace(law, hold_stale_neighbours=False), NOW, own, dropped_inbox, memory)
    assert_same(results((held, after)), results((dropped, after)), rtol=0, atol=0)
    assert np.isnan(after.held_position[:, 2]).all()
