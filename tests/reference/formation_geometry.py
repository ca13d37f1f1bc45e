"""The leader's velocity frame and the slots that turn with it, [HBH23] eqs. (22)-(29)."""

from __future__ import annotations

import numpy as np

from reference.formation_arrays import cross, rotate
from reference.frames import velocity_frame
from testbed.core.frames import COURSE_FLOOR
from testbed.core.records import Array


def frame_rate(flight_path_angle: Array, chi_dot: Array, gamma_dot: Array) -> Array:
    """ω_g (n, 3) rad/s from γ (rad), σ̇ and γ̇ (rad/s), [HBH23] eq. (26)."""
    out = np.empty((len(chi_dot), 3))
    out[:, 0] = -chi_dot * np.sin(flight_path_angle)
    out[:, 1] = gamma_dot
    out[:, 2] = chi_dot * np.cos(flight_path_angle)
    return out


def frame_acceleration(
    flight_path_angle: Array, chi_dot: Array, gamma_dot: Array, course_acceleration: Array
) -> Array:
    """ω̇_g (n, 3) rad/s², the derivative of [HBH23] eq. (26) where γ̈ is zero; rad, rad/s, rad/s²."""
    sine, cosine = np.sin(flight_path_angle), np.cos(flight_path_angle)
    out = np.zeros((len(chi_dot), 3))
    out[:, 0] = -course_acceleration * sine - chi_dot * gamma_dot * cosine
    out[:, 2] = course_acceleration * cosine - chi_dot * gamma_dot * sine
    return out


def slots(
    frame: Array, rate: Array, acceleration: Array, offsets: Array
) -> tuple[Array, Array, Array]:
    """χ, χ̇, χ̈ of offsets held in the leader's frame, [HBH23] eqs. (27)-(29).

    Args:
        frame: R_g (n, 3, 3), as each agent computes it.
        rate: ω_g (n, 3) rad/s in that frame.
        acceleration: ω̇_g (n, 3) rad/s²; the paper neglects it: zero.
        offsets: υ (m, 3), or (n, m, 3) as each agent knows them, m: forward, right, down.

    Returns:
        Three arrays (n, m, 3): metres, m/s and m/s², resolved in NED.
    """
    upsilon = np.empty((len(frame), *offsets.shape[-2:]))
    upsilon[:] = offsets
    turning = cross(rate, upsilon)
    curving = cross(rate, turning) + cross(acceleration, upsilon)
    return rotate(frame, upsilon), rotate(frame, turning), rotate(frame, curving)


def velocity_rates(velocity: Array, acceleration: Array) -> tuple[Array, Array]:
    """σ̇ and γ̇ (n,) rad/s of a velocity (n, 3) m/s that changes at (n, 3) m/s²."""
    north, east, down = velocity[:, 0], velocity[:, 1], velocity[:, 2]
    along = north * acceleration[:, 0] + east * acceleration[:, 1]
    across = north * acceleration[:, 1] - east * acceleration[:, 0]
    square = np.maximum(north * north + east * east, COURSE_FLOOR)
    horizontal = np.sqrt(square)
    gamma = (down * along / horizontal - horizontal * acceleration[:, 2]) / (square + down * down)
    return across / square, gamma


def true_slots(
    position: Array, velocity: Array, offsets: Array, altitudes: Array
) -> tuple[Array, Array, Array]:
    """Where the followers should be, how far they are from it, and how they move.

    Args:
        position: (n + 1, 3) m, the leader first.
        velocity: (n + 1, 3) m/s.
        offsets: υ (n + 1, 3) m in the leader's frame.
        altitudes: (n,) m above the origin; where it is not nan the slot lies at this altitude and
            its offset is turned by the leader's course alone.

    Returns:
        q_g + χ_i (n, 3) m by (27); q̃_i (n, 3) m; and ground speed (m/s), course and flight-path
        angle (rad) in the rows of an array (3, n).
    """
    holding = np.expand_dims(~np.isnan(altitudes), 1)
    level = velocity[:1] * np.array([1.0, 1.0, 0.0])
    slot = position[0] + np.where(
        holding,
        offsets[1:] @ velocity_frame(level)[0].T,
        offsets[1:] @ velocity_frame(velocity[:1])[0].T,
    )
    slot[:, 2] = np.where(holding[:, 0], -altitudes, slot[:, 2])
    moving = velocity[1:]
    horizontal = np.hypot(moving[:, 0], moving[:, 1])
    motion = np.empty((3, len(moving)))
    motion[0] = np.hypot(horizontal, moving[:, 2])
    motion[1] = np.arctan2(moving[:, 1], moving[:, 0])
    motion[2] = np.arctan2(-moving[:, 2], horizontal)
    return slot, position[1:] - slot, motion
