"""Conversions between latitude, longitude, height and local NED, and the wrap of longitudes.

Longitudes are added and subtracted in this module only. Each result lies in [−180°, 180°), and
differences are those of the shorter way round the Earth. An origin at 180° equals one at −180°.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np

from testbed.core.compile import jitable
from testbed.core.records import Array, BoolArray, NedOrigin

_ScalarsT = TypeVar("_ScalarsT", float, Array)

WGS84_A = 6378137.0  # m
WGS84_E2 = 6.69437999014e-3
DEGREES, RADIANS, E7 = 180.0, math.pi, 1.8e9  # half a turn in degrees, rad, and 1e-7 degrees


class LocalFrame(NamedTuple):
    """Local NED frame of an origin, as kernels use it; angles in the unit of `half_turn`.

    The curvilinear frame that ArduPlane uses: north and east are arcs along the ellipsoid's
    meridian and parallel at the origin, down is against height, so that level flight keeps down
    constant. Up to 1 km away it differs horizontally from the tangent plane by at most 0.07 m at a
    latitude of 38°, 0.16 m at 60° and 0.25 m at 70°.
    """

    latitude: float
    longitude: float  # in [−half_turn, half_turn)
    elevation: float  # m above sea level
    metres_per_latitude: float  # m per unit of angle
    metres_per_longitude: float
    half_turn: float  # DEGREES or RADIANS


def local_frame(origin: NedOrigin, half_turn: float = DEGREES) -> LocalFrame:
    """Return the local frame of an origin, for angles in degrees or RADIANS."""
    unit, radian = half_turn / DEGREES, RADIANS / half_turn
    latitude = math.radians(origin.latitude_deg)
    w2 = 1.0 - WGS84_E2 * math.sin(latitude) ** 2
    meridian = WGS84_A * (1.0 - WGS84_E2) / w2**1.5 + origin.elevation_m
    prime_vertical = WGS84_A / math.sqrt(w2) + origin.elevation_m
    return LocalFrame(
        latitude=unit * origin.latitude_deg,
        longitude=float(wrap_longitude(unit * origin.longitude_deg, half_turn)),
        elevation=origin.elevation_m,
        metres_per_latitude=radian * meridian,
        metres_per_longitude=radian * (prime_vertical * math.cos(latitude)),
        half_turn=half_turn,
    )


@jitable
def wrap_longitude(longitude: _ScalarsT, half_turn: float) -> _ScalarsT:
    """Wrap longitudes or their differences (...,) into [−half_turn, half_turn), without rounding.

    Args:
        longitude: (...,) in the unit of `half_turn`.
        half_turn: DEGREES, RADIANS or E7.
    """
    turn = 2.0 * half_turn
    rest = np.fmod(longitude, turn)  # exact, as are the sums
    wrapped: _ScalarsT = rest - turn * (rest >= half_turn) + turn * (rest < -half_turn)
    return wrapped


def has_position(latitude: Array, longitude: Array) -> BoolArray:
    """Mask positions (…) that are known: finite, and not at 0°, 0°.

    Receivers and autopilots write 0, 0 until they know one.
    """
    known = np.isfinite(latitude) & np.isfinite(longitude)
    found: BoolArray = known & ((latitude != 0.0) | (longitude != 0.0))
    return found


@jitable
def to_ned(
    frame: LocalFrame, latitude: _ScalarsT, longitude: _ScalarsT, height: _ScalarsT
) -> tuple[_ScalarsT, _ScalarsT, _ScalarsT]:
    """Return north, east, down, m, of geodetic positions.

    Args:
        frame: local frame.
        latitude: (...,) in the unit of the frame.
        longitude: (...,) in the unit of the frame.
        height: (...,) m above sea level.
    """
    east_of_origin = wrap_longitude(longitude - frame.longitude, frame.half_turn)
    return (
        frame.metres_per_latitude * (latitude - frame.latitude),
        frame.metres_per_longitude * east_of_origin,
        frame.elevation - height,
    )


@jitable
def to_geodetic(
    frame: LocalFrame, north: _ScalarsT, east: _ScalarsT, down: _ScalarsT
) -> tuple[_ScalarsT, _ScalarsT, _ScalarsT]:
    """Return latitude, longitude, in the unit of the frame, and height, m; inverts `to_ned`."""
    longitude = frame.longitude + east / frame.metres_per_longitude
    return (
        frame.latitude + north / frame.metres_per_latitude,
        wrap_longitude(longitude, frame.half_turn),
        frame.elevation - down,
    )


def ned_from_geodetic(geodetic: Array, origin: NedOrigin) -> Array:
    """Return NED (..., 3) m from latitude deg, longitude deg, height m above sea level (..., 3)."""
    values = np.asarray(geodetic, dtype=np.float64)
    with np.errstate(invalid="ignore"):  # infinite: NaN
        return np.stack(to_ned(local_frame(origin), *np.moveaxis(values, -1, 0)), axis=-1)


def geodetic_from_ned(position_ned: Array, origin: NedOrigin) -> Array:
    """Return latitude deg, longitude deg, height m above sea level (..., 3) from NED (..., 3)."""
    values = np.asarray(position_ned, dtype=np.float64)
    with np.errstate(invalid="ignore"):  # infinite: NaN
        return np.stack(to_geodetic(local_frame(origin), *np.moveaxis(values, -1, 0)), axis=-1)


def origin_geodetic(origin: NedOrigin) -> tuple[float, float, float]:
    """Return latitude deg, longitude deg in [−180, 180) and elevation m of an origin."""
    return local_frame(origin)[:3]


def longitude_e7(longitude_deg: _ScalarsT) -> _ScalarsT:
    """Round longitudes (...,), degrees, to whole 1e-7 degrees in [−180°, 180°), as MAVLink does."""
    rounded: _ScalarsT = np.rint(longitude_deg * 1e7)
    return wrap_longitude(rounded, E7)
