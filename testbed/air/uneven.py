"""What differs from point to point of an airframe: the wind's profile, and gusts."""

from __future__ import annotations

import numpy as np

from testbed.air.airframe import felt, place
from testbed.air.gusts import Gusts
from testbed.air.mean import MeanWind
from testbed.compiled import ready_of
from testbed.state import Array


def add_uneven(
    wind: MeanWind,
    gusts: Gusts,
    position: Array,
    euler: Array,
    body: Array,
    mean: Array,
    displacement: Array,
    ambient: Array,
    velocity: Array,
    rates: Array,
    time: float,
) -> None:
    """Add what airframes feel beside the mean wind at their places, and the turns of that.

    Args:
        wind: the mean wind.
        gusts: none or more.
        position: (N, 3) m, NED.
        euler: (N, 3) rad.
        body: (N, 5, 3) m, of `airframe.points_body`.
        mean: (N, 3) m/s, the mean wind at these places.
        displacement: (3,) m, its path since time 0.
        ambient: (N, 3) m/s; written: mean wind and gusts.
        velocity: (N, 3) m/s of the air; added to.
        rates: (N, 3) rad/s about body axes; added to.
        time: s.
    """
    points = place(position, euler, body)
    beside = wind.velocity_ned(time, -points[:, :, 2]) - mean[:, np.newaxis]
    beside += gusts.velocity_ned(time, points, displacement)
    blown, turns = felt(beside, euler, body)
    ambient[:] = mean + blown
    velocity += blown
    rates += turns


READY_UNEVEN = ready_of(add_uneven, "testbed.air.uneven_twin")
