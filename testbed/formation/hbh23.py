"""The formation law of [HBH23] for one follower: eqs. (5)-(15) and (22)-(29)."""

from __future__ import annotations

from math import atan2, copysign, cos, isnan, nan, sin

import numpy as np

from testbed.core.compile import kernel
from testbed.core.flags import LimiterFlag
from testbed.core.frames import PAPER_GRAVITY, gamma_of, norm
from testbed.core.records import Record, Values, Vector
from testbed.core.speed_model import SPEED_MODEL, speed_terms
from testbed.core.velocity_frame import (
    cross,
    frame_angles,
    frame_angular_acceleration,
    frame_angular_velocity,
    to_ned,
)
from testbed.formation.barrier import BARRIER, NO_BARRIER, h
from testbed.formation.control_function import MU, mu
from testbed.formation.leader_filter import (
    DIFFERENCE,
    ROLL_RATE,
    difference_angular_velocity,
    estimate_leader_acceleration,
)
from testbed.formation.message_extrapolation import (
    extrapolate,
    hold_relative_position,
    message_time,
    relative_position,
    timed_out,
)

CLAMPED = int(LimiterFlag.SPEED_DESIRED_CLAMPED)
OUTSIDE = int(LimiterFlag.OUTSIDE_SPEED_SET)
LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
# (14) divides by the slope of h outside the speed set. Where tanh has saturated that slope
# underflows; the limit on the commanded airspeed bounds what this floor lets through.
SLOPE_FLOOR = 1e-12

# Gains and options of the law of one follower.
LAW = np.dtype(
    [
        ("row", "i8"),  # of the follower among the N aircraft
        ("k", "f8"),  # m/s over ρ̄, the largest speed at which an error is closed, (7)
        ("a", "f8"),  # 1/s, (14)
        ("b", "f8"),  # s/m², (14)
        ("c", "f8"),  # 1/s, constant part of c_i(t), (15)
        ("c_speed", "f8"),  # s/m², part of c_i(t) that grows with s_d²
        ("speed_pole", "f8"),  # p, 1/s, of the speed model f = −p s, g = p
        ("speed_model", SPEED_MODEL),  # f and g of a user in its place
        ("mu", MU),
        ("barrier", BARRIER),
        ("speed_min", "f8"),  # s_lo, m/s
        ("speed_max", "f8"),  # s_hi, m/s
        ("speed_desired_min", "f8"),  # s_lo + ε, m/s, with ε = κ − k ρ̄ by fact 1
        ("speed_desired_max", "f8"),  # s_hi − ε, m/s
        ("horizontal", "?"),  # the law uses horizontal motion only; the middle loop holds altitude
        ("bounds_of_airspeed", "?"),  # the bounds hold for the airspeed, not the ground speed
        ("from_timestamp", "?"),  # messages are extrapolated from their stamp, not their receipt
        ("with_acceleration", "?"),  # ... along a parabola
        ("acceleration_source", "i8"),  # of q̈_g: leader_filter.NOTHING, BROADCAST or TURN
        ("acceleration_blend", "f8", 3),  # NED, share of a new message in the average of BROADCAST
        ("difference_blend", "f8", 2),  # share of a new difference in the averages of ṡ_g and γ̇_g
        # of ω̇_g: NOTHING, as the paper, ROLL_RATE, DIFFERENCE
        ("angular_acceleration_source", "i8"),
        ("turn_rate_blend", "f8"),  # share of a new difference in the average of ω̇_g
        ("leader_timeout_s", "f8"),  # since the last message of the leader was received
        ("neighbour_timeout_s", "f8"),
        # a timed-out neighbour keeps its relative position, instead of being left out of (6)
        ("hold_stale_neighbours", "?"),
        ("lost_leader_airspeed", "f8"),  # m/s, flown level while the leader has timed out
        ("lost_leader_turn_rate", "f8"),  # rad/s, course rate during the timeout
    ],
    align=True,
)
# Gains and state of a follower for one aircraft of its formation; the leader's row is the first.
NEIGHBOUR = np.dtype(
    [
        ("offset", "f8", 3),  # υ, m: forward, right, down in the leader's velocity frame
        ("gain", "f8", 3),  # β_i of the leader, β_ij of a neighbour, per axis of NED
        ("used", "?"),  # its messages are used
        # it has failed, or the follower has left the formation: treated as timed out
        ("excluded", "?"),
        ("timeout_s", "f8"),  # s since receipt, after which a message is not used
        ("held_position", "f8", 3),  # m, in the leader's velocity frame; nan: none
        ("held_time_s", "f8"),  # of the message that it came from; nan: none
    ],
    align=True,
)


