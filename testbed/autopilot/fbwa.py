"""Fly-by-wire A: from pitch, roll and throttle to surfaces, as ArduPlane does it.

The law is ArduPlane's, written from its documentation and its measured behaviour and compared
with a recording of it. Angles and rates are in radians; ArduPlane's 45 degrees of surface at full
output are part of the gains. docs/autopilot.md lists what is not modelled.
"""

from __future__ import annotations

from math import acos, cos, pi, radians, sqrt
from typing import NamedTuple

import numpy as np

from testbed.autopilot.slew_limiter import SLEW, slew_factor, start_slew_limiters
from testbed.core.compile import entry, kernel
from testbed.core.records import (
    ACTUATORS,
    AIRCRAFT,
    ActuatorCommand,
    Array,
    FbwaCommand,
    Indices,
    Record,
    Records,
    Values,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)

LEAST_BANK_LIMIT = radians(25.0)  # stall prevention never asks for less
COS_STEEPEST = cos(radians(80.0))  # beyond, the turn's pitch rate grows no more
STEEP_PITCH = radians(70.0)  # above it, no turn coordination and no fade at large bank
AIRSPEED_S = 0.1  # s, period of the airspeed, the speed scaler and stall prevention
# Weights of new values in low-passes of that period: of the pressure, the airspeed of stall
# prevention, and the speed scaler, which has a cut-off of 2 Hz.
PRESSURE_WEIGHT, AIRSPEED_WEIGHT = 0.3, 0.2
SCALER_WEIGHT = AIRSPEED_S / (AIRSPEED_S + 1.0 / (2.0 * pi * 2.0))
LEAST_AIRSPEED = 0.1  # m/s
PITCH_UNDERSPEED = 0.5  # share of AIRSPEED_MIN at which the pitch integral is frozen

# Parameters of one autopilot, prepared for one rate; pairs hold roll, then pitch. Surface gains are
# per full output, which ArduPlane calls 45 degrees.
GAINS = np.dtype(
    [
        ("dt", "f8"),  # s, period
        ("command_periods", "i8"),  # whole periods of the command's latency
        ("command_fraction", "f8"),  # the rest, as a part of a period
        ("gyro_b", "f8", (3,)),  # numerator of the gyro filter: of this sample and two before
        ("gyro_a", "f8", (2,)),  # denominator, of two outputs before; that of this one is 1
        ("sitl_physics_hz", "f8"),  # of the SITL whose gyro filter this is; 0: an aircraft's
        ("airspeed_periods", "i8"),  # periods from one reading of the airspeed to the next
        ("pressure_weight", "f8"),  # of a new pressure in the filtered one
        ("airspeed_min", "f8"),
        ("stall_speed", "f8"),
        ("scaling_speed", "f8"),
        ("scaler_low", "f8"),
        ("scaler_high", "f8"),
        ("roll_limit", "f8"),
        ("fade_slope", "f8"),  # 1/rad, of the pitch rate between the roll limit + 5° and 90°
        ("pitch_low", "f8"),
        ("pitch_high", "f8"),
        ("pitch_trim", "f8"),
        ("throttle_max", "f8"),
        ("throttle_trim", "f8"),
        ("pitch_down", "f8"),  # rad per throttle below trim
        ("turn", "f8"),  # m/s², g times the part of the turn's pitch rate that is fed forward
        ("rudder_mix", "f8"),
        ("travel", "f8", (2,)),  # of aileron and elevator, part of the whole at full output
        ("rudder_travel", "f8"),
        ("per_tconst", "f8", (2,)),
        ("rate_low", "f8", (2,)),
        ("rate_high", "f8", (2,)),
        ("p", "f8", (2,)),
        ("i_dt", "f8", (2,)),
        ("d", "f8", (2,)),
        ("ff", "f8", (2,)),
        ("i_max", "f8", (2,)),
        ("underspeed", "f8", (2,)),  # m/s, at and below which the integral is frozen
        ("slew_max", "f8", (2,)),  # deg/s, 0: no limit
        ("alpha_target", "f8", (2,)),
        ("alpha_error", "f8", (2,)),
        ("alpha_derivative", "f8", (2,)),
    ],
    align=True,
)
# What one autopilot keeps from one period to the next.
MEMORY = np.dtype(
    [
        ("period", "i8"),  # number of the present period; in the first, 0, filters settle
        ("pressure", "f8"),  # m²/s², filtered dynamic pressure, as the square of an airspeed
        ("smoothed_airspeed", "f8"),  # m/s, equivalent, of stall prevention
        ("scaler", "f8"),  # filtered
        ("gyro_first", "f8", (2,)),  # rad/s, states of the gyro filter
        ("gyro_second", "f8", (2,)),  # rad/s
        ("target", "f8", (2,)),  # rad/s, filtered rate target, scaled
        ("error", "f8", (2,)),  # rad/s, filtered rate error, scaled
        ("derivative", "f8", (2,)),  # rad/s², filtered
        ("integral", "f8", (2,)),  # part of full output
        ("output", "f8", (2,)),  # sum before its limit, part of full output
        ("slew", SLEW),
        ("surfaces", ACTUATORS),  # commanded last
    ],
    align=True,
)
ROLL, PITCH, THROTTLE = range(3)  # columns of a delay line


