"""The local frame beside the tangent plane and the ellipsoid, as the docs say."""

import math
import re

import numpy as np
import pytest
from places import ROOT

from testbed.core.geodetic import WGS84_A, WGS84_E2, geodetic_from_ned, ned_from_geodetic
from testbed.core.records import NedOrigin

OWN_SCENARIO = (ROOT / "docs" / "own-scenario.md").read_text(encoding="utf-8")


def earth_fixed(geodetic):
    """Return the place (..., 3), m, from the centre of the earth."""
    latitude, longitude = np.radians(geodetic[..., 0]), np.radians(geodetic[..., 1])
    height = geodetic[..., 2]
    radius = WGS84_A / np.sqrt(1.0 - WGS84_E2 * np.sin(latitude) ** 2)
    out = (radius + height) * np.cos(latitude)
    up = (radius * (1.0 - WGS84_E2) + height) * np.sin(latitude)
    return np.stack([out * np.cos(longitude), out * np.sin(longitude), up], axis=-1)


def test_tangent_plane_differs_as_documented():
    documented = re.findall(r"([\d.]+) m at (?:a latitude of )?(\d+)°", OWN_SCENARIO)
    assert [float(latitude) for _, latitude in documented] == [38.0, 60.0, 70.0]
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    ned = 1000.0 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    for metres, degrees in documented:
        origin, angle = NedOrigin(float(degrees), 0.0, 0.0), math.radians(float(degrees))
        place = earth_fixed(geodetic_from_ned(ned, origin))
        place -= earth_fixed(np.array([float(degrees), 0.0, 0.0]))
        north = -math.sin(angle) * place[:, 0] + math.cos(angle) * place[:, 2]
        off = np.hypot(north - ned[:, 0], place[:, 1] - ned[:, 1]).max()
        assert off == pytest.approx(float(metres), abs=0.005)


def test_east_grows_faster_in_the_north_as_documented():
    percent = float(re.search(r"changes ([\d.]+) % faster", OWN_SCENARIO)[1])
    north = geodetic_from_ned(np.array([14000.0, 0.0, 0.0]), NedOrigin(38.0, 0.0, 0.0))
    beside = north + [0.0, 1e-4, 0.0]
    east = ned_from_geodetic(beside, NedOrigin(38.0, 0.0, 0.0))[1]
    true = np.linalg.norm(earth_fixed(beside) - earth_fixed(north))
    assert 100.0 * (east / true - 1.0) == pytest.approx(percent, abs=0.005)
