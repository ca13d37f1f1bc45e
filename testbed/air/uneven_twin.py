"""The compiled twin of `uneven.add_uneven`."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, pi

import numpy as np

from testbed.air.airframe_twin import add_felt, write_places, write_rotations
from testbed.air.mean_twin import blowing, factor
from testbed.compiled import bound, twin


def ready_add_uneven(wind, gusts, *places):
    """The places: what `uneven.add_uneven` takes but the time."""
    rows = wind.time, wind.velocity, wind.slope, wind.numbers
    waves = gusts.velocity, gusts.rate, gusts.offset, gusts.carried, gusts.normal
    return bound(_add, *rows, *waves, gusts.rise, gusts.end, *places, more=(0.0,))


@twin
def _add(
    times,
    rows,
    slope,
    profile,
    gust,
    rate,
    offset,
    carried,
    normal,
    rise,
    end,
    position,
    euler,
    body,
    mean,
    displacement,
    ambient,
    velocity,
    rates,
    time,
):
    n = len(position)
    rotations, blown = np.empty((n, 3, 3)), np.zeros((n, 3))
    points, beside = np.empty(body.shape), np.empty(body.shape)
    front = np.empty(len(rate))
    for g in range(len(rate)):
        front[g] = rate[g] * time + offset[g]
        for axis in range(3):
            front[g] += carried[g, axis] * displacement[axis]
    write_rotations(euler, rotations)
    write_places(position, rotations, body, points)
    north, east, down = blowing(times, rows, slope, time)
    for i in range(n):
        for k in range(body.shape[1]):
            share = factor(profile, -points[i, k, 2])
            beside[i, k, 0] = north * share - mean[i, 0]
            beside[i, k, 1] = east * share - mean[i, 1]
            beside[i, k, 2] = down - mean[i, 2]
            for g in range(len(rate)):
                along = 0.0
                for axis in range(3):
                    along += points[i, k, axis] * normal[g, axis]
                depth = min(max((front[g] - along) / rise[g], 0.0), end[g])
                part = 0.5 - 0.5 * cos(pi * depth)
                for axis in range(3):
                    beside[i, k, axis] += part * gust[g, axis]
    add_felt(beside, rotations, body, blown, rates)
    for i in range(n):
        for axis in range(3):
            ambient[i, axis] = mean[i, axis] + blown[i, axis]
            velocity[i, axis] += blown[i, axis]
