"""The kernels of the formation do what the reference says, on thousands of random states."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL
from formation_cases import (
    HIGH,
    LOW,
    PAPERS_MU,
    choose,
    make_law,
    make_middle,
    middle_gains,
    middle_states,
    mixed_options,
    results,
    same,
    some_of,
    states,
    velocities,
)
from reference import adapters
from reference import formation_barrier as barriers
from reference import formation_control_function as functions
from reference import formation_geometry as geometry
from reference import formation_laws as laws
from reference import formation_leader_filter as leading
from reference import formation_message_extrapolation as extrapolation
from reference.adapters import law_records, loop_records, neighbour_records
from reference.formation_geometry import true_slots
from reference.formation_hbh23 import hbh23_step
from reference.formation_message_extrapolation import ages
from reference.formation_middle_loop import middle_step
from reference.frames import velocity_frame

from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.records import AIRCRAFT, FOLLOWER, LINK, allocate, write_fields
from testbed.flight import control
from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.formation.control_step import initial_controllers

FUNCTIONS = [PAPERS_MU, example_1(2.5e5, 1.0, 0.8), EXAMPLE_2, EXAMPLE_3]
BARRIERS = [
    SpeedBarrier(4, 0.02),
    SpeedBarrier(5, 0.05),
    SpeedBarrier(6, 1.0),
    SpeedBarrier(7, 0.0),
]
# times four choices that all agents share: some thousand states of agents
AGENTS, STATES = 16, 50 if ALL else 20
# The two take the same sums in other orders, so they differ by roundings of 1e-16, which (14)
# magnifies by 1/D, and example 5 by 1/(1 − tanh²), some 1e3 at 34 m/s.
TOLERANCE = 1e-11

# the flags of law and middle loop; the others are of the separation filter behind them
OF_LAW = [flag for flag in LimiterFlag if flag <= LimiterFlag.LEADER_TIMEOUT]


def compare(ours, theirs):
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert theirs[name].dtype == array.dtype, name
        assert theirs[name].shape == array.shape, name
        np.testing.assert_array_equal(np.isnan(theirs[name]), np.isnan(array), err_msg=name)
        np.testing.assert_allclose(
            theirs[name], array, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name
        )


def any_of(choices, rng):
    return [choices[i] for i in rng.integers(0, len(choices), AGENTS)]


def test_the_formation_law():
    """Every agent with options of its own; agents of one law differ in all of them."""
    rng = np.random.default_rng(40)
    seen, timed_out, held, dropped, known_messages, messages = 0, 0, 0, 0, 0, 0
    for from_timestamp, of_airspeed in itertools.product([False, True], repeat=2):
        for k in range(STATES):
            law = make_law(
                AGENTS,
                rng,
                mu=any_of(FUNCTIONS, rng),
                barrier=any_of(BARRIERS, rng),
                from_timestamp=from_timestamp,
                bounds_of_airspeed=of_airspeed,
                neighbour_timeout_s=rng.choice([0.2, 5.0]),
                **mixed_options(AGENTS, rng),
            )
            gaps = {"never": 0.1, "old": 0.1} if k % 3 == 0 else {}
            own, inbox, memory = states(AGENTS, rng, **gaps)
            begun = np.where(rng.random(AGENTS) < 0.5, 1.0, np.nan)
            memory = memory._replace(
                timeout_since=begun * rng.uniform(90.0, 99.0, AGENTS),
                timeout_course=begun * rng.uniform(-np.pi, np.pi, AGENTS),
            )
            # bounds of the airspeed lie no farther from it than those of the ground speed do
            own = own._replace(airspeed=np.clip(own.airspeed, LOW - 4.0, HIGH + 4.0))
            ours = results(hbh23_step(law, 100.0, own, inbox, memory))
            compare(ours, results(adapters.hbh23_step(law, 100.0, own, inbox, memory)))
            seen |= int(np.bitwise_or.reduce(ours["inputs.limiter_flags"]))
            lost = (ours["inputs.limiter_flags"] & LimiterFlag.LEADER_TIMEOUT) != 0
            stale = ~(100.0 - inbox.received_s <= law.neighbour_timeout_s) & ~lost[:, None]
            known = law.hold_stale_neighbours & ~np.isnan(memory.held_position[:, :, 0])
            heeded = (law.gains != 0.0).any(axis=2)[:, 1:]
            timed_out += int(lost.sum())
            held += int((heeded & (stale & known)[:, 1:]).sum())
            dropped += int((heeded & (stale & ~known)[:, 1:]).sum())
            placed = ours["memory.held_time_s"] > memory.held_time_s
            fresh = heeded & (law.hold_stale_neighbours & known & ~stale & ~lost[:, None])[:, 1:]
            messages += int((fresh & placed[:, 1:]).sum())
            known_messages += int((fresh & ~placed[:, 1:]).sum())
    # the states reach every branch
    assert seen == sum(OF_LAW) - LimiterFlag.SPEED_COMMAND_CLIPPED
    assert min(timed_out, held, dropped, messages, known_messages) > 2 * STATES


def test_a_law_of_some_of_the_agents():
    """Agents that step apart from the others know the same, and more aircraft than they are."""
    rng = np.random.default_rng(43)
    for _ in range(25):
        law = make_law(AGENTS, rng, **mixed_options(AGENTS, rng))
        own, inbox, memory = states(AGENTS, rng, never=0.1, old=0.1)
        rows = rng.permutation(AGENTS)[:6]
        part = some_of(law, rows)
        args = (part, 100.0, *(choose(each, rows) for each in (own, inbox, memory)))
        compare(results(hbh23_step(*args)), results(adapters.hbh23_step(*args)))


def test_the_law_over_many_steps_of_its_own_memory():
    """The memories of both engines are equal after each message."""
    rng = np.random.default_rng(44)
    law = make_law(AGENTS, rng, **{**mixed_options(AGENTS, rng), "hold_stale_neighbours": True})
    own, _, _ = states(AGENTS, rng)
    ours = theirs = law.start(own)
    for k in range(2 * STATES):
        now = 100.0 + 0.04 * k
        own, inbox, _ = states(AGENTS, rng, never=0.02, old=0.05, now=now)
        inputs, ours = hbh23_step(law, now, own, inbox, ours)
        kernel_inputs, theirs = adapters.hbh23_step(law, now, own, inbox, theirs)
        compare(results((inputs, ours)), results((kernel_inputs, theirs)))


def test_the_middle_loop():
    """Agents that hold an altitude beside agents that do not, with every gain there is."""
    rng = np.random.default_rng(45)
    seen = {"limiter_flags": 0, "saturations": 0}
    extras = ("altitude_p", "altitude_i", "altitude_d", "turn_incidence", "roll_lead", "eta_climb")
    for as_printed in (False, True):
        for _ in range(2 * STATES):
            more = {name: rng.uniform(0.0, 0.1, AGENTS) for name in extras}
            gains = middle_gains(
                AGENTS,
                **more,
                incidence=rng.integers(0, 2, AGENTS),
                lead_filter=rng.uniform(0.0, 0.2, AGENTS),
                rate_filter=rng.choice([0.0, 0.06], AGENTS),
            )
            holds = np.where(rng.random(AGENTS) < 0.4, rng.normal(0.0, 10.0, AGENTS), np.nan)
            loop = replace(make_middle(AGENTS, altitude=holds, as_printed=as_printed), gains=gains)
            args = (loop, *middle_states(AGENTS, rng))
            ours = results(middle_step(*args))
            compare(ours, results(adapters.middle_step(*args)))
            for kind in seen:
                seen[kind] |= int(np.bitwise_or.reduce(ours[f"diagnosis.{kind}"]))
    assert seen == {"limiter_flags": sum(OF_LAW), "saturations": sum(Saturation)}


def test_step_of_some_agents_equals_step_of_all():
    """Law, middle loop and ages in the kernel of flights, in rows of records of more agents."""
    rng = np.random.default_rng(47)
    law = make_law(AGENTS, rng, **{**mixed_options(AGENTS, rng), "hold_stale_neighbours": True})
    loop = make_middle(AGENTS, altitude=np.where(rng.random(AGENTS) < 0.4, 90.0, np.nan))
    aircraft = law.gains.shape[1]
    for hold in (False, True):
        rows = rng.permutation(AGENTS)[:3]
        law = replace(law, hold_stale_neighbours=hold)
        mine, middle = some_of(law, rows), choose(loop, rows)
        excluded = rng.random((3, aircraft)) < 0.2
        excluded[:, 0] = rng.random(3) < 0.3
        memory, integrals = mine.start(None), middle.start()
        neighbours = neighbour_records(law, law.start(None))
        flags = [False] * AGENTS
        controllers = initial_controllers(law_records(law), loop_records(loop), flags)
        neighbours["excluded"][rows], neighbours["used"] = excluded, True
        followers, links = allocate(FOLLOWER, AGENTS), allocate(LINK, AGENTS, aircraft)
        own_records = allocate(AIRCRAFT, AGENTS + 1)
        commands = own_records["control"][1:]
        known = controllers, neighbours, own_records, own_records, followers, links
        limit = np.full(aircraft, mine.neighbour_timeout_s)
        limit[0] = mine.leader_timeout_s
        used = 0
        for k in range(STATES):
            now = 100.0 + 0.04 * k
            own, inbox, _ = states(AGENTS, rng, never=0.05, old=0.05, now=now)
            write_fields(own_records["estimate"][1:], own)
            write_fields(links, inbox)
            links["measured_s"] = inbox.stamp_s
            control._step(rows, *known, now)

            own, inbox = choose(own, rows), choose(inbox, rows)
            # an excluded aircraft is treated as timed out
            for each in inbox:
                each[excluded] = np.nan
            inputs, memory = hbh23_step(mine, now, own, inbox, memory)
            command, integrals, diagnosis = middle_step(middle, own, inputs, integrals)
            age_s = ages(now, inbox.stamp_s, inbox.received_s, excluded, limit, True)
            ours = {
                **{f"command.{name}": array for name, array in command._asdict().items()},
                **{f"out.{name}": array for name, array in diagnosis._asdict().items()},
                "out.speed_command": inputs.speed,
                "out.omega": inputs.omega,
                "out.direction": inputs.direction,
                "link.age_s": age_s,
            }
            records = {"command": commands, "out": followers, "link": links}
            theirs = {}
            for path in ours:
                kind, name = path.split(".")
                theirs[path] = np.array(records[kind][name][rows])
            compare(ours, theirs)
            used += np.isfinite(age_s).sum()
        others = [i for i in range(AGENTS) if i not in rows]
        assert not commands["pitch"][others].any()
        assert commands["roll"][rows].all()
        assert 0 < used < STATES * age_s.size


def test_ages():
    rng = np.random.default_rng(44)
    stamp = 100.0 - rng.uniform(0.0, 8.0, (40, 5))
    received = stamp + rng.uniform(0.0, 1.0, stamp.shape)
    received[rng.random(stamp.shape) < 0.2] = np.nan
    unused = rng.random(stamp.shape) < 0.3
    for limit, led in ((4.0, True), (np.array([4.0, 2.0, 2.0, np.inf, np.inf]), False)):
        args = (100.0, stamp, received, unused, limit, led)
        ours = ages(*args)
        assert 0 < np.isnan(ours).sum() < ours.size
        np.testing.assert_array_equal(adapters.ages(*args), ours)
    # a held neighbour does not time out, if any of its messages was received
    assert np.array_equal(np.isnan(ours)[:, 3:], (unused | np.isnan(received))[:, 3:])


def test_true_slots_and_errors():
    rng = np.random.default_rng(41)
    for n in (1, 3, 40):
        position, offsets = rng.normal(0.0, 300.0, (2, n + 1, 3))
        velocity = velocities(rng, (n + 1,), 10.0, 35.0)
        altitudes = np.where(rng.random(n) < 0.5, rng.normal(100.0, 10.0, n), np.nan)
        ours = true_slots(position, velocity, offsets, altitudes)
        theirs = adapters.true_slots(position, velocity, offsets, altitudes)
        for one, two in zip(ours, theirs, strict=True):
            assert two == pytest.approx(one, abs=1e-12)  # roundings of some 1e3 m


# equation by equation


def close(ours, theirs, **tolerance):
    tolerance = {"rtol": TOLERANCE, "atol": TOLERANCE, **tolerance}
    for one, two in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(two, one, **tolerance)


def many(choices, rng, n):
    return [choices[i] for i in rng.integers(0, len(choices), n)]


def test_barriers_and_control_functions():
    rng = np.random.default_rng(50)
    n = 4000
    barrier, function = (
        barriers.per_agent(many(BARRIERS, rng, n)),
        functions.per_agent(many(FUNCTIONS, rng, n)),
    )
    s = rng.uniform(LOW - 4.0, HIGH + 4.0, n)
    close(barriers.h(barrier, s, same(LOW, n), same(HIGH, n)), adapters.h(barrier, s, LOW, HIGH))
    x, x_rate = rng.normal(0.0, 1.0, (2, n, 3)) * rng.choice([0.1, 0.5, 1.0, 30.0], (n, 1))
    close(functions.mu(function, laws.dot(x, x)), adapters.mu(function, laws.dot(x, x)))
    close(functions.rho_and_rate(function, x, x_rate), adapters.rho_and_rate(function, x, x_rate))


def test_the_velocity_frame_and_the_motion_of_slots():
    rng = np.random.default_rng(51)
    n = 2000
    velocity = velocities(rng, (n,), 0.1, 40.0)
    frame = velocity_frame(velocity)
    close([frame], [adapters.velocity_frame(velocity)])
    gamma = rng.uniform(-1.4, 1.4, n)
    rates = rng.normal(0.0, 0.4, (3, n))
    close([geometry.frame_rate(gamma, *rates[:2])], [adapters.frame_rate(gamma, *rates[:2])])
    close(
        [geometry.frame_acceleration(gamma, *rates)], [adapters.frame_acceleration(gamma, *rates)]
    )
    turning, bending = rng.normal(0.0, 0.4, (2, n, 3))
    for offsets in (rng.uniform(-50.0, 50.0, (4, 3)), rng.uniform(-50.0, 50.0, (n, 4, 3))):
        args = frame, turning, bending, offsets
        close(geometry.slots(*args), adapters.slot_motions(*args))
    acceleration = rng.normal(0.0, 5.0, (n, 3))
    close(
        geometry.velocity_rates(velocity, acceleration),
        adapters.velocity_rates(velocity, acceleration),
        rtol=1e-10,
    )


def test_the_equations_of_the_law():
    """(6) and its rate, (7)-(13), (14) and (15), each by itself."""
    rng = np.random.default_rng(52)
    n = 3000
    speeds = laws.SpeedSet(same(LOW, n), same(HIGH, n), same(LOW + 0.6, n), same(HIGH - 0.6, n))
    own, slot = rng.normal(0.0, 30.0, (2, n, 3))
    others, other_slots, gains = rng.normal(0.0, 30.0, (3, n, 4, 3))
    gains *= rng.random((n, 4, 1)) < 0.8
    other_slots[:, 0] = 0.0
    args = own, slot, others, other_slots, gains
    close([laws.formation_error(*args)], [adapters.formation_error(*args)], atol=1e-9)
    function = functions.per_agent(many(FUNCTIONS, rng, n))
    vectors = [velocities(rng, (n,), 16.0, 30.0), *rng.normal(0.0, 3.0, (5, n, 3))]
    args = *vectors, rng.uniform(2.0, 3.0, n), function, speeds
    desired, theirs = laws.desired_velocity(*args), adapters.desired_velocity(*args)
    assert np.array_equal(desired.clamped, theirs.clamped)
    assert 0 < desired.clamped.sum() < n
    close(desired[:4], theirs[:4])
    barrier = barriers.per_agent(many(BARRIERS, rng, n))
    s = rng.uniform(LOW - 4.0, HIGH + 4.0, n)
    args = s, desired, *rng.uniform(0.1, 1.5, (2, n)), rng.uniform(0.4, 0.7, n), barrier, speeds
    (u, inside), (theirs, also) = laws.speed_control(*args), adapters.speed_control(*args)
    assert np.array_equal(inside, also)
    close([u], [theirs], rtol=1e-9)
    args = velocities(rng, (n,), 15.0, 31.0), desired, rng.uniform(0.05, 1.0, n)
    close(laws.turn_control(*args), adapters.turn_control(*args))


def test_messages_and_the_acceleration_of_the_leader():
    rng = np.random.default_rng(53)
    n = 300 if ALL else 50  # of as many messages each
    own, inbox, memory = states(n, rng)
    for from_timestamp in (False, True):
        args = inbox, 100.0, from_timestamp, rng.random(n) < 0.5
        close(extrapolation.corrected(*args), adapters.corrected(*args))
    velocity, time_s = np.ascontiguousarray(inbox.velocity_ned[:, 0]), inbox.received_s[:, 0]
    args = memory, time_s, velocity, rng.uniform(0.0, 1.0, (n, 2))
    close(leading.differentiate(*args), adapters.differentiate(*args))
    speed, gamma, *rates = leading.differentiate(*args)
    euler = rng.uniform(-0.8, 0.8, (n, 3))
    args = velocity_frame(velocity), speed, gamma, *rates, euler
    close([leading.turn_acceleration(*args)], [adapters.turn_acceleration(*args)])
