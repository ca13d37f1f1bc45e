"""The kernels of the product behind the signatures of the reference: arrays in, arrays out.

Each function packs its arrays into records, calls the kernel for each agent and unpacks what it
wrote, for tests with arrays of agents and for comparisons with the reference.
"""

from __future__ import annotations

from dataclasses import fields
from math import inf, nan

import numpy as np

from reference import fbwa_tables
from reference import formation_laws as laws
from reference.formation_hbh23 import Hbh23Law
from reference.formation_laws import Desired
from reference.formation_leader_filter import Memory
from reference.formation_middle_loop import (
    ControlDiagnostics,
    MiddleLoop,
    MiddleLoopGains,
    MiddleLoopMemory,
)
from reference.unicycle import Unicycle
from testbed.autopilot import fbwa as product_fbwa
from testbed.core import velocity_frame as frames
from testbed.core.compile import entry, kernel
from testbed.core.records import (
    AIRCRAFT,
    COMMAND,
    FOLLOWER,
    LINK,
    MOTION,
    ActuatorCommand,
    FbwaCommand,
    Records,
    UnicycleCommand,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)
from testbed.core.velocity_frame import velocity_frame
from testbed.formation import control_function, hbh23, leader_filter, middle_loop, slots
from testbed.formation.barrier import BARRIER
from testbed.formation.barrier import h as h_kernel
from testbed.formation.control_step import Hbh23Law as KernelLaw
from testbed.formation.control_step import Hbh23Memory, make_neighbours
from testbed.formation.hbh23 import LAW, NEIGHBOUR
from testbed.formation.message_extrapolation import extrapolate, message_ages
from testbed.formation.middle_loop import LOOP
from testbed.vehicle import unicycle as unicycles

_RENAMED = {"row": "agents"}  # fields of LAW that the reference calls otherwise


def _dense(array, *shape):
    """Broadcast to a contiguous array of floats of its own."""
    out = np.empty(shape)
    out[...] = array
    return out


# whole steps


def law_records(law: Hbh23Law) -> Records:
    """Pack the gains and options of n agents into (n,) of LAW."""
    records = allocate(LAW, len(law.k))
    _write_tuples(records, law.control_function, law.barrier, law.speeds)
    own = {each.name for each in fields(law)}
    for name in LAW.names:
        source = _RENAMED.get(name, name)
        if source in own and name not in ("mu", "barrier"):
            records[name] = getattr(law, source)
    return records


def _write_tuples(records, mu=None, barrier=None, speeds=None):
    for name, value in mu._asdict().items() if mu is not None else ():
        records["mu"][name] = value
    for name, value in barrier._asdict().items() if barrier is not None else ():
        records["barrier"][name] = value
    for name, value in speeds._asdict().items() if speeds is not None else ():
        records[_SPEEDS[name]] = value


_SPEEDS = {
    "min": "speed_min",
    "max": "speed_max",
    "desired_min": "speed_desired_min",
    "desired_max": "speed_desired_max",
}


def memory_records(memory: Memory) -> Records:
    """Pack what n agents keep of their leader into (n,) of leader_filter.MEMORY."""
    records = allocate(leader_filter.MEMORY, len(memory.speed))
    for name in leader_filter.MEMORY.names:
        records[name] = getattr(memory, name)
    return records


def neighbour_records(law: Hbh23Law, memory: Memory) -> Records:
    """Pack what n agents know of N aircraft into (n, N) of NEIGHBOUR."""
    gains = law.gains
    records = make_neighbours(
        np.zeros(gains.shape[1:]), gains, law.leader_timeout_s, law.neighbour_timeout_s
    )
    records["offset"] = law.offsets
    records["held_position"], records["held_time_s"] = memory.held_position, memory.held_time_s
    return records


def hbh23_step(law, now, own, inbox, memory):
    """As `formation_hbh23.hbh23_step`."""
    neighbours = neighbour_records(law, memory)
    kernel_law = KernelLaw(law_records(law), neighbours)
    last = Hbh23Memory(memory_records(memory), memory.held_position, memory.held_time_s)
    inputs, after = kernel_law.step(now, own, inbox, last)
    kept = {name: np.array(after.leader[name]) for name in leader_filter.MEMORY.names}
    return (
        UnicycleCommand(*(np.array(each) for each in inputs)),
        Memory(
            **kept,
            held_position=after.held_position,
            held_time_s=after.held_time_s,
        ),
    )


