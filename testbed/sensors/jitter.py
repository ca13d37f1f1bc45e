"""Jitter: first-order Gauss-Markov errors added to an estimate, whatever its source."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.copies import copy_motion
from testbed.core.frames import GRAVITY, rotation_rows
from testbed.core.random import stream
from testbed.core.records import Array, Record, Records
from testbed.scenario.sensors import Sensors
from testbed.sensors.errors import GaussMarkovErrors, NoiseParameters, advance_errors

# Columns of the errors of one aircraft, each the first of three.
POSITION, VELOCITY, ATTITUDE = 0, 3, 6  # m NED, m/s NED, rad
COUNT = 9


def make_jitter(
    names: Sequence[str], sensors: Sequence[Sensors], *, seed: int, dt: float
) -> GaussMarkovErrors | None:
    """Return the errors (N, 9) of N aircraft; None: no aircraft has any.

    Axes are independent; every aircraft has a random stream, "sensors/<aircraft>".

    Args:
        names: N names of aircraft.
        sensors: N sections of the scenario.
        seed: of the run.
        dt: s, step.
    """
    parts = [(each.position, each.velocity, each.attitude) for each in sensors]
    sigma = np.array(
        [
            (position.sigma_m, velocity.sigma_mps, math.radians(attitude.sigma_deg))
            for position, velocity, attitude in parts
        ]
    )
    if not sigma.any():
        return None
    tau = np.array([[each.time_constant_s for each in row] for row in parts])
    own = [[(stream(seed, f"sensors/{name}"), COUNT)] for name in names]
    parameters = NoiseParameters(*(np.repeat(each, 3, axis=1) for each in (sigma, tau)))
    return GaussMarkovErrors(parameters, dt, own)


@entry
def add_jitter_to_all(
    coefficients: Array,
    values: Array,
    on_truth: bool,
    aircraft: Records,
    numbers: Array,
    advance: bool,
) -> None:
    """Advance the jitter of all aircraft and add it to their estimates.

    Args:
        coefficients: (2, N, 9) of `GaussMarkovErrors`.
        values: (N, 9) of `GaussMarkovErrors`; written.
        on_truth: the estimate is the truth with jitter; else it is there already.
        aircraft: (N,) of AIRCRAFT; `estimate` is written.
        numbers: (N, 9), standard normal.
        advance: False: the errors stay as they are.
    """
    if advance:
        advance_errors(coefficients, values, numbers)
    for i in range(len(aircraft)):
        estimate = aircraft[i].estimate
        if on_truth:
            copy_motion(aircraft[i].truth, estimate)
        add_jitter(values[i], estimate)


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
