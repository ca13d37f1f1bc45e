"""Bringing received measurements to the control sample time, [HBH23] sec. 8.3."""

from __future__ import annotations

import numpy as np

from testbed.state import Array, Inbox


def corrected_positions(inbox: Inbox, now: float, from_timestamp: bool) -> Array:
    """Positions (n, N, 3) moved to the time `now` (s) by one Euler step along the velocity.

    The paper steps from the time of receipt, so that what the network took stays in. Stepping
    from the sender's timestamp, as the authors' code does, needs synchronised clocks and takes it
    out.
    """
    since = inbox.stamp_s if from_timestamp else inbox.received_s
    return inbox.position_ned + np.expand_dims(now - since, 2) * inbox.velocity_ned