def loop_records(loop: MiddleLoop) -> Records:
    """Pack the gains and options of n middle loops into (n,) of LOOP."""
    records = allocate(LOOP, len(loop.altitude))
    for name in LOOP.names:
        source = loop.gains if name in MiddleLoopGains._fields else loop
        records[name] = getattr(source, name)
    return records


def middle_step(loop, own, inputs, memory):
    """As `formation_middle_loop.middle_step`."""
    n = len(loop.altitude)
    estimate, followers = allocate(MOTION, n), allocate(FOLLOWER, n)
    memories, commands = allocate(middle_loop.MEMORY, n), allocate(COMMAND, n)
    write_fields(estimate, own)
    write_fields(followers, inputs, speed="speed_command")
    write_fields(memories, memory)
    _middle_loops(loop_records(loop), estimate, memories, followers, commands)
    return tuple(
        type(each)(*(np.array(array) for array in each))
        for each in (
            fields_of(FbwaCommand, commands),
            fields_of(MiddleLoopMemory, memories),
            fields_of(ControlDiagnostics, followers),
        )
    )


@entry
def _middle_loops(loops, estimate, memories, followers, commands):
    for i in range(len(loops)):
        middle_loop.middle_loop(loops[i], estimate[i], memories[i], followers[i], commands[i])


def ages(now, stamp_s, received_s, excluded, limit, needs_leader):
    """As `formation_message_extrapolation.ages`."""
    links, neighbours = allocate(LINK, *stamp_s.shape), allocate(NEIGHBOUR, *stamp_s.shape)
    links["measured_s"], links["received_s"] = stamp_s, received_s
    neighbours["used"] = True
    neighbours["excluded"] = excluded
    neighbours["timeout_s"] = limit
    _ages(now, neighbours, needs_leader, links)
    return np.array(links["age_s"])


@entry
def _ages(now, neighbours, needs_leader, links):
    for i in range(len(links)):
        message_ages(now, neighbours[i], needs_leader, links[i])


# barrier and control function


def h(barrier, s, s_min, s_max):
    """As `formation_barrier.h`."""
    s = np.asarray(s, dtype=float)
    records, out = allocate(BARRIER, s.size), np.empty((2, s.size))
    records["example"], records["nu"] = barrier
    _h(records, s.ravel(), _dense(s_min, s.size), _dense(s_max, s.size), out)
    return out[0].reshape(s.shape), out[1].reshape(s.shape)


@entry
def _h(barriers, s, s_min, s_max, out):
    for i in range(len(s)):
        out[0, i], out[1, i] = h_kernel(barriers[i], s[i], s_min[i], s_max[i])


def mu(function, z):
    """As `formation_control_function.mu`; z (..., n)."""
    z = np.asarray(z, dtype=float)
    count = np.broadcast(*function).size  # records of a table each are large
    records, out = allocate(control_function.MU, count), np.empty((2, z.size))
    for name, value in function._asdict().items():
        records[name] = value
    _mu(records, z.ravel(), out)
    return out[0].reshape(z.shape), out[1].reshape(z.shape)


@entry
def _mu(functions, z, out):
    for i in range(len(z)):
        out[0, i], out[1, i] = control_function.mu(functions[i % len(functions)], z[i])


def rho_and_rate(function, x, x_rate):
    """As `formation_control_function.rho_and_rate`, with μ and μ' of the kernel."""
    value, slope = mu(function, laws.dot(x, x))
    along = 2.0 * slope * laws.dot(x, x_rate)
    return laws.scale(value, x), laws.scale(value, x_rate) + laws.scale(along, x)


# the velocity frame and the slots


def from_ned(velocity, vectors):
    """Resolve vectors (n, 3) of NED in the velocity frames of velocities (n, 3)."""
    pairs = zip(velocity, vectors, strict=True)
    return np.array([frames.from_ned(frames.frame_angles(*v), *each) for v, each in pairs])


def frame_rate(gamma, chi_dot, gamma_dot):
    """As `formation_geometry.frame_rate`."""
    n = len(chi_dot)
    out = np.empty((n, 3))
    _frame_rates(_dense(gamma, n), _dense(chi_dot, n), _dense(gamma_dot, n), out)
    return out


