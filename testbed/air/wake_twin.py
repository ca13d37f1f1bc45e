"""The compiled twin of `wake.add_wakes`, which defines what this does."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, exp, expm1, pi, sin, sqrt

import numpy as np

from testbed.air.trails import Trails
from testbed.air.vortices import NEAREST
from testbed.air.wake import FADED, ROLL_UP, SLOWEST, Tables
from testbed.compiled import bound, twin
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
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@twin
def _row(array, i):
    return array[i, 0], array[i, 1], array[i, 2]


@twin
def _kept(array, j, row):
    """What a trail has kept in a row."""
    return array[j, row, 0], array[j, row, 1], array[j, row, 2]


@twin
def _keep(array, j, row, vector):
    array[j, row, 0], array[j, row, 1], array[j, row, 2] = vector


@twin
def _between(array, j, newer, older, share):
    a, b = _kept(array, j, newer), _kept(array, j, older)
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
        through_air, pushed = _row(velocity, i), _row(acceleration, i)
        speed = max(sqrt(_dot(through_air, through_air)), SLOWEST)
        forward = _unit(through_air)
        down = _unit(_cross(forward, _wing(_row(euler, i))))
        load = _dot((-pushed[0], -pushed[1], GRAVITY - pushed[2]), down)
        lift = tables.mass[i] * load
        trails.circulation[i, row] = lift / (tables.density * speed * (0.25 * pi * tables.span[i]))
        _keep(trails.position, i, row, _row(position, i))
        _keep(trails.forward, i, row, forward)
        _keep(trails.right, i, row, _cross(down, forward))
        chord = _less(_row(position, i), _kept(trails.position, i, row - 1))
        trails.path[i, row] = trails.path[i, row - 1] + sqrt(_dot(chord, chord))
    return row


@twin
def _past(trails, j, row, place):
    """How far a place lies ahead of a row of trail j."""
    to = _less(place, _kept(trails.position, j, row))
    return _dot(to, _kept(trails.forward, j, row))


@twin
def _abeam(tables, trails, j, newest, place):
    """Where trail j passes a place: as `wake.Places` of one pair."""
    count = len(trails.tick)
    older = newer = newest
    along = _past(trails, j, newest, place)
    ahead, share, found = -along, 0.0, along >= 0.0
    for _ in range(count - 1):
        if found:
            break
        newer, older = older, older - 1 if older > 0 else count - 1
        before = along
        along = _past(trails, j, older, place)
        found = along >= 0.0
        if found:
            share = before / (before - along)
            ahead = trails.path[j, newest] - (
                trails.path[j, newer] + share * (trails.path[j, older] - trails.path[j, newer])
            )
    at = _between(trails.position, j, newer, older, share)
    forward = _unit(_between(trails.forward, j, newer, older, share))
    right = _between(trails.right, j, newer, older, share)
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
def _add_felt(tables, trails, newest, position, velocity, euler, wind, roll):
    n, points = len(position), tables.points
    flow = np.empty((3, len(points)))
    for i in range(n):
        roll[i] = 0.0
        if not tables.feels[i]:
            continue
        place, wing = _row(position, i), _wing(_row(euler, i))
        reach = 0.5 * tables.span[i]
        below = _cross(_kept(trails.forward, i, newest), _kept(trails.right, i, newest))
        north = east = up = moment = 0.0
        for j in range(n):
            if j == i or not tables.sheds[j]:
                continue
            at, forward, right, circulation, ahead, age, found = _abeam(
                tables, trails, j, newest, place
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
            to = _less(place, at)
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
            north += strength * (x * forward[0] + y * right[0] + z * down[0])
            east += strength * (x * forward[1] + y * right[1] + z * down[1])
            up += strength * (x * forward[2] + y * right[2] + z * down[2])
        through_air = _row(velocity, i)
        speed = max(sqrt(_dot(through_air, through_air)), SLOWEST)
        roll[i] = tables.roll_gain[i] * moment / speed
        wind[i, 0] += north
        wind[i, 1] += east
        wind[i, 2] += up


def ready_add_wakes(tables, trails, drift, *given):
    """Given: what `wake.add_wakes` takes behind the drift but the tick."""
    return bound(_add, *tables, *trails, drift, *given, more=(0,))


@twin
def _add(
    span,
    mass,
    roll_gain,
    sheds,
    feels,
    points,
    weights,
    pair_places,
    pair_shares,
    core,
    density,
    decay,
    memory_s,
    dt,
    kept,
    positions,
    forward,
    right,
    circulation,
    path,
    ticks,
    newest,
    drift,
    position,
    velocity,
    acceleration,
    euler,
    ambient,
    wind,
    roll,
    tick,
):
    wings = span, mass, roll_gain, sheds, feels, points, weights
    vortices = pair_places, pair_shares, core, density, decay, memory_s, dt, kept
    tables = Tables(*wings, *vortices)
    trails = Trails(positions, forward, right, circulation, path, ticks, newest)
    n = len(position)
    in_air, through_air, carried = np.empty((n, 3)), np.empty((n, 3)), np.zeros(3)
    shedding = 0
    for i in range(n):
        shedding += sheds[i]
        for axis in range(3):
            in_air[i, axis] = position[i, axis] - drift[axis]
            through_air[i, axis] = velocity[i, axis] - ambient[i, axis]
            if sheds[i]:
                carried[axis] += ambient[i, axis]
    row = _shed(tables, trails, tick, in_air, through_air, acceleration, euler)
    _add_felt(tables, trails, row, in_air, through_air, euler, wind, roll)
    for axis in range(3):
        if shedding > 0:
            drift[axis] += dt * (carried[axis] / shedding)
