"""Kernels of the sensors for many aircraft or filters at once."""

import numpy as np

from reference.interpreted import interpreted
from testbed.core.compile import entry
from testbed.core.records import (
    AIRCRAFT,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)
from testbed.core.standard_atmosphere import SEA_LEVEL_DENSITY
from testbed.sensors import ekf
from testbed.sensors.airspeed import AIRSPEED_SENSOR, measure_airspeed, write_airspeeds
from testbed.sensors.sensor_errors import ERRORS
from testbed.sensors.sensor_step import estimate_motions


def aircraft_of(truth, faults=None):
    """Records (N,) of AIRCRAFT with this truth, and with these faults."""
    aircraft = allocate(AIRCRAFT, len(truth.airspeed))
    write_fields(aircraft["truth"], truth)
    if faults is not None:
        write_fields(aircraft["faults"], faults)
    return aircraft


def estimate_of(aircraft):
    """A copy of the estimates of N aircraft."""
    return VehicleState(*(each.copy() for each in fields_of(VehicleState, aircraft["estimate"])))


def ekf_step(
    settings,
    filters,
    past,
    step,
    rate_hz,
    truth,
    *,
    errors,
    heading_bias,
    equivalent_airspeed,
    airspeed,
    airspeed_sampled,
    gps_lost,
    gps_jump,
):
    """Step M filters: errors (M, 9) of attitude, velocity and position as flown on.

    By the entry of flights, in which errors stay as they are, and so do filtered pressures.
    """
    n = len(filters)
    aircraft, sensors = aircraft_of(truth), allocate(AIRSPEED_SENSOR, n)
    aircraft["faults"]["gps_lost"], aircraft["faults"]["gps_jump"] = gps_lost, gps_jump
    aircraft["truth"]["airspeed"] = airspeed
    aircraft["truth"]["equivalent_airspeed"] = equivalent_airspeed
    sensors["pressure"] = 0.5 * SEA_LEVEL_DENSITY * np.square(equivalent_airspeed)
    sensors["rate_hz"] = np.where(airspeed_sampled, rate_hz, 0)
    values = np.zeros((n, ERRORS.itemsize // 8))
    drawn = values.view(ERRORS)[:, 0].view(type(allocate(ERRORS, 0)))
    drawn[...] = errors
    coefficients, used = np.zeros((2, *values.shape)), np.zeros(1, dtype=np.intp)
    coefficients[0] = 1.0
    settings = settings.copy()
    settings["heading_bias"], settings["row"] = heading_bias, np.arange(n)
    drawing = np.zeros((1, *values.shape)), used, np.array([step])
    own = settings, filters, past, *drawing, aircraft, True
    assert not estimate_motions(coefficients, values, drawn, sensors, rate_hz, *own)
    return np.array(filters["output"])


@interpreted
def _propagate(covariance, rotation, force, process, dt):
    for m in range(len(covariance)):
        r = rotation[m]
        rows = (
            (r[0, 0], r[0, 1], r[0, 2]),
            (r[1, 0], r[1, 1], r[1, 2]),
            (r[2, 0], r[2, 1], r[2, 2]),
        )
        f = force[m]
        ekf.propagate_covariance(covariance[m], rows, (f[0], f[1], f[2]), process[m], dt[m])


def propagate_covariance(covariance, rotation, force, process, dt):
    """The covariance (M, 17, 17) after `dt` (M,) s without measurements."""
    out = covariance.copy()
    _propagate(out, rotation, force, process, dt)
    return out


@interpreted
def _apply_errors(rows, filters, errors, aircraft):
    for m in range(len(rows)):
        ekf.apply_errors(filters[m], errors[rows[m]], aircraft[rows[m]].estimate)


def apply_errors(truth, rows, output, states, errors):
    """The estimates of N aircraft, of which those in `rows` (M,) have filters."""
    aircraft, filters = aircraft_of(truth), allocate(ekf.FILTER, len(rows))
    aircraft["estimate"] = aircraft["truth"]
    filters["output"], filters["states"] = output, states
    _apply_errors(rows, filters, errors, aircraft)
    return estimate_of(aircraft)


@entry
def _measure_airspeeds(sensors, aircraft, noise, step, rate_hz):
    for i in range(len(sensors)):
        a = aircraft[i]
        measure_airspeed(sensors[i], a.truth, a.faults, noise[i], step, rate_hz)
        write_airspeeds(sensors[i], a.truth, a.estimate)


def airspeeds(sensors, truth, faults, noise, step, rate_hz):
    """Equivalent and true airspeeds (2, N) after one more measurement."""
    aircraft = aircraft_of(truth, faults)
    _measure_airspeeds(sensors, aircraft, noise, step, rate_hz)
    estimate = aircraft["estimate"]
    return np.array([estimate["equivalent_airspeed"], estimate["airspeed"]])