@entry
def _frame_rates(gamma, chi_dot, gamma_dot, out):
    for i in range(len(out)):
        a, b, c = frames.frame_angular_velocity(gamma[i], chi_dot[i], gamma_dot[i])
        out[i, 0], out[i, 1], out[i, 2] = a, b, c


def frame_acceleration(gamma, chi_dot, gamma_dot, chi_ddot):
    """As `formation_geometry.frame_acceleration`."""
    agents = np.broadcast(gamma, chi_dot, gamma_dot, chi_ddot)
    return np.array([frames.frame_angular_acceleration(*each) for each in agents])


def slot_motions(frame, rate, acceleration, offsets):
    """As `formation_geometry.slots`."""
    n = len(frame)
    upsilon = _dense(offsets, n, *np.shape(offsets)[-2:])
    out = np.empty((3, *upsilon.shape))
    _slot_motions(
        _angles(frame), np.ascontiguousarray(rate), np.ascontiguousarray(acceleration), upsilon, out
    )
    return tuple(out)


def _angles(frame):
    """Return cos σ, sin σ, cos γ, sin γ (n, 4) of matrices R (n, 3, 3), (24)."""
    return np.stack([frame[:, 1, 1], -frame[:, 0, 1], frame[:, 2, 2], -frame[:, 2, 0]], axis=1)


@entry
def _slot_motions(angles, rate, acceleration, upsilon, out):
    for i in range(upsilon.shape[0]):
        frame = (angles[i, 0], angles[i, 1], angles[i, 2], angles[i, 3])
        for m in range(upsilon.shape[1]):
            u = (upsilon[i, m, 0], upsilon[i, m, 1], upsilon[i, m, 2])
            chi = hbh23.slot_motion(frame, rate[i], acceleration[i], u)
            for axis in range(3):
                out[0, i, m, axis] = chi[0][axis]
                out[1, i, m, axis] = chi[1][axis]
                out[2, i, m, axis] = chi[2][axis]


def velocity_rates(velocity, acceleration):
    """As `formation_geometry.velocity_rates`."""
    agents = zip(velocity, acceleration, strict=True)
    return tuple(np.array([frames.velocity_rates(*each) for each in agents]).T)


def true_slots(position, velocity, offsets, altitudes):
    """As `formation_geometry.true_slots`."""
    aircraft, followers = allocate(AIRCRAFT, len(position)), allocate(FOLLOWER, len(altitudes))
    for motion in ("truth", "estimate"):
        aircraft[motion]["position_ned"], aircraft[motion]["velocity_ned"] = position, velocity
    _slots(
        aircraft, followers, _dense(offsets, *np.shape(offsets)), _dense(altitudes, len(altitudes))
    )
    np.testing.assert_array_equal(followers["estimated_error_ned"], followers["error_ned"])
    motion = [followers[name] for name in ("speed", "course", "flight_path_angle")]
    return np.array(followers["slot_ned"]), np.array(followers["error_ned"]), np.array(motion)


@entry
def _slots(aircraft, followers, offsets, altitudes):
    slots.write_formation_state(aircraft, followers, offsets, altitudes)


# messages and the leader's acceleration


def corrected(inbox, now, from_timestamp, with_acceleration):
    """As `formation_message_extrapolation.corrected`."""
    links, law = allocate(LINK, *inbox.stamp_s.shape), allocate(LAW, len(inbox.stamp_s))
    write_fields(links, inbox)
    law["from_timestamp"], law["with_acceleration"] = from_timestamp, with_acceleration
    found = [
        [extrapolate(one, link, float(now)) for link in row]
        for one, row in zip(law, links, strict=True)
    ]
    return tuple(np.moveaxis(found, 2, 0))


def differentiate(memory, time_s, velocity, blend):
    """As `formation_leader_filter.differentiate`."""
    law, links = allocate(LAW, len(velocity)), allocate(LINK, len(velocity))
    law["difference_blend"] = blend
    links["velocity_ned"] = velocity
    records = memory_records(memory)
    _estimate(law, links, records, np.array(time_s), _angles(velocity_frame(velocity)))
    return tuple(np.array(records[name]) for name in ("speed", "gamma", "speed_rate", "gamma_dot"))


