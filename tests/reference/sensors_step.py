"""Airspeed sensors, estimates of filters and jitter of N aircraft at once, with numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reference.frames import rotation_ned_body
from reference.sensors_ekf import ACCELEROMETER_BIAS, GYRO_BIAS
from testbed.core.frames import GRAVITY, wrap_pi
from testbed.core.records import Array, BoolArray, FaultState, Records, VehicleState

DENSITY, MIN_PRESSURE = 1.225, 1e-4
_DOWN = np.array([0.0, 0.0, GRAVITY])


class AirspeedSensors:
    """The airspeed sensors of N aircraft.

    Args:
        sensors: (N,) of AIRSPEED_SENSOR, whose parameters are used.
        rate_hz: of the steps.
    """

    def __init__(self, sensors: Records, rate_hz: int) -> None:
        """Before the first measurement."""
        self.sensors, self.rate_hz = sensors, rate_hz
        self.pressure = np.full(len(sensors), np.nan)
        self.trapped = np.full((2, len(sensors)), np.nan)  # pressure, height
        self.reading = np.zeros((2, len(sensors)))  # equivalent and true airspeed

    def sampled(self, step: int) -> BoolArray:
        """Which of them (N,) measure at a step."""
        rate = self.sensors["rate_hz"]
        out: BoolArray = (step * rate) % self.rate_hz < rate
        return out

    def measure(self, step: int, truth: VehicleState, noise: Array, faults: FaultState) -> None:
        """Measure once more, with a noise (N,) Pa of the pressure."""
        s, eas = self.sensors, truth.equivalent_airspeed
        pressure = self._in_tube(truth, 0.5 * DENSITY * eas * eas, faults)
        measured = (1.0 + s["scale_bias"]) * pressure + s["pressure_bias"] + noise
        before = np.where(np.isnan(self.pressure), measured, self.pressure)
        after = before + s["blend"] * (measured - before)
        self.pressure = np.where(self.sampled(step), after, before)
        equivalent = np.sqrt(np.maximum(self.pressure, MIN_PRESSURE) * (2.0 / DENSITY))
        self.reading[:] = equivalent, equivalent * (truth.airspeed / eas)

    def airspeeds(self, truth: VehicleState) -> Array:
        """Equivalent and true airspeed (2, N) that autopilots have."""
        exact = ~self.sensors["modelled"] & np.isnan(self.trapped[0])
        return np.where(exact, np.array([truth.equivalent_airspeed, truth.airspeed]), self.reading)

    def _in_tube(self, truth: VehicleState, pressure: Array, faults: FaultState) -> Array:
        height, blocked = -truth.position_ned[:, 2], faults.pitot_blocked
        now = np.where(np.isnan(self.trapped), np.array([pressure, height]), self.trapped)
        self.trapped = np.where(blocked, now, np.nan)
        ratio = truth.equivalent_airspeed / truth.airspeed
        climbed = DENSITY * ratio * ratio * GRAVITY * (height - now[1])
        closed = np.where(faults.pitot_drained, 0.0, now[0] + climbed)
        return np.where(blocked, closed, pressure)


def apply_errors(
    estimate: VehicleState, rows: NDArray[np.intp], output: Array, states: Array, errors: Records
) -> None:
    """Turn the truth of the aircraft `rows` (M,) into the estimates of their filters, in place.

    Args:
        estimate: of N aircraft; all but the airspeeds change.
        rows: (M,)
        output: (M, 9) errors of attitude, velocity, position.
        states: (M, 17) of the filters.
        errors: (N,) of ERRORS.
    """
    own, euler = errors[rows], estimate.euler[rows]
    force = np.einsum(
        "nji,nj->ni", rotation_ned_body(euler), estimate.acceleration_ned[rows] - _DOWN
    )
    force += own["accelerometer_bias"] + own["accelerometer_noise"] - states[:, ACCELEROMETER_BIAS]
    turned = euler + euler_errors(euler, output[:, :3])
    turned[:, 2] = wrap_pi(turned[:, 2])
    estimate.euler[rows] = turned
    estimate.acceleration_ned[rows] = (
        np.einsum("nij,nj->ni", rotation_ned_body(turned), force) + _DOWN
    )
    estimate.rates_body[rows] += own["gyro_bias"] + own["gyro_noise"] - states[:, GYRO_BIAS]
    estimate.velocity_ned[rows] += output[:, 3:6]
    estimate.position_ned[rows] += output[:, 6:9]


def euler_errors(euler: Array, rotation: Array) -> Array:
    """Changes of roll, pitch, yaw (M, 3) rad by a small rotation (M, 3) rad about NED axes."""
    sine, cosine = np.sin(euler[:, 2]), np.cos(euler[:, 2])
    along = cosine * rotation[:, 0] + sine * rotation[:, 1]
    return np.stack(
        [
            along / np.cos(euler[:, 1]),
            cosine * rotation[:, 1] - sine * rotation[:, 0],
            rotation[:, 2] + along * np.tan(euler[:, 1]),
        ],
        axis=1,
    )


def add_jitter(errors: Array, estimate: VehicleState) -> VehicleState:
    """An estimate of N aircraft with errors (N, 9) of position, velocity and attitude."""
    position, velocity, attitude = errors.reshape(-1, 3, 3).swapaxes(0, 1)
    euler = estimate.euler + attitude
    force = np.einsum(
        "nji,nj->ni", rotation_ned_body(estimate.euler), estimate.acceleration_ned - _DOWN
    )
    return estimate._replace(
        position_ned=estimate.position_ned + position,
        velocity_ned=estimate.velocity_ned + velocity,
        acceleration_ned=np.einsum("nij,nj->ni", rotation_ned_body(euler), force) + _DOWN,
        euler=euler,
    )
