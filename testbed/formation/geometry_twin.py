"""The compiled twin of `geometry`: frames, rotations and the followers' true slots.

A test holds it to the numpy functions. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan2, hypot, isnan

import numpy as np

from testbed.compiled import twin
from testbed.frames import COURSE_FLOOR


@twin
def frame_of(x, y, z):
    """The angles of (22)-(24): cos σ, sin σ, cos γ, sin γ."""
    horizontal = hypot(x, y)
    speed = hypot(horizontal, z)
    cs, ss = (x / horizontal, y / horizontal) if horizontal > COURSE_FLOOR else (1.0, 0.0)
    return cs, ss, horizontal / speed, -z / speed


@twin
def to_ned(cs, ss, cg, sg, x, y, z):
    return cg * cs * x - ss * y + sg * cs * z, cg * ss * x + cs * y + sg * ss * z, -sg * x + cg * z


@twin
def cross(a, b, c, x, y, z):
    return b * z - c * y, c * x - a * z, a * y - b * x


def true_slots(position, velocity, offsets, altitudes):
    n = len(position) - 1
    written = np.empty((n, 3)), np.empty((n, 3)), np.empty((3, n))
    write_true_slots(position, velocity, offsets, altitudes, *written)
    return written


@twin
def write_true_slots(position, velocity, offsets, altitudes, slot, error, motion):
    leader = velocity[0]
    for i in range(len(slot)):
        holding = not isnan(altitudes[i])
        cs, ss, cg, sg = frame_of(leader[0], leader[1], 0.0 if holding else leader[2])
        chi = to_ned(cs, ss, cg, sg, offsets[i + 1, 0], offsets[i + 1, 1], offsets[i + 1, 2])
        for axis in range(3):
            slot[i, axis] = position[0, axis] + chi[axis]
        if holding:
            slot[i, 2] = -altitudes[i]
        for axis in range(3):
            error[i, axis] = position[i + 1, axis] - slot[i, axis]
        north, east, down = velocity[i + 1]
        horizontal = hypot(north, east)
        motion[0, i] = hypot(horizontal, down)
        motion[1, i] = atan2(east, north)
        motion[2, i] = atan2(-down, horizontal)