def turn_acceleration(frame, speed, gamma, speed_rate, gamma_dot, euler):
    """As `formation_leader_filter.turn_acceleration`; γ is that of the frame."""
    n = len(speed)
    law, links = allocate(LAW, n), allocate(LINK, n)
    law["acceleration_source"] = leader_filter.TURN
    links["velocity_ned"], links["euler"] = laws.scale(speed, frame[:, :, 0]), euler
    records = allocate(leader_filter.MEMORY, n)
    records["time_s"], records["speed_rate"], records["gamma_dot"] = nan, speed_rate, gamma_dot
    _estimate(law, links, records, np.zeros(n), _angles(frame))
    np.testing.assert_allclose(records["gamma"], gamma, atol=1e-9)
    return np.array(records["acceleration"])


@entry
def _estimate(law, links, memory, time_s, angles):
    for i in range(len(law)):
        frame = (angles[i, 0], angles[i, 1], angles[i, 2], angles[i, 3])
        leader_filter.estimate_leader_acceleration(law[i], links[i], memory[i], time_s[i], frame)


# the law's equations one by one


def formation_error(own, own_slot, others, other_slots, gains):
    """As `formation_laws.formation_error`: slots as offsets in a frame that points north."""
    shape = gains.shape[:2]
    neighbours, links, law = allocate(NEIGHBOUR, *shape), allocate(LINK, *shape), allocate(LAW, 1)
    neighbours["gain"], neighbours["offset"] = gains, other_slots
    links["position_ned"] = others
    law["neighbour_timeout_s"] = inf
    out = np.empty((len(own), 3))
    _errors(law, _dense(own, *own.shape), _dense(own_slot, *own.shape), links, neighbours, out)
    return out


@entry
def _errors(law, own, own_slot, links, neighbours, out):
    zero, frame = (0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0)
    for i in range(len(own)):
        q = links[i, 0].position_ned
        leader = ((q[0], q[1], q[2]), zero)
        slot = ((own_slot[i, 0], own_slot[i, 1], own_slot[i, 2]), zero, zero)
        xi, _ = hbh23.formation_error(
            law[0], 0.0, own[i], zero, leader, slot, frame, zero, links[i], neighbours[i]
        )
        out[i, 0], out[i, 1], out[i, 2] = xi


def desired_velocity(v_g, a_g, chi_rate, chi_acceleration, xi, xi_rate, k, function, speeds):
    """As `formation_laws.desired_velocity`; S_d is applied here, as `hbh23` does."""
    n = len(k)
    law, out = allocate(LAW, n), np.empty((n, 8))
    law["k"] = k
    _write_tuples(law, function)
    vectors = np.stack([v_g, a_g, chi_rate, chi_acceleration, xi, xi_rate], axis=1)
    _desired(law, vectors, out)
    limited = np.clip(out[:, 0], speeds.desired_min, speeds.desired_max)
    clamped = limited != out[:, 0]
    return Desired(
        limited,
        np.where(clamped, 0.0, out[:, 1]),
        out[:, 2:5].copy(),
        out[:, 5:].copy(),
        clamped,
    )


@entry
def _desired(law, vectors, out):
    for i in range(len(law)):
        v = vectors[i]
        s_d, s_d_rate, y_d, y_d_rate = hbh23.desired_velocity(
            law[i],
            (v[0, 0], v[0, 1], v[0, 2]),
            (v[1, 0], v[1, 1], v[1, 2]),
            (v[2, 0], v[2, 1], v[2, 2]),
            (v[3, 0], v[3, 1], v[3, 2]),
            (v[4, 0], v[4, 1], v[4, 2]),
            (v[5, 0], v[5, 1], v[5, 2]),
        )
        out[i, 0], out[i, 1] = s_d, s_d_rate
        out[i, 2], out[i, 3], out[i, 4] = y_d
        out[i, 5], out[i, 6], out[i, 7] = y_d_rate


def speed_control(speed, desired, a, b, pole, barrier, speeds):
    """As `formation_laws.speed_control`."""
    law, out = allocate(LAW, len(speed)), np.empty(len(speed))
    law["a"], law["b"], law["speed_pole"] = a, b, pole
    _write_tuples(law, None, barrier, speeds)
    n = len(speed)
    _speed_controls(
        law, _dense(speed, n), _dense(desired.speed, n), _dense(desired.speed_rate, n), out
    )
    return out, (speed > speeds.min) & (speed < speeds.max)


