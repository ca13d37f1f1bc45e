"""The compiled twins of `ideal.advance_ticks` and `ideal.report`, which define what these do."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan, atan2, cos, exp, hypot, sin, sqrt

import numpy as np

from testbed.compiled import twin
from testbed.frames import COURSE_FLOOR, GRAVITY
from testbed.state import VehicleState
from testbed.vehicle.ideal import Unicycle


@twin
def _sinc(angle):
    return sin(angle) / angle if angle > 0.0 else 1.0


@twin
def _resolved(y, forward, right, down):
    """A vector of the zero-roll frame of the unit vector y, in NED."""
    level = hypot(y[0], y[1])
    cs, ss = 1.0, 0.0
    if level > COURSE_FLOOR:
        cs, ss = y[0] / level, y[1] / level
    along = level * forward - y[2] * down  # of the course
    return along * cs - right * ss, along * ss + right * cs, y[2] * forward + level * down


@twin
def _rotated(x, y, z, angle, vx, vy, vz):
    """A vector turned by the rotation vector (x, y, z) of this length."""
    half = _sinc(0.5 * angle)
    first, second = _sinc(angle), 0.5 * half * half
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    return (
        vx + first * cx + second * (y * cz - z * cy),
        vy + first * cy + second * (z * cx - x * cz),
        vz + first * cz + second * (x * cy - y * cx),
    )


@twin
def _polish(rotation):
    """One Newton step to the nearest rotation."""
    excess = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            product = 0.0
            for row in range(3):
                product += rotation[row, a] * rotation[row, b]
            excess[a, b] = 0.5 * ((3.0 if a == b else 0.0) - product)
    for row in range(3):
        x, y, z = rotation[row]
        for b in range(3):
            rotation[row, b] = x * excess[0, b] + y * excess[1, b] + z * excess[2, b]


@twin
def advance_ticks(state, speed_command, turn, pole, dt, ticks):
    position, rotation = state.position.copy(), state.rotation.copy()
    speed = state.speed.copy()
    for i in range(speed.shape[0]):
        r = rotation[i]
        u, s = speed_command[i], speed[i]
        decay_midway, decay = exp(-0.5 * dt * pole[i]), exp(-dt * pole[i])
        angle = dt * sqrt(turn[i, 0] ** 2 + turn[i, 1] ** 2 + turn[i, 2] ** 2)
        for _ in range(ticks):
            x, y, z = _resolved(r[:, 0], dt * turn[i, 0], dt * turn[i, 1], dt * turn[i, 2])
            before = (r[0, 0], r[1, 0], r[2, 0])
            midway = _rotated(0.5 * x, 0.5 * y, 0.5 * z, 0.5 * angle, *before)
            for axis in range(3):
                r[0, axis], r[1, axis], r[2, axis] = _rotated(
                    x, y, z, angle, r[0, axis], r[1, axis], r[2, axis]
                )
            _polish(r)
            s_midway, s_after = u + (s - u) * decay_midway, u + (s - u) * decay
            for axis in range(3):
                mean = s * before[axis] + 4.0 * s_midway * midway[axis] + s_after * r[axis, 0]
                position[i, axis] += dt * mean / 6.0
            s = s_after
        speed[i] = s
    return Unicycle(position, rotation, speed)


@twin
def report(state, speed_command, turn, pole, wind_ned):
    n = state.speed.shape[0]
    velocity, acceleration = np.empty((n, 3)), np.empty((n, 3))
    euler, rates, airspeed = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    for i in range(n):
        s, w2, w3 = state.speed[i], turn[i, 1], turn[i, 2]
        y = state.rotation[i, :, 0]
        level = hypot(y[0], y[1])
        square = 0.0
        for axis in range(3):
            velocity[i, axis] = s * y[axis]
            square += (velocity[i, axis] - wind_ned[i, axis]) ** 2
        airspeed[i] = sqrt(square)
        acceleration[i] = _resolved(y, pole[i] * (speed_command[i] - s), s * w3, -s * w2)
        phi, theta = atan(w3 * s / GRAVITY), atan2(-y[2], level)
        euler[i] = phi, theta, atan2(y[1], y[0])
        yaw_rate = w3 / max(level, COURSE_FLOOR)
        rates[i, 0] = -yaw_rate * sin(theta)
        rates[i, 1] = w2 * cos(phi) + yaw_rate * sin(phi) * cos(theta)
        rates[i, 2] = yaw_rate * cos(phi) * cos(theta) - w2 * sin(phi)
    return VehicleState(
        state.position.copy(), velocity, acceleration, euler, rates, airspeed, airspeed.copy()
    )
