"""The compiled twin of `airframe`: where airframes feel the air, and what it does to them.

A test holds it to the numpy functions. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, sin

from testbed.air.airframe import AHEAD, BEHIND, MEAN, RIGHT, SLOPE, WING
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
def write_rotations(euler, out):
    """R_NB (N, 3, 3) of N attitudes."""
    for i in range(len(out)):
        x, y, z = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = x
        out[i, 1, 0], out[i, 1, 1], out[i, 1, 2] = y
        out[i, 2, 0], out[i, 2, 1], out[i, 2, 2] = z


@twin
def write_places(position_ned, rotations, body, out):
    for i in range(body.shape[0]):
        for k in range(body.shape[1]):
            x, y, z = body[i, k, 0], body[i, k, 1], body[i, k, 2]
            for axis in range(3):
                out[i, k, axis] = (
                    position_ned[i, axis]
                    + rotations[i, axis, 0] * x
                    + rotations[i, axis, 1] * y
                    + rotations[i, axis, 2] * z
                )


@twin
def add_felt(velocity_ned, rotations, body, wind, rates):
    for i in range(len(wind)):
        length = body[i, AHEAD, 0] - body[i, BEHIND, 0]
        p = q = r = 0.0
        for axis in range(3):
            mean = slope = 0.0
            for k in range(AHEAD):
                mean += _MEAN[k] * velocity_ned[i, k, axis]
                slope += _SLOPE[k] * velocity_ned[i, k, axis]
            slope = slope / body[i, RIGHT, 1] * _OUTERMOST
            along = (velocity_ned[i, AHEAD, axis] - velocity_ned[i, BEHIND, axis]) / length
            p += slope * rotations[i, axis, 2]
            q -= along * rotations[i, axis, 2]
            r += along * rotations[i, axis, 1]
            wind[i, axis] += mean
        rates[i, 0] += p
        rates[i, 1] += q
        rates[i, 2] += r