@entry
def _speed_controls(law, s, s_d, s_d_rate, out):
    for i in range(len(law)):
        one = law[i]
        out[i] = hbh23.speed_control(one, s[i], s_d[i], s_d_rate[i], one.speed_min, one.speed_max)


def turn_control(velocity, desired, c):
    """As `formation_laws.turn_control`."""
    n = len(velocity)
    out = np.empty((2, n))
    vectors = (_dense(each, n, 3) for each in (velocity, desired.direction, desired.direction_rate))
    _turn_controls(*vectors, _dense(c, n), out)
    return out[0], out[1]


@entry
def _turn_controls(velocity, direction, direction_rate, c, out):
    for i in range(len(c)):
        out[0, i], out[1, i] = hbh23.turn_control(
            velocity[i], direction[i], direction_rate[i], c[i]
        )


# all of them, for formations of which each agent knows its own and its leader's motion as it is

FOLLOWED = np.dtype(
    [
        ("xi", "f8", 3),  # (6)
        *((name, "f8") for name in ("speed", "speed_rate")),  # (8), (11), and S_d
        *((name, "f8", 3) for name in ("direction", "direction_rate")),  # (9), (12)
        ("clamped", "?"),
        ("u", "f8"),  # (14)
        ("omega", "f8", 3),  # (15)
        ("y_rate", "f8", 3),  # (3)
    ]
)


def follower_records(formations):
    """Pack gains and offsets of M formations of n agents, and their messages, which are written.

    Returns:
        (M n) of LAW, (M n, n + 1) of NEIGHBOUR, (M, n + 1) of LINK, all alike for `follow`.
    """
    m, n = formations.offsets.shape[:2]
    law, neighbours = allocate(LAW, m * n), allocate(NEIGHBOUR, m * n, n + 1)
    law["neighbour_timeout_s"], law["speed_pole"] = inf, formations.pole
    for name in ("k", "a", "b", "c"):
        law[name] = getattr(formations, name)
    _write_tuples(law, formations.mu, formations.barrier, formations.speeds)
    neighbours["gain"] = formations.gains
    neighbours["offset"][:, 1:] = np.repeat(formations.offsets, n, axis=0)
    return law, neighbours, allocate(LINK, m, n + 1)


def follow(records, motion, slots_now, q, velocity, s):
    """Compute what the law commands, and ẏ.

    Args:
        records: of `follower_records`.
        motion: q_g, q̇_g, q̈_g and ω_g (4, M, 3) of the leaders.
        slots_now: χ, χ̇, χ̈ (3, M, n, 3).
        q: (M n, 3) m.
        velocity: (M n, 3) m/s.
        s: (M n,) m/s.

    Returns:
        (M n,) of FOLLOWED.
    """
    out = np.zeros(len(s), FOLLOWED)
    # numba would compile the kernel again for arrays in another order
    _follow(*records, motion, slots_now, *map(np.ascontiguousarray, (q, velocity)), s, out)
    return out


@kernel
def _triple(x):
    return x[0], x[1], x[2]


