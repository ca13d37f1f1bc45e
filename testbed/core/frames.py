"""Frames, angles and the only unit conversions.

NED: local north-east-down at the scenario's origin. B: body, x forward, y right, z down. Euler
angles are roll φ, pitch θ, yaw ψ (yaw first). Names read right to left: R_NB takes a vector
resolved in B to N. Functions broadcast over leading axes.
"""

from __future__ import annotations

import math
from typing import TypeAlias, TypeVar

import numpy as np

from testbed.core.compile import jitable, kernel
from testbed.core.records import Array, Values, Vector

Scalars: TypeAlias = "float | Array"
_ScalarsT = TypeVar("_ScalarsT", float, Array)

GRAVITY = 9.80665  # m/s², standard
PAPER_GRAVITY = 9.81  # m/s², as printed beside [HBH23] eq. (20)
FOOT = 0.3048  # m
# Below this horizontal speed (m/s) a course is undefined; (22) is then taken as north.
COURSE_FLOOR = 1e-9


@jitable
def wrap_pi(angle: _ScalarsT) -> _ScalarsT:
    """Wrap angles (..., rad) into (−π, π]."""
    return np.pi - (np.pi - angle) % (2.0 * np.pi)


@kernel
def norm(v: Vector) -> float:
    """Return the length of a vector."""
    length: float = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return length


@jitable
def rotation_rows(euler: Vector) -> Values:
    """Return the rows of R_NB from roll, pitch and yaw, rad; numbers or arrays alike."""
    phi, theta, psi = euler[0], euler[1], euler[2]
    cf, sf, ct, st = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta)
    cp, sp = np.cos(psi), np.sin(psi)
    return (
        (ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp),
        (ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp),
        (-st, sf * ct, cf * ct),
    )


def rotation_ned_body(euler: Array) -> Array:
    """Return R_NB (..., 3, 3) from roll, pitch, yaw (..., 3) in rad."""
    rows = rotation_rows(np.moveaxis(np.asarray(euler), -1, 0))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@jitable
def attitude_rates(
    roll: Scalars, pitch: Scalars, p: Scalars, q: Scalars, r: Scalars
) -> tuple[Scalars, Scalars, Scalars]:
    """Return the derivatives of roll, pitch and yaw, rad/s, from body rates.

    For numbers or arrays. Singular at a pitch of ±90°, where yaw is undefined.
    """
    yaw_rate = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    return p + yaw_rate * np.sin(pitch), q * np.cos(roll) - r * np.sin(roll), yaw_rate


def euler_rates(euler: Array, rates_body: Array) -> Array:
    """Return the derivatives of roll, pitch, yaw (..., 3) rad/s from body rates (..., 3)."""
    p, q, r = np.moveaxis(rates_body, -1, 0)
    return np.stack(attitude_rates(euler[..., 0], euler[..., 1], p, q, r), axis=-1)


@jitable
def specific_force(euler: Vector, acceleration_ned: Vector) -> Values:
    """Return the specific force along body axes, m/s², which accelerometers measure.

    Args:
        euler: roll, pitch, yaw, rad.
        acceleration_ned: derivative of the velocity, m/s².
    """
    rows = rotation_rows(euler)
    north, east = acceleration_ned[0], acceleration_ned[1]
    down = acceleration_ned[2] - GRAVITY
    return (
        rows[0][0] * north + rows[1][0] * east + rows[2][0] * down,
        rows[0][1] * north + rows[1][1] * east + rows[2][1] * down,
        rows[0][2] * north + rows[1][2] * east + rows[2][2] * down,
    )


def body_rates(euler: Array, angle_rates: Array) -> Array:
    """Return p, q, r (..., 3) rad/s from Euler angles and their derivatives (..., 3)."""
    sine, cosine = np.sin(euler), np.cos(euler)
    sf, cf, ct = sine[..., 0], cosine[..., 0], cosine[..., 1]
    pitch_rate, yaw_rate = angle_rates[..., 1], angle_rates[..., 2]
    out = np.empty(np.broadcast_shapes(euler.shape, angle_rates.shape))
    out[..., 0] = angle_rates[..., 0] - yaw_rate * sine[..., 1]
    out[..., 1] = pitch_rate * cf + yaw_rate * sf * ct
    out[..., 2] = yaw_rate * cf * ct - pitch_rate * sf
    return out