@kernel
def hbh23(
    law: Record,
    now: float,
    own: Record,
    inbox: Record,
    neighbours: Record,
    memory: Record,
    out: Record,
) -> None:
    """Compute the inputs u and ω of one follower's extended unicycle.

    A follower whose leader has timed out flies level, from its course at the timeout. A neighbour
    that has timed out is left out of (6), or keeps its position relative to the leader.

    Args:
        law: record of LAW.
        now: s.
        own: record of MOTION, the follower's estimate.
        inbox: (N,) of LINK, the newest messages; the leader's is the first.
        neighbours: (N,) of NEIGHBOUR; held positions are written.
        memory: record of leader_filter.MEMORY; written.
        out: record of FOLLOWER: speed_command (u), omega, speed_desired, direction and
            limiter_flags are written.
    """
    vertical_weight = 0.0 if law.horizontal else 1.0
    q, own_velocity = own.position_ned, own.velocity_ned
    v = (own_velocity[0], own_velocity[1], vertical_weight * own_velocity[2])
    s = norm(v)
    out.omega[0] = 0.0
    if neighbours[0].excluded or timed_out(inbox[0], now, law.leader_timeout_s):
        _fly_without_leader(law, now, v, s, own.airspeed, memory, out)
        return
    memory.timeout_since = memory.timeout_course = nan

    # the leader's frame and the own slot in it, (22)-(29)
    leader = extrapolate(law, inbox[0], now)
    v_g = leader[1]
    s_g = norm(v_g)
    gamma_g = gamma_of(v_g[0], v_g[1], v_g[2])
    frame = frame_angles(v_g[0], v_g[1], v_g[2])
    rates = inbox[0].euler_rates
    gamma_dot, chi_dot = vertical_weight * rates[1], rates[2]
    omega_g = frame_angular_velocity(gamma_g, chi_dot, gamma_dot)
    omega_dot_g = (0.0, 0.0, 0.0)
    time_s = message_time(law, inbox[0])
    if law.angular_acceleration_source == ROLL_RATE:
        euler = inbox[0].euler
        # the derivative of σ̇_g ≈ g tan φ_g / (s_g cos θ_g) by the bank alone
        chi_ddot = PAPER_GRAVITY * rates[0] / (s_g * cos(euler[1]) * cos(euler[0]) ** 2)
        omega_dot_g = frame_angular_acceleration(gamma_g, chi_dot, gamma_dot, chi_ddot)
    elif law.angular_acceleration_source == DIFFERENCE:
        omega_dot_g = difference_angular_velocity(law, memory, time_s, omega_g)
    slot = slot_motion(frame, omega_g, omega_dot_g, neighbours[law.row].offset)
    estimate_leader_acceleration(law, inbox[0], memory, time_s, frame)

    xi, xi_rate = formation_error(law, now, q, v, leader, slot, frame, omega_g, inbox, neighbours)
    w = memory.acceleration
    desired = desired_velocity(
        law, v_g, (w[0], w[1], vertical_weight * w[2]), slot[1], slot[2], xi, xi_rate
    )
    write_inputs(velocity_control(law, v, s, own.airspeed, desired), out)


