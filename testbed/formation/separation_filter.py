"""A filter that limits how fast a follower's desired velocity closes towards other aircraft.

Each aircraft that is heard gives a bound on the component of p_d along the line to it, a barrier
function of the distance d: where D is the separation that is kept plus a margin, and α the rate,

    n·(p_d − w(q)) ≥ −β α (d − D),    n = (q − q_j)/d.    (F1)

w(q) = q̇_g + ω_g × (q − q_g) is the motion of the leader's frame at the follower, which keeps all
distances. Two followers that fly at their filtered velocities, each with β = 1/2, therefore have
ḋ ≥ −α (d − D), and d − D does not fall below (d(0) − D) exp(−α t). The leader is not filtered: β is
1 towards it. A follower whose leader has timed out has no common frame: w is then the other's
velocity, and β is 1.

A safe velocity of a barrier function that a controller tracks faster than at the rate α is safe
with a margin (Molnar, Cosner, Singletary, Ubellacker and Ames, IEEE Control Systems Letters 6
(2022)); it was not written for aircraft with a least speed. What voids it is flagged.
"""

from __future__ import annotations

from math import isnan

import numpy as np

from testbed.core.compile import kernel
from testbed.core.flags import LimiterFlag
from testbed.core.frames import gamma_of, norm
from testbed.core.records import Record, Values, Vector
from testbed.core.speed_model import speed_terms
from testbed.core.velocity_frame import cross, frame_angles, frame_angular_velocity, to_ned
from testbed.formation.barrier import h
from testbed.formation.hbh23 import (
    LEADER_TIMEOUT,
    speed_and_direction,
    velocity_control,
    write_inputs,
)
from testbed.formation.message_extrapolation import dead_reckon, timed_out

LIMITED = int(LimiterFlag.CLOSING_LIMITED)
INFEASIBLE = int(LimiterFlag.CLOSING_LIMITS_INFEASIBLE)
INSIDE = int(LimiterFlag.INSIDE_SEPARATION_MARGIN)
# Bounds are taken one after the other, since each projection can break those before it.
SWEEPS = 3
TOLERANCE = 0.05  # m/s, of a bound after the last sweep
TURN = 2.0  # m/s, speed to the right of the line between two that approach each other
# vertical speed beside it, as a share of it; up for the aircraft of the lower row
CLIMB_OF_TURN = 0.5
APPROACH = 0.1  # m/s, from which the other approaches
LEAST_FACING = 0.2  # cosine between velocity and desired one, from which ẏ_d is known

# The filter of one follower.
SEPARATION = np.dtype(
    [
        ("on", "?"),
        ("distance", "f8"),  # D, m
        ("rate", "f8"),  # α, 1/s
    ],
    align=True,
)


