"""Airspeed sensors: a pitot tube's dynamic pressure, sampled, filtered and turned into airspeed.

A tube whose mouth and drain are both blocked traps the total pressure of that moment, so that it
reads high above that height and low below it; with an open drain it reads zero (FAA Pilot's
Handbook of Aeronautical Knowledge, FAA-H-8083-25C, ch. 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan, nan, sqrt

import numpy as np

from testbed.core.compile import kernel
from testbed.core.frames import GRAVITY
from testbed.core.records import Record, Records, allocate
from testbed.core.standard_atmosphere import SEA_LEVEL_DENSITY
from testbed.scenario.sensors import Sensors
from testbed.sensors.sensor_errors import ConstantBiases, is_sampled

MIN_PRESSURE = 1e-4  # Pa: the autopilot divides by the airspeed, which must not be 0

# The airspeed sensor of one aircraft; one that the scenario does not describe is exact, and never
# late, as long as its tube is open.
AIRSPEED_SENSOR = np.dtype(
    [
        ("rate_hz", "i8"),
        ("blend", "f8"),  # part of a new pressure in the filtered one
        ("modelled", "?"),  # the scenario describes it
        ("pressure_bias", "f8"),  # Pa
        ("scale_bias", "f8"),  # part of the dynamic pressure
        ("pressure", "f8"),  # Pa, filtered; nan: none yet
        ("trapped_pressure", "f8"),  # Pa, in a blocked tube; nan: it is open
        ("trapped_height", "f8"),  # m, at which it was blocked; nan: it is open
        ("equivalent_airspeed", "f8"),  # m/s, the present reading
        ("airspeed", "f8"),  # m/s, the present reading
        ("sampled", "?"),  # at this step
    ],
    align=True,
)


def make_airspeed_sensors(
    sensors: Sequence[Sensors], biases: ConstantBiases, rate_hz: int
) -> Records:
    """Return the sensors (N,) of AIRSPEED_SENSOR of N aircraft, before the first measurement.

    Args:
        sensors: N sections of the scenario.
        biases: of N aircraft.
        rate_hz: of the steps.
    """
    described = [each.airspeed for each in sensors]
    records = allocate(AIRSPEED_SENSOR, len(described))
    records["modelled"] = [each is not None for each in described]
    records["rate_hz"] = [rate_hz if each is None else each.rate_hz for each in described]
    smoothing = np.array([each.smoothing_s if each else 0.0 for each in described])
    with np.errstate(divide="ignore"):
        blend = 1.0 - np.exp(-1.0 / (records["rate_hz"] * smoothing))
    records["blend"] = np.where(smoothing > 0.0, blend, 1.0)
    records["pressure_bias"], records["scale_bias"] = biases.pressure, biases.scale
    for name in ("pressure", "trapped_pressure", "trapped_height"):
        records[name] = nan
    return records


@kernel
def measure_airspeed(
    sensor: Record, truth: Record, faults: Record, noise: float, step: int, steps_per_s: int
) -> None:
    """Measure the dynamic pressure of one aircraft, and update the reading.

    Args:
        sensor: record of AIRSPEED_SENSOR; written.
        truth: record of MOTION.
        faults: record of FAULTS.
        noise: Pa.
        step: number of the step.
        steps_per_s: Hz.
    """
    pressure = tube_pressure(sensor, truth, faults)
    measured = (1.0 + sensor.scale_bias) * pressure + sensor.pressure_bias + noise
    if isnan(sensor.pressure):
        sensor.pressure = measured
    sensor.sampled = is_sampled(sensor.rate_hz, step, steps_per_s)
    if sensor.sampled:
        sensor.pressure += sensor.blend * (measured - sensor.pressure)
    filtered = sensor.pressure
    if filtered < MIN_PRESSURE:
        filtered = MIN_PRESSURE
    equivalent = sqrt(filtered * (2.0 / SEA_LEVEL_DENSITY))
    sensor.equivalent_airspeed = equivalent
    # the density is taken to be known: its error is below a hundredth
    sensor.airspeed = equivalent * (truth.airspeed / truth.equivalent_airspeed)


@kernel
def tube_pressure(sensor: Record, truth: Record, faults: Record) -> float:
    """Return the dynamic pressure in the tube of one aircraft, Pa.

    Args:
        sensor: record of AIRSPEED_SENSOR; what is trapped is written.
        truth: record of MOTION.
        faults: record of FAULTS.
    """
    equivalent, height = truth.equivalent_airspeed, -truth.position_ned[2]
    pressure: float = 0.5 * SEA_LEVEL_DENSITY * equivalent * equivalent
    if not faults.pitot_blocked:
        sensor.trapped_pressure = sensor.trapped_height = nan
        return pressure
    if isnan(sensor.trapped_pressure):
        sensor.trapped_pressure = pressure
    if isnan(sensor.trapped_height):
        sensor.trapped_height = height
    if faults.pitot_drained:
        return 0.0
    # static pressure falls by ρ g per metre, with ρ = ρ0 (EAS/TAS)²
    ratio = equivalent / truth.airspeed
    climbed = height - sensor.trapped_height
    pressure = sensor.trapped_pressure + SEA_LEVEL_DENSITY * ratio * ratio * GRAVITY * climbed
    return pressure


@kernel
def write_airspeeds(sensor: Record, truth: Record, estimate: Record) -> None:
    """Write the airspeeds that an autopilot has from its sensor.

    Args:
        sensor: record of AIRSPEED_SENSOR.
        truth: record of MOTION.
        estimate: record of MOTION; airspeed and equivalent_airspeed are written.
    """
    if sensor.modelled or not isnan(sensor.trapped_pressure):
        estimate.airspeed = sensor.airspeed
        estimate.equivalent_airspeed = sensor.equivalent_airspeed
    else:
        estimate.airspeed = truth.airspeed
        estimate.equivalent_airspeed = truth.equivalent_airspeed
