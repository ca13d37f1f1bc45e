"""Slots: where followers should be, (27), and how fast that moves, [HBH23] Assumption 1."""

from __future__ import annotations

from math import atan2, hypot, isnan

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import GRAVITY, flight_path_angle, gamma_of, turn_bank
from testbed.core.records import Array, Record, Records, Vector
from testbed.core.velocity_frame import (
    frame_angles,
    frame_angular_velocity,
    to_ned,
    velocity_frame,
    velocity_rates,
)


@kernel
def write_slot(
    leader: Vector, own: Record, offset: Vector, altitude: float, slot: Vector, error: Vector
) -> None:
    """Write the slot q_g + χ_i of a follower, (27), and its position error, m.

    Args:
        leader: record of MOTION.
        own: record of MOTION.
        offset: υ_i (3,) m in the leader's velocity frame.
        altitude: of the slot above the origin, m. The law is then the horizontal variant: the
            offset is rotated by the leader's course only. NaN: the law controls all three axes.
        slot: (3,) m NED; written.
        error: (3,) m NED, position − slot; written.
    """
    holds_altitude = not isnan(altitude)
    v = leader.velocity_ned
    frame = frame_angles(v[0], v[1], 0.0 if holds_altitude else v[2])
    chi = to_ned(frame, offset[0], offset[1], offset[2])
    for axis in range(3):
        slot[axis] = leader.position_ned[axis] + chi[axis]
    if holds_altitude:
        slot[2] = -altitude
    for axis in range(3):
        error[axis] = own.position_ned[axis] - slot[axis]


@entry
def write_formation_state(
    aircraft: Records, followers: Records, offsets: Array, altitudes: Array
) -> None:
    """Write slots, errors and motions of all followers, by the truth and by the estimates.

    Args:
        aircraft: (N,) of AIRCRAFT.
        followers: (n,) of FOLLOWER; slot_ned, error_ned, estimated_error_ned, speed, course and
            flight_path_angle are written.
        offsets: υ (N, 3) m, the leader's zero first.
        altitudes: (n,) m, see `write_slot`.
    """
    for i in range(len(followers)):
        f, leader, own = followers[i], aircraft[0], aircraft[i + 1]
        # the slot by the estimates is overwritten by the true one
        write_slot(
            leader.estimate,
            own.estimate,
            offsets[i + 1],
            altitudes[i],
            f.slot_ned,
            f.estimated_error_ned,
        )
        write_slot(leader.truth, own.truth, offsets[i + 1], altitudes[i], f.slot_ned, f.error_ned)
        north, east, down = own.truth.velocity_ned
        f.speed = hypot(hypot(north, east), down)
        f.course, f.flight_path_angle = atan2(east, north), gamma_of(north, east, down)


ANGLES = 61  # flight-path angles tried, level among them
FORWARD = np.array([1.0, 0.0, 0.0])


@entry
def _write_frame_rates(velocity: Array, acceleration: Array, out: Array) -> None:
    for i in range(len(out)):
        v, a = velocity[i], acceleration[i]
        chi_dot, gamma_dot = velocity_rates(v, a)
        gamma = gamma_of(v[0], v[1], v[2])
        out[i, 0], out[i, 1], out[i, 2] = frame_angular_velocity(gamma, chi_dot, gamma_dot)


def frame_rates(velocity: Array, acceleration: Array) -> Array:
    """Return ω_g (K, 3) rad/s along a path, (26), from velocity and acceleration (K, 3)."""
    out = np.empty(velocity.shape)
    _write_frame_rates(np.ascontiguousarray(velocity), np.ascontiguousarray(acceleration), out)
    return out


def slot_speed(velocity: Array, rate: Array, offsets: Array) -> Array:
    """Return ‖q̇_g + χ̇_i‖ (K, n), m/s, along a leader's path, [HBH23] eqs. (26)-(28).

    Args:
        velocity: q̇_g (K, 3) m/s, NED.
        rate: ω_g (K, 3) rad/s in the leader's velocity frame, (26).
        offsets: υ (n, 3) m in the leader's velocity frame.
    """
    turning = np.cross(rate[:, None, :], offsets)
    return _norm(_norm(velocity)[:, None, None] * FORWARD + turning)


def slot_attitude(
    velocity: Array, acceleration: Array, offsets: Array, wind_ned: Array
) -> tuple[Array, Array]:
    """Return banks and flight-path angles (K, n), rad, that slots need along a leader's path.

    They are `turn_bank` and γ of q̇_g + χ̇_i through the air, with the acceleration q̈_g + χ̈_i.
    ω̇_g is neglected, as in the law: where the leader rolls into a turn the slot needs another bank
    for less than a second.

    Args:
        velocity: q̇_g (K, 3) m/s, NED.
        acceleration: q̈_g (K, 3) m/s², NED.
        offsets: υ (n, 3) m in the leader's velocity frame.
        wind_ned: (3,) m/s.
    """
    rate = frame_rates(velocity, acceleration)[:, None, :]
    turning = np.cross(rate, offsets)
    to_ned = velocity_frame(velocity).swapaxes(1, 2)  # of row vectors
    slot_velocity = velocity[:, None, :] + turning @ to_ned - wind_ned
    slot_acceleration = acceleration[:, None, :] + np.cross(rate, turning) @ to_ned
    return turn_bank(slot_velocity, slot_acceleration), flight_path_angle(slot_velocity)


