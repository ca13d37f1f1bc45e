"""The compiled mean wind and gusts do what the readable ones say, in every kind of them."""

import itertools

import numpy as np
import pytest

from testbed.air.airframe import points_body
from testbed.air.gusts import PlacedGust, TimedGust, make_gusts
from testbed.air.mean import LogProfile, PowerProfile, make_mean_wind, write_mean
from testbed.air.uneven import add_uneven
from testbed.state import Airframe

pytest.importorskip("numba")

from testbed.air import mean_twin, uneven_twin  # noqa: E402

PROFILES = (None, LogProfile(10.0, 0.03), PowerProfile(10.0, 0.143))
TIMES = (0.0, 0.7, 3.0, 11.5, 19.9, 20.0)  # s; rows of the wandering wind are at whole ones
N = 7


def winds(rng):
    """Steady and wandering, with each profile."""
    rows = rng.normal([4.0, -3.0, 0.3], 1.0, (21, 3))
    for profile in PROFILES:
        for count in (1, 21):
            yield make_mean_wind(
                np.arange(float(count)), rows[:count], profile=profile, carrying_height=80.0
            )


def places(rng):
    """Of N aircraft, some on the ground and below."""
    position = rng.normal(0.0, 40.0, (N, 3))
    position[:3, 2] = 3.0, 0.0, -0.02
    return position


def test_the_mean_wind():
    rng = np.random.default_rng(90)
    for wind, time in itertools.product(winds(rng), TIMES):
        position = places(rng)
        ours, theirs = ((np.empty((N, 3)), np.empty(3)) for _ in range(2))
        write_mean(wind, position, *ours, time)
        mean_twin.ready_write_mean(wind, position, *theirs)(time)
        for one, two in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(two, one, rtol=1e-13, atol=1e-13)


def test_what_differs_from_point_to_point():
    rng = np.random.default_rng(91)
    body = points_body([Airframe(2.8, 1.0, 0.8, 6.5, 5.0)] * N)
    felt = []
    for wind in winds(rng):
        gusts = [
            TimedGust((3.0, -1.0, 2.0), start=1.0, ramp=4.0, pulse=False),
            PlacedGust((0.0, 2.0, 1.0), (5.0, 3.0), 1.2, 0.0, 30.0, None, True),
            PlacedGust((1.0, 0.0, -2.0), (-9.0, 3.0), 4.0, 2.0, 50.0, 7.0, False),
        ]
        for some, time in itertools.product((gusts, []), TIMES):
            position, euler = places(rng), rng.uniform(-1.0, 1.0, (N, 3))
            mean, path = np.empty((N, 3)), np.empty(3)
            write_mean(wind, position, mean, path, time)
            air = make_gusts(some, wind)
            ours = rng.normal(0.0, 1.0, (3, N, 3))
            theirs = ours.copy()
            before = ours[2].copy()
            add_uneven(wind, air, position, euler, body, mean, path, *ours, time)
            given = wind, air, position, euler, body, mean, path
            uneven_twin.ready_add_uneven(*given, *theirs)(time)
            np.testing.assert_allclose(theirs, ours, rtol=1e-11, atol=1e-12)
            felt.append(abs(ours[2] - before).max())
    assert np.median(felt) > 1e-4  # rad/s: most of them turn somebody