@kernel
def velocity_control(law: Record, v: Vector, s: float, airspeed: float, desired: Values) -> Values:
    """Compute u, (14), and ω, (15), that turn the velocity to a desired one.

    Args:
        law: record of LAW.
        v: q̇_i, m/s.
        s: its length, m/s.
        airspeed: m/s.
        desired: s_d, m/s, ṡ_d, m/s², y_d and ẏ_d, 1/s.

    Returns:
        u, ω, s_d within its bounds, y_d, and the flags of the limiters that acted.
    """
    s_d, s_d_rate, y_d, y_d_rate = desired
    # bounds of the airspeed are shifted by ground speed minus airspeed
    shift = s - airspeed if law.bounds_of_airspeed else 0.0
    s_min, s_max = law.speed_min + shift, law.speed_max + shift
    limited = min(max(s_d, law.speed_desired_min + shift), law.speed_desired_max + shift)
    flags = 0
    if limited != s_d:
        # the proof assumes s_d in S_d; an unreachable leader breaks that
        flags |= CLAMPED
        s_d_rate = 0.0
    s_d = limited
    if not s_min < s < s_max:
        flags |= OUTSIDE
    u = speed_control(law, s, s_d, s_d_rate, s_min, s_max)
    c = law.c + law.c_speed * s_d * s_d
    pitching, yawing = turn_control(v, y_d, y_d_rate, c)
    return u, (0.0, pitching, yawing), s_d, y_d, flags


@kernel
def write_inputs(inputs: Values, out: Record) -> None:
    """Write what `velocity_control` returns.

    Args:
        inputs: of the extended unicycle.
        out: record of FOLLOWER: speed_command, omega, speed_desired, direction and
            limiter_flags are written.
    """
    u, omega, s_d, y_d, flags = inputs
    out.speed_command = u
    out.omega[0], out.omega[1], out.omega[2] = omega
    out.speed_desired = s_d
    out.direction[0], out.direction[1], out.direction[2] = y_d
    out.limiter_flags = flags


@kernel
def reach_velocity(
    law: Record, own_velocity: Vector, airspeed: float, p: Vector, p_rate: Vector
) -> Values:
    """Return what `velocity_control` does, for a desired velocity.

    The horizontal variant uses no vertical components.

    Args:
        law: record of LAW.
        own_velocity: q̇_i, m/s.
        airspeed: m/s.
        p: p_d, m/s; not zero.
        p_rate: ṗ_d, m/s².
    """
    vertical_weight = 0.0 if law.horizontal else 1.0
    v = (own_velocity[0], own_velocity[1], vertical_weight * own_velocity[2])
    desired = speed_and_direction(
        (p[0], p[1], vertical_weight * p[2]), (p_rate[0], p_rate[1], vertical_weight * p_rate[2])
    )
    return velocity_control(law, v, norm(v), airspeed, desired)


@kernel
def slot_motion(frame: Vector, omega: Vector, omega_dot: Vector, offset: Vector) -> Values:
    """Return χ, χ̇ and χ̈ of an offset υ, (27)-(29); m, m/s, m/s².

    The offset is held in the leader's frame.
    """
    x, y, z = offset
    chi = to_ned(frame, x, y, z)
    a, b, c = cross(omega[0], omega[1], omega[2], x, y, z)
    chi_rate = to_ned(frame, a, b, c)
    a, b, c = cross(omega[0], omega[1], omega[2], a, b, c)
    x, y, z = cross(omega_dot[0], omega_dot[1], omega_dot[2], x, y, z)
    return chi, chi_rate, to_ned(frame, a + x, b + y, c + z)


