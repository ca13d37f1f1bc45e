"""The compiled twin of `fusion.navigate`, filter by filter.

That function defines what this does; a test compares them along a flight. numba compiles it at its
first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, exp, sin, sqrt, tan

import numpy as np

from testbed.compiled import twin
from testbed.frames import GRAVITY
from testbed.sensing import errors as _columns
from testbed.sensing.belief_twin import rotation_of
from testbed.sensing.fusion import HEIGHTS
from testbed.sensing.navigation import SLIP_VARIANCE, SLOWEST_AIR, SMOOTHING_S, STATES
from testbed.sensing.navigation_twin import FLOWING, drift, fuse, spread

GPS_SHARED, GPS_OWN = _columns.GPS_SHARED.start, _columns.GPS_OWN.start
GPS_NOISE, GPS_VELOCITY = _columns.GPS_NOISE.start, _columns.GPS_VELOCITY.start
BARO_SHARED, BARO_OWN, BARO_NOISE = _columns.BARO_SHARED, _columns.BARO_OWN, _columns.BARO_NOISE
HEADING_NOISE = _columns.HEADING_NOISE
VELOCITY, POSITION, HEIGHT, WIND = 3, 6, 8, 15
MOST = 8  # states that one measurement depends on


@twin
def _take(x, p, count, innovation, variance, gate, room):
    """One number, which depends on `count` states, unless it is beyond the gate."""
    where, slope, _ = room
    total = variance
    for k in range(count):
        for j in range(count):
            total += slope[k] * p[where[k], where[j]] * slope[j]
    if innovation * innovation <= gate * gate * total:
        fuse(x, p, count, innovation, variance, room)


@twin
def _take_axes(x, p, residual, accepted, g, step, hz, m, kind, off, at, room):
    """States of which `off`, from `at` on, is the innovation, less what they are now."""
    where, slope, _ = room
    first, axes = ((VELOCITY, 3), (POSITION, 2), (HEIGHT, 1))[kind]
    again = step - accepted[kind, m] > g.reset_after_s * hz
    square = total = 0.0
    for k in range(axes):
        noise = g.position_noise[first - POSITION + k] if kind else g.velocity_noise[k]
        square += (off[at + k] + x[first + k]) ** 2
        total += p[first + k, first + k] + noise**2
    if not again and square > g.gate**2 * total:
        return
    accepted[kind, m] = step
    for k in range(axes):
        noise = g.position_noise[first - POSITION + k] if kind else g.velocity_noise[k]
        axis = first + k
        innovation = off[at + k] + x[axis]
        if again:
            x[axis] -= innovation
            residual[m, axis] -= innovation
            p[axis, :] = 0.0
            p[:, axis] = 0.0
            p[axis, axis] = noise**2
        else:
            where[0], slope[0] = axis, 1.0
            fuse(x, p, 1, innovation, noise**2, room)


@twin
def _expect_fix(x, g, step, m, motions, past, errors, jump, i, off):
    """What was expected of a fix, less what it says: velocity, then position."""
    length = len(motions)
    assumed, real = (step - g.assumed) % length, (step - g.latency) % length
    for axis in range(3):
        off[axis] = past[assumed, m, axis] + motions[assumed, m, 3 + axis]
        off[axis] -= motions[real, m, 3 + axis]
        off[axis] -= errors[i, GPS_VELOCITY + axis] + x[VELOCITY + axis]
        fix = errors[i, GPS_SHARED + axis] + errors[i, GPS_OWN + axis] + errors[i, GPS_NOISE + axis]
        off[3 + axis] = past[assumed, m, 3 + axis] + motions[assumed, m, axis]
        off[3 + axis] -= motions[real, m, axis]
        off[3 + axis] -= fix + jump[i, axis] + x[POSITION + axis]


@twin
def _take_heading(x, p, pitch, yaw, wrong, g, room):
    where, slope, _ = room
    where[0], where[1], where[2] = 0, 1, 2
    slope[0], slope[1], slope[2] = tan(pitch) * cos(yaw), tan(pitch) * sin(yaw), 1.0
    innovation = slope[0] * x[0] + slope[1] * x[1] + x[2] - wrong
    _take(x, p, 3, innovation, g.heading_noise**2, g.gate, room)


@twin
def _through(x, velocity, i):
    """Velocity through the air as the filter believes it."""
    return (
        velocity[i, 0] + x[VELOCITY] - x[WIND],
        velocity[i, 1] + x[VELOCITY + 1] - x[WIND + 1],
        velocity[i, 2] + x[VELOCITY + 2],
    )


@twin
def _take_airspeed(x, p, velocity, i, equivalent, true, g, room):
    where, slope, _ = room
    a, b, c = _through(x, velocity, i)
    speed = sqrt(a * a + b * b + c * c)
    if speed > SLOWEST_AIR:
        for k in range(3):
            where[k] = VELOCITY + k
        where[3], where[4] = WIND, WIND + 1
        slope[0], slope[1], slope[2] = a / speed, b / speed, c / speed
        slope[3], slope[4] = -a / speed, -b / speed
        variance = (g.airspeed_noise * true / equivalent) ** 2
        _take(x, p, 5, speed - true, variance, g.airspeed_gate, room)


@twin
def _tilted(x, r, axis):
    """A body axis as the filter takes it to lie."""
    a, b, c = r[0][axis], r[1][axis], r[2][axis]
    return a + x[1] * c - x[2] * b, b + x[2] * a - x[0] * c, c + x[0] * b - x[1] * a


@twin
def _take_slip(x, p, velocity, i, r, room):
    where, slope, _ = room
    a, b, c = _through(x, velocity, i)
    n0, n1, n2 = _tilted(x, r, 0)
    s0, s1, s2 = _tilted(x, r, 1)
    forward = n0 * a + n1 * b + n2 * c
    if forward > SLOWEST_AIR:
        for k in range(VELOCITY + 3):
            where[k] = k
        where[6], where[7] = WIND, WIND + 1
        slope[0] = (s1 * c - s2 * b) / forward
        slope[1] = (s2 * a - s0 * c) / forward
        slope[2] = (s0 * b - s1 * a) / forward
        slope[3], slope[4], slope[5] = s0 / forward, s1 / forward, s2 / forward
        slope[6], slope[7] = -s0 / forward, -s1 / forward
        slip = (s0 * a + s1 * b + s2 * c) / forward
        fuse(x, p, MOST, slip, SLIP_VARIANCE, room)


@twin
def due(rate_hz, step, steps_hz):
    return (step * rate_hz) % steps_hz < rate_hz


@twin
def step_filters(
    rows,
    settings,
    hz,
    states,
    covariance,
    residual,
    motions,
    past,
    spread_at,
    accepted,
    flown,
    step,
    position,
    velocity,
    acceleration,
    euler,
    errors,
    heading,
    told,
    told_new,
    lost,
    jump,
):
    dt = 1.0 / hz
    decay = exp(-dt / SMOOTHING_S)
    now = step % len(motions)
    measured = False
    for m in range(len(rows)):
        i, g = rows[m], settings[m]
        r = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        f = acceleration[i, 0], acceleration[i, 1], acceleration[i, 2] - GRAVITY
        drift(states, m, errors, i, r, f, dt)
        for axis in range(3):
            motions[now, m, axis], motions[now, m, 3 + axis] = position[i, axis], velocity[i, axis]
            past[now, m, axis] = states[m, VELOCITY + axis]
            past[now, m, 3 + axis] = states[m, POSITION + axis]
        for k in range(9):
            residual[m, k] *= decay
            flown[m, k] = states[m, k] + residual[m, k]
        measured |= _measures(g, step, hz, lost[i], told_new[i])
    if measured:
        filters = states, covariance, residual, motions, past, spread_at, accepted, flown
        truth, sensed = (
            (velocity, acceleration, euler),
            (errors, heading, told, told_new, lost, jump),
        )
        _take_all(rows, settings, hz, filters, step, truth, sensed)


@twin
def _measures(g, step, hz, lost, told_new):
    """Whether a filter takes anything in at this step."""
    height = due(g.barometer_hz, step, hz) and not g.gps_height
    fixed = due(g.gps_hz, step, hz) and not lost
    return fixed or height or due(g.compass_hz, step, hz) or told_new


@twin
def _take_all(rows, settings, hz, filters, step, truth, sensed):
    """What is measured at this step, into each of the filters."""
    states, covariance, residual, motions, past, spread_at, accepted, flown = filters
    velocity, acceleration, euler = truth
    errors, heading, told, told_new, lost, jump = sensed
    rooms = np.empty((9, FLOWING)), np.empty((STATES, STATES)), np.empty((STATES, STATES))
    room = np.empty(MOST, np.int64), np.empty(MOST), np.empty(STATES)
    off, before, dt = np.empty(6), np.empty(9), 1.0 / hz
    for m in range(len(rows)):
        i, g = rows[m], settings[m]
        if not _measures(g, step, hz, lost[i], told_new[i]):
            continue
        x, p = states[m], covariance[m]
        before[:] = x[:9]
        r = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        f = acceleration[i, 0], acceleration[i, 1], acceleration[i, 2] - GRAVITY
        spread(p, r, f, g, dt * (step - spread_at[m]), rooms)
        spread_at[m] = step
        if due(g.gps_hz, step, hz) and not lost[i]:
            _expect_fix(x, g, step, m, motions, past, errors, jump, i, off)
            _take_axes(x, p, residual, accepted, g, step, hz, m, 0, off, 0, room)
            _take_axes(x, p, residual, accepted, g, step, hz, m, 1, off, 3, room)
            if g.gps_height:
                _take_axes(x, p, residual, accepted, g, step, hz, m, HEIGHTS, off, 5, room)
        if due(g.barometer_hz, step, hz) and not g.gps_height:
            off[0] = -(errors[i, BARO_SHARED] + errors[i, BARO_OWN] + errors[i, BARO_NOISE])
            _take_axes(x, p, residual, accepted, g, step, hz, m, HEIGHTS, off, 0, room)
        if due(g.compass_hz, step, hz):
            wrong = heading[i] + errors[i, HEADING_NOISE]
            _take_heading(x, p, euler[i, 1], euler[i, 2], wrong, g, room)
        if told_new[i]:
            _take_airspeed(x, p, velocity, i, told[0, i], told[1, i], g, room)
            _take_slip(x, p, velocity, i, r, room)
        for k in range(9):
            change = x[k] - before[k]
            residual[m, k] -= change
            if k >= VELOCITY:
                for late in range(len(motions)):
                    past[late, m, k - VELOCITY] += change
            flown[m, k] = x[k] + residual[m, k]
