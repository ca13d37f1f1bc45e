"""Fly-by-wire A: from pitch, roll and throttle to surfaces, as ArduPlane does it.

The law is ArduPlane's, written from its documentation and its measured behaviour and compared
with a recording of it. Angles and rates are in radians here; ArduPlane's degrees of surface, 45 at
full output, are taken up in the gains.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np

from reference.fbwa_tables import MEMORY, Columns, FbwaGains, FbwaMemory
from testbed.core.records import ActuatorCommand, Array, FbwaCommand, VehicleState

_LEAST_BANK_LIMIT = np.radians(25.0)  # stall prevention never asks for less
_COS_STEEPEST = np.cos(np.radians(80.0))  # beyond, the turn's pitch rate grows no more
_QUARTER_TURN = np.pi / 2.0


def fresh(n: int) -> FbwaMemory:
    """The memory of N autopilots that have just been switched on."""
    return FbwaMemory(False, np.zeros((0, 3, n)), np.zeros(n, dtype=MEMORY))


def settled(surfaces: ActuatorCommand, gains: FbwaGains) -> FbwaMemory:
    """The memory of N autopilots that have long held these surfaces, as before a trimmed start."""
    g = Columns(gains.each)
    held = np.array([surfaces.aileron, surfaces.elevator]) / g.travel
    held = np.minimum(np.maximum(held, -g.i_max), g.i_max)
    memory = fresh(held.shape[1])
    for name in ("integral", "output"):
        memory.each[name] = held.T
    return memory


class SlewLimiter:
    """ArduPlane's limiter of P + D of one axis, in whole milliseconds and degrees per second."""

    def __init__(self, limit: float, dt: float) -> None:
        """At rest; the limit is in deg/s, 0 for none."""
        self.limit, self.dt, self.ms = limit, dt, 0
        self.samples, self.slope, self.decayed = [0.0, 0.0], 0.0, 0.0
        self.events: list[tuple[int, int]] = []  # (side, ms) where the limit was passed anew
        self.peaks = {1: (0.0, 0), -1: (0.0, 0)}  # of each side: deg/s, ms

    def factor(self) -> float:
        """What P and D of this period are multiplied with."""
        if self.limit == 0.0:
            return 1.0
        self.ms += round(1000.0 * self.dt)
        raw = (self.samples[-1] - self.samples[-2]) / self.dt
        tau = 1.0 / (2.0 * np.pi * 25.0)
        self.slope += self.dt / (self.dt + tau) * (raw - self.slope)
        for side in (1, -1):
            size = side * self.slope
            if size > self.limit and (not self.events or self.events[-1][0] != side):
                self.events.append((side, self.ms))
            peak, ms = self.peaks[side]
            if size > peak:
                peak, ms = min(size, 10.0 * self.limit), self.ms
            elif self.ms - ms > 300:
                peak *= 1.0 - self.dt
            self.peaks[side] = peak, ms
        amplitude = (self.peaks[1][0] + self.peaks[-1][0]) / 2.0
        starts = [
            ([-np.inf, -np.inf] + [ms for where, ms in self.events if where == side])[-2]
            for side in (1, -1)
        ]
        amplitude *= np.exp(-max(self.ms - min(starts) - 900, 0) / 1000.0)
        self.decayed += 2.0 * self.dt * (amplitude - self.decayed)
        self.decayed = min(self.decayed, amplitude)
        excess = max(self.decayed - self.limit, 0.0)
        return float(self.limit / (self.limit + 1.5 * excess))

    def reduce(self, total: float) -> float:
        """P + D of this period, part of full output, reduced."""
        reduced = self.factor() * total
        self.samples.append(45.0 * np.radians(45.0 * reduced))
        return reduced


def _limited(total: Array, slew: list[SlewLimiter]) -> Array:
    """P + D (2, N), reduced by limiters for roll and pitch of each aircraft in turn."""
    reduced = [each.reduce(one) for each, one in zip(slew, total.T.ravel(), strict=True)]
    return np.reshape(reduced, total.T.shape).T


