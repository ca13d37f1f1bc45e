"""The compiled twin of `belief.believe`, aircraft by aircraft.

That function defines what this does; a test compares them along a flight. numba compiles it at its
first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, pi, sin, tan

import numpy as np

from testbed.compiled import twin
from testbed.frames import GRAVITY
from testbed.sensing import errors as _columns

GYRO_BIAS, GYRO_NOISE = _columns.GYRO_BIAS.start, _columns.GYRO_NOISE.start
FORCE_BIAS, FORCE_NOISE = _columns.FORCE_BIAS.start, _columns.FORCE_NOISE.start
VELOCITY, POSITION, TURN, PUSH = 3, 6, 9, 12


@twin
def rotation_of(euler, out):
    """R_NB of roll, pitch, yaw."""
    cf, sf = cos(euler[0]), sin(euler[0])
    ct, st = cos(euler[1]), sin(euler[1])
    cp, sp = cos(euler[2]), sin(euler[2])
    out[0, 0], out[0, 1], out[0, 2] = ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp
    out[1, 0], out[1, 1], out[1, 2] = ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp
    out[2, 0], out[2, 1], out[2, 2] = -st, sf * ct, cf * ct


@twin
def believe(out, rows, flown, states, errors):
    r = np.empty((3, 3))
    felt = np.empty(3)
    for at in range(len(rows)):
        i = rows[at]
        e, off, x = errors[i], flown[at], states[at]
        euler, push = out.euler[i], out.acceleration_ned[i]
        rotation_of(euler, r)
        for axis in range(3):
            felt[axis] = e[FORCE_BIAS + axis] + e[FORCE_NOISE + axis] - x[PUSH + axis]
            felt[axis] += r[0, axis] * push[0] + r[1, axis] * push[1]
            felt[axis] += r[2, axis] * (push[2] - GRAVITY)
        s, c = sin(euler[2]), cos(euler[2])
        ahead = c * off[0] + s * off[1]
        roll, pitch = ahead / cos(euler[1]), c * off[1] - s * off[0]
        yaw = off[2] + ahead * tan(euler[1])
        euler[0] += roll
        euler[1] += pitch
        euler[2] = pi - (pi - euler[2] - yaw) % (2.0 * pi)
        rotation_of(euler, r)
        for axis in range(3):
            push[axis] = r[axis, 0] * felt[0] + r[axis, 1] * felt[1] + r[axis, 2] * felt[2]
            turned = e[GYRO_BIAS + axis] + e[GYRO_NOISE + axis] - x[TURN + axis]
            out.rates_body[i, axis] += turned
            out.velocity_ned[i, axis] += off[VELOCITY + axis]
            out.position_ned[i, axis] += off[POSITION + axis]
        push[2] += GRAVITY
