"""Simulation 3's graph with ideal vehicles in a climbing turn, and a neighbour whose messages stop.

uav2 and uav3 are ideal vehicles under the paper's law at 25 Hz. uav1 is moved as a slot of the
leader's helix, 4 m to the right of its own, so that it pulls uav2 out of its slot and flights that
use its messages differ from flights that do not.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import in_full
from closed_loop import Leader
from reference.adapters import advance_ticks, frame_rate, report
from reference.adapters import slot_motions as slots
from reference.frames import velocity_frame
from reference.unicycle import unicycle

from testbed.core.records import Messages, VehicleState
from testbed.formation import leader_filter as leading
from testbed.formation.control_step import Hbh23Law
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.scenario import load_scenario

HZ, TICKS = 25, 8
MUTE = (20.0, 50.0)  # s; six radians of the turn
LIMIT = 0.5  # s, for which a message of a neighbour is extrapolated, unless a test says more
END = 80.0
LEADER = Leader(*(np.array(each) for each in ([[0.0, 0.0, -100.0]], [22.0], [0.06], [0.4], [0.2])))
RATE = frame_rate(LEADER.climb, LEADER.course_rate, np.zeros(1))
ASIDE = np.array([0.0, 4.0, 0.0])


@cache
def leader(t):
    """Its motion and its frame; flights share their times."""
    motion = LEADER.motion(t)
    return motion, velocity_frame(motion[1])


def helix(t, offsets):
    """Positions and velocities (K, 3) of what keeps offsets in the leader's frame; and q̈_g."""
    (position, velocity, acceleration), frame = leader(t)
    chi, chi_rate, _ = slots(frame, RATE, np.zeros((1, 3)), offsets)
    return position + chi[0], velocity + chi_rate[0], acceleration[0]


def make_law(then, limit=LIMIT):
    """Simulation 3's, with q̈_g as it is: how it is averaged is not the question."""
    timeout = [f"controller.neighbour_timeout_s={limit}", f"controller.on_neighbour_timeout={then}"]
    scenario = load_scenario("simulation-3", timeout)
    clock = SimpleNamespace(control=TICKS, base_rate_hz=HZ * TICKS, groups=((0, 1, 2),))
    control = build_control(resolve(scenario), scenario.controller, clock)
    law = control.controllers["law"].copy()
    law["acceleration_source"], law["acceleration_blend"] = leading.BROADCAST, 1.0
    return Hbh23Law(law, control.neighbours)


def rows(begin, end):
    return slice(round(begin * HZ), round(end * HZ))


def simulate(law, mute=MUTE, then_gain=None, until=END):
    """Errors of uav2 and uav3 from their slots in the leader's frame (K, 2, 3), and K memories.

    Once uav1 is stale, uav2 flies with this gain for it, if there is one.
    """
    offsets = law.neighbours["offset"][0].copy()
    offsets[1] += ASIDE
    vehicles = unicycle(*(each[2:] for each in helix(0.0, offsets)[:2]))
    speed, turn, pole = vehicles.speed, np.zeros((2, 3)), law.law["speed_pole"][1:]
    memories, sent_s, errors, inbox = [], 0.0, [], None
    for tick in range(round(until * HZ)):
        now = tick / HZ
        slots_now, moved, acceleration_now = helix(now, offsets)
        seen = report(vehicles, speed, turn, pole, np.zeros((2, 3)))
        errors.append((seen.position_ned - slots_now[2:]) @ leader(now)[1][0])
        position = np.vstack([slots_now[:2], seen.position_ned])
        velocity = np.vstack([moved[:2], seen.velocity_ned])
        own = np.stack([position[1:], velocity[1:]])
        airspeed = np.linalg.norm(velocity[1:], axis=1)
        own = VehicleState(*own, *np.zeros((3, 3, 3)), airspeed, airspeed)
        if not mute[0] <= now < mute[1]:
            sent_s = now
        when = np.full((3, 4), now)
        when[1:, 1] = sent_s
        rates = np.tile([0.0, 0.0, LEADER.course_rate[0]], (3, 4, 1))
        messages = [np.tile(each, (3, 1, 1)) for each in (position, velocity)]
        if sent_s != now:
            for each, old in zip(messages, inbox[2:4], strict=True):
                each[1:, 1] = old[1:, 1]
        acceleration = np.zeros((3, 4, 3))
        acceleration[:, 0] = acceleration_now
        inbox = Messages(when, when, *messages, acceleration, np.zeros((3, 4, 3)), rates)
        memory = memories[-1] if memories else law.start(own)
        if then_gain is not None and now - sent_s > LIMIT:
            law.neighbours["gain"][1, 1] = then_gain
        inputs, memory = law.step(now, own, inbox, memory)
        memories.append(memory)
        speed, turn = inputs.speed[1:].copy(), inputs.omega[1:].copy()
        vehicles = advance_ticks(vehicles, speed, turn, pole, 1.0 / (HZ * TICKS), TICKS)
    return np.array(errors), memories


@pytest.fixture(scope="module")
def received():
    """Errors with all messages of uav1: uav2 is pulled aside, and uav3 by uav2."""
    errors, _ = simulate(make_law("drop"), mute=(END, END))
    assert errors[rows(*MUTE), 0, 1].min() > 1.5
    assert errors[rows(*MUTE), 1, 1].min() > 0.7
    return errors


@pytest.mark.parametrize("limit", [LIMIT, pytest.param(5.0, marks=in_full)])
def test_timed_out_neighbour_is_held_at_its_position(received, limit):
    """It is held where it was at its last message, however far a line has led from there since.

    Until the limit that line leaves the turn, by δ at the end. uav2 and uav3 are never off by as
    much; and once uav1 is held, in its place as with its messages, what they are off decays by the
    turn gain c = 0.1 per second at the slowest, in six radians of turn and after the outage.
    """
    law = make_law("hold-relative-position", limit)
    held, memories = simulate(law)
    memory = memories[round((MUTE[0] + limit + 1.0) * HZ) - 1]
    # the last message was one period before the outage
    last, offset = MUTE[0] - 1.0 / HZ, np.array([-5.0, 5.0, 0.0]) + ASIDE
    assert memory.held_position[1, 1] == pytest.approx(offset, abs=1e-9)
    assert memory.held_time_s[1, 1] == last
    (position,), (velocity,), _ = helix(last, offset[None])
    (after,), _, _ = helix(last + limit, offset[None])
    delta = np.linalg.norm(position + limit * velocity - after)
    # ½ v σ̇ times the square of the limit, less a fortieth when that is a radian of the turn
    level = np.hypot(*velocity[:2])
    assert delta == pytest.approx(0.5 * level * 0.2 * limit**2, rel=0.03)
    off = np.linalg.norm(held - received, axis=2)
    assert off[rows(0.0, MUTE[0])].max() == 0.0
    assert 0.1 * delta < off[rows(*MUTE), 0].max()
    since = np.arange(len(off)) / HZ - (last + limit)
    assert (off < delta * np.exp(-0.1 * np.maximum(since, 0.0))[:, None]).all()


def test_timed_out_neighbour_is_excluded(received):
    """To the bit: while it is stale uav2 flies as if it had no gain for uav1, back to its slot."""
    law = make_law("drop")
    dropped, _ = simulate(law, until=MUTE[1])
    leader_alone, _ = simulate(law, then_gain=0.0, until=MUTE[1])
    np.testing.assert_array_equal(dropped, leader_alone)
    assert np.linalg.norm(dropped[-1, 0]) < 0.3 < np.linalg.norm(received[len(dropped), 0])
