"""Bringing received measurements to the control sample time, [HBH23] sec. 8.3."""

from __future__ import annotations

import numpy as np

from reference.formation_arrays import cross, rotate
from testbed.core.records import Array, BoolArray, Messages


def times(inbox: Messages, from_timestamp: bool) -> Array:
    """What the law takes for the times (n, N) s of its messages: their stamps or their receipt."""
    return inbox.stamp_s if from_timestamp else inbox.received_s


def corrected(
    inbox: Messages, now: float, from_timestamp: bool, with_acceleration: BoolArray
) -> tuple[Array, Array]:
    """Positions and velocities (n, N, 3) of the others at the time `now` (s).

    The paper takes one Euler step along the velocity from the time of receipt, so that what the
    network took stays in. Stepping from the sender's timestamp, as the authors' code does, needs
    synchronised clocks and takes it out. For the agents (n,) that reckon with the acceleration
    too, the step is a parabola and the velocity moves.
    """
    lag = np.expand_dims(now - times(inbox, from_timestamp), 2)
    position = inbox.position_ned + lag * inbox.velocity_ned
    gained = np.where(np.expand_dims(with_acceleration, (1, 2)), lag * inbox.acceleration_ned, 0.0)
    return position + 0.5 * lag * gained, inbox.velocity_ned + gained


def places(frame: Array, positions: Array) -> Array:
    """Positions in the leader's velocity frame: R_gᵀ (q_j − q_g), (n, N, 3) m.

    Args:
        frame: R_g (n, 3, 3), as each agent computes it.
        positions: (n, N, 3) m, the leader's first.
    """
    return rotate(frame.transpose(0, 2, 1), positions - positions[:, :1])


def kept(
    frame: Array, rate: Array, place: Array, held: BoolArray, positions: Array, velocities: Array
) -> tuple[Array, Array]:
    """Positions and velocities (n, N, 3) where the held keep their place in the formation.

    They are at q_g + R_g p_j and move at q̇_g + R_g (ω_g × p_j), as slots do by (27) and (28). To
    keep them where they were over the ground would be to fall back at the speed of flight.

    Args:
        frame: R_g (n, 3, 3).
        rate: ω_g (n, 3) rad/s in that frame.
        place: p (n, N, 3) m in that frame.
        held: (n, N, 3) aircraft that are held there; the others are unchanged.
        positions: (n, N, 3) m, the leader's first.
        velocities: (n, N, 3) m/s.
    """
    return (
        np.where(held, positions[:, :1] + rotate(frame, place), positions),
        np.where(held, velocities[:, :1] + rotate(frame, cross(rate, place)), velocities),
    )


def ages(
    now: float,
    stamp_s: Array,
    received_s: Array,
    excluded: BoolArray,
    limit: Array | float,
    needs_leader: bool,
) -> Array:
    """Age (n, N) s at the time `now` of what each agent uses of each aircraft; nan: it does not.

    Args:
        now: s.
        stamp_s: (n, N) of the newest message, by its sender.
        received_s: (n, N) its arrival, by its receiver; nan: no message yet.
        excluded: (n, N) whose messages are not used.
        limit: (n, N) s since the arrival, after which a message is not used; or one for all.
        needs_leader: a follower that does not use the leader's message uses none.
    """
    used = (now - received_s <= limit) & ~excluded
    if needs_leader:
        used &= used[:, :1].copy()
    return np.where(used, now - stamp_s, np.nan)
