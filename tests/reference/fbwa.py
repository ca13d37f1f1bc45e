"""Fly-by-wire A: from pitch, roll and throttle to surfaces, as ArduPlane does it.

The law is ArduPlane's, written from its documentation and its measured behaviour and compared
with a recording of it. Angles and rates are in radians here; ArduPlane's degrees of surface, 45 at
full output, are taken up in the gains. The slew limiter (RLL_RATE_SMAX, PTCH_RATE_SMAX), which
acts on sustained oscillation only, is left out.
"""

from __future__ import annotations

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
    memory = fresh(held.shape[1])
    for name in ("integral", "output"):
        memory.each[name] = np.minimum(np.maximum(held, -g.i_max), g.i_max).T
    return memory


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
    eas, tas = estimate.equivalent_airspeed, estimate.airspeed
    angles = estimate.euler.T[:2]
    delayed, commands = _late(command, memory, gains)
    throttle = np.minimum(np.maximum(delayed[2], 0.0), g.throttle_max)

    cosines = np.cos(angles)
    rate = _demanded_angles(delayed, throttle, eas, cosines, g)
    rate -= angles
    rate *= g.per_tconst
    rate[1] += _turning(cosines, tas, g)
    rate = np.minimum(np.maximum(rate, g.rate_low), g.rate_high)
    upright = (_QUARTER_TURN - np.abs(angles[0])) * g.fade_slope
    rate[1] *= np.minimum(np.maximum(upright, 0.0), 1.0)

    # The rate loop works on target and measurement times the square of the speed scaler.
    scaler = np.minimum(np.maximum(g.scaling_speed / eas, g.scaler_low), g.scaler_high)
    squared = scaler * scaler
    rates = estimate.rates_body.T[:2]
    fed = gains.gyro_b0 * rates
    if memory.begun:
        measured = fed + m.gyro_first
        gyro_first = 2.0 * fed - gains.gyro_a1 * measured + m.gyro_second
    else:
        measured = rates
        gyro_first = rates - fed
    gyro_second = fed - gains.gyro_a2 * measured
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
    output = g.ff * target / (scaler * tas / eas) + g.p * error + g.d * derivative + integral

    surface = np.minimum(np.maximum(output, -1.0), 1.0)
    rudder = np.minimum(np.maximum(g.rudder_mix * surface[0], -1.0), 1.0) * g.rudder_travel
    surface *= g.travel
    each = np.empty(len(eas), dtype=MEMORY)
    each["gyro_first"], each["gyro_second"] = gyro_first.T, gyro_second.T
    each["target"], each["error"], each["derivative"] = target.T, error.T, derivative.T
    each["integral"], each["output"] = integral.T, output.T
    return (
        ActuatorCommand(surface[0], surface[1], rudder, throttle),
        FbwaMemory(True, commands, each),
    )


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
    slow = eas <= g.airspeed_min
    stuck = (np.abs(m.output) >= 1.0) & (m.integral * growth >= 0.0)
    integral = m.integral + np.where(stuck | slow, 0.0, growth)
    limited: Array = np.minimum(np.maximum(integral, -g.i_max), g.i_max)
    return limited