def quaternion_xyzw(euler: Array) -> Array:
    """Return the quaternion (..., 4) of R_NB from roll, pitch, yaw (..., 3) in rad.

    Its order is x, y, z, w.
    """
    half = 0.5 * np.asarray(euler)
    cf, ct, cp = np.moveaxis(np.cos(half), -1, 0)
    sf, st, sp = np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            sf * ct * cp - cf * st * sp,
            cf * st * cp + sf * ct * sp,
            cf * ct * sp - sf * st * cp,
            cf * ct * cp + sf * st * sp,
        ],
        axis=-1,
    )


def enu_from_ned(vectors: Array) -> Array:
    """Resolve NED vectors (..., 3) east, north and up."""
    out: Array = np.asarray(vectors)[..., [1, 0, 2]] * [1.0, 1.0, -1.0]
    return out


def flu_from_frd(vectors: Array) -> Array:
    """Resolve body vectors (..., 3), forward, right, down, along forward, left and up."""
    out: Array = np.asarray(vectors) * [1.0, -1.0, -1.0]
    return out


def euler_enu_flu(euler: Array) -> Array:
    """Roll, pitch, yaw (..., 3) rad of axes forward, left, up in east, north, up.

    Args:
        euler: the same of axes forward, right, down in north, east, down.
    """
    out: Array = np.asarray(euler) * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.5 * np.pi]
    return out


def euler_from_quaternion(xyzw: Array) -> Array:
    """Return roll, pitch, yaw (..., 3) rad of R_NB from a quaternion (..., 4).

    Its order is x, y, z, w.

    Of any length but zero, for which the angles are not numbers.
    """
    x, y, z, w = np.moveaxis(np.asarray(xyzw), -1, 0)
    length2 = x * x + y * y + z * z + w * w
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = 2.0 * (w * y - x * z) / length2
    out = np.empty((*np.shape(x), 3))
    out[..., 0] = np.arctan2(2.0 * (w * x + y * z), length2 - 2.0 * (x * x + y * y))
    out[..., 1] = np.arcsin(np.clip(sine, -1.0, 1.0))
    out[..., 2] = np.arctan2(2.0 * (w * z + x * y), length2 - 2.0 * (y * y + z * z))
    return out


@jitable
def angles_from_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw, rad, of a quaternion; see `euler_from_quaternion`.

    For one aircraft, with the same last bits in kernels as in Python.

    Raises:
        ZeroDivisionError: in Python, the length is zero.
    """
    length2 = x * x + y * y + z * z + w * w
    sine = 2.0 * (w * y - x * z) / length2
    return (
        math.atan2(2.0 * (w * x + y * z), length2 - 2.0 * (x * x + y * y)),
        math.asin(min(max(sine, -1.0), 1.0)),
        math.atan2(2.0 * (w * z + x * y), length2 - 2.0 * (y * y + z * z)),
    )


def course(velocity_ned: Array) -> Array:
    """Course over the ground σ (...,) rad from velocity (..., 3)."""
    return np.arctan2(velocity_ned[..., 1], velocity_ned[..., 0])


def wind_from_deg(wind_ned: Array) -> Array:
    """Where winds (..., 3) blow from (...,), degrees clockwise from north, 0 to 360."""
    return np.degrees(np.arctan2(-wind_ned[..., 1], -wind_ned[..., 0])) % 360.0


@jitable
def gamma_of(north: _ScalarsT, east: _ScalarsT, down: _ScalarsT) -> _ScalarsT:
    """Return the flight-path angle γ, rad, climbing positive, of a velocity or direction."""
    gamma: _ScalarsT = np.arctan2(-down, np.hypot(north, east))
    return gamma


def flight_path_angle(velocity_ned: Array) -> Array:
    """Return the flight-path angle γ (...,) rad, climbing positive, of velocities (..., 3)."""
    return gamma_of(velocity_ned[..., 0], velocity_ned[..., 1], velocity_ned[..., 2])


def turn_bank(velocity_ned: Array, acceleration_ned: Array) -> Array:
    """Return the bank (...,) rad of a coordinated turn, positive to the right.

    It is atan(χ̇ V cos γ / g): the horizontal acceleration across the velocity through the air is
    χ̇ V cos γ. An aircraft that slips in its turn banks by another angle.

    Args:
        velocity_ned: (..., 3) m/s through the air.
        acceleration_ned: (..., 3) m/s².
    """
    north, east = velocity_ned[..., 0], velocity_ned[..., 1]
    across = north * acceleration_ned[..., 1] - east * acceleration_ned[..., 0]
    level = np.maximum(np.hypot(north, east), COURSE_FLOOR)
    bank: Array = np.arctan(across / (level * GRAVITY))
    return bank