def slot_attitude_range(
    offsets: Array, *, speed_min: float, speed_max: float, turn_rate: float, gamma: float
) -> tuple[Array, Array]:
    """Return the largest bank and |γ| (n,), rad, that slots need behind a leader within limits.

    The velocities of slot and leader turn at the same rate about the vertical, and have the same
    vertical component.

    Args:
        offsets: υ (n, 3) m in the leader's velocity frame.
        speed_min: smallest speed of the leader through the air, m/s.
        speed_max: largest one, m/s.
        turn_rate: largest |σ̇_g|, rad/s.
        gamma: largest |γ_g|, rad.
    """
    limits = {"turn_rate": turn_rate, "gamma": gamma}
    slowest, fastest = slot_speed_range(offsets, speed_min=speed_min, speed_max=speed_max, **limits)
    sine = np.minimum(speed_max * np.sin(gamma) / slowest, 1.0)
    return np.arctan(turn_rate * fastest / GRAVITY), np.arcsin(sine)


def slot_speed_range(
    offsets: Array,
    *,
    speed_min: float,
    speed_max: float,
    turn_rate: float,
    gamma: float = 0.0,
    gamma_dot: float = 0.0,
) -> tuple[Array, Array]:
    """Return the smallest and largest ‖q̇_g + χ̇_i‖ (n,), m/s, of a leader within limits.

    In the leader's frame the slot moves at w = v e1 + ω_g × υ with
    ω_g = (−σ̇ sin γ, γ̇, σ̇ cos γ), (26). For fixed γ the terms in σ̇ and γ̇ form a parallelogram, so
    extremes of ‖w‖ grow with v. The maximum is at a corner; the minimum at a corner, on an edge or
    where the gradient is zero. γ is tried on a grid. In a level turn this is v ± |σ̇ υ_2| forward
    and |σ̇ υ_1| across.

    Args:
        offsets: υ (n, 3) m: forward, right, down in the leader's velocity frame.
        speed_min: smallest ‖q̇_g‖, m/s over the ground.
        speed_max: largest ‖q̇_g‖, m/s over the ground.
        turn_rate: largest |σ̇_g|, rad/s.
        gamma: largest |γ_g|, rad.
        gamma_dot: largest |γ̇_g|, rad/s.
    """
    gammas = np.linspace(-gamma, gamma, ANGLES)
    ones, zeros = np.ones(ANGLES), np.zeros(ANGLES)
    by_course = np.stack([-np.sin(gammas), zeros, np.cos(gammas)], axis=1)  # (26) per σ̇ and per γ̇
    by_gamma = np.stack([zeros, ones, zeros], axis=1)
    a = turn_rate * np.cross(by_course[:, None, :], offsets)
    b = gamma_dot * np.cross(by_gamma[:, None, :], offsets)
    corners = [speed_max * FORWARD + x * a + y * b for x in (1.0, -1.0) for y in (1.0, -1.0)]
    fastest = np.max([_norm(corner) for corner in corners], axis=(0, 1))
    return _shortest(speed_min * FORWARD, a, b).min(axis=0), fastest


def _shortest(base: Array, a: Array, b: Array) -> Array:
    """Return the smallest ‖base + x a + y b‖ (...).

    x and y are in [−1, 1]; vectors are (..., 3).
    """
    edges = [
        _norm(start + _along(start, side)[..., None] * side)
        for start, side in ((base + b, a), (base - b, a), (base + a, b), (base - a, b))
    ]
    # stationary point, if it is within the square; with parallel a and b the edges suffice
    aa, ab, bb = _dot(a, a), _dot(a, b), _dot(b, b)
    determinant = aa * bb - ab * ab
    regular = determinant > 1e-12 * aa * bb
    divisor = np.where(regular, determinant, 1.0)
    x = (ab * _dot(b, base) - bb * _dot(a, base)) / divisor
    y = (ab * _dot(a, base) - aa * _dot(b, base)) / divisor
    within = regular & (np.abs(x) <= 1.0) & (np.abs(y) <= 1.0)
    inner = np.where(within, _norm(base + x[..., None] * a + y[..., None] * b), np.inf)
    shortest: Array = np.minimum(inner, np.min(edges, axis=0))
    return shortest


def _along(start: Array, side: Array) -> Array:
    """Return the t (...) in [−1, 1] that minimises ‖start + t side‖.

    Vectors are (..., 3).
    """
    square = _dot(side, side)
    t = -_dot(start, side) / np.where(square > 0.0, square, 1.0)
    return np.clip(t, -1.0, 1.0)


def _dot(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _norm(a: Array) -> Array:
    return np.sqrt(_dot(a, a))
