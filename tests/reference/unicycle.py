"""The ideal vehicle: n extended unicycles, the model that the formation law is proved on.

q̇ = s R e1        ṡ = p (u − s)        Ṙ = R [ω]×        y = R e1        [HBH23] eqs. (1)-(4)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.frames import velocity_frame
from testbed.core.records import Array


class Unicycle(NamedTuple):
    """The state of n extended unicycles."""

    position: Array  # q (n, 3) m, NED
    rotation: Array  # R (n, 3, 3); its first column is y, the direction of flight in NED
    speed: Array  # s (n,) over the ground, m/s


def unicycle(position: Array, velocity: Array) -> Unicycle:
    """Unicycles at positions (n, 3) m with velocities over the ground (n, 3) m/s, without roll."""
    position, velocity = np.array(position, dtype=float), np.asarray(velocity, dtype=float)
    speed = np.sqrt((velocity**2).sum(axis=1))
    return Unicycle(position, velocity_frame(velocity), speed)
