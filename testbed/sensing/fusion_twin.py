"""The compiled twin of `fusion.navigate`, aircraft by aircraft.

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
from testbed.sensing.navigation import (
    SLIP_VARIANCE,
    SLOWEST_AIR,
    SMOOTHING_S,
    STATES,
)

GPS_SHARED, GPS_OWN = _columns.GPS_SHARED.start, _columns.GPS_OWN.start
GPS_NOISE, GPS_VELOCITY = _columns.GPS_NOISE.start, _columns.GPS_VELOCITY.start
BARO_SHARED, BARO_OWN, BARO_NOISE = _columns.BARO_SHARED, _columns.BARO_OWN, _columns.BARO_NOISE
GYRO_BIAS, GYRO_NOISE = _columns.GYRO_BIAS.start, _columns.GYRO_NOISE.start
FORCE_BIAS, FORCE_NOISE = _columns.FORCE_BIAS.start, _columns.FORCE_NOISE.start
HEADING_NOISE = _columns.HEADING_NOISE
TILT, VELOCITY, POSITION, HEIGHT, TURN, PUSH, WIND = 0, 3, 6, 8, 9, 12, 15


@twin
def _block(transition, row, column, a, factor):
    for i in range(3):
        for j in range(3):
            transition[row + i, column + j] = factor * a[i, j]


@twin
def _spread(p, r, f, process, dt, transition, half):
    """Covariance p after dt, in place; transition and half are room to work in."""
    skew = np.zeros((3, 3))  # ε × f = −[f]× ε
    skew[0, 1], skew[0, 2], skew[1, 2] = f[2], -f[1], f[0]
    skew[1, 0], skew[2, 0], skew[2, 1] = -f[2], f[1], -f[0]
    turned = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turned[i, j] += skew[i, k] * r[k, j]
    transition[:] = 0.0
    for i in range(STATES):
        transition[i, i] = 1.0
    for i in range(3):
        transition[POSITION + i, VELOCITY + i] = dt
    _block(transition, TILT, TURN, r, -dt)
    _block(transition, VELOCITY, PUSH, r, -dt)
    _block(transition, VELOCITY, TILT, skew, dt)
    _block(transition, VELOCITY, TURN, turned, -0.5 * dt * dt)
    _block(transition, POSITION, TILT, skew, 0.5 * dt * dt)
    _block(transition, POSITION, PUSH, r, -0.5 * dt * dt)
    # only the first nine states gain anything from others
    for i in range(STATES):
        for j in range(STATES):
            total = p[i, j]
            if i < TURN:
                total = 0.0
                for k in range(WIND):
                    total += transition[i, k] * p[k, j]
            half[i, j] = total
    for i in range(STATES):
        for j in range(STATES):
            total = half[i, j]
            if j < TURN:
                total = 0.0
                for k in range(WIND):
                    total += half[i, k] * transition[j, k]
            p[i, j] = total
    for i in range(STATES):
        p[i, i] += process[i] * dt


@twin
def _fuse(x, p, slope, innovation, variance, along):
    """One number into the states x and covariance p."""
    total = variance
    for i in range(STATES):
        along[i] = 0.0
        for j in range(STATES):
            along[i] += p[i, j] * slope[j]
        total += along[i] * slope[i]
    for i in range(STATES):
        gain = along[i] / total
        x[i] -= gain * innovation
        for j in range(STATES):
            p[i, j] -= gain * along[j]


@twin
def _take(x, p, slope, innovation, variance, gate, along):
    total = variance
    for k in range(STATES):
        for j in range(STATES):
            total += slope[k] * p[k, j] * slope[j]
    if innovation * innovation <= gate * gate * total:
        _fuse(x, p, slope, innovation, variance, along)


@twin
def _take_axes(memory, settings, step, i, kind, off, slope, along):
    """States of which `off` is the innovation, less what they are now."""
    x, p = memory.states[i], memory.covariance[i]
    first, axes = ((VELOCITY, 3), (POSITION, 2), (HEIGHT, 1))[kind]
    noise = settings.position_noise[i, first - POSITION :] if kind else settings.velocity_noise[i]
    again = step - memory.accepted[kind, i] > settings.reset_after_s[i] * settings.rate_hz
    square = total = 0.0
    for k in range(axes):
        square += (off[k] + x[first + k]) ** 2
        total += p[first + k, first + k] + noise[k] ** 2
    if not again and square > settings.gate[i] ** 2 * total:
        return
    memory.accepted[kind, i] = step
    for k in range(axes):
        axis = first + k
        innovation = off[k] + x[axis]
        if again:
            x[axis] -= innovation
            memory.residual[i, axis] -= innovation
            p[axis, :] = 0.0
            p[:, axis] = 0.0
            p[axis, axis] = noise[k] ** 2
        else:
            slope[:] = 0.0
            slope[axis] = 1.0
            _fuse(x, p, slope, innovation, noise[k] ** 2, along)


@twin
def _take_fix(memory, settings, step, sensed, i, slope, along):
    x, e = memory.states[i], sensed.errors[i]
    length = len(memory.motions)
    assumed = (step - settings.assumed[i]) % length
    real = (step - settings.latency[i]) % length
    expected = np.empty(6)
    for axis in range(3):
        there, then = memory.motions[assumed, i], memory.motions[real, i]
        was = memory.errors[assumed, i]
        expected[axis] = was[axis] + there[3 + axis] - then[3 + axis]
        expected[axis] -= e[GPS_VELOCITY + axis] + x[VELOCITY + axis]
        fix = e[GPS_SHARED + axis] + e[GPS_OWN + axis] + e[GPS_NOISE + axis]
        expected[3 + axis] = was[3 + axis] + there[axis] - then[axis]
        expected[3 + axis] -= fix + sensed.gps_jump[i, axis] + x[POSITION + axis]
    _take_axes(memory, settings, step, i, 0, expected, slope, along)
    _take_axes(memory, settings, step, i, 1, expected[3:], slope, along)
    if settings.gps_height[i]:
        _take_axes(memory, settings, step, i, HEIGHTS, expected[5:], slope, along)


@twin
def _take_air(x, p, velocity, settings, sensed, i, r, slope, along):
    """Airspeed, then slip."""
    a, b = velocity[0] + x[VELOCITY] - x[WIND], velocity[1] + x[VELOCITY + 1] - x[WIND + 1]
    c = velocity[2] + x[VELOCITY + 2]
    speed = sqrt(a * a + b * b + c * c)
    if speed > SLOWEST_AIR:
        slope[:] = 0.0
        slope[VELOCITY], slope[VELOCITY + 1], slope[VELOCITY + 2] = a / speed, b / speed, c / speed
        slope[WIND], slope[WIND + 1] = -a / speed, -b / speed
        tas = sensed.airspeed[i]
        variance = (settings.airspeed_noise[i] * tas / sensed.equivalent_airspeed[i]) ** 2
        _take(x, p, slope, speed - tas, variance, settings.airspeed_gate[i], along)

    a, b = velocity[0] + x[VELOCITY] - x[WIND], velocity[1] + x[VELOCITY + 1] - x[WIND + 1]
    c = velocity[2] + x[VELOCITY + 2]
    n0, n1, n2 = _tilted(x, r, 0)
    s0, s1, s2 = _tilted(x, r, 1)
    forward = n0 * a + n1 * b + n2 * c
    if forward > SLOWEST_AIR:
        slope[:] = 0.0
        slope[VELOCITY], slope[VELOCITY + 1] = s0 / forward, s1 / forward
        slope[VELOCITY + 2] = s2 / forward
        slope[WIND], slope[WIND + 1] = -s0 / forward, -s1 / forward
        slope[TILT] = (s1 * c - s2 * b) / forward
        slope[TILT + 1] = (s2 * a - s0 * c) / forward
        slope[TILT + 2] = (s0 * b - s1 * a) / forward
        slip = (s0 * a + s1 * b + s2 * c) / forward
        _fuse(x, p, slope, slip, SLIP_VARIANCE, along)


@twin
def _tilted(x, r, axis):
    """A body axis as the filter takes it to lie."""
    a, b, c = r[0, axis], r[1, axis], r[2, axis]
    return a + x[1] * c - x[2] * b, b + x[2] * a - x[0] * c, c + x[0] * b - x[1] * a


@twin
def navigate(memory, settings, step, truth, sensed):
    n, hz = len(memory.states), settings.rate_hz
    dt = 1.0 / hz
    decay = exp(-dt / SMOOTHING_S)
    length = len(memory.motions)
    now = step % length
    flown = np.empty((n, 9))
    r, transition, half = np.empty((3, 3)), np.empty((STATES, STATES)), np.empty((STATES, STATES))
    off = np.empty(1)
    f, slope, along, before = np.empty(3), np.empty(STATES), np.empty(STATES), np.empty(9)
    for i in range(n):
        x, p, e, residual = (
            memory.states[i],
            memory.covariance[i],
            sensed.errors[i],
            memory.residual[i],
        )
        rotation_of(truth.euler[i], r)
        for axis in range(3):
            f[axis] = truth.acceleration_ned[i, axis]
        f[2] -= GRAVITY
        push = (
            x[1] * f[2] - x[2] * f[1],
            x[2] * f[0] - x[0] * f[2],
            x[0] * f[1] - x[1] * f[0],
        )
        for axis in range(3):
            turned = felt = 0.0
            for k in range(3):
                turned += r[axis, k] * (e[GYRO_BIAS + k] + e[GYRO_NOISE + k] - x[TURN + k])
                felt += r[axis, k] * (e[FORCE_BIAS + k] + e[FORCE_NOISE + k] - x[PUSH + k])
            x[POSITION + axis] += dt * x[VELOCITY + axis]
            x[VELOCITY + axis] += dt * (push[axis] + felt)
            x[TILT + axis] += dt * turned
            memory.motions[now, i, axis] = truth.position_ned[i, axis]
            memory.motions[now, i, 3 + axis] = truth.velocity_ned[i, axis]
            memory.errors[now, i, axis] = x[VELOCITY + axis]
            memory.errors[now, i, 3 + axis] = x[POSITION + axis]
        for k in range(9):
            residual[k] *= decay
            before[k] = x[k]

        fixed = (step * settings.gps_hz[i]) % hz < settings.gps_hz[i] and not sensed.gps_lost[i]
        height = (step * settings.barometer_hz[i]) % hz < settings.barometer_hz[i]
        height = height and not settings.gps_height[i]
        heading = (step * settings.compass_hz[i]) % hz < settings.compass_hz[i]
        if fixed or height or heading or sensed.airspeed_new[i]:
            _spread(
                p, r, f, settings.process[i], dt * (step - memory.spread_at[i]), transition, half
            )
            memory.spread_at[i] = step
            if fixed:
                _take_fix(memory, settings, step, sensed, i, slope, along)
            if height:
                off[0] = -(e[BARO_SHARED] + e[BARO_OWN] + e[BARO_NOISE])
                _take_axes(memory, settings, step, i, HEIGHTS, off, slope, along)
            if heading:
                euler = truth.euler[i]
                slope[:] = 0.0
                slope[0], slope[1] = tan(euler[1]) * cos(euler[2]), tan(euler[1]) * sin(euler[2])
                slope[2] = 1.0
                innovation = slope[0] * x[0] + slope[1] * x[1] + x[2]
                innovation -= sensed.heading[i] + e[HEADING_NOISE]
                variance = settings.heading_noise[i] ** 2
                _take(x, p, slope, innovation, variance, settings.gate[i], along)
            if sensed.airspeed_new[i]:
                _take_air(x, p, truth.velocity_ned[i], settings, sensed, i, r, slope, along)
            for k in range(9):
                change = x[k] - before[k]
                residual[k] -= change
                if k >= VELOCITY:
                    for late in range(length):
                        memory.errors[late, i, k - VELOCITY] += change
        for k in range(9):
            flown[i, k] = x[k] + residual[k]
    return flown
