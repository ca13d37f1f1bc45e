"""Frames, angles and the only unit conversions.

NED: local north-east-down at the scenario's origin. B: body, x forward, y right, z down. Euler
angles are roll φ, pitch θ, yaw ψ (yaw first). Names read right to left: R_NB takes a vector
resolved in B to N. Functions broadcast over leading axes.
"""

from __future__ import annotations

import math

import numpy as np

from testbed.core.records import Array, Origin

GRAVITY = 9.80665  # m/s², standard
FOOT = 0.3048  # m
# Below this horizontal speed (m/s) a course is undefined; (22) is then taken as north.
COURSE_FLOOR = 1e-9

WGS84_A = 6378137.0  # m
WGS84_E2 = 6.69437999014e-3


def wrap_pi(angle: Array) -> Array:
    """Wrap angles (..., rad) into (−π, π]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def rotation_ned_body(euler: Array) -> Array:
    """R_NB (..., 3, 3) from roll, pitch, yaw (..., 3) in rad."""
    phi, theta, psi = np.moveaxis(np.asarray(euler), -1, 0)
    cf, sf = np.cos(phi), np.sin(phi)
    ct, st = np.cos(theta), np.sin(theta)
    cp, sp = np.cos(psi), np.sin(psi)
    out = np.empty((*np.shape(phi), 3, 3))
    out[..., 0, 0] = ct * cp
    out[..., 0, 1] = sf * st * cp - cf * sp
    out[..., 0, 2] = cf * st * cp + sf * sp
    out[..., 1, 0] = ct * sp
    out[..., 1, 1] = sf * st * sp + cf * cp
    out[..., 1, 2] = cf * st * sp - sf * cp
    out[..., 2, 0] = -st
    out[..., 2, 1] = sf * ct
    out[..., 2, 2] = cf * ct
    return out


def body_rates(euler: Array, angle_rates: Array) -> Array:
    """Body rates p, q, r (..., 3) rad/s from the derivatives of roll, pitch, yaw (..., 3)."""
    sine, cosine = np.sin(euler), np.cos(euler)
    sf, cf, ct = sine[..., 0], cosine[..., 0], cosine[..., 1]
    pitch_rate, yaw_rate = angle_rates[..., 1], angle_rates[..., 2]
    out = np.empty(np.broadcast_shapes(euler.shape, angle_rates.shape))
    out[..., 0] = angle_rates[..., 0] - yaw_rate * sine[..., 1]
    out[..., 1] = pitch_rate * cf + yaw_rate * sf * ct
    out[..., 2] = yaw_rate * cf * ct - pitch_rate * sf
    return out


def quaternion_xyzw(euler: Array) -> Array:
    """Quaternion (..., 4) ordered x, y, z, w of R_NB from roll, pitch, yaw (..., 3) in rad."""
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
    """Roll, pitch, yaw (..., 3) rad of R_NB from a quaternion (..., 4) ordered x, y, z, w.

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


def course(velocity_ned: Array) -> Array:
    """Course over the ground σ (...,) rad from velocity (..., 3)."""
    return np.arctan2(velocity_ned[..., 1], velocity_ned[..., 0])


def wind_from_deg(wind_ned: Array) -> Array:
    """Where winds (..., 3) blow from (...,), degrees clockwise from north, 0 to 360."""
    return np.degrees(np.arctan2(-wind_ned[..., 1], -wind_ned[..., 0])) % 360.0


def flight_path_angle(velocity_ned: Array) -> Array:
    """Flight-path angle γ (...,) rad, climbing positive, from velocity (..., 3)."""
    horizontal = np.hypot(velocity_ned[..., 0], velocity_ned[..., 1])
    return np.arctan2(-velocity_ned[..., 2], horizontal)


def velocity_frame(velocity: Array) -> Array:
    """R(σ, γ) (n, 3, 3): the zero-roll velocity frame of velocities (n, 3), m/s.

    Its columns are forward along the velocity, right in the horizontal, and down.
    [HBH23] eqs. (22)-(24), with the angles' sines and cosines taken from the velocity itself.
    """
    north, east, down = velocity[:, 0], velocity[:, 1], velocity[:, 2]
    horizontal = np.hypot(north, east)
    speed = np.hypot(horizontal, down)
    upright = np.maximum(horizontal, COURSE_FLOOR)
    cs = np.where(horizontal > COURSE_FLOOR, north / upright, 1.0)
    ss = np.where(horizontal > COURSE_FLOOR, east / upright, 0.0)
    cg, sg = horizontal / speed, -down / speed
    out = np.zeros((len(velocity), 3, 3))
    out[:, 0, 0] = cg * cs
    out[:, 0, 1] = -ss
    out[:, 0, 2] = sg * cs
    out[:, 1, 0] = cg * ss
    out[:, 1, 1] = cs
    out[:, 1, 2] = sg * ss
    out[:, 2, 0] = -sg
    out[:, 2, 2] = cg
    return out


def metres_per_radian(origin: Origin) -> tuple[float, float]:
    """Metres of north per radian of latitude and of east per radian of longitude at the origin."""
    lat = math.radians(origin.latitude_deg)
    w2 = 1.0 - WGS84_E2 * math.sin(lat) ** 2
    meridian = WGS84_A * (1.0 - WGS84_E2) / w2**1.5 + origin.elevation_m
    prime_vertical = WGS84_A / math.sqrt(w2) + origin.elevation_m
    return meridian, prime_vertical * math.cos(lat)


def geodetic_from_ned(position_ned: Array, origin: Origin) -> Array:
    """Latitude deg, longitude deg, height m above sea level (..., 3) from NED (..., 3).

    The curvilinear local frame ArduPlane uses: north and east are arcs along the ellipsoid's
    meridian and parallel at the origin, down is against height, so that level flight keeps down
    constant. Up to 1 km away it differs horizontally from the tangent plane by at most 0.07 m at a
    latitude of 38°, 0.16 m at 60° and 0.25 m at 70°.
    """
    north, east = metres_per_radian(origin)
    position = np.asarray(position_ned, dtype=np.float64)
    return np.stack(
        [
            origin.latitude_deg + np.degrees(position[..., 0] / north),
            origin.longitude_deg + np.degrees(position[..., 1] / east),
            origin.elevation_m - position[..., 2],
        ],
        axis=-1,
    )


def ned_from_geodetic(geodetic: Array, origin: Origin) -> Array:
    """NED (..., 3) m from latitude deg, longitude deg, height m above sea level (..., 3).

    The inverse of `geodetic_from_ned`. East is by the shorter way round the earth.
    """
    north, east = metres_per_radian(origin)
    place = np.asarray(geodetic, dtype=np.float64)
    return np.stack(
        [
            north * np.radians(place[..., 0] - origin.latitude_deg),
            east * wrap_pi(np.radians(place[..., 1] - origin.longitude_deg)),
            origin.elevation_m - place[..., 2],
        ],
        axis=-1,
    )
