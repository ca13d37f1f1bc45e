"""What a follower does that does not hear: its leader, a neighbour, or anybody."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import (
    LOOP_ENGINES,
    NOW,
    assert_same,
    each_engine,
    flags,
    make_law,
    make_middle,
    mixed_options,
    results,
    same,
    states,
)

from testbed.formation import leader as leading
from testbed.formation.flags import Guard
from testbed.network.channel import Channel, deliver, send, silent
from testbed.state import Broadcast, Inbox

NEVER, LONG_AGO = "never", "long ago"
each_way = pytest.mark.parametrize("way", [NEVER, LONG_AGO])


def unhear(inbox, links, way):
    """The inbox in which these links are silent."""
    quiet = Inbox(*(each.copy() for each in inbox))
    if way == NEVER:
        for each in quiet:
            each[links] = np.nan
    else:
        quiet.received_s[links] -= 30.0
        quiet.stamp_s[links] -= 30.0
    return quiet


@each_engine
@each_way
def test_who_does_not_hear_the_leader_flies_level_straight_on(step, way):
    rng = np.random.default_rng(21)
    law = make_law(3, rng, silent_airspeed=np.array([20.0, 21.0, 22.0]))
    own, inbox, memory = states(3, rng, low=20.0, high=24.0)
    quiet = unhear(inbox, np.s_[1, 0], way)
    told, after = step(law, NOW, own, quiet, memory)
    speed = np.linalg.norm(own.velocity_ned[1])
    level = own.velocity_ned[1] * [1.0, 1.0, 0.0]
    # u over the ground that is 21 m/s in the air
    assert told.speed[1] == pytest.approx(21.0 + speed - own.airspeed[1], abs=1e-13)
    assert told.speed_desired[1] == told.speed[1]
    assert told.direction[1] == pytest.approx(level / np.linalg.norm(level), abs=1e-15)
    # (15) where ẏ_d = 0: c sin(γ_d − γ) upwards, nothing to the side
    climb = np.arcsin(-own.velocity_ned[1, 2] / speed)
    assert told.turn[1] == pytest.approx([0.0, -law.c[1] * np.sin(climb), 0.0], abs=1e-15)
    assert told.guards[1] == Guard.LEADER_SILENT
    for name, array in results((told, after)).items():
        forgotten = name in ("memory.stamp_s", "memory.speed", "memory.climb")
        if name in ("memory.silent_since", "memory.silent_course"):
            assert np.isnan(array[[0, 2]]).all(), name
        assert np.isnan(array[1]) if forgotten else np.isfinite(array[1]).all(), name
    # nothing of that leaks to the others
    heard = results(step(law, NOW, own, inbox, memory))
    for name, array in results((told, after)).items():
        np.testing.assert_array_equal(array[[0, 2]], heard[name][[0, 2]], err_msg=name)
    assert not (told.guards[[0, 2]] & Guard.LEADER_SILENT).any()


@each_engine
@each_way
@pytest.mark.parametrize("middle", LOOP_ENGINES.values(), ids=LOOP_ENGINES)
def test_or_round_in_a_circle(step, middle, way):
    """Level flight at 22 m/s, 20° of bank: σ̇ = g tan 20°/22; (20) banks for that rate."""
    rng = np.random.default_rng(67)
    rate = 9.81 * np.tan(np.radians(20.0)) / 22.0
    law = make_law(2, rng, silent_turn=np.array([rate, -rate]), silent_airspeed=same(22.0, 2))
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
    told, _ = step(law, NOW, own, unhear(inbox, np.s_[:, 0], way), memory)
    assert told.speed == pytest.approx([22.0, 22.0], abs=1e-13)
    assert told.turn == pytest.approx(np.array([[0, 0, rate], [0, 0, -rate]]), abs=1e-15)
    loop = make_middle(2)
    command, _, diagnosis = middle(loop, own, told, loop.start())
    assert np.degrees(command.roll) == pytest.approx([20.0, -20.0], abs=1e-11)
    assert command.pitch == pytest.approx([0.0, 0.0], abs=1e-15)
    assert command.throttle == pytest.approx([0.22, 0.22], abs=1e-14)
    assert (diagnosis.guards == Guard.LEADER_SILENT).all()


@each_engine
@each_way
@pytest.mark.parametrize("rate", [0.0, 0.15])
def test_the_course_of_the_silence_is_that_at_its_beginning(step, way, rate):
    """Blown off it, or left with a bank, a follower turns back; in a circle it keeps its phase."""
    rng = np.random.default_rng(73)
    law = make_law(2, rng, silent_turn=same(rate, 2))
    own, inbox, memory = states(2, rng)
    own.velocity_ned[:] = [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0]]
    quiet = unhear(inbox, np.s_[:, 0], way)
    _, memory = step(law, NOW, own, quiet, memory)
    assert memory.silent_since.tolist() == [NOW, NOW]
    assert memory.silent_course == pytest.approx([0.0, np.pi / 2.0], abs=1e-15)
    off = 0.1
    own.velocity_ned[:] = 20.0 * np.array(
        [[np.cos(off), np.sin(off), 0.0], [-np.sin(off), np.cos(off), 0.0]]
    )
    told, after = step(law, NOW + 2.0, own, quiet, memory)
    wanted = np.array([0.0, np.pi / 2.0]) + 2.0 * rate
    assert np.arctan2(told.direction[:, 1], told.direction[:, 0]) == pytest.approx(
        wanted, abs=1e-13
    )
    # (15): c sin(σ_d − σ) + σ̇_d cos²(σ_d − σ) less what the rate takes of c, by hand
    gap = 2.0 * rate - off
    pull = (law.c + rate * np.sin(gap)) * np.sin(gap) + rate * np.cos(gap) ** 2
    assert told.turn[:, 2] == pytest.approx(pull, abs=1e-13)
    assert np.array_equal(after.silent_since, memory.silent_since)
    assert np.array_equal(after.silent_course, memory.silent_course)
    _, heard = step(law, NOW + 2.04, own, inbox, after)
    assert np.isnan(heard.silent_since).all()
    assert np.isnan(heard.silent_course).all()


@each_engine
@each_way
def test_the_turn_back_to_level_is_by_the_gain_of_that_speed(step, way):
    """c_i(t) = c + c_s s_d², with the s_d that is flown in silence."""
    rng = np.random.default_rng(68)
    law = make_law(2, rng, c=same(0.02, 2), c_speed=np.array([0.0, 4e-4]))
    own, inbox, memory = states(2, rng)
    own.velocity_ned[:] = [22.0 * np.cos(0.2), 0.0, -22.0 * np.sin(0.2)]
    told, _ = step(law, NOW, own, unhear(inbox, np.s_[:, 0], way), memory)
    flown = law.silent_airspeed + 22.0 - own.airspeed
    gain = 0.02 + np.array([0.0, 4e-4]) * flown**2
    assert told.turn[:, 1] == pytest.approx(-gain * np.sin(0.2), rel=1e-12)


@each_engine
def test_news_count_as_old_when_they_are_older_than_that(step):
    """By the time of receipt, whatever their stamps; exactly `forget_after` is not too old."""
    rng = np.random.default_rng(69)
    law = make_law(3, rng, forget_after=2.0)
    own, inbox, memory = states(3, rng)
    inbox.received_s[:, 0] = NOW - np.array([2.0, 2.0 + 1e-9, 0.0])
    inbox.stamp_s[:, 0] = NOW - np.array([2.1, 2.1, 60.0])
    told, _ = step(law, NOW, own, inbox, memory)
    assert (told.guards & Guard.LEADER_SILENT != 0).tolist() == [False, True, False]


@each_engine
@each_way
def test_a_neighbour_not_heard_is_left_out_of_the_sum(step, way):
    rng = np.random.default_rng(22)
    law = make_law(3, rng, gains=rng.uniform(0.5, 1.0, (3, 4, 3)))
    own, inbox, memory = states(3, rng)
    without = replace(law, gains=law.gains.copy())
    without.gains[0, 2] = 0.0
    ours = results(step(law, NOW, own, unhear(inbox, np.s_[0, 2], way), memory))
    theirs = results(step(without, NOW, own, inbox, memory))
    assert_same(ours, theirs, rtol=1e-12)
    heard = step(law, NOW, own, inbox, memory)[0]
    assert abs(ours["told.direction"][0] - heard.direction[0]).max() > 1e-3


@each_engine
def test_in_silence_what_was_known_of_the_leader_waits_or_is_dropped(step):
    """Averages stay as they are, differences begin anew: what comes back is the first news."""
    rng = np.random.default_rng(70)
    sources = [leading.BROADCAST, leading.TURN]
    blend = np.tile([0.4, 0.3, 0.2], (2, 1))
    law = make_law(2, rng, acceleration_source=np.array(sources), acceleration_blend=blend)
    own, inbox, memory = states(2, rng)
    _, after = step(law, NOW, own, unhear(inbox, np.s_[:, 0], LONG_AGO), memory)
    assert np.array_equal(after.acceleration, memory.acceleration)
    assert after.speed_rate.tolist() == after.climb_rate.tolist() == [0.0, 0.0]
    _, again = step(law, NOW + 0.04, own, inbox, after)
    assert again.speed_rate.tolist() == again.climb_rate.tolist() == [0.0, 0.0]
    assert np.array_equal(again.stamp_s, inbox.stamp_s[:, 0])


@each_engine
def test_once_it_hears_again_it_flies_as_if_it_had_always_heard(step):
    """But for the average of q̈_g, which lacks what was not heard: with none, to the bit."""
    rng = np.random.default_rng(71)
    options = {**mixed_options(3, rng), "acceleration_blend": np.ones((3, 3))}
    options["acceleration_source"] = np.full(3, leading.BROADCAST)
    law = make_law(3, rng, **options)
    own, inbox, memory = states(3, rng)
    memory = memory._replace(stamp_s=inbox.stamp_s[:, 0] - 0.04)
    deaf, after = step(law, NOW, own, unhear(inbox, np.s_[:, 0], LONG_AGO), memory)
    assert (deaf.guards & Guard.LEADER_SILENT).all()
    again, _ = step(law, NOW, own, inbox, after)
    always, _ = step(law, NOW, own, inbox, memory)
    for name in again._fields:
        ours, theirs = getattr(again, name), getattr(always, name)
        np.testing.assert_array_equal(ours, theirs, err_msg=name)


@each_engine
def test_a_muted_leader_over_the_radio(step):
    """Muted in [1, 3) s, forgotten 0.5 s after its last word at 0.96 s, heard again at 3 s."""
    rng = np.random.default_rng(72)
    n = 2
    law = make_law(n, rng, forget_after=0.5, horizontal=flags(False, n))
    radio = Channel(np.zeros((n, n + 1)), mute=((0, 1.0, 3.0),))
    inboxes, memory, flagged = silent(radio), None, []
    own, _, _ = states(n, rng)
    memory = law.start(own)
    velocity = np.tile([22.0, 0.0, 0.0], (n + 1, 1))
    for k in range(101):
        now = 0.04 * k
        content = Broadcast(np.full(n + 1, now), now * velocity, velocity, *np.zeros((3, n + 1, 3)))
        inboxes = deliver(send(radio, inboxes, content, now), now)
        told, memory = step(law, now, own, inboxes.inbox, memory)
        if (told.guards & Guard.LEADER_SILENT).any():
            assert (told.guards & Guard.LEADER_SILENT).all()
            flagged.append(now)
    # 0.96 + 0.5 = 1.46 s: the next control tick after it is 1.48 s
    assert (flagged[0], flagged[-1]) == pytest.approx((1.48, 2.96), abs=1e-12)
    assert len(flagged) == 38
