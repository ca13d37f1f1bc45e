"""All that blows for everyone alike: the mean wind, a field of turbulence, and gusts."""

from __future__ import annotations

import numpy as np

from testbed.air.airframe import felt, place
from testbed.air.field_sample import Tables, sample
from testbed.air.gusts import Gusts
from testbed.air.mean import MeanWind
from testbed.compiled import ready_of
from testbed.state import Array


def blow(
    wind: MeanWind,
    field: Tables,
    gusts: Gusts,
    position: Array,
    euler: Array,
    body: Array,
    mean: Array,
    carried: Array,
    ambient: Array,
    velocity: Array,
    rates: Array,
    time: float,
) -> None:
    """Write what N airframes feel of it, and the turns of that.

    Args:
        wind: the mean wind, which carries field and gusts.
        field: of turbulence; it may have no boxes.
        gusts: none or more.
        position: (N, 3) m, NED.
        euler: (N, 3) rad.
        body: (N, 5, 3) m, of `airframe.points_body`.
        mean: (N, 3) m/s; written: the mean wind at these places.
        carried: (3,) m; written: the path of the air since time 0.
        ambient: (N, 3) m/s; written: what blows in the large, mean wind and gusts.
        velocity: (N, 3) m/s; written: of the air, averaged over the wing.
        rates: (N, 3) rad/s; written: turn of the air about body axes.
        time: s.
    """
    mean[:] = wind.velocity_ned(time, -position[:, 2])
    carried[:] = wind.displacement_ned(time)
    ambient[:], velocity[:], rates[:] = mean, mean, 0.0
    if len(field.first):
        in_air = position - carried
        turbulent = sample(field, in_air, place(in_air, euler, body))
        for written, each in zip((velocity, rates), felt(turbulent, euler, body), strict=True):
            written += each
    if len(gusts.rate) or not wind.uniform:
        # what differs from point to point of an airframe
        points = place(position, euler, body)
        beside = wind.velocity_ned(time, -points[:, :, 2]) - mean[:, np.newaxis]
        beside += gusts.velocity_ned(time, points, carried)
        blown, turns = felt(beside, euler, body)
        ambient += blown
        velocity += blown
        rates += turns


READY_BLOW = ready_of(blow, "testbed.air.together_twin")
