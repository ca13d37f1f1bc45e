"""Received states extrapolated to the time of the control step, [HBH23] sec. 8.3."""

from __future__ import annotations

from math import isnan, nan

from testbed.core.compile import kernel
from testbed.core.records import Record, Values, Vector
from testbed.core.velocity_frame import cross, from_ned, to_ned


@kernel
def timed_out(link: Record, now: float, timeout_s: float) -> bool:
    """Return whether a link has no message, or none for longer than a timeout, s.

    Args:
        link: record of LINK.
        now: s.
        timeout_s: since the receipt of the newest message.
    """
    expired: bool = isnan(link.stamp_s) or now - link.received_s > timeout_s
    return expired


@kernel
def message_time(law: Record, link: Record) -> float:
    """Return the time that the law extrapolates from: the message's stamp, or its receipt, s."""
    time_s: float = link.stamp_s if law.from_timestamp else link.received_s
    return time_s


@kernel
def extrapolate(law: Record, link: Record, now: float) -> Values:
    """Return position and velocity of an aircraft at the time `now` from its newest message.

    The paper takes one Euler step along the velocity from the time of receipt, which does not
    correct the network's delay. A step from the sender's timestamp, as in the authors' code,
    corrects it and needs synchronised clocks. With the acceleration the step is a parabola.

    Args:
        law: record of LAW.
        link: record of LINK.
        now: s.

    Returns:
        Position, m, and velocity, m/s, NED; the velocity is horizontal for the horizontal variant.
    """
    vertical_weight = 0.0 if law.horizontal else 1.0
    return dead_reckon(link, now - message_time(law, link), law.with_acceleration, vertical_weight)


@kernel
def dead_reckon(link: Record, dt: float, with_acceleration: bool, vertical_weight: float) -> Values:
    """Return position, m, and velocity, m/s, NED, of a message a time dt, s, after it.

    Args:
        link: record of LINK.
        dt: s.
        with_acceleration: along a parabola, not a straight line.
        vertical_weight: of the vertical velocity that is returned, 0 or 1.
    """
    q, v, a = link.position_ned, link.velocity_ned, link.acceleration_ned
    gain = dt if with_acceleration else 0.0
    x, y, z = gain * a[0], gain * a[1], gain * a[2]
    return (
        (
            q[0] + dt * v[0] + 0.5 * dt * x,
            q[1] + dt * v[1] + 0.5 * dt * y,
            q[2] + dt * v[2] + 0.5 * dt * z,
        ),
        (v[0] + x, v[1] + y, vertical_weight * (v[2] + z)),
    )


@kernel
def relative_position(frame: Vector, leader_position: Vector, position: Vector) -> Vector:
    """Return R_gᵀ (q_j − q_g), m: where an aircraft is in the leader's velocity frame."""
    x, y, z = (
        position[0] - leader_position[0],
        position[1] - leader_position[1],
        position[2] - leader_position[2],
    )
    return from_ned(frame, x, y, z)


@kernel
def hold_relative_position(frame: Vector, omega: Vector, leader: Vector, held: Vector) -> Values:
    """Return the motion of a neighbour that keeps its position in the leader's velocity frame.

    It is at q_g + R_g p and moves at q̇_g + R_g (ω_g × p), like slots in (27) and (28).

    Args:
        frame: cos σ_g, sin σ_g, cos γ_g, sin γ_g.
        omega: ω_g, rad/s, in that frame.
        leader: q_g and q̇_g.
        held: p (3,), m, in that frame.
    """
    (x, y, z), (u, v, w) = leader
    a, b, c = held
    da, db, dc = cross(omega[0], omega[1], omega[2], a, b, c)
    a, b, c = to_ned(frame, a, b, c)
    da, db, dc = to_ned(frame, da, db, dc)
    return (x + a, y + b, z + c), (u + da, v + db, w + dc)


@kernel
def message_ages(now: float, neighbours: Record, needs_leader: bool, inbox: Record) -> None:
    """Write the ages of the messages that one follower uses into its links.

    Args:
        now: s.
        neighbours: (N,) of NEIGHBOUR: which messages are used, and for how long.
        needs_leader: in a leader timeout the follower uses no message.
        inbox: (N,) of LINK; `age_s` is written, NaN where a message is not used.
    """
    for m in range(len(inbox)):
        inbox[m].age_s = nan
    for m in range(len(inbox)):
        other = neighbours[m]
        used = other.used and not other.excluded
        if used and now - inbox[m].received_s <= other.timeout_s:
            inbox[m].age_s = now - inbox[m].measured_s
        elif needs_leader and m == 0:
            break
