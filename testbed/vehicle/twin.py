"""The compiled twins of `fbwa`, `motion` and `frames.euler_rates`.

Those functions define what this does; a test compares them along a flight. numba compiles it at
its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import acos, cos, pi, radians, sin

import numpy as np

from testbed.compiled import bound, twin
from testbed.state import Surfaces
from testbed.vehicle.tables import FbwaMemory

LEAST_BANK_LIMIT = radians(25.0)
COS_STEEPEST = cos(radians(80.0))


@twin
def _clip(value, low, high):
    return min(max(value, low), high)


def fbwa(estimate, command, memory, gains):
    n = len(command.roll)
    commands = np.empty((gains.command_periods + 1, 3, n))
    if memory.begun:
        commands[:] = memory.commands
    surfaces, after = np.empty((4, n)), FbwaMemory(memory.begun, commands, memory.each.copy())
    _fly(*_parts(estimate, command, after, gains), surfaces)
    return Surfaces(*surfaces), after._replace(begun=True)


def ready_fly(estimate, command, memory, gains, surfaces):
    return bound(_fly, *_parts(estimate, command, memory, gains), surfaces)


def _parts(estimate, command, memory, gains):
    return (
        estimate.euler,
        estimate.rates_body,
        estimate.airspeed,
        estimate.equivalent_airspeed,
        command.roll,
        command.pitch,
        command.throttle,
        memory.begun,
        memory.commands,
        memory.each,
        gains.command_fraction,
        gains.dt,
        gains.gyro_b0,
        gains.gyro_a1,
        gains.gyro_a2,
        gains.each,
    )


@twin
def _late(commands, fraction, begun, now, kind, i):
    """A command one latency ago, from the line of commands under way; it takes its place there."""
    if not begun:
        commands[:, kind, i] = now
        return now
    whole = len(commands) - 1
    younger = now if whole == 0 else commands[whole - 1, kind, i]
    late = younger + fraction * (commands[whole, kind, i] - younger)
    for k in range(whole, 0, -1):
        commands[k, kind, i] = commands[k - 1, kind, i]
    commands[0, kind, i] = now
    return late


@twin
def _fly(
    euler,
    rates_body,
    airspeed,
    equivalent_airspeed,
    rolls,
    pitches,
    throttles,
    begun,
    commands,
    memory,
    fraction,
    dt,
    gyro_b0,
    gyro_a1,
    gyro_a2,
    gains,
    surfaces,
):
    n = len(memory)
    for i in range(n):
        g, m = gains[i], memory[i]
        eas, tas = equivalent_airspeed[i], airspeed[i]
        roll, pitch = euler[i, 0], euler[i, 1]
        roll_told = _late(commands, fraction, begun, rolls[i], 0, i)
        pitch_told = _late(commands, fraction, begun, pitches[i], 1, i)
        throttle_told = _late(commands, fraction, begun, throttles[i], 2, i)
        throttle = _clip(throttle_told, 0.0, g.throttle_max)

        load = g.stall_speed / eas
        limit = min(max(acos(min(load * load, 1.0)), LEAST_BANK_LIMIT), g.roll_limit)
        held_down = g.pitch_down * max(g.throttle_trim - throttle, 0.0)
        pitch_demand = _clip(pitch_told, g.pitch_low, g.pitch_high) - held_down
        cos_bank = max(cos(roll), COS_STEEPEST)
        curve = (1.0 / cos_bank - cos_bank) * cos(pitch)
        turning = g.turn * curve / max(tas, g.airspeed_min)
        upright = _clip((0.5 * pi - abs(roll)) * g.fade_slope, 0.0, 1.0)
        wanted = (
            (_clip(roll_told, -limit, limit) - roll) * g.per_tconst[0],
            (max(pitch_demand, g.pitch_low) + g.pitch_trim - pitch) * g.per_tconst[1] + turning,
        )

        scaler = _clip(g.scaling_speed / eas, g.scaler_low, g.scaler_high)
        squared = scaler * scaler
        for a in range(2):
            rate = _clip(wanted[a], g.rate_low[a], g.rate_high[a])
            rate *= squared * upright if a == 1 else squared
            gyro = rates_body[i, a]
            fed = gyro_b0 * gyro
            if begun:
                measured = fed + m.gyro_first[a]
                m.gyro_first[a] = 2.0 * fed - gyro_a1 * measured + m.gyro_second[a]
            else:
                measured = gyro
                m.gyro_first[a] = gyro - fed
            m.gyro_second[a] = fed - gyro_a2 * measured
            measured *= squared
            if begun:
                last = m.error[a]
                m.target[a] = m.target[a] + g.alpha_target[a] * (rate - m.target[a])
                m.error[a] = last + g.alpha_error[a] * (m.target[a] - measured - last)
                slope = (m.error[a] - last) / dt - m.derivative[a]
                m.derivative[a] = m.derivative[a] + g.alpha_derivative[a] * slope
            else:
                m.target[a] = rate
                m.error[a] = rate - measured
                m.derivative[a] = m.derivative[a]
            growth = g.i_dt[a] * m.error[a]
            stuck = abs(m.output[a]) >= 1.0 and m.integral[a] * growth >= 0.0
            if stuck or eas <= g.airspeed_min:
                growth = 0.0
            m.integral[a] = _clip(m.integral[a] + growth, -g.i_max[a], g.i_max[a])
            forward = g.ff[a] * m.target[a] / (scaler * tas / eas)
            m.output[a] = forward + g.p[a] * m.error[a] + g.d[a] * m.derivative[a] + m.integral[a]
        mixed = _clip(m.output[0], -1.0, 1.0)
        surfaces[0, i] = mixed * g.travel[0]
        surfaces[1, i] = _clip(m.output[1], -1.0, 1.0) * g.travel[1]
        surfaces[2, i] = _clip(g.rudder_mix * mixed, -1.0, 1.0) * g.rudder_travel
        surfaces[3, i] = throttle


@twin
def _rotated(sf, cf, st, ct, sp, cp, x, y, z):
    """A body vector in NED, by three plane rotations."""
    across, below = cf * y - sf * z, sf * y + cf * z
    ahead = ct * x + st * below
    return cp * ahead - sp * across, sp * ahead + cp * across, ct * below - st * x


@twin
def motion(said, wanted, zero, scale, flat):
    n = len(said)
    for i in range(n):
        if not wanted[i]:
            continue
        for k in range(15):
            flat[3 * (n * (k // 3) + i) + k % 3] = (said[i, k] - zero[k]) * scale[k]
        for k in range(2):
            flat[n * (15 + k) + i] = (said[i, 15 + k] - zero[15 + k]) * scale[15 + k]
        v, a, e, w = 3 * (n + i), 3 * (2 * n + i), 3 * (3 * n + i), 3 * (4 * n + i)
        if flat[e + 2] > pi:
            flat[e + 2] -= 2.0 * pi
        phi, theta, psi = flat[e], flat[e + 1], flat[e + 2]
        sf, cf, st, ct, sp, cp = sin(phi), cos(phi), sin(theta), cos(theta), sin(psi), cos(psi)
        ax, ay, az = _rotated(sf, cf, st, ct, sp, cp, flat[a], flat[a + 1], flat[a + 2])
        p, q, r = _rotated(sf, cf, st, ct, sp, cp, flat[w], flat[w + 1], flat[w + 2])
        flat[a] = ax + q * flat[v + 2] - r * flat[v + 1]
        flat[a + 1] = ay + r * flat[v] - p * flat[v + 2]
        flat[a + 2] = az + p * flat[v + 1] - q * flat[v]


@twin
def lost(position_ned, broken, lowest, out):
    for i in range(len(out)):
        out[i] = broken[i] or not -position_ned[i, 2] >= lowest


def euler_rates(euler, rates_body):
    out = np.empty_like(euler)
    write_euler_rates(euler, rates_body, out)
    return out


@twin
def write_euler_rates(euler, rates_body, out):
    for i in range(euler.shape[0]):
        p, q, r = rates_body[i]
        sf, cf = sin(euler[i, 0]), cos(euler[i, 0])
        out[i, 2] = (q * sf + r * cf) / cos(euler[i, 1])
        out[i, 1] = q * cf - r * sf
        out[i, 0] = p + out[i, 2] * sin(euler[i, 1])