@entry
def _follow(laws, neighbours, links, motion, slots_now, q, velocity, s, out):
    n = slots_now.shape[2]
    for i in range(len(s)):
        link = links[i // n, i % n + 1]
        for axis in range(3):
            link.position_ned[axis], link.velocity_ned[axis] = q[i, axis], velocity[i, axis]
    for i in range(len(s)):
        law, found, m, k = laws[i], out[i], i // n, i % n
        q_g, v_g = _triple(motion[0, m]), _triple(motion[1, m])
        chi = (
            _triple(slots_now[0, m, k]),
            _triple(slots_now[1, m, k]),
            _triple(slots_now[2, m, k]),
        )
        v = _triple(velocity[i])
        frame = frames.frame_angles(v_g[0], v_g[1], v_g[2])
        xi, xi_rate = hbh23.formation_error(
            law,
            0.0,
            _triple(q[i]),
            v,
            (q_g, v_g),
            chi,
            frame,
            _triple(motion[3, m]),
            links[m],
            neighbours[i],
        )
        s_d, s_d_rate, y_d, y_d_rate = hbh23.desired_velocity(
            law, v_g, _triple(motion[2, m]), chi[1], chi[2], xi, xi_rate
        )
        limited = min(max(s_d, law.speed_desired_min), law.speed_desired_max)
        found.clamped = limited != s_d
        s_d_rate = 0.0 if found.clamped else s_d_rate
        found.speed, found.speed_rate = limited, s_d_rate
        found.u = hbh23.speed_control(law, s[i], limited, s_d_rate, law.speed_min, law.speed_max)
        pitching, yawing = hbh23.turn_control(v, y_d, y_d_rate, law.c)
        found.omega[1], found.omega[2] = pitching, yawing
        # (3) with v = e1: ẏ = R [ω]x e1 = ω3 (right) − ω2 (down)
        y_rate = frames.to_ned(frames.frame_angles(v[0], v[1], v[2]), 0.0, yawing, -pitching)
        for axis in range(3):
            found.xi[axis], found.direction[axis] = xi[axis], y_d[axis]
            found.direction_rate[axis], found.y_rate[axis] = y_d_rate[axis], y_rate[axis]


# the ideal vehicle


def unicycle_records(state, speed_command, omega, pole):
    """Pack n unicycles under their commands into (n,) of UNICYCLE."""
    records = allocate(unicycles.UNICYCLE, len(state.speed))
    write_fields(records, state)
    records["speed_command"], records["omega"], records["pole"] = speed_command, omega, pole
    return records


def advance_ticks(state, speed_command, omega, pole, dt, ticks):
    """n unicycles some ticks of dt s later, under commands held meanwhile, [HBH23] eqs. (1)-(4).

    Commands are u (n,) m/s and ω (n, 3) rad/s in the zero-roll velocity frame, which turns.
    """
    records = unicycle_records(state, speed_command, omega, pole)
    unicycles.advance(records, dt, ticks)
    return Unicycle(*(np.array(records[name]) for name in Unicycle._fields))


def advance(state, speed_command, omega, pole, dt):
    """As `advance_ticks`, one tick."""
    return advance_ticks(state, speed_command, omega, pole, dt, 1)


def report(state, speed_command, omega, pole, wind_ned):
    """The motion of n unicycles under their commands in a wind (n, 3), as vehicles report it."""
    records, n = unicycle_records(state, speed_command, omega, pole), len(state.speed)
    aircraft = allocate(AIRCRAFT, n)
    aircraft["wind"]["wind_ned"] = wind_ned
    unicycles.write_motion(records, np.arange(n), aircraft)
    truth = fields_of(VehicleState, aircraft["truth"])
    return VehicleState(*(each.copy() for each in truth))


# fly-by-wire A


def fbwa(estimate, command, memory, gains):
    """As `fbwa.fbwa`, with gains (N,) of the product's GAINS."""
    autopilots = product_fbwa.initial_autopilots(gains)
    records = autopilots.memory
    for name in fbwa_tables.MEMORY.names:
        records[name] = memory.each[name]
    if memory.slew is not None:
        records["slew"] = memory.slew
    if memory.begun:
        autopilots.delay_line[:] = memory.commands.transpose(2, 0, 1)
    surfaces = product_fbwa.step_autopilots(autopilots, estimate, command)
    return (
        ActuatorCommand(*(np.array(each) for each in surfaces)),
        fbwa_tables.FbwaMemory(
            True,
            autopilots.delay_line.transpose(1, 2, 0).copy(),
            _fbwa_table(records),
            records["slew"].copy(),
        ),
    )


def settled(surfaces, gains):
    """As `fbwa.settled`, with gains (N,) of the product's GAINS."""
    autopilots = product_fbwa.settled_autopilots(gains, surfaces)
    n = len(gains)
    return fbwa_tables.FbwaMemory(False, np.zeros((0, 3, n)), _fbwa_table(autopilots.memory))


def _fbwa_table(records):
    each = np.zeros(len(records), dtype=fbwa_tables.MEMORY)
    for name in fbwa_tables.MEMORY.names:
        each[name] = records[name]
    return each


def reference_gains(gains):
    """Present gains (N,) of the product's GAINS, all of one timing, as those of the reference."""
    first = {name: gains[name][0].item() for name in fbwa_tables.FbwaGains._fields[:-1]}
    return fbwa_tables.FbwaGains(**first, each=gains)
