"""Longitudes: the wrap by exact fractions, and local NED beside angles about the Earth's axis."""

import math
from fractions import Fraction

import numpy as np
import pytest

from testbed.core.geodetic import (
    E7,
    RADIANS,
    WGS84_A,
    WGS84_E2,
    geodetic_from_ned,
    local_frame,
    longitude_e7,
    ned_from_geodetic,
    origin_geodetic,
    to_geodetic,
    to_ned,
    wrap_longitude,
)
from testbed.core.records import AIRCRAFT, NedOrigin, allocate
from testbed.vehicle.jsbsim_io import write_truth

LONGITUDES = (0.0, 90.0, 179.9999, 180.0, -180.0, -90.0)


def parallel_radius(origin):
    """Return the radius of the origin's parallel, m."""
    latitude = math.radians(origin.latitude_deg)
    normal = WGS84_A / math.sqrt(1.0 - WGS84_E2 * math.sin(latitude) ** 2)
    return (normal + origin.elevation_m) * math.cos(latitude)


def longitude_of(origin, east):
    """Return the longitude east of an origin, rad, as the direction of a vector: it wraps."""
    turned, angle = math.radians(origin.longitude_deg), east / parallel_radius(origin)
    return np.arctan2(np.sin(turned + angle), np.cos(turned + angle))


def test_wrap_equals_exact_remainder():
    edges = [each for k in (-540.0, -360.0, -180.0, 180.0, 360.0) for each in near(k)]
    values = [*edges, *np.random.default_rng(1).uniform(-600.0, 600.0, 200), 1e-300, 0.0]
    for value in values:
        exact = (Fraction(value) + 180) % 360 - 180
        wrapped = float(wrap_longitude(float(value), 180.0))
        assert -180.0 <= wrapped < 180.0
        assert Fraction(wrapped) == exact


def near(value):
    return np.nextafter(value, -1e9), value, np.nextafter(value, 1e9)


def test_rounding_to_e7_stays_below_180():
    rounded = longitude_e7(np.array([180.0 - 1e-9, 180.0, -180.0 - 1e-9, 179.9999999, 12.5]))
    assert rounded.tolist() == [-E7, -E7, -E7, 1799999999.0, 125000000.0]


@pytest.mark.parametrize("longitude", LONGITUDES)
def test_longitude_equals_direction_from_axis(longitude):
    origin = NedOrigin(-16.8, longitude, 10.0)
    east = np.linspace(-900.0, 900.0, 7)
    ned = np.stack([0 * east, east, 0 * east], axis=-1)
    found = geodetic_from_ned(ned, origin)[:, 1]
    assert ((found >= -180.0) & (found < 180.0)).all()
    off = np.radians(found) - longitude_of(origin, east)
    assert np.abs(np.sin(0.5 * off)).max() < 1e-15
    assert ned_from_geodetic(geodetic_from_ned(ned, origin), origin) == pytest.approx(ned, abs=1e-6)
    frame = local_frame(origin, RADIANS)
    for position in ned.tolist():
        again = to_ned(frame, *to_geodetic(frame, *position))
        assert again == pytest.approx(position, abs=1e-8)


@pytest.mark.parametrize("longitude", LONGITUDES)
def test_truth_is_continuous_at_any_longitude(longitude):
    """Of JSBSim's numbers on both sides of the origin; JSBSim's longitudes are directions."""
    origin, east = NedOrigin(-16.8, longitude, 10.0), np.linspace(-900.0, 900.0, 8)
    numbers, aircraft = np.zeros((8, 17)), allocate(AIRCRAFT, 8)
    numbers[:, 0], numbers[:, 1] = math.radians(-16.8), longitude_of(origin, east)
    frame = tuple(local_frame(origin, RADIANS))
    write_truth(np.arange(8), numbers, frame, aircraft, np.arange(8))
    assert aircraft["truth"]["position_ned"][:, 1] == pytest.approx(east, abs=1e-8)


def test_origin_at_180_equals_minus_180():
    assert local_frame(NedOrigin(38.0, 180.0)) == local_frame(NedOrigin(38.0, -180.0))
    assert local_frame(NedOrigin(38.0, 180.0), RADIANS) == local_frame(
        NedOrigin(38.0, -180.0), RADIANS
    )
    assert origin_geodetic(NedOrigin(38.0, 180.0, 300.0)) == (38.0, -180.0, 300.0)