@kernel
def formation_error(
    law: Record,
    now: float,
    q: Vector,
    v: Vector,
    leader: Vector,
    slot: Vector,
    frame: Vector,
    omega: Vector,
    inbox: Record,
    neighbours: Record,
) -> Values:
    """Return ξ_i, m, and its time derivative, m/s, (6).

    Args:
        law: record of LAW.
        now: s.
        q: q_i (3,), m.
        v: q̇_i, m/s.
        leader: q_g and q̇_g.
        slot: χ_i, χ̇_i, χ̈_i.
        frame: cos σ_g, sin σ_g, cos γ_g, sin γ_g.
        omega: ω_g, rad/s.
        inbox: (N,) of LINK.
        neighbours: (N,) of NEIGHBOUR; held positions are written.
    """
    chi, chi_rate, _ = slot
    vertical_weight = 0.0 if law.horizontal else 1.0
    x = y = z = xr = yr = zr = 0.0
    for m in range(len(neighbours)):
        other = neighbours[m]
        gain = other.gain
        gn, ge, gd = gain[0], gain[1], vertical_weight * gain[2]
        if gn == 0.0 and ge == 0.0 and gd == 0.0:
            continue
        position, velocity = leader
        if m > 0:
            if not (other.excluded or timed_out(inbox[m], now, law.neighbour_timeout_s)):
                position, velocity = extrapolate(law, inbox[m], now)
                time_s = message_time(law, inbox[m])
                if law.hold_stale_neighbours and not time_s <= other.held_time_s:
                    other.held_time_s = time_s
                    a, b, c = relative_position(frame, leader[0], position)
                    held = other.held_position
                    held[0], held[1], held[2] = a, b, c
            elif law.hold_stale_neighbours and not isnan(other.held_position[0]):
                position, velocity = hold_relative_position(
                    frame, omega, leader, other.held_position
                )
            else:
                continue
        a, b, c = other.offset
        da, db, dc = cross(omega[0], omega[1], omega[2], a, b, c)
        a, b, c = to_ned(frame, a, b, c)
        da, db, dc = to_ned(frame, da, db, dc)
        x += gn * ((position[0] - a) - (q[0] - chi[0]))
        y += ge * ((position[1] - b) - (q[1] - chi[1]))
        z += gd * ((position[2] - c) - (q[2] - chi[2]))
        xr += gn * ((velocity[0] - da) - (v[0] - chi_rate[0]))
        yr += ge * ((velocity[1] - db) - (v[1] - chi_rate[1]))
        zr += gd * ((velocity[2] - dc) - (v[2] - chi_rate[2]))
    return (x, y, z), (xr, yr, zr)


@kernel
def desired_velocity(
    law: Record,
    v_g: Vector,
    a_g: Vector,
    chi_rate: Vector,
    chi_acceleration: Vector,
    xi: Vector,
    xi_rate: Vector,
) -> Values:
    """Return s_d, ṡ_d, y_d and ẏ_d of the desired velocity p_d, (7)-(12).

    ρ is that of (5) and (13).

    Args:
        law: record of LAW.
        v_g: q̇_g, m/s.
        a_g: q̈_g, m/s².
        chi_rate: χ̇_i, m/s.
        chi_acceleration: χ̈_i, m/s².
        xi: ξ_i, m.
        xi_rate: its time derivative, m/s.
    """
    x, y, z = xi
    xr, yr, zr = xi_rate
    value, slope = mu(law.mu, x * x + y * y + z * z)
    along = 2.0 * slope * (x * xr + y * yr + z * zr)
    k = law.k
    p = (
        v_g[0] + chi_rate[0] + k * (value * x),
        v_g[1] + chi_rate[1] + k * (value * y),
        v_g[2] + chi_rate[2] + k * (value * z),
    )
    p_rate = (
        a_g[0] + chi_acceleration[0] + k * (value * xr + along * x),
        a_g[1] + chi_acceleration[1] + k * (value * yr + along * y),
        a_g[2] + chi_acceleration[2] + k * (value * zr + along * z),
    )
    return speed_and_direction(p, p_rate)


