"""The compiled twin of the mean wind, at aircraft and carrying the air."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import log

import numpy as np

from testbed.air.mean import LOG, POWER
from testbed.compiled import twin


@twin
def row_of(times, time):
    """The row whose slope leads on to this time."""
    return 0 if len(times) == 1 else np.searchsorted(times[1:-1], time)


@twin
def blowing(times, velocity, slope, time):
    """The wind at its profile's height."""
    row = row_of(times, time)
    since = time - times[row]
    return (
        velocity[row, 0] + since * slope[row, 0],
        velocity[row, 1] + since * slope[row, 1],
        velocity[row, 2] + since * slope[row, 2],
    )


@twin
def factor(profile, height):
    """The part of the wind's horizontal speed at a height."""
    kind, reference, shape = profile
    if kind == LOG:
        return 1.0 / log(reference / shape) * log(max(height, shape) / shape)
    if kind == POWER:
        return (max(height, 0.0) / reference) ** shape
    return 1.0


@twin
def write_mean(times, rows, slope, path, part, profile, position, velocity, displacement, time):
    north, east, down = blowing(times, rows, slope, time)
    for i in range(len(velocity)):
        share = factor(profile, -position[i, 2])
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = north * share, east * share, down
    row = row_of(times, time)
    since = time - times[row]
    for axis in range(3):
        if len(times) == 1:
            displacement[axis] = time * (part[axis] * rows[0, axis])
        else:
            mean = rows[row, axis] + 0.5 * since * slope[row, axis]
            displacement[axis] = path[row, axis] + since * part[axis] * mean
