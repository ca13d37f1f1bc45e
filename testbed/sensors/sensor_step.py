"""One step of the sensors of all aircraft: errors advance, sensors measure, filters update."""

from __future__ import annotations

from testbed.core.compile import entry, kernel
from testbed.core.copies import copy_motion
from testbed.core.records import Array, Records
from testbed.sensors.airspeed import measure_airspeed, write_airspeeds
from testbed.sensors.ekf import apply_errors, ekf_step
from testbed.sensors.errors import advance_errors


@entry
def estimate_airspeeds(
    coefficients: Array,
    values: Array,
    errors: Records,
    sensors: Records,
    steps_per_s: int,
    aircraft: Records,
    numbers: Array,
    step: int,
    advance: bool,
) -> None:
    """Write the estimates of aircraft that fly on the truth and a measured airspeed.

    Args:
        coefficients: (2, N, 29) of `GaussMarkovErrors`.
        values: (N, 29) of `GaussMarkovErrors`; written.
        errors: (N,) of ERRORS, which are the values.
        sensors: (N,) of AIRSPEED_SENSOR; written.
        steps_per_s: Hz.
        aircraft: (N,) of AIRCRAFT; truth and faults are read, `estimate` is written.
        numbers: (N, 29), standard normal.
        step: number of the step.
        advance: a step begins; False: errors and readings stay as they are.
    """
    if advance:
        measure(coefficients, values, errors, sensors, steps_per_s, aircraft, numbers, step)
    write_truth(sensors, aircraft)


@entry
def estimate_motions(
    coefficients: Array,
    values: Array,
    errors: Records,
    sensors: Records,
    steps_per_s: int,
    settings: Records,
    filters: Records,
    past: Records,
    aircraft: Records,
    numbers: Array,
    step: int,
    advance: bool,
) -> None:
    """Write the estimates of aircraft of which M fly on a navigation filter.

    Args:
        coefficients: (2, N, 29) of `GaussMarkovErrors`.
        values: (N, 29) of `GaussMarkovErrors`; written.
        errors: (N,) of ERRORS, which are the values.
        sensors: (N,) of AIRSPEED_SENSOR; written.
        steps_per_s: Hz.
        settings: (M,) of SETTINGS.
        filters: (M,) of FILTER; written.
        past: (M, L) of PAST_MOTION; written.
        aircraft: (N,) of AIRCRAFT; truth and faults are read, `estimate` is written.
        numbers: (N, 29), standard normal.
        step: number of the step.
        advance: a step begins; False: errors, readings and filters stay as they are.
    """
    if advance:
        measure(coefficients, values, errors, sensors, steps_per_s, aircraft, numbers, step)
        for m in range(len(settings)):
            i = settings[m].row
            a = aircraft[i]
            ekf_step(
                settings[m],
                filters[m],
                past[m],
                errors[i],
                sensors[i],
                a.truth,
                a.faults,
                step,
                steps_per_s,
            )
    write_truth(sensors, aircraft)
    for m in range(len(settings)):
        i = settings[m].row
        apply_errors(filters[m], errors[i], aircraft[i].estimate)


@kernel
def measure(
    coefficients: Array,
    values: Array,
    errors: Records,
    sensors: Records,
    steps_per_s: int,
    aircraft: Records,
    numbers: Array,
    step: int,
) -> None:
    """Advance the errors of all sensors and read the airspeed sensors; see `estimate_motions`."""
    advance_errors(coefficients, values, numbers)
    for i in range(len(aircraft)):
        a = aircraft[i]
        measure_airspeed(sensors[i], a.truth, a.faults, errors[i].pressure_noise, step, steps_per_s)


@kernel
def write_truth(sensors: Records, aircraft: Records) -> None:
    """Write the truth with the airspeeds of the sensors as all estimates."""
    for i in range(len(aircraft)):
        a = aircraft[i]
        copy_motion(a.truth, a.estimate)
        write_airspeeds(sensors[i], a.truth, a.estimate)
