"""The compiled mean wind and gusts do what the readable ones say, in every kind of them."""

import itertools

import numpy as np
import pytest

from testbed.air.airframe import points_body
from testbed.air.field_sample import no_field
from testbed.air.gusts import PlacedGust, TimedGust, make_gusts
from testbed.air.mean import LogProfile, PowerProfile, make_mean_wind
from testbed.air.together import blow
from testbed.state import Airframe

pytest.importorskip("numba")

from testbed.air import together_twin  # noqa: E402

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


def room():
    """For mean, path, ambient, wind and turns of N, all of it not a number."""
    return np.full((N, 3), np.nan), np.full(3, np.nan), *np.full((3, N, 3), np.nan)


def test_what_blows_for_everyone_alike():
    """Without a field, which has a test of its own."""
    rng = np.random.default_rng(91)
    body = points_body([Airframe(2.8, 1.0, 0.8, 6.5, 5.0)] * N)
    turned, apart = [], []
    for wind in winds(rng):
        gusts = [
            TimedGust((3.0, -1.0, 2.0), start=1.0, ramp=4.0, pulse=False),
            PlacedGust((0.0, 2.0, 1.0), (5.0, 3.0), 1.2, 0.0, 30.0, None, True),
            PlacedGust((1.0, 0.0, -2.0), (-9.0, 3.0), 4.0, 2.0, 50.0, 7.0, False),
        ]
        for some, time in itertools.product((gusts, []), TIMES):
            position, euler = places(rng), rng.uniform(-1.0, 1.0, (N, 3))
            given = wind, no_field(), make_gusts(some, wind), position, euler, body
            ours, theirs = room(), room()
            blow(*given, *ours, time)
            together_twin.ready_blow(*given, *theirs)(time)
            for one, two in zip(ours, theirs, strict=True):
                np.testing.assert_allclose(two, one, rtol=1e-11, atol=1e-12)
            mean, path, ambient, velocity, turns = ours
            np.testing.assert_array_equal(path, wind.displacement_ned(time))
            np.testing.assert_array_equal(mean, wind.velocity_ned(time, -position[:, 2]))
            np.testing.assert_array_equal(ambient, velocity)  # no field
            turned.append(abs(turns).max())
            apart.append(abs(velocity - mean).max())
            if not some and wind.uniform:
                assert turned.pop() == apart.pop() == 0.0
    assert np.median(turned) > 1e-4  # rad/s: most of them turn somebody
    assert np.median(apart) > 1e-3  # m/s
