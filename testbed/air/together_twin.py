"""The compiled twin of `together.blow`."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, pi

import numpy as np

from testbed.air.airframe_twin import add_felt, write_places, write_rotations
from testbed.air.field_twin import write_sample
from testbed.air.mean import EVEN
from testbed.air.mean_twin import blowing, factor, write_mean
from testbed.compiled import bound, twin


def ready_blow(wind, field, gusts, *places):
    """The places: what `together.blow` takes but the time."""
    rows = wind.time, wind.velocity, wind.slope, wind.path, wind.carried, wind.numbers
    waves = gusts.velocity, gusts.rate, gusts.offset, gusts.carried, gusts.normal
    return bound(_blow, *rows, *field, *waves, gusts.rise, gusts.end, *places, more=(0.0,))


@twin
def _write_beside(
    times,
    rows,
    slope,
    profile,
    gust,
    rate,
    offset,
    part,
    normal,
    rise,
    end,
    points,
    mean,
    carried,
    time,
    out,
):
    """What blows at the points beside the mean wind of their airframe."""
    front = np.empty(len(rate))
    for g in range(len(rate)):
        front[g] = rate[g] * time + offset[g]
        for axis in range(3):
            front[g] += part[g, axis] * carried[axis]
    north, east, down = blowing(times, rows, slope, time)
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            share = factor(profile, -points[i, k, 2])
            out[i, k, 0] = north * share - mean[i, 0]
            out[i, k, 1] = east * share - mean[i, 1]
            out[i, k, 2] = down - mean[i, 2]
            for g in range(len(rate)):
                along = 0.0
                for axis in range(3):
                    along += points[i, k, axis] * normal[g, axis]
                depth = min(max((front[g] - along) / rise[g], 0.0), end[g])
                share = 0.5 - 0.5 * cos(pi * depth)
                for axis in range(3):
                    out[i, k, axis] += share * gust[g, axis]


@twin
def _blow(
    times,
    rows,
    slope,
    path,
    part,
    profile,
    values,
    first,
    counts,
    axes,
    near,
    gust,
    rate,
    offset,
    gust_part,
    normal,
    rise,
    end,
    position,
    euler,
    body,
    mean,
    carried,
    ambient,
    velocity,
    rates,
    time,
):
    write_mean(times, rows, slope, path, part, profile, position, mean, carried, time)
    ambient[:] = mean
    velocity[:] = mean
    rates[:] = 0.0
    uneven = len(rate) > 0 or profile[0] != EVEN
    if not (uneven or len(first)):
        return
    rotations, places = np.empty((len(position), 3, 3)), np.empty_like(position)
    points, air = np.empty(body.shape), np.empty(body.shape)
    write_rotations(euler, rotations)
    if len(first):
        for i in range(len(position)):
            for axis in range(3):
                places[i, axis] = position[i, axis] - carried[axis]
        write_places(places, rotations, body, points)
        write_sample(values, first, counts, axes, near, places, points, air)
        add_felt(air, rotations, body, velocity, rates)
    if uneven:
        write_places(position, rotations, body, points)
        row = times, rows, slope, profile
        waves = gust, rate, offset, gust_part, normal, rise, end
        _write_beside(*row, *waves, points, mean, carried, time, air)
        blown = places
        blown[:] = 0.0
        add_felt(air, rotations, body, blown, rates)
        for i in range(len(position)):
            for axis in range(3):
                ambient[i, axis] += blown[i, axis]
                velocity[i, axis] += blown[i, axis]