class Autopilots(NamedTuple):
    """The parameters and the state of N virtual autopilots; the state is written in place."""

    gains: Records  # (N,) of GAINS, by `parameters.make_gains`
    memory: Records  # (N,) of MEMORY
    delay_line: Array  # (N, P, 3) roll, pitch, throttle commands under way, the newest first


def initial_autopilots(gains: Records) -> Autopilots:
    """Return N autopilots that have just been switched on."""
    n = len(gains)
    periods = int(gains["command_periods"].max(initial=0)) + 1
    memory = allocate(MEMORY, n)
    start_slew_limiters(memory["slew"])
    return Autopilots(gains, memory, np.zeros((n, periods, 3)))


def settled_autopilots(gains: Records, surfaces: ActuatorCommand) -> Autopilots:
    """Return N autopilots that have long held these surfaces (N), as before a trimmed start."""
    autopilots = initial_autopilots(gains)
    memory = autopilots.memory
    held = np.stack([surfaces.aileron, surfaces.elevator], axis=-1) / gains["travel"]
    memory["integral"] = memory["output"] = np.clip(held, -gains["i_max"], gains["i_max"])
    write_fields(memory["surfaces"], surfaces)
    return autopilots


def step_autopilots(
    autopilots: Autopilots, estimate: VehicleState, command: FbwaCommand[Array]
) -> ActuatorCommand:
    """Step N autopilots by one period, outside a run.

    Args:
        autopilots: N, changed in place.
        estimate: (N) the autopilots' estimates of their motion.
        command: (N), acted on after the command's latency.

    Returns:
        The surfaces (N).
    """
    aircraft = allocate(AIRCRAFT, len(autopilots.gains))
    write_fields(aircraft["estimate"], estimate)
    write_fields(aircraft["command"], command)
    fly_by_wire_a(np.arange(len(aircraft)), *autopilots, aircraft)
    return fields_of(ActuatorCommand, aircraft["surfaces"])


@entry
def fly_by_wire_a(
    rows: Indices, gains: Records, memory: Record, delay_line: Array, aircraft: Records
) -> None:
    """Step the autopilots of the aircraft in these rows: command and estimate to surfaces.

    A frozen autopilot keeps its state and its servo commands. One that is frozen from the start
    takes its first period, and its servos stay where they were.

    Args:
        rows: (M,) of the aircraft that have a virtual autopilot.
        gains: (M,) of GAINS.
        memory: (M,) of MEMORY; written.
        delay_line: (M, P, 3) of `Autopilots`; written.
        aircraft: (N,) of AIRCRAFT; `surfaces` are written.
    """
    for k in range(len(rows)):
        a, m = aircraft[rows[k]], memory[k]
        frozen = a.faults.frozen
        if not frozen or m.period == 0:
            new = fbwa(gains[k], m, delay_line[k], a.estimate, a.command, a.guided)
            if not frozen:
                held = m.surfaces
                held.aileron, held.elevator, held.rudder, held.throttle = new
        held, out = m.surfaces, a.surfaces
        out.aileron, out.elevator = held.aileron, held.elevator
        out.rudder, out.throttle = held.rudder, held.throttle


