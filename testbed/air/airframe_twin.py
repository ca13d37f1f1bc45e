"""The compiled twin of `airframe`: where airframes feel the air, and what it does to them.

A test holds it to the numpy functions. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, sin

import numpy as np

from testbed.air.airframe import AHEAD, BEHIND, MEAN, POINTS, RIGHT, SLOPE, WING
from testbed.compiled import twin

_MEAN, _SLOPE = tuple(MEAN.tolist()), tuple(SLOPE.tolist())
_OUTERMOST = float(WING[RIGHT])


@twin
def rotation_of(phi, theta, psi):
    """R_NB row by row."""
    cf, sf, ct, st, cp, sp = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
    return (
        (ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp),
        (ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp),
        (-st, sf * ct, cf * ct),
    )


@twin
def place(position_ned, euler, body):
    n = len(position_ned)
    out = np.empty((n, POINTS, 3))
    for i in range(n):
        rotation = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        for k in range(POINTS):
            x, y, z = body[i, k, 0], body[i, k, 1], body[i, k, 2]
            for axis in range(3):
                row = rotation[axis]
                out[i, k, axis] = position_ned[i, axis] + row[0] * x + row[1] * y + row[2] * z
    return out


@twin
def felt(velocity_ned, euler, body):
    n = len(velocity_ned)
    wind, rates = np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        rotation = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        length = body[i, AHEAD, 0] - body[i, BEHIND, 0]
        for axis in range(3):
            slope = 0.0
            for k in range(AHEAD):
                wind[i, axis] += _MEAN[k] * velocity_ned[i, k, axis]
                slope += _SLOPE[k] * velocity_ned[i, k, axis]
            slope = slope / body[i, RIGHT, 1] * _OUTERMOST
            along = (velocity_ned[i, AHEAD, axis] - velocity_ned[i, BEHIND, axis]) / length
            rates[i, 0] += slope * rotation[axis][2]
            rates[i, 1] -= along * rotation[axis][2]
            rates[i, 2] += along * rotation[axis][1]
    return wind, rates
