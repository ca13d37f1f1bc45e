"""The motion of N aircraft from the numbers that a flight model gives."""

from __future__ import annotations

import numpy as np

from reference.frames import rotation_ned_body
from testbed.core.records import Array, BoolArray, VehicleState


def state_of(flat: Array) -> VehicleState:
    """The state of N aircraft as views of its numbers (17 N,), field after field."""
    n = flat.size // 17
    return VehicleState(*flat[: 15 * n].reshape(5, n, 3), *flat[15 * n :].reshape(2, n))


def motion(properties: Array, wanted: BoolArray, zero: Array, scale: Array, flat: Array) -> None:
    """Write the numbers of `state_of` from JSBSim's: (properties − zero) scale.

    JSBSim's acceleration is that of u, v, w in the turning body: it becomes
    R_NB (d(u, v, w)/dt) + (R_NB ω) × velocity.

    Args:
        properties: (N, 17) numbers of each aircraft, in the order of the fields.
        wanted: (N,) whose; the others' stay.
        zero: (17,)
        scale: (17,)
        flat: (17 N,) becomes the numbers.
    """
    numbers = (properties - zero) * scale
    vectors, speeds = numbers[:, :15].reshape(-1, 5, 3), numbers[:, 15:]
    _, velocity, acceleration, euler, rates = vectors.swapaxes(0, 1)
    yaw = euler[:, 2]
    yaw[yaw > np.pi] -= 2.0 * np.pi
    rotation = rotation_ned_body(euler)
    along = (rotation @ acceleration[:, :, None])[:, :, 0]
    turning = (rotation @ rates[:, :, None])[:, :, 0]
    acceleration[:] = along + np.cross(turning, velocity)
    state = state_of(flat)
    for own, new in zip(state, (*vectors.swapaxes(0, 1), *speeds.T), strict=True):
        own[wanted] = new[wanted]