def fbwa(
    estimate: VehicleState, command: FbwaCommand, memory: FbwaMemory, gains: FbwaGains
) -> tuple[ActuatorCommand, FbwaMemory]:
    """One period of the law for N autopilots.

    Args:
        estimate: estimates of the autopilots.
        command: fly-by-wire-A commands, which act after their latency.
        memory: returned by the period before, or `fresh(n)`, or `settled(surfaces, gains)`.
        gains: `params.stack` of the N parameter sets.

    Returns:
        ActuatorCommand and the memory for the next period.
    """
    g, m = Columns(gains.each), Columns(memory.each)
    equivalent = np.maximum(estimate.equivalent_airspeed, 0.1)
    eas2tas = np.maximum(estimate.airspeed, 0.1) / equivalent
    pressure, smoothed, scaler = _airspeeds(equivalent, memory, m, g)
    eas = np.sqrt(pressure)
    tas = eas * eas2tas
    angles = estimate.euler.T[:2]
    delayed, commands = _late(command, memory, gains)
    throttle = np.minimum(np.maximum(delayed[2], 0.0), g.throttle_max)

    cosines = np.cos(angles)
    rate = _demanded_angles(delayed, throttle, smoothed, cosines, g)
    rate -= angles
    rate *= g.per_tconst
    flat = np.abs(angles[1]) < np.radians(70.0)
    rate[1] += np.where(flat, _turning(cosines, tas, g), 0.0)
    rate = np.minimum(np.maximum(rate, g.rate_low), g.rate_high)
    upright = (_QUARTER_TURN - np.abs(angles[0])) * g.fade_slope
    rate[1] *= np.where(flat, np.minimum(np.maximum(upright, 0.0), 1.0), 1.0)

    # The rate loop works on target and measurement times the square of the speed scaler.
    squared = scaler * scaler
    rates = estimate.rates_body.T[:2]
    fed = g.gyro_b[0] * rates
    if memory.begun:
        measured = fed + m.gyro_first
        gyro_first = g.gyro_b[1] * rates - g.gyro_a[0] * measured + m.gyro_second
    else:
        measured = rates
        gyro_first = rates - fed
    gyro_second = g.gyro_b[2] * rates - g.gyro_a[1] * measured
    rate *= squared
    measured = measured * squared
    if memory.begun:
        target = m.target + g.alpha_target * (rate - m.target)
        error = m.error + g.alpha_error * (target - measured - m.error)
        slope = (error - m.error) / gains.dt
        derivative = m.derivative + g.alpha_derivative * (slope - m.derivative)
    else:
        target = rate
        error = rate - measured
        derivative = m.derivative
    integral = _integrate(m, error, eas, g)
    slew = deepcopy(memory.slew) or [SlewLimiter(limit, gains.dt) for limit in g.slew_max.T.ravel()]
    limited = _limited(g.p * error + g.d * derivative, slew)
    output = g.ff * target / (scaler * eas2tas) + limited + integral

    surface = np.minimum(np.maximum(output, -1.0), 1.0)
    rudder = np.minimum(np.maximum(g.rudder_mix * surface[0], -1.0), 1.0) * g.rudder_travel
    surface *= g.travel
    each = np.empty(len(eas), dtype=MEMORY)
    each["period"] = m.period + 1
    each["pressure"], each["smoothed_airspeed"], each["scaler"] = pressure, smoothed, scaler
    each["gyro_first"], each["gyro_second"] = gyro_first.T, gyro_second.T
    each["target"], each["error"], each["derivative"] = target.T, error.T, derivative.T
    each["integral"], each["output"] = integral.T, output.T
    return (
        ActuatorCommand(surface[0], surface[1], rudder, throttle),
        FbwaMemory(True, commands, each, slew),
    )


