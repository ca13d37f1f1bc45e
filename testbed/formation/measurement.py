"""Bringing received measurements to the control sample time, [HBH23] sec. 8.3."""

from __future__ import annotations

import numpy as np

from testbed.compiled import twin_of
from testbed.state import Array, Inbox, Truths


def corrected(
    inbox: Inbox, now: float, from_timestamp: bool, with_acceleration: Truths
) -> tuple[Array, Array]:
    """Positions and velocities (n, N, 3) of the others at the time `now` (s).

    The paper takes one Euler step along the velocity from the time of receipt, so that what the
    network took stays in. Stepping from the sender's timestamp, as the authors' code does, needs
    synchronised clocks and takes it out. For the agents (n,) that reckon with the acceleration
    too, the step is a parabola and the velocity moves.
    """
    since = inbox.stamp_s if from_timestamp else inbox.received_s
    lag = np.expand_dims(now - since, 2)
    position = inbox.position_ned + lag * inbox.velocity_ned
    gained = np.where(np.expand_dims(with_acceleration, (1, 2)), lag * inbox.acceleration_ned, 0.0)
    return position + 0.5 * lag * gained, inbox.velocity_ned + gained


def ages(now: float, stamp_s: Array, received_s: Array, unheeded: Truths, limit: float) -> Array:
    """Age (n, N) s at the time `now` of what each agent uses of each aircraft; nan: it does not.

    Args:
        now: s.
        stamp_s: (n, N) of the newest message, by its sender.
        received_s: (n, N) its arrival, by its receiver; nan: nothing heard yet.
        unheeded: (n, N) whose messages are not used.
        limit: s since the arrival, after which a message is not used.
    """
    used = (now - received_s <= limit) & ~unheeded
    return np.where(used, now - stamp_s, np.nan)


AGES = twin_of(ages, "testbed.formation.laws_twin")
