"""The compiled twins of what `navigation` does to one filter.

What is known to be zero is left out of sums. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import twin
from testbed.sensing import errors as _columns
from testbed.sensing.navigation import STATES

GYRO_BIAS, GYRO_NOISE = _columns.GYRO_BIAS.start, _columns.GYRO_NOISE.start
FORCE_BIAS, FORCE_NOISE = _columns.FORCE_BIAS.start, _columns.FORCE_NOISE.start
TILT, VELOCITY, POSITION, TURN, PUSH = 0, 3, 6, 9, 12
FLOWING = 15  # states that others gain from; the wind only stays


@twin
def drift(states, m, e, i, r, f, dt):
    """Let the errors of a filter move on."""
    a, b, c = states[m, TILT], states[m, TILT + 1], states[m, TILT + 2]
    push = b * f[2] - c * f[1], c * f[0] - a * f[2], a * f[1] - b * f[0]
    for axis in range(3):
        turned = felt = 0.0
        for k in range(3):
            turning = e[i, GYRO_BIAS + k] + e[i, GYRO_NOISE + k] - states[m, TURN + k]
            feeling = e[i, FORCE_BIAS + k] + e[i, FORCE_NOISE + k] - states[m, PUSH + k]
            turned += r[axis][k] * turning
            felt += r[axis][k] * feeling
        states[m, POSITION + axis] += dt * states[m, VELOCITY + axis]
        states[m, VELOCITY + axis] += dt * (push[axis] + felt)
        states[m, TILT + axis] += dt * turned


@twin
def _flow(r, f, dt, out):
    """The transition's rows (9, FLOWING) of tilt, velocity and position; the others only stay."""
    out[:] = 0.0
    skew = (0.0, f[2], -f[1]), (-f[2], 0.0, f[0]), (f[1], -f[0], 0.0)  # ε × f = −[f]× ε
    for i in range(3):
        for j in range(3):
            turned = skew[i][0] * r[0][j] + skew[i][1] * r[1][j] + skew[i][2] * r[2][j]
            out[TILT + i, TURN + j] = -dt * r[i][j]
            out[VELOCITY + i, TILT + j] = dt * skew[i][j]
            out[VELOCITY + i, TURN + j] = -0.5 * dt * dt * turned
            out[VELOCITY + i, PUSH + j] = -dt * r[i][j]
            out[POSITION + i, TILT + j] = 0.5 * dt * dt * skew[i][j]
            out[POSITION + i, PUSH + j] = -0.5 * dt * dt * r[i][j]
        out[POSITION + i, VELOCITY + i] = dt


@twin
def _moved(flow, p, out):
    """The transition times p (STATES, STATES); the width is asked for, so that loops stay loops."""
    width = p.shape[1]
    for i in range(3):
        t, v, x = flow[TILT + i], flow[VELOCITY + i], flow[POSITION + i]
        for j in range(width):
            out[TILT + i, j] = p[TILT + i, j] + t[9] * p[9, j] + t[10] * p[10, j] + t[11] * p[11, j]
        for j in range(width):
            tilted = v[0] * p[0, j] + v[1] * p[1, j] + v[2] * p[2, j] + p[VELOCITY + i, j]
            turned = tilted + v[9] * p[9, j] + v[10] * p[10, j] + v[11] * p[11, j]
            out[VELOCITY + i, j] = turned + v[12] * p[12, j] + v[13] * p[13, j] + v[14] * p[14, j]
        for j in range(width):
            tilted = x[0] * p[0, j] + x[1] * p[1, j] + x[2] * p[2, j]
            came = tilted + x[VELOCITY + i] * p[VELOCITY + i, j] + p[POSITION + i, j]
            out[POSITION + i, j] = came + x[12] * p[12, j] + x[13] * p[13, j] + x[14] * p[14, j]
    for i in range(TURN, STATES):
        for j in range(width):
            out[i, j] = p[i, j]


@twin
def spread(p, r, f, g, dt, rooms):
    """Covariance p after dt, in place; rooms to work in are (9, FLOWING) and two as large as p."""
    flow, one, two = rooms
    _flow(r, f, dt, flow)
    _moved(flow, p, one)
    for i in range(STATES):
        for j in range(STATES):
            two[i, j] = one[j, i]
    _moved(flow, two, one)
    for i in range(STATES):
        for j in range(STATES):
            p[i, j] = one[j, i]
        p[i, i] += g.process[i] * dt


@twin
def fuse(x, p, count, innovation, variance, room):
    """One number, which depends on `count` states, into the states x and covariance p."""
    where, slope, along = room
    width = len(along)
    total = variance
    for i in range(width):
        each = 0.0
        for c in range(count):
            each += p[i, where[c]] * slope[c]
        along[i] = each
    for c in range(count):
        total += along[where[c]] * slope[c]
    for i in range(width):
        gain = along[i] / total
        x[i] -= gain * innovation
        for j in range(width):
            p[i, j] -= gain * along[j]