@kernel
def speed_and_direction(p: Vector, p_rate: Vector) -> Values:
    """Return s_d, ṡ_d, y_d and ẏ_d of a desired velocity and its derivative, (8)-(12).

    Args:
        p: p_d, m/s; not zero.
        p_rate: ṗ_d, m/s².
    """
    s_d = norm(p)
    y_d = (p[0] / s_d, p[1] / s_d, p[2] / s_d)
    s_d_rate = y_d[0] * p_rate[0] + y_d[1] * p_rate[1] + y_d[2] * p_rate[2]
    y_d_rate = (
        (p_rate[0] - s_d_rate * y_d[0]) / s_d,
        (p_rate[1] - s_d_rate * y_d[1]) / s_d,
        (p_rate[2] - s_d_rate * y_d[2]) / s_d,
    )
    return s_d, s_d_rate, y_d, y_d_rate


@kernel
def speed_control(
    law: Record, s: float, s_d: float, s_d_rate: float, s_min: float, s_max: float
) -> float:
    """Return the control u, (14).

    It is in m/s for f = −p s and g = p, else in the unit of g.

    Args:
        law: record of LAW.
        s: ground speed, m/s.
        s_d: desired speed, m/s.
        s_d_rate: its derivative, m/s².
        s_min: s_lo, m/s.
        s_max: s_hi, m/s.
    """
    height, slope = h(law.barrier, s, s_min, s_max)
    error = s_d - s
    if s_min < s < s_max or law.barrier.example == NO_BARRIER:
        u = (law.b * error**3 + s_d_rate * height + law.a * error * height) / (
            height + error * slope
        )
    else:
        u = law.b * error**2 / copysign(max(abs(slope), SLOPE_FLOOR), slope)
    if law.speed_model.own:
        f, g = speed_terms(law.speed_model, s)
        own: float = (u - f) / g
        return own
    speed: float = u / law.speed_pole + s
    return speed


@kernel
def turn_control(v: Vector, y_d: Vector, y_d_rate: Vector, c: float) -> Values:
    """Return e2ᵀω and e3ᵀω, rad/s, (15), in the zero-roll velocity frame.

    With y = R e1 the product Rᵀ [y]× w is e1 × Rᵀ w: the first component is zero and the other two
    are components of w across the velocity.

    Args:
        v: q̇_i, m/s.
        y_d: desired direction.
        y_d_rate: its derivative, 1/s.
        c: c_i(t), 1/s.
    """
    cs, ss, cg, sg = frame_angles(v[0], v[1], v[2])
    y1, y2, y3 = cg * cs, cg * ss, -sg
    closing = c - (y1 * y_d_rate[0] + y2 * y_d_rate[1] + y3 * y_d_rate[2])
    facing = y1 * y_d[0] + y2 * y_d[1] + y3 * y_d[2]
    w1 = closing * y_d[0] + facing * y_d_rate[0]
    w2 = closing * y_d[1] + facing * y_d_rate[1]
    w3 = closing * y_d[2] + facing * y_d_rate[2]
    return -(sg * cs * w1 + sg * ss * w2 + cg * w3), cs * w2 - ss * w1


@kernel
def _fly_without_leader(
    law: Record, now: float, v: Vector, s: float, airspeed: float, memory: Record, out: Record
) -> None:
    """Fly level on the course at the timeout, or turn at a constant rate."""
    starts = isnan(memory.timeout_since)
    since = now if starts else memory.timeout_since
    course = atan2(v[1], v[0]) if starts else memory.timeout_course
    memory.time_s = memory.speed = memory.gamma = nan
    memory.speed_rate = memory.gamma_dot = 0.0
    memory.omega_dot[0] = memory.omega_dot[1] = memory.omega_dot[2] = 0.0
    memory.timeout_since, memory.timeout_course = since, course
    turn_rate = law.lost_leader_turn_rate
    now_course = course + turn_rate * (now - since)
    north, east = cos(now_course), sin(now_course)
    u = law.lost_leader_airspeed + s - airspeed
    out.speed_command = out.speed_desired = u
    c = law.c + law.c_speed * u * u
    y_d = (north, east, 0.0)
    out.omega[1], out.omega[2] = turn_control(
        v, y_d, (-turn_rate * east, turn_rate * north, 0.0), c
    )
    out.direction[0], out.direction[1], out.direction[2] = y_d
    out.limiter_flags = LEADER_TIMEOUT
