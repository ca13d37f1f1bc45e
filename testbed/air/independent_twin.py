"""The compiled twins of `independent.advance_filters` and `independent.turbulence_axes`."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import hypot

import numpy as np

from testbed.air.airframe_twin import rotation_of
from testbed.air.mil import HIGH, LOW
from testbed.compiled import twin
from testbed.frames import COURSE_FLOOR


@twin
def advance_filters(state, draw, filters):
    n, parts = len(state), filters.keep.shape[1] - 1
    out, turbulence, rates = np.empty_like(state), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for k in range(parts + 1):
            out[i, k] = filters.keep[i, k] * state[i, k] + filters.fresh[i, k] * draw[i, k]
        total = 0.0
        for k in range(parts):
            total += filters.gain[i, k] * out[i, k]
        turbulence[i, 0] = total
        rates[i, 0] = filters.gain[i, parts] * out[i, parts]
        at = parts + 1
        for axis in range(2):
            speed, rate = 0.0, 0.0
            for k in range(parts):
                phi, root = filters.transition[i, axis, k], filters.root[i, axis, k]
                for row in range(3):
                    value = 0.0
                    for column in range(row + 1):
                        value += phi[row, column] * state[i, at + column]
                        value += root[row, column] * draw[i, at + column]
                    out[i, at + row] = value
                    rate += filters.rate[i, axis, k, row] * value
                for row in range(2):
                    speed += filters.speed[i, axis, k, row] * out[i, at + row]
                at += 3
            turbulence[i, 1 + axis] = speed
            rates[i, 2 - axis] = rate
    return out, turbulence, rates


@twin
def turbulence_axes(height, velocity_through_air_ned, euler):
    n = len(height)
    out = np.empty((n, 3, 3))
    for i in range(n):
        north, east = velocity_through_air_ned[i, 0], velocity_through_air_ned[i, 1]
        horizontal = hypot(north, east)
        cosine, sine = 1.0, 0.0
        if horizontal > COURSE_FLOOR:
            cosine, sine = north / horizontal, east / horizontal
        above = min(max((height[i] - LOW) / (HIGH - LOW), 0.0), 1.0)
        body = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        for row in range(3):
            for column in range(3):
                out[i, row, column] = above * body[row][column]
        out[i, 0, 0] += (1.0 - above) * cosine
        out[i, 1, 1] += (1.0 - above) * cosine
        out[i, 0, 1] -= (1.0 - above) * sine
        out[i, 1, 0] += (1.0 - above) * sine
        out[i, 2, 2] += 1.0 - above
    return out
