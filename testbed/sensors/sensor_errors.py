"""Random errors of sensors: white noise and first-order Gauss-Markov drifts.

Every error follows e ← k e + g z from one step to the next, with z standard normal. White noise has
k = 0. A drift of standard deviation σ and time constant τ has k = exp(−dt/τ) and g = σ √(1 − k²),
so that its variance does not depend on dt. White noise of two-sided density N² has the standard
deviation N/√dt in samples dt apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import numpy as np

from testbed.core.compile import entry, jitable, kernel
from testbed.core.copies import copy_motion
from testbed.core.frames import GRAVITY, rotation_rows
from testbed.core.random import NormalNumbers, Streams, ZeroNumbers, named_stream
from testbed.core.reads import unrecorded
from testbed.core.records import Array, Indices, Record, Records, allocate
from testbed.scenario.sensors import Sensors

# The errors of one aircraft's sensors. Those common to all receivers and all barometers come first,
# then those of one sensor after the other, in the order of its random stream's numbers.
ERRORS = np.dtype(
    [
        ("gps_shared", "f8", 3),  # m NED
        ("barometer_shared", "f8"),  # m, down
        ("gps_own", "f8", 3),  # m NED
        ("gps_noise", "f8", 3),  # m NED
        ("gps_velocity_noise", "f8", 3),  # m/s NED
        ("barometer_own", "f8"),  # m, down
        ("barometer_noise", "f8"),  # m, down
        ("pressure_noise", "f8"),  # Pa, of the airspeed sensor
        ("gyro_bias", "f8", 3),  # rad/s, body axes
        ("gyro_noise", "f8", 3),
        ("accelerometer_bias", "f8", 3),  # m/s², body axes
        ("accelerometer_noise", "f8", 3),
        ("heading_noise", "f8"),  # rad
    ],
    align=True,
)
ERROR_COUNT = ERRORS.itemsize // 8
# Random streams common to all aircraft, and of each aircraft, with their numbers per step.
SHARED_STREAMS = {"gps": 3, "barometer": 1}
OWN_STREAMS = {
    "gps": 9,
    "barometer": 2,
    "airspeed": 1,
    "gyro": 6,
    "accelerometer": 6,
    "magnetometer": 1,
}


class NoiseParameters(NamedTuple):
    """The statistics of K errors of each of N aircraft."""

    sigma: Array  # (N, K) standard deviation; of a drift that of the stationary process
    time_constant_s: Array  # (N, K) of a drift; 0: white noise


class ConstantBiases(NamedTuple):
    """Constant errors of the sensors of N aircraft."""

    pressure: Array  # (N,) Pa, added to the dynamic pressure
    scale: Array  # (N,) part of the dynamic pressure, added to it
    heading: Array  # (N,) rad


class GaussMarkovErrors:
    """K random errors of each of N aircraft, stationary from the first step.

    Args:
        parameters: (N, K)
        dt: s, step.
        own: random streams of each aircraft, for the errors behind the shared ones.
        shared: random streams common to all aircraft, for the first errors.
        drawn: false: all errors are zero, and no numbers are drawn.

    Attributes:
        coefficients: (2, N, K) k and g of the recursion.
        values: (N, K) the present errors, which `advance_errors` changes.
        numbers: standard normal, (N, K) per step.
    """

    def __init__(
        self,
        parameters: NoiseParameters,
        dt: float,
        own: Sequence[Streams],
        shared: Streams = (),
        *,
        drawn: bool = True,
    ) -> None:
        sigma, time_constant = parameters
        drifts = time_constant > 0.0
        tau = np.where(drifts, time_constant, 1.0)
        keep = np.where(drifts, np.exp(-dt / tau), 0.0)
        self.coefficients = np.array([keep, sigma * np.sqrt(1.0 - keep**2)])
        self.numbers = NormalNumbers(own, shared) if drawn else ZeroNumbers(own, shared)
        self.values = sigma * self.numbers.draw()


@kernel
def advance_errors(coefficients: Array, values: Array, numbers: Array) -> None:
    """Advance all errors by one step.

    Args:
        coefficients: (2, N, K) of `GaussMarkovErrors`.
        values: (N, K) of `GaussMarkovErrors`; written.
        numbers: (N, K), standard normal.
    """
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            values[i, k] = (
                coefficients[0, i, k] * values[i, k] + coefficients[1, i, k] * (numbers[i, k])
            )


@jitable
def is_sampled(rate_hz: int, step: int, steps_per_s: int) -> bool:
    """Return whether a sensor measures at a step; steps may be negative."""
    return (step * rate_hz) % steps_per_s < rate_hz


def make_sensor_errors(
    names: Sequence[str], sensors: Sequence[Sensors], *, seed: int, dt: float
) -> GaussMarkovErrors:
    """Return the random errors of the sensors of N aircraft, of ERRORS.

    Every sensor has a stream of its own, "sensors/<aircraft>/<sensor>"; errors common to all
    aircraft come from "sky/gps" and "sky/barometer".

    Args:
        names: N names of aircraft.
        sensors: N sections of the scenario.
        seed: of the run.
        dt: s, step.
    """
    own = [
        [
            (named_stream(seed, f"sensors/{name}/{sensor}"), width)
            for sensor, width in OWN_STREAMS.items()
        ]
        for name in names
    ]
    shared = [
        (named_stream(seed, f"sky/{sensor}"), width) for sensor, width in SHARED_STREAMS.items()
    ]
    drawn = any(each.measured for each in sensors)
    return GaussMarkovErrors(make_noise_parameters(sensors, dt), dt, own, shared, drawn=drawn)


def view_errors(errors: GaussMarkovErrors) -> Records:
    """View the values of sensor errors as records (N,) of ERRORS."""
    records = errors.values.view(ERRORS)[:, 0]
    return records.view(type(allocate(ERRORS, 0)))


def make_noise_parameters(sensors: Sequence[Sensors], dt: float) -> NoiseParameters:
    """Return the statistics (N, K) of ERRORS, drawn every `dt` s.

    A missing sensor has no error.
    """
    sigma, tau = np.zeros((2, len(sensors)), dtype=ERRORS)
    for row, each in enumerate(sensors):
        s, t = sigma[row], tau[row]
        if (gps := each.gps) is not None:
            s["gps_shared"], s["gps_own"] = _axes(gps.shared_drift_m), _axes(gps.own_drift_m)
            with _if_any(s["gps_shared"]):
                t["gps_shared"] = gps.shared_time_constant_s
            with _if_any(s["gps_own"]):
                t["gps_own"] = gps.own_time_constant_s
            s["gps_noise"] = _axes(gps.noise_m)
            s["gps_velocity_noise"] = _axes(gps.velocity_noise_mps)
        if (barometer := each.barometer) is not None:
            s["barometer_shared"] = barometer.shared_drift_m
            s["barometer_own"] = barometer.own_drift_m
            with _if_any(s["barometer_shared"]):
                t["barometer_shared"] = barometer.shared_time_constant_s
            with _if_any(s["barometer_own"]):
                t["barometer_own"] = barometer.own_time_constant_s
            s["barometer_noise"] = barometer.noise_m
        if (airspeed := each.airspeed) is not None:
            s["pressure_noise"] = airspeed.noise_pa
        if (gyro := each.gyro) is not None:
            s["gyro_bias"] = math.radians(gyro.bias_dps)
            with _if_any(s["gyro_bias"]):
                t["gyro_bias"] = gyro.bias_time_constant_s
            s["gyro_noise"] = math.radians(gyro.noise_dps_rthz) / math.sqrt(dt)
        if (accelerometer := each.accelerometer) is not None:
            s["accelerometer_bias"] = accelerometer.bias_mps2
            with _if_any(s["accelerometer_bias"]):
                t["accelerometer_bias"] = accelerometer.bias_time_constant_s
            s["accelerometer_noise"] = accelerometer.noise_mps2_rthz / math.sqrt(dt)
        if (magnetometer := each.magnetometer) is not None:
            s["heading_noise"] = math.radians(magnetometer.noise_deg)
    return NoiseParameters(*(each.view("f8").reshape(-1, ERROR_COUNT) for each in (sigma, tau)))


def make_constant_biases(
    names: Sequence[str], sensors: Sequence[Sensors], seed: int
) -> ConstantBiases:
    """Return given and drawn constant errors of N aircraft, streams "sensors/<name>/offsets"."""
    out = ConstantBiases(*np.zeros((3, len(names))))
    for row, (name, each) in enumerate(zip(names, sensors, strict=True)):
        pressure, scale, heading = named_stream(seed, f"sensors/{name}/offsets").standard_normal(3)
        if (airspeed := each.airspeed) is not None:
            out.pressure[row] = airspeed.offset_pa + airspeed.offset_sigma_pa * pressure
            out.scale[row] = max(airspeed.scale + airspeed.scale_sigma * scale, -1.0)
        if (magnetometer := each.magnetometer) is not None:
            offset_deg = magnetometer.offset_deg + magnetometer.offset_sigma_deg * heading
            out.heading[row] = math.radians(offset_deg)
    return out


def _if_any(sigma: Array) -> AbstractContextManager[None]:
    """Return a context in which the time constant of an error counts as read if there is any."""
    return nullcontext() if np.any(sigma) else unrecorded()


def _axes(pair: tuple[float, float]) -> tuple[float, float, float]:
    """Return north, east and down from horizontal and vertical."""
    return pair[0], pair[0], pair[1]


# Columns of the jitter of one aircraft: errors added to an estimate, whatever its source; each is
# the first of three.
POSITION, VELOCITY, ATTITUDE = 0, 3, 6  # m NED, m/s NED, rad
JITTER_COUNT = 9


def make_jitter(
    names: Sequence[str], sensors: Sequence[Sensors], *, seed: int, dt: float
) -> GaussMarkovErrors | None:
    """Return the jitter (N, 9) of N aircraft; None: no aircraft has any.

    Axes are independent; every aircraft has a random stream, "sensors/<aircraft>".

    Args:
        names: N names of aircraft.
        sensors: N sections of the scenario.
        seed: of the run.
        dt: s, step.
    """
    parts: list[tuple[Any, ...]] = [
        (each.position, each.velocity, each.attitude) for each in sensors
    ]
    sigma = np.array(
        [
            (position.sigma_m, velocity.sigma_mps, math.radians(attitude.sigma_deg))
            for position, velocity, attitude in parts
        ]
    )
    if not sigma.any():
        return None
    tau = np.ones_like(sigma)
    for row, sections in enumerate(parts):
        for column, section in enumerate(sections):
            with _if_any(sigma[row, column]):
                tau[row, column] = section.time_constant_s
    own = [[(named_stream(seed, f"sensors/{name}"), JITTER_COUNT)] for name in names]
    parameters = NoiseParameters(*(np.repeat(each, 3, axis=1) for each in (sigma, tau)))
    return GaussMarkovErrors(parameters, dt, own)


@entry
def add_jitter_to_all(
    coefficients: Array,
    values: Array,
    on_truth: bool,
    block: Array,
    used: Indices,
    aircraft: Records,
    advance: bool,
) -> bool:
    """Advance the jitter of all aircraft and add it to their estimates.

    True: no random numbers are left, and nothing is written.

    Args:
        coefficients: (2, N, 9) of `GaussMarkovErrors`.
        values: (N, 9) of `GaussMarkovErrors`; written.
        on_truth: the estimate is the truth with jitter; else it is there already.
        block: (B, N, 9) of `NormalNumbers`.
        used: (1,) of these; written.
        aircraft: (N,) of AIRCRAFT; `estimate` is written.
        advance: False: the errors stay as they are.
    """
    if advance:
        if used[0] == len(block):
            return True
        advance_errors(coefficients, values, block[used[0]])
        used[0] += 1
    for i in range(len(aircraft)):
        estimate = aircraft[i].estimate
        if on_truth:
            copy_motion(aircraft[i].truth, estimate)
        add_jitter(values[i], estimate)
    return False


@kernel
def add_jitter(errors: Array, estimate: Record) -> None:
    """Add jitter to the estimate of one aircraft.

    Accelerations are resolved with the attitude in error: they are those of accelerometers. Rates
    and airspeeds stay as they are.

    Args:
        errors: (9,) of position, m, velocity, m/s, attitude, rad.
        estimate: record of MOTION; written.
    """
    euler, acceleration = estimate.euler, estimate.acceleration_ned
    x, y, z = rotation_rows(euler)
    north, east, down = acceleration[0], acceleration[1], acceleration[2] - GRAVITY
    a = north * x[0] + east * y[0] + down * z[0]
    b = north * x[1] + east * y[1] + down * z[1]
    c = north * x[2] + east * y[2] + down * z[2]
    for axis in range(3):
        estimate.position_ned[axis] += errors[POSITION + axis]
        estimate.velocity_ned[axis] += errors[VELOCITY + axis]
        euler[axis] += errors[ATTITUDE + axis]
    x, y, z = rotation_rows(euler)
    acceleration[0] = x[0] * a + x[1] * b + x[2] * c
    acceleration[1] = y[0] * a + y[1] * b + y[2] * c
    acceleration[2] = z[0] * a + z[1] * b + z[2] * c + GRAVITY