@kernel
def limit_closing(
    separation: Record,
    law: Record,
    now: float,
    own: Record,
    inbox: Record,
    neighbours: Record,
    out: Record,
) -> None:
    """Replace the command of one follower by that of a desired velocity within the bounds (F1).

    A command within them is left as it is, to the bit.

    Args:
        separation: record of SEPARATION.
        law: record of LAW.
        now: s.
        own: record of MOTION, the follower's estimate.
        inbox: (N,) of LINK.
        neighbours: (N,) of NEIGHBOUR.
        out: record of FOLLOWER; speed_command, omega, speed_desired, direction and limiter_flags
            are read, and written where a bound acts.
    """
    vertical_weight = 0.0 if law.horizontal else 1.0
    q, own_velocity = own.position_ned, own.velocity_ned
    v = (own_velocity[0], own_velocity[1], vertical_weight * own_velocity[2])
    s_d, y_d = out.speed_desired, out.direction
    p = (s_d * y_d[0], s_d * y_d[1], s_d * y_d[2])
    heard = not (neighbours[0].excluded or timed_out(inbox[0], now, law.leader_timeout_s))
    frame = leader_motion(inbox[0], now)
    broken = False
    for m in range(len(inbox)):
        if m == law.row or timed_out(inbox[m], now, neighbours[m].timeout_s):
            continue
        n, least, _, gap, _ = bound_towards(separation, now, q, v, inbox[m], m, heard, frame)
        if gap < 0.0:
            out.limiter_flags |= INSIDE
        broken |= n[0] * p[0] + n[1] * p[1] + n[2] * p[2] < least
    if not broken:
        return
    p_rate = desired_acceleration(law, v, own.airspeed, out)
    for sweep in range(SWEEPS + 1):
        for m in range(len(inbox)):
            if m == law.row or timed_out(inbox[m], now, neighbours[m].timeout_s):
                continue
            n, least, least_rate, _, approach = bound_towards(
                separation, now, q, v, inbox[m], m, heard, frame
            )
            short = least - (n[0] * p[0] + n[1] * p[1] + n[2] * p[2])
            if sweep == SWEEPS:
                out.limiter_flags |= INFEASIBLE if short > TOLERANCE else 0
                continue
            if short <= 0.0:
                continue
            if sweep == 0 and approach > APPROACH:
                climb = -CLIMB_OF_TURN if law.row < m else CLIMB_OF_TURN
                p = (
                    p[0] + TURN * n[1],
                    p[1] - TURN * n[0],
                    p[2] + vertical_weight * TURN * climb,
                )
                short = least - (n[0] * p[0] + n[1] * p[1] + n[2] * p[2])
            a, b, c = n[0], n[1], vertical_weight * n[2]
            size = a * a + b * b + c * c
            if size < LEAST_FACING**2:  # straight above or below, and it has no vertical command
                continue
            gain = max(short, 0.0) / size
            p = (p[0] + gain * a, p[1] + gain * b, p[2] + gain * c)
            gain = (least_rate - (n[0] * p_rate[0] + n[1] * p_rate[1] + n[2] * p_rate[2])) / size
            p_rate = (p_rate[0] + gain * a, p_rate[1] + gain * b, p_rate[2] + gain * c)
    if not norm(p) > TOLERANCE:  # it has no direction
        out.limiter_flags |= INFEASIBLE
        return
    flags = out.limiter_flags & (INSIDE | INFEASIBLE | LEADER_TIMEOUT) | LIMITED
    write_inputs(
        velocity_control(law, v, norm(v), own.airspeed, speed_and_direction(p, p_rate)), out
    )
    out.limiter_flags |= flags


@kernel
def leader_motion(leader: Record, now: float) -> Values:
    """Return position, velocity, acceleration and angular velocity of the leader's frame, NED.

    Args:
        leader: record of LINK, extrapolated from its time stamp along a parabola.
        now: s.
    """
    position, velocity = dead_reckon(leader, now - leader.stamp_s, True, 1.0)
    frame = frame_angles(velocity[0], velocity[1], velocity[2])
    gamma = gamma_of(velocity[0], velocity[1], velocity[2])
    rates, a = leader.euler_rates, leader.acceleration_ned
    omega = frame_angular_velocity(gamma, rates[2], rates[1])
    x, y, z = to_ned(frame, omega[0], omega[1], omega[2])
    return position, velocity, (a[0], a[1], a[2]), (x, y, z)


@kernel
def bound_towards(
    separation: Record,
    now: float,
    q: Vector,
    v: Vector,
    other: Record,
    row: int,
    heard: bool,
    frame: Values,
) -> Values:
    """Return the bound (F1) on the desired velocity towards one aircraft.

    Args:
        separation: record of SEPARATION.
        now: s.
        q: own position, m.
        v: own velocity, m/s.
        other: record of LINK, extrapolated from its time stamp along a parabola.
        row: of the other among the N aircraft; 0 is the leader.
        heard: the leader's message is used.
        frame: of `leader_motion`.

    Returns:
        n, the least n·p_d, m/s, its time derivative, m/s², with n held, d − D, m, and the speed at
        which the other approaches in the frame, m/s.
    """
    q_j, v_j = dead_reckon(other, now - other.stamp_s, True, 1.0)
    x, y, z = q[0] - q_j[0], q[1] - q_j[1], q[2] - q_j[2]
    d = max(norm((x, y, z)), 1e-6)
    n = (x / d, y / d, z / d)
    gap = d - separation.distance
    rate_of_d = n[0] * (v[0] - v_j[0]) + n[1] * (v[1] - v_j[1]) + n[2] * (v[2] - v_j[2])
    a = other.acceleration_ned
    w, w_rate, w_j = v_j, (a[0], a[1], a[2]), v
    share = 1.0
    if heard:
        share = 0.5 if row > 0 else 1.0
        w, w_rate = frame_velocity(frame, q, v)
        w_j, _ = frame_velocity(frame, q_j, v_j)
    least = n[0] * w[0] + n[1] * w[1] + n[2] * w[2] - share * separation.rate * gap
    least_rate = n[0] * w_rate[0] + n[1] * w_rate[1] + n[2] * w_rate[2]
    least_rate -= share * separation.rate * rate_of_d
    approach = n[0] * (v_j[0] - w_j[0]) + n[1] * (v_j[1] - w_j[1]) + n[2] * (v_j[2] - w_j[2])
    return n, least, least_rate, gap, approach


