"""The compiled twin of `wake.felt`, which defines what this does."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, exp, expm1, pi, sin, sqrt

import numpy as np

from testbed.air.wake import FADED, NEAREST, ROLL_UP, SLOWEST
from testbed.compiled import twin
from testbed.frames import GRAVITY


@twin
def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@twin
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@twin
def _unit(a):
    length = sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


@twin
def _row(a):
    return a[0], a[1], a[2]


@twin
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@twin
def _between(a, b, share):
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


@twin
def _wing(euler):
    """The body's y axis."""
    sf, cf = sin(euler[0]), cos(euler[0])
    st = sin(euler[1])
    sp, cp = sin(euler[2]), cos(euler[2])
    return sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * cos(euler[1])


@twin
def _shed(tables, trails, tick, position, velocity, acceleration, euler):
    row = trails.newest[0]
    if trails.tick[row] - trails.tick[row - 1] >= tables.kept:
        row = (row + 1) % len(trails.tick)
        trails.newest[0] = row
    trails.tick[row] = tick
    for i in range(len(position)):
        speed = max(sqrt(_dot(velocity[i], velocity[i])), SLOWEST)
        forward = _unit(velocity[i])
        down = _unit(_cross(forward, _wing(euler[i])))
        right = _cross(down, forward)
        load = _dot((-acceleration[i, 0], -acceleration[i, 1], GRAVITY - acceleration[i, 2]), down)
        lift = tables.mass[i] * load
        trails.circulation[i, row] = lift / (tables.density * speed * (0.25 * pi * tables.span[i]))
        for axis in range(3):
            trails.position[i, row, axis] = position[i, axis]
            trails.forward[i, row, axis] = forward[axis]
            trails.right[i, row, axis] = right[axis]
        chord = _less(position[i], trails.position[i, row - 1])
        trails.path[i, row] = trails.path[i, row - 1] + sqrt(_dot(chord, chord))
    return row


@twin
def _abeam(tables, trails, j, newest, place):
    """Where trail j passes a place: as `wake.Places` of one pair."""
    count = len(trails.tick)
    older = newer = newest
    along = _dot(_less(place, trails.position[j, newest]), trails.forward[j, newest])
    ahead, share, found = -along, 0.0, along >= 0.0
    for _ in range(count - 1):
        if found:
            break
        newer, older = older, (older - 1) % count
        before = along
        along = _dot(_less(place, trails.position[j, older]), trails.forward[j, older])
        found = along >= 0.0
        if found:
            share = before / (before - along)
            ahead = trails.path[j, newest] - (
                trails.path[j, newer] + share * (trails.path[j, older] - trails.path[j, newer])
            )
    at = _between(trails.position[j, newer], trails.position[j, older], share)
    forward = _unit(_between(trails.forward[j, newer], trails.forward[j, older], share))
    right = _between(trails.right[j, newer], trails.right[j, older], share)
    lean = _dot(right, forward)
    right = _unit(_less(right, (lean * forward[0], lean * forward[1], lean * forward[2])))
    first, last = trails.circulation[j, newer], trails.circulation[j, older]
    tick = trails.tick[newer] + share * (trails.tick[older] - trails.tick[newer])
    age = (trails.tick[newest] - tick) * tables.dt
    return at, forward, right, first + share * (last - first), ahead, age, found


@twin
def _horseshoes(tables, span, core, flat, start, step, flow):
    """Velocities (3, M) of all pairs of unit circulation at start + points × step."""
    half_span = 0.5 * span * 0.25 * pi
    flow[:] = 0.0
    for pair in range(len(tables.pair_places)):
        drawn = half_span + flat * (0.5 * span * tables.pair_places[pair] - half_span)
        share = tables.pair_shares[pair] / (4.0 * pi)
        for k in range(len(tables.points)):
            x = start[0] + tables.points[k] * step[0]
            y = start[1] + tables.points[k] * step[1]
            z = start[2] + tables.points[k] * step[2]
            y1, y2 = y - drawn, y + drawn
            r1 = sqrt(x * x + y1 * y1 + z * z + NEAREST)
            r2 = sqrt(x * x + y2 * y2 + z * z + NEAREST)
            square = core * core + z * z
            trail1 = (1.0 - x / r1) / (y1 * y1 + square)
            trail2 = (1.0 - x / r2) / (y2 * y2 + square)
            bound = (y2 / r2 - y1 / r1) / (x * x + square)
            flow[0, k] += share * z * bound
            flow[1, k] += share * z * (trail1 - trail2)
            flow[2, k] += share * (y2 * trail2 - y1 * trail1 - x * bound)


@twin
def felt(tables, trails, tick, position, velocity, acceleration, euler):
    n, points = len(position), tables.points
    wind, roll = np.zeros((n, 3)), np.zeros(n)
    flow = np.empty((3, len(points)))
    newest = _shed(tables, trails, tick, position, velocity, acceleration, euler)
    for i in range(n):
        if not tables.feels[i]:
            continue
        wing = _wing(euler[i])
        reach = 0.5 * tables.span[i]
        below = _cross(trails.forward[i, newest], trails.right[i, newest])
        moment = 0.0
        for j in range(n):
            if j == i or not tables.sheds[j]:
                continue
            at, forward, right, circulation, ahead, age, found = _abeam(
                tables, trails, j, newest, position[i]
            )
            left = min(max((1.0 - age / tables.memory_s) / FADED, 0.0), 1.0)
            if not found or left == 0.0:
                continue
            down = _cross(forward, right)
            effective_age = age
            if tables.decay > 0.0:
                effective_age = -expm1(-tables.decay * age) / tables.decay
            span = tables.span[j]
            sunk = circulation / (0.5 * pi**2 * span) * effective_age
            flat = max(0.0, 1.0 - age * abs(circulation) / (ROLL_UP * span**2))
            to = _less(position[i], at)
            start = (_dot(to, forward) - ahead, _dot(to, right), _dot(to, down) - sunk)
            step = (
                reach * _dot(wing, forward),
                reach * _dot(wing, right),
                reach * _dot(wing, down),
            )
            _horseshoes(tables, span, tables.core[j], flat, start, step, flow)
            strength = circulation * exp(-tables.decay * age) * left
            across = (_dot(below, forward), _dot(below, right), _dot(below, down))
            x = y = z = 0.0
            for k in range(len(points)):
                weight = tables.weights[k]
                x += weight * flow[0, k]
                y += weight * flow[1, k]
                z += weight * flow[2, k]
                downwash = _dot(across, (flow[0, k], flow[1, k], flow[2, k]))
                moment += strength * weight * points[k] * downwash
            for axis in range(3):
                wind[i, axis] += strength * (x * forward[axis] + y * right[axis] + z * down[axis])
        speed = max(sqrt(_dot(velocity[i], velocity[i])), SLOWEST)
        roll[i] = tables.roll_gain[i] * moment / speed
    return wind, roll
