"""From the errors of filters and inertial sensors to what an autopilot believes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.frames import GRAVITY, rotation_ned_body, wrap_pi
from testbed.sensing import navigation
from testbed.sensing.errors import FORCE_BIAS, FORCE_NOISE, GYRO_BIAS, GYRO_NOISE
from testbed.state import Array, VehicleState

_DOWN = np.array([0.0, 0.0, GRAVITY])


def believe(
    out: VehicleState, rows: NDArray[np.intp], flown: Array, states: Array, errors: Array
) -> None:
    """Turn the truth of the aircraft `rows` (M,) into what they believe, in place.

    Rates are those of the gyros, and accelerations what accelerometers feel, resolved with the
    believed attitude: both less the biases that the filter knows.

    Args:
        out: of N aircraft; all but the airspeeds change.
        rows: (M,)
        flown: (M, 9) errors of attitude, velocity, position.
        states: (M, STATES) of the filters.
        errors: (N, COLUMNS) of the sensors.
    """
    own = errors[rows]
    euler = out.euler[rows]
    felt = (
        rotation_ned_body(euler).swapaxes(1, 2)
        @ ((out.acceleration_ned[rows] - _DOWN)[:, :, np.newaxis])
    )
    felt[:, :, 0] += own[:, FORCE_BIAS] + own[:, FORCE_NOISE] - states[:, navigation.FORCE_BIAS]
    believed = euler + euler_errors(euler, flown[:, :3])
    believed[:, 2] = wrap_pi(believed[:, 2])
    out.euler[rows] = believed
    out.acceleration_ned[rows] = (rotation_ned_body(believed) @ felt)[:, :, 0] + _DOWN
    out.rates_body[rows] += own[:, GYRO_BIAS] + own[:, GYRO_NOISE] - states[:, navigation.GYRO_BIAS]
    out.velocity_ned[rows] += flown[:, 3:6]
    out.position_ned[rows] += flown[:, 6:9]


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