@kernel
def frame_velocity(frame: Values, q: Vector, v: Vector) -> Values:
    """Return w(q) and its time derivative along a motion, without that of ω_g; m/s, m/s².

    Args:
        frame: of `leader_motion`.
        q: a position, m.
        v: its velocity, m/s.
    """
    q_g, v_g, a_g, omega = frame
    a, b, c = cross(omega[0], omega[1], omega[2], q[0] - q_g[0], q[1] - q_g[1], q[2] - q_g[2])
    x, y, z = cross(omega[0], omega[1], omega[2], v[0] - v_g[0], v[1] - v_g[1], v[2] - v_g[2])
    return (v_g[0] + a, v_g[1] + b, v_g[2] + c), (a_g[0] + x, a_g[1] + y, a_g[2] + z)


@kernel
def desired_acceleration(law: Record, v: Vector, airspeed: float, out: Record) -> Vector:
    """Return ṗ_d, m/s², with which (14) and (15) give a follower's command for its p_d.

    It is their inverse for ṡ_d and ẏ_d, so that the command is continuous where a bound begins to
    act, for a law of the user's, too. Zero where it is not known: outside the speed bounds, with
    s_d at its bounds, and far from the desired direction.

    Args:
        law: record of LAW.
        v: q̇_i, m/s.
        airspeed: m/s.
        out: record of FOLLOWER.
    """
    s, s_d, y_d = norm(v), out.speed_desired, out.direction
    shift = s - airspeed if law.bounds_of_airspeed else 0.0
    s_min, s_max = law.speed_min + shift, law.speed_max + shift
    s_d_rate = 0.0
    if s_min < s < s_max:
        height, slope = h(law.barrier, s, s_min, s_max)
        u = (out.speed_command - s) * law.speed_pole
        if law.speed_model.own:
            f, g = speed_terms(law.speed_model, s)
            u = f + g * out.speed_command
        e = s_d - s
        s_d_rate = (u * (height + e * slope) - law.b * e**3) / height - law.a * e
    cs, ss, cg, sg = frame_angles(v[0], v[1], v[2])
    facing = cg * cs * y_d[0] + cg * ss * y_d[1] - sg * y_d[2]
    aside = cs * y_d[1] - ss * y_d[0]
    below = sg * cs * y_d[0] + sg * ss * y_d[1] + cg * y_d[2]
    if facing < LEAST_FACING or isnan(s_d_rate):
        return 0.0, 0.0, 0.0
    c = law.c + law.c_speed * s_d * s_d
    pitching, yawing = out.omega[1], out.omega[2]
    # components of ẏ_d along and across the velocity; that along y_d is zero
    along = c * (1.0 - facing * facing) - yawing * aside + pitching * below
    right = (yawing - (c - along) * aside) / facing
    down = (-pitching - (c - along) * below) / facing
    return (
        s_d_rate * y_d[0] + s_d * (along * cg * cs - right * ss + down * sg * cs),
        s_d_rate * y_d[1] + s_d * (along * cg * ss + right * cs + down * sg * ss),
        s_d_rate * y_d[2] + s_d * (-along * sg + down * cg),
    )
