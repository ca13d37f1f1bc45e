"""One step of the sensors of all aircraft: errors advance, sensors measure, filters update."""

from __future__ import annotations

from testbed.core.compile import entry
from testbed.core.copies import copy_motion
from testbed.core.records import Array, Indices, Records
from testbed.sensors.airspeed import measure_airspeed, write_airspeeds
from testbed.sensors.ekf import apply_errors, ekf_step
from testbed.sensors.sensor_errors import advance_errors


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
    block: Array,
    used: Indices,
    step: Indices,
    aircraft: Records,
    advance: bool,
) -> bool:
    """Write the estimates of aircraft of which M fly on a navigation filter.

    The others fly on the truth and a measured airspeed. True: no random numbers are left, and
    nothing is written.

    Args:
        coefficients: (2, N, 29) of `GaussMarkovErrors`.
        values: (N, 29) of `GaussMarkovErrors`; written.
        errors: (N,) of ERRORS, which are the values.
        sensors: (N,) of AIRSPEED_SENSOR; written.
        steps_per_s: Hz.
        settings: (M,) of SETTINGS.
        filters: (M,) of FILTER; written.
        past: (M, L) of PAST_MOTION; written.
        block: (B, N, 29) of `NormalNumbers`.
        used: (1,) of these; written.
        step: (1,) number of the step; written.
        aircraft: (N,) of AIRCRAFT; truth and faults are read, `estimate` is written.
        advance: a step begins; False: errors, readings and filters stay as they are.
    """
    if advance:
        if used[0] == len(block):
            return True
        advance_errors(coefficients, values, block[used[0]])
        for i in range(len(aircraft)):
            a, noise = aircraft[i], errors[i].pressure_noise
            measure_airspeed(sensors[i], a.truth, a.faults, noise, step[0], steps_per_s)
        for m in range(len(settings)):
            g, i = settings[m], settings[m].row
            a, own = aircraft[i], errors[i]
            ekf_step(
                *(g, filters[m], past[m], own, sensors[i]),
                *(a.truth, a.faults, step[0], steps_per_s),
            )
        used[0] += 1
        step[0] += 1
    for i in range(len(aircraft)):
        a = aircraft[i]
        copy_motion(a.truth, a.estimate)
        write_airspeeds(sensors[i], a.truth, a.estimate)
    for m in range(len(settings)):
        i = settings[m].row
        apply_errors(filters[m], errors[i], aircraft[i].estimate)
    return False


@entry
def warm_up_motions(
    coefficients: Array,
    values: Array,
    errors: Records,
    sensors: Records,
    steps_per_s: int,
    settings: Records,
    filters: Records,
    past: Records,
    block: Array,
    used: Indices,
    step: Indices,
    aircraft: Records,
    start: Array,
) -> bool:
    """Step along straight lines until step 0; True: no random numbers are left for the next step.

    Args:
        coefficients: as those of `estimate_motions`.
        values: the same.
        errors: the same.
        sensors: the same.
        steps_per_s: Hz.
        settings: as those of `estimate_motions`.
        filters: the same.
        past: the same.
        block: the same.
        used: the same.
        step: (1,) number of the step, below 0; written.
        aircraft: (N,) of AIRCRAFT; positions and `estimate` are written.
        start: (N, 3) positions at step 0.
    """
    while step[0] < 0:
        for i in range(len(aircraft)):
            truth = aircraft[i].truth
            for axis in range(3):
                ahead = step[0] / steps_per_s * truth.velocity_ned[axis]
                truth.position_ned[axis] = start[i, axis] + ahead
        if estimate_motions(
            *(coefficients, values, errors, sensors, steps_per_s, settings, filters, past),
            *(block, used, step, aircraft, True),
        ):
            return True
    return False