@kernel
def fbwa(
    g: Record, m: Record, delay_line: Array, estimate: Record, command: Record, guided: bool
) -> Values:
    """Compute one period of fly-by-wire A for one aircraft.

    Args:
        g: record of GAINS.
        m: record of MEMORY; written, but for its surfaces.
        delay_line: (P, 3); written.
        estimate: record of MOTION.
        command: record of COMMAND.
        guided: it is an attitude target in GUIDED, which lowers the nose at no throttle.

    Returns:
        Aileron, elevator and rudder, -1..1, and throttle, 0..1.
    """
    started = m.period > 0
    roll_command = _delayed(g, delay_line, ROLL, started, command.roll)
    pitch_command = _delayed(g, delay_line, PITCH, started, command.pitch)
    throttle = _delayed(g, delay_line, THROTTLE, started, command.throttle)
    throttle = _clip(throttle, 0.0, g.throttle_max)
    equivalent = max(estimate.equivalent_airspeed, LEAST_AIRSPEED)
    eas2tas = max(estimate.airspeed, LEAST_AIRSPEED) / equivalent
    eas = _filtered_airspeed(g, m, equivalent)
    tas = eas * eas2tas
    roll, pitch = estimate.euler[0], estimate.euler[1]

    # A stick commands a share of its limit. ArduPlane turns two limits from the horizon to the
    # body: that of roll by the pitch, the lowest pitch by the roll.
    cos_roll, cos_pitch = cos(roll), cos(pitch)
    roll_demand = _clip(roll_command, -g.roll_limit, g.roll_limit) * cos_pitch
    pitch_demand = _clip(pitch_command, g.pitch_low, g.pitch_high)
    if pitch_demand < 0.0:
        pitch_demand *= abs(cos_roll)
    # the bank that the wing can bear at this speed
    load = g.stall_speed / m.smoothed_airspeed
    limit = max(acos(min(load * load, 1.0)), LEAST_BANK_LIMIT)
    # below the trim throttle the nose is lowered in proportion
    lowered = 0.0 if guided else g.pitch_down * max(g.throttle_trim - throttle, 0.0)
    pitch_demand = max(pitch_demand - lowered, g.pitch_low * abs(cos_roll))
    # the pitch rate of a level turn, g/V tan φ sin φ cos θ; tan φ sin φ is 1/cos φ − cos φ
    cos_bank = max(cos_roll, COS_STEEPEST)
    curve = (1.0 / cos_bank - cos_bank) * cos_pitch
    turning = g.turn * curve / max(tas, g.airspeed_min)
    upright = _clip((0.5 * pi - abs(roll)) * g.fade_slope, 0.0, 1.0)
    if abs(pitch) >= STEEP_PITCH:
        turning, upright = 0.0, 1.0
    rates = (
        (_clip(roll_demand, -limit, limit) - roll) * g.per_tconst[0],
        (pitch_demand + g.pitch_trim - pitch) * g.per_tconst[1] + turning,
    )

    # the rate loop works on target and measurement times the square of the speed scaler
    squared = m.scaler * m.scaler
    for axis in range(2):
        rate = _clip(rates[axis], g.rate_low[axis], g.rate_high[axis])
        rate *= squared * upright if axis == 1 else squared
        gyro = estimate.rates_body[axis]
        fed = g.gyro_b[0] * gyro
        if started:
            measured = fed + m.gyro_first[axis]
            later = g.gyro_b[1] * gyro - g.gyro_a[0] * measured
            m.gyro_first[axis] = later + m.gyro_second[axis]
        else:
            measured = gyro
            m.gyro_first[axis] = gyro - fed
        m.gyro_second[axis] = g.gyro_b[2] * gyro - g.gyro_a[1] * measured
        measured *= squared
        if started:
            last = m.error[axis]
            m.target[axis] += g.alpha_target[axis] * (rate - m.target[axis])
            m.error[axis] = last + g.alpha_error[axis] * (m.target[axis] - measured - last)
            slope = (m.error[axis] - last) / g.dt - m.derivative[axis]
            m.derivative[axis] += g.alpha_derivative[axis] * slope
        else:
            m.target[axis] = rate
            m.error[axis] = rate - measured
        # the integral cannot grow at full output, and is frozen when too slow
        growth = g.i_dt[axis] * m.error[axis]
        full = abs(m.output[axis]) >= 1.0 and m.integral[axis] * growth >= 0.0
        if full or eas <= g.underspeed[axis]:
            growth = 0.0
        m.integral[axis] = _clip(m.integral[axis] + growth, -g.i_max[axis], g.i_max[axis])
        if g.i_dt[axis] == 0.0:
            m.integral[axis] = 0.0
        forward = g.ff[axis] * m.target[axis] / (m.scaler * eas2tas)
        factor = slew_factor(m.slew, axis, g.slew_max[axis], m.period, g.dt)
        m.slew.pd[axis] = factor * (g.p[axis] * m.error[axis] + g.d[axis] * m.derivative[axis])
        m.output[axis] = forward + m.slew.pd[axis] + m.integral[axis]
    m.period += 1
    aileron = _clip(m.output[0], -1.0, 1.0)
    return (
        aileron * g.travel[0],
        _clip(m.output[1], -1.0, 1.0) * g.travel[1],
        _clip(g.rudder_mix * aileron, -1.0, 1.0) * g.rudder_travel,
        throttle,
    )


@kernel
def _filtered_airspeed(g: Record, m: Record, eas: float) -> float:
    """Update pressure, smoothed airspeed and speed scaler at 10 Hz; return the airspeed, m/s."""
    if m.period == 0:
        m.pressure = eas * eas
        m.smoothed_airspeed = eas
        m.scaler = _clip(g.scaling_speed / eas, g.scaler_low, g.scaler_high)
        return eas
    if m.period % g.airspeed_periods == 0:
        m.pressure += g.pressure_weight * (eas * eas - m.pressure)
        filtered = sqrt(m.pressure)
        m.smoothed_airspeed += AIRSPEED_WEIGHT * (filtered - m.smoothed_airspeed)
        scaler = _clip(g.scaling_speed / filtered, g.scaler_low, g.scaler_high)
        m.scaler += SCALER_WEIGHT * (scaler - m.scaler)
    return sqrt(m.pressure)


@kernel
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@kernel
def _delayed(g: Record, line: Array, column: int, started: bool, now: float) -> float:
    """Return a command one latency ago, and put the newest into the delay line."""
    if not started:
        line[:, column] = now
        return now
    whole = g.command_periods
    younger = now if whole == 0 else line[whole - 1, column]
    late: float = younger + g.command_fraction * (line[whole, column] - younger)
    for k in range(whole, 0, -1):
        line[k, column] = line[k - 1, column]
    line[0, column] = now
    return late