def _airspeeds(
    eas: Array, memory: FbwaMemory, m: Columns, g: Columns
) -> tuple[Array, Array, Array]:
    """Square of the airspeed, airspeed of stall prevention, speed scaler (N,): new at 10 Hz."""

    def scaled(speed: Array) -> Array:
        return np.clip(g.scaling_speed / speed, g.scaler_low, g.scaler_high)

    if not memory.begun:
        return eas**2, eas, scaled(eas)
    due = m.period % g.airspeed_periods == 0
    pressure = np.where(
        due, (1.0 - g.pressure_weight) * m.pressure + g.pressure_weight * eas**2, m.pressure
    )
    filtered = np.sqrt(pressure)
    smoothed = np.where(due, 0.8 * m.smoothed_airspeed + 0.2 * filtered, m.smoothed_airspeed)
    old = 1.0 / (1.0 + 0.1 * 2.0 * np.pi * 2.0)  # 1 - dt / (dt + tau)
    scaler = np.where(due, old * m.scaler + (1.0 - old) * scaled(filtered), m.scaler)
    return pressure, smoothed, scaler


def _late(command: FbwaCommand, memory: FbwaMemory, gains: FbwaGains) -> tuple[Array, Array]:
    """The command as it was one latency ago (3, N), and the commands still under way."""
    whole, fraction = gains.command_periods, gains.command_fraction
    line = np.empty((whole + 2, 3, command.roll.shape[0]))
    line[0, 0] = command.roll
    line[0, 1] = command.pitch
    line[0, 2] = command.throttle
    if memory.begun:
        line[1:] = memory.commands
    else:
        line[1:] = line[0]
    return line[whole] + fraction * (line[whole + 1] - line[whole]), line[:-1].copy()


def _demanded_angles(
    delayed: Array, throttle: Array, eas: Array, cosines: Array, g: Columns
) -> Array:
    """Roll and pitch (2, N) inside the sticks' limits and the load factor the wing can bear.

    The limit of roll shrinks with the cosine of the pitch, the lowest pitch with that of the roll,
    and shares of them with them. Below the trim throttle the nose is lowered in proportion.
    """
    one_over_load = g.stall_speed / eas
    limit = np.arccos(np.minimum(one_over_load * one_over_load, 1.0))
    limit = np.maximum(limit, _LEAST_BANK_LIMIT)
    roll = np.minimum(np.maximum(delayed[0], -g.roll_limit), g.roll_limit) * cosines[1]
    flat = np.abs(cosines[0])
    pitch = np.minimum(np.maximum(delayed[1], g.pitch_low), g.pitch_high)
    pitch = np.where(pitch < 0.0, pitch * flat, pitch)
    pitch -= g.pitch_down * np.maximum(g.throttle_trim - throttle, 0.0)
    demand = np.empty((2, eas.shape[0]))
    demand[0] = np.minimum(np.maximum(roll, -limit), limit)
    demand[1] = np.maximum(pitch, g.pitch_low * flat) + g.pitch_trim
    return demand


def _turning(cosines: Array, tas: Array, g: Columns) -> Array:
    """Pitch rate (N,) of a level turn, g/V tan φ sin φ cos θ; tan φ sin φ is 1/cos φ − cos φ."""
    cos_bank = np.maximum(cosines[0], _COS_STEEPEST)
    curve = (1.0 / cos_bank - cos_bank) * cosines[1]
    rate: Array = g.turn * curve / np.maximum(tas, g.airspeed_min)
    return rate


def _integrate(m: Columns, error: Array, eas: Array, g: Columns) -> Array:
    """The integral (2, N): limited, unable to grow at full output, frozen when too slow."""
    growth = g.i_dt * error
    slow = eas <= np.stack([g.airspeed_min, 0.5 * g.airspeed_min])
    stuck = (np.abs(m.output) >= 1.0) & (m.integral * growth >= 0.0)
    integral = m.integral + np.where(stuck | slow, 0.0, growth)
    limited = np.minimum(np.maximum(integral, -g.i_max), g.i_max)
    return np.where(g.i_dt == 0.0, 0.0, limited)
