"""The compiled twins of `independent`: filters stepped, and turned into the air's motion."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import hypot

import numpy as np

from testbed.air.airframe_twin import rotation_of
from testbed.air.mil import HIGH, LOW
from testbed.compiled import bound, twin
from testbed.frames import COURSE_FLOOR


@twin
def _turned(phi, root, state, draw, i, axis, k, at):
    """The next three states of a part, from `at` on."""
    a, b, c = state[i, at], state[i, at + 1], state[i, at + 2]
    x, y, z = draw[i, at], draw[i, at + 1], draw[i, at + 2]
    first = phi[i, axis, k, 0, 0] * a
    first += root[i, axis, k, 0, 0] * x
    second = phi[i, axis, k, 1, 0] * a
    second += root[i, axis, k, 1, 0] * x
    second += phi[i, axis, k, 1, 1] * b
    second += root[i, axis, k, 1, 1] * y
    third = phi[i, axis, k, 2, 0] * a
    third += root[i, axis, k, 2, 0] * x
    third += phi[i, axis, k, 2, 1] * b
    third += root[i, axis, k, 2, 1] * y
    third += phi[i, axis, k, 2, 2] * c
    third += root[i, axis, k, 2, 2] * z
    return first, second, third


@twin
def _advance(state, draw, i, keep, fresh, gain, transition, root, speed, rate):
    """One aircraft's next states, in place; its turbulence, then p, q, r."""
    parts = keep.shape[1] - 1
    along = 0.0
    for k in range(parts + 1):
        state[i, k] = keep[i, k] * state[i, k] + fresh[i, k] * draw[i, k]
        if k < parts:
            along += gain[i, k] * state[i, k]
    roll = gain[i, parts] * state[i, parts]
    at = parts + 1
    across = down = pitch = yaw = 0.0
    for axis in range(2):
        velocity, turn = 0.0, 0.0
        for k in range(parts):
            a, b, c = _turned(transition, root, state, draw, i, axis, k, at)
            state[i, at], state[i, at + 1], state[i, at + 2] = a, b, c
            turn += rate[i, axis, k, 0] * a
            turn += rate[i, axis, k, 1] * b
            turn += rate[i, axis, k, 2] * c
            velocity += speed[i, axis, k, 0] * a
            velocity += speed[i, axis, k, 1] * b
            at += 3
        if axis == 0:
            across, yaw = velocity, turn
        else:
            down, pitch = velocity, turn
    return along, across, down, roll, pitch, yaw


@twin
def _axes(height, north, east, phi, theta, psi):
    """Row by row, the matrix that takes turbulence to NED."""
    horizontal = hypot(north, east)
    cosine, sine = 1.0, 0.0
    if horizontal > COURSE_FLOOR:
        cosine, sine = north / horizontal, east / horizontal
    above = min(max((height - LOW) / (HIGH - LOW), 0.0), 1.0)
    below = 1.0 - above
    x, y, z = rotation_of(phi, theta, psi)
    return (
        (above * x[0] + below * cosine, above * x[1] - below * sine, above * x[2]),
        (above * y[0] + below * sine, above * y[1] + below * cosine, above * y[2]),
        (above * z[0], above * z[1], above * z[2] + below),
    )


def ready_add_turbulence(state, filters, position, velocity, euler, mean, wind, rates):
    given = position, velocity, euler, mean, wind, rates
    return bound(_add_turbulence, state, *filters, *given, more=(np.empty_like(state),))


@twin
def _add_turbulence(
    state,
    keep,
    fresh,
    gain,
    transition,
    root,
    speed,
    rate,
    position,
    velocity,
    euler,
    mean,
    wind,
    rates,
    draw,
):
    for i in range(len(state)):
        u, v, w, p, q, r = _advance(
            state, draw, i, keep, fresh, gain, transition, root, speed, rate
        )
        north, east = velocity[i, 0] - mean[i, 0], velocity[i, 1] - mean[i, 1]
        axes = _axes(-position[i, 2], north, east, euler[i, 0], euler[i, 1], euler[i, 2])
        for axis in range(3):
            row = axes[axis]
            wind[i, axis] += row[0] * u + row[1] * v + row[2] * w
        rates[i, 0] += p
        rates[i, 1] += q
        rates[i, 2] += r
