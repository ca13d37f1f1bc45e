"""The compiled twin of `belief.believe`, aircraft by aircraft.

That function defines what this does; a test compares them along a flight. numba compiles it at its
first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, pi, sin, tan

from testbed.compiled import twin
from testbed.frames import GRAVITY
from testbed.sensing import errors as _columns
from testbed.state import VehicleState

GYRO_BIAS, GYRO_NOISE = _columns.GYRO_BIAS.start, _columns.GYRO_NOISE.start
FORCE_BIAS, FORCE_NOISE = _columns.FORCE_BIAS.start, _columns.FORCE_NOISE.start
VELOCITY, POSITION, TURN, PUSH = 3, 6, 9, 12
FIELDS = tuple(VehicleState._fields.index(name) for name in VehicleState._fields[:5])
AT, MOVES, PUSHED, POINTS, TURNS = FIELDS  # rows of a state's vectors


@twin
def rotation_of(phi, theta, psi):
    """R_NB row by row, of roll, pitch, yaw."""
    cf, sf, ct, st, cp, sp = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
    return (
        (ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp),
        (ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp),
        (-st, sf * ct, cf * ct),
    )


@twin
def write_beliefs(vectors, rows, flown, states, errors):
    for m in range(len(rows)):
        i = rows[m]
        phi, theta, psi = vectors[POINTS, i, 0], vectors[POINTS, i, 1], vectors[POINTS, i, 2]
        x, y, z = rotation_of(phi, theta, psi)
        north, east = vectors[PUSHED, i, 0], vectors[PUSHED, i, 1]
        down = vectors[PUSHED, i, 2] - GRAVITY
        a = errors[i, FORCE_BIAS] + errors[i, FORCE_NOISE] - states[m, PUSH]
        b = errors[i, FORCE_BIAS + 1] + errors[i, FORCE_NOISE + 1] - states[m, PUSH + 1]
        c = errors[i, FORCE_BIAS + 2] + errors[i, FORCE_NOISE + 2] - states[m, PUSH + 2]
        a += x[0] * north + y[0] * east
        a += z[0] * down
        b += x[1] * north + y[1] * east
        b += z[1] * down
        c += x[2] * north + y[2] * east
        c += z[2] * down
        s, t = sin(psi), cos(psi)
        ahead = t * flown[m, 0] + s * flown[m, 1]
        phi += ahead / cos(theta)
        psi = pi - (pi - psi - (flown[m, 2] + ahead * tan(theta))) % (2.0 * pi)
        theta += t * flown[m, 1] - s * flown[m, 0]
        vectors[POINTS, i, 0], vectors[POINTS, i, 1], vectors[POINTS, i, 2] = phi, theta, psi
        x, y, z = rotation_of(phi, theta, psi)
        vectors[PUSHED, i, 0] = x[0] * a + x[1] * b + x[2] * c
        vectors[PUSHED, i, 1] = y[0] * a + y[1] * b + y[2] * c
        vectors[PUSHED, i, 2] = z[0] * a + z[1] * b + z[2] * c + GRAVITY
        for axis in range(3):
            turned = errors[i, GYRO_BIAS + axis] + errors[i, GYRO_NOISE + axis]
            vectors[TURNS, i, axis] += turned - states[m, TURN + axis]
            vectors[MOVES, i, axis] += flown[m, VELOCITY + axis]
            vectors[AT, i, axis] += flown[m, POSITION + axis]
