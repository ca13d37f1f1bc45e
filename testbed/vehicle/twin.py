"""The compiled twins of `fbwa.fbwa`, the door's motion and `frames.euler_rates`.

Those functions define what this does; a test compares them along a flight. numba compiles it at
its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import acos, cos, pi, radians, sin

import numpy as np

from testbed.compiled import twin
from testbed.state import Surfaces, VehicleState
from testbed.vehicle.tables import MEMORY, FbwaMemory

LEAST_BANK_LIMIT = radians(25.0)
COS_STEEPEST = cos(radians(80.0))


@twin
def _clip(value, low, high):
    return min(max(value, low), high)


@twin
def _late(memory, g, now, kind, i):
    """A command one latency ago, from the line of commands under way."""
    whole = g.command_periods
    if not memory.begun:
        return now
    younger = now if whole == 0 else memory.commands[whole - 1, kind, i]
    return younger + g.command_fraction * (memory.commands[whole, kind, i] - younger)


@twin
def fbwa(estimate, command, memory, gains):
    begun = memory.begun
    n = command.roll.shape[0]
    aileron, elevator = np.empty(n), np.empty(n)
    rudder, throttle = np.empty(n), np.empty(n)
    commands = np.empty((gains.command_periods + 1, 3, n))
    each = np.empty(n, dtype=MEMORY)
    for i in range(n):
        g, m, new = gains.each[i], memory.each[i], each[i]
        eas, tas = estimate.equivalent_airspeed[i], estimate.airspeed[i]
        roll, pitch = estimate.euler[i, 0], estimate.euler[i, 1]
        commands[0, 0, i] = command.roll[i]
        commands[0, 1, i] = command.pitch[i]
        commands[0, 2, i] = command.throttle[i]
        for k in range(gains.command_periods):
            for kind in range(3):
                before = memory.commands[k, kind, i] if begun else commands[0, kind, i]
                commands[k + 1, kind, i] = before
        roll_told = _late(memory, gains, command.roll[i], 0, i)
        pitch_told = _late(memory, gains, command.pitch[i], 1, i)
        throttle[i] = _clip(_late(memory, gains, command.throttle[i], 2, i), 0.0, g.throttle_max)

        load = g.stall_speed / eas
        limit = min(max(acos(min(load * load, 1.0)), LEAST_BANK_LIMIT), g.roll_limit)
        held_down = g.pitch_down * max(g.throttle_trim - throttle[i], 0.0)
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
            gyro = estimate.rates_body[i, a]
            fed = gains.gyro_b0 * gyro
            if begun:
                measured = fed + m.gyro_first[a]
                new.gyro_first[a] = 2.0 * fed - gains.gyro_a1 * measured + m.gyro_second[a]
            else:
                measured = gyro
                new.gyro_first[a] = gyro - fed
            new.gyro_second[a] = fed - gains.gyro_a2 * measured
            measured *= squared
            if begun:
                last = m.error[a]
                new.target[a] = m.target[a] + g.alpha_target[a] * (rate - m.target[a])
                new.error[a] = last + g.alpha_error[a] * (new.target[a] - measured - last)
                slope = (new.error[a] - last) / gains.dt - m.derivative[a]
                new.derivative[a] = m.derivative[a] + g.alpha_derivative[a] * slope
            else:
                new.target[a] = rate
                new.error[a] = rate - measured
                new.derivative[a] = m.derivative[a]
            growth = g.i_dt[a] * new.error[a]
            stuck = abs(m.output[a]) >= 1.0 and m.integral[a] * growth >= 0.0
            if stuck or eas <= g.airspeed_min:
                growth = 0.0
            new.integral[a] = _clip(m.integral[a] + growth, -g.i_max[a], g.i_max[a])
            forward = g.ff[a] * new.target[a] / (scaler * tas / eas)
            new.output[a] = (
                forward + g.p[a] * new.error[a] + g.d[a] * new.derivative[a] + new.integral[a]
            )
        mixed = _clip(new.output[0], -1.0, 1.0)
        aileron[i] = mixed * g.travel[0]
        elevator[i] = _clip(new.output[1], -1.0, 1.0) * g.travel[1]
        rudder[i] = _clip(g.rudder_mix * mixed, -1.0, 1.0) * g.rudder_travel
    return (
        Surfaces(aileron, elevator, rudder, throttle),
        FbwaMemory(True, commands, each),
    )


@twin
def _rotated(sf, cf, st, ct, sp, cp, x, y, z):
    """A body vector in NED, by three plane rotations."""
    across, below = cf * y - sf * z, sf * y + cf * z
    ahead = ct * x + st * below
    return cp * ahead - sp * across, sp * ahead + cp * across, ct * below - st * x


@twin
def motion(raw, zero, scale):
    n = raw.size // 17
    flat = (raw - zero) * scale
    position, velocity = np.empty((n, 3)), np.empty((n, 3))
    acceleration = np.empty((n, 3))
    euler, rates = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for axis in range(3):
            k = 3 * i + axis
            position[i, axis] = flat[k]
            velocity[i, axis] = flat[3 * n + k]
            euler[i, axis] = flat[9 * n + k]
            rates[i, axis] = flat[12 * n + k]
        if euler[i, 2] > pi:
            euler[i, 2] -= 2.0 * pi
        phi, theta, psi = euler[i]
        sf, cf, st, ct, sp, cp = sin(phi), cos(phi), sin(theta), cos(theta), sin(psi), cos(psi)
        at = 6 * n + 3 * i
        ax, ay, az = _rotated(sf, cf, st, ct, sp, cp, flat[at], flat[at + 1], flat[at + 2])
        p, q, r = _rotated(sf, cf, st, ct, sp, cp, rates[i, 0], rates[i, 1], rates[i, 2])
        u, v, w = velocity[i]
        acceleration[i, 0] = ax + q * w - r * v
        acceleration[i, 1] = ay + r * u - p * w
        acceleration[i, 2] = az + p * v - q * u
    airspeed, equivalent = flat[15 * n : 16 * n].copy(), flat[16 * n :].copy()
    return VehicleState(position, velocity, acceleration, euler, rates, airspeed, equivalent)


@twin
def euler_rates(euler, rates_body):
    out = np.empty_like(euler)
    for i in range(euler.shape[0]):
        p, q, r = rates_body[i]
        sf, cf = sin(euler[i, 0]), cos(euler[i, 0])
        out[i, 2] = (q * sf + r * cf) / cos(euler[i, 1])
        out[i, 1] = q * cf - r * sf
        out[i, 0] = p + out[i, 2] * sin(euler[i, 1])
    return out
