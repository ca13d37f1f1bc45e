"""Where an airframe feels the air, and what the air's motion there does to it.

Five points: three along the wing, one ahead of and one behind the centre of gravity. On the wing
they are the nodes of the Gauss-Chebyshev rule of the second kind, whose weight √(1 − η²) is the
loading of an elliptic wing: by the reverse-flow theorem lift and rolling moment of such a wing are
those of the air's motion averaged with that loading, and with it times η.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.frames import rotation_ned_body
from testbed.state import Airframe, Array

_ANGLES = np.pi * np.array([3.0, 2.0, 1.0]) / 4.0
WING = np.cos(_ANGLES)  # η, left to right
_LOADS = np.sin(_ANGLES) ** 2
MEAN = _LOADS / _LOADS.sum()  # weights of the average over the wing
SLOPE = _LOADS * WING / (_LOADS * WING**2).sum()  # weights of the slope along η
RIGHT, AHEAD, BEHIND = 2, 3, 4  # the right one on the wing, and the two off it
POINTS = 5


def points_body(airframes: Sequence[Airframe]) -> Array:
    """The points (N, 5, 3) of N airframes, m from the centre of gravity along body axes."""
    out = np.zeros((len(airframes), POINTS, 3))
    for each, airframe in zip(out, airframes, strict=True):
        each[: len(WING), 1] = 0.5 * airframe.span * WING
        each[AHEAD, 0], each[BEHIND, 0] = airframe.arm, -airframe.arm
    return out


def place(position_ned: Array, euler: Array, body: Array) -> Array:
    """The points (N, 5, 3) NED, m, of airframes at positions (N, 3) with attitudes (N, 3)."""
    out: Array = position_ned[:, np.newaxis, :] + body @ rotation_ned_body(euler).swapaxes(1, 2)
    return out


def felt(velocity_ned: Array, euler: Array, body: Array) -> tuple[Array, Array]:
    """Wind (N, 3) NED and turn about body axes (N, 3) of air that moves at the points (N, 5, 3).

    The wind is the average over the wing. The turn is that of air turning as a rigid body:
    p = ∂w/∂y along the wing, q = −∂w/∂x and r = ∂v/∂x from ahead to behind.
    """
    wing = velocity_ned[:, : len(WING)]
    wind = (MEAN[:, np.newaxis] * wing).sum(axis=1)
    rotation = rotation_ned_body(euler)
    slope = (SLOPE[:, np.newaxis] * wing).sum(axis=1) / body[:, RIGHT, 1, np.newaxis] * WING[RIGHT]
    along = velocity_ned[:, AHEAD] - velocity_ned[:, BEHIND]
    along = along / (body[:, AHEAD, 0] - body[:, BEHIND, 0])[:, np.newaxis]
    rates = np.empty_like(wind)
    rates[:, 0] = (slope * rotation[:, :, 2]).sum(axis=1)
    rates[:, 1] = -(along * rotation[:, :, 2]).sum(axis=1)
    rates[:, 2] = (along * rotation[:, :, 1]).sum(axis=1)
    return wind, rates
