"""Kernels of the atmosphere together: wind, field and gusts over airframes, turbulence of a step.

The parts have tests of their own; here they are composed with numpy.
"""

import itertools

import numpy as np
import pytest
from reference import adapters_atmosphere as adapters

from testbed.atmosphere.airframe_wind import make_local_wind, sample_ambient_wind
from testbed.atmosphere.dryden import MIXTURES, add_dryden_turbulence
from testbed.atmosphere.gusts import PlaneFrontGust, UniformGust, make_gusts
from testbed.atmosphere.mean_wind import LOGARITHMIC, POWER, Profile, make_mean_wind
from testbed.atmosphere.turbulence_field import empty_grid, make_field
from testbed.core.records import AIRCRAFT, Airframe, allocate

SIGMA = np.array([1.6, 1.6, 1.2])  # m/s
LENGTH = np.array([263.0, 263.0, 100.0])  # m, of 100 m above the ground
RASCAL = Airframe(span=2.8, area=1.0, arm=0.8, mass=6.5, lift_slope=5.0)
SHORT = Airframe(span=2.1, area=0.75, arm=0.18, mass=3.4, lift_slope=4.0)
PROFILES = (None, Profile(LOGARITHMIC, 10.0, 0.03), Profile(POWER, 10.0, 0.143))
GUSTS = [
    UniformGust((3.0, -1.0, 2.0), start=1.0, ramp=4.0, pulse=False),
    PlaneFrontGust((0.0, 2.0, 1.0), (5.0, 3.0), 1.2, 0.0, 30.0, None, True),
    PlaneFrontGust((1.0, 0.0, -2.0), (-9.0, 3.0), 4.0, 2.0, 50.0, 7.0, False),
]


@pytest.fixture(scope="module")
def field():
    return make_field(1, SIGMA, LENGTH)


@pytest.mark.parametrize("profile", PROFILES, ids=["uniform", "logarithmic", "power"])
def test_ambient_wind_is_the_sum_over_the_airframe(profile, field):
    """Steady and unsteady wind, with and without gusts and field, of which only gusts move wakes.

    Profile and gusts are averaged over the airframe as differences from the wind at its centre;
    the mean wind carries the field.
    """
    n, rng = 7, np.random.default_rng(91)
    rows = rng.normal([4.0, -3.0, 0.3], 1.0, (21, 3))
    local, aircraft = make_local_wind([RASCAL, SHORT, *[RASCAL] * 5]), allocate(AIRCRAFT, n)
    body, truth, out = np.array(local["sample_points"]), aircraft["truth"], aircraft["wind"]
    rates, differences = [], []
    choices = (1, 21), (GUSTS, []), (field.grid, empty_grid()), (0.0, 0.7, 11.5, 20.0)
    for count, gusts, grid, time in itertools.product(*choices):
        position, euler = rng.normal(0.0, 40.0, (n, 3)), rng.uniform(-1.0, 1.0, (n, 3))
        position[:3, 2] = 3.0, 0.0, -0.02  # below, on and just above the ground
        truth["position_ned"], truth["euler"] = position, euler
        for records in (local["mean_wind"], local["ambient_wind"], out["wind_ned"]):
            records[:] = np.nan
        wind = make_mean_wind(
            np.arange(float(count)), rows[:count], profile=profile, advection_height=80.0
        )
        records = make_gusts(gusts, wind)
        sample_ambient_wind(wind.rows, wind.profile, records, *grid, local, aircraft, time)

        path = wind.displacement_ned(time)
        mean = adapters.mean_velocity(wind, time, -position[:, 2])
        points = adapters.sample_points(position, euler, body)
        more = adapters.mean_velocity(wind, time, -points[:, :, 2]) - mean[:, None]
        more += adapters.gust_velocity(records, time, points, path)
        average, gradient = adapters.mean_and_gradient(more, euler, body)
        if grid is field.grid:
            points = adapters.sample_points(position - path, euler, body)
            air = adapters.sample_field(grid, position - path, points)
            turbulence, gradients = adapters.mean_and_gradient(air, euler, body)
            assert (abs(turbulence).max(axis=0) > 0.2).all()
        else:
            turbulence = gradients = np.zeros((n, 3))
        np.testing.assert_array_equal(local["mean_wind"], mean)
        expected = mean + average, mean + average + turbulence, gradient + gradients
        found = local["ambient_wind"], out["wind_ned"], out["wind_gradient_rates"]
        for one, two in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, two, rtol=0.0, atol=1e-12)
        if gusts or profile:
            rates.append(abs(gradient).max())
            differences.append(abs(average).max())
    assert np.median(rates) > 1e-4  # rad/s
    assert np.median(differences) > 1e-3  # m/s


def test_field_over_airframes_has_its_sigma(field):
    """Of 50 positions within some scale lengths, of which few are independent."""
    n, rng = 50, np.random.default_rng(9)
    points = rng.normal(0.0, 300.0, (n, 3))
    body = np.array(make_local_wind([RASCAL] * n)["sample_points"])
    euler = rng.uniform(-1.0, 1.0, (n, 3))
    air = adapters.sample_field(field.grid, points, adapters.sample_points(points, euler, body))
    average, _ = adapters.mean_and_gradient(air, euler, body)
    assert average.std(axis=0) == pytest.approx(SIGMA, rel=0.4)
    there = adapters.sample_field(field.grid, points, points[:, np.newaxis])[:, 0]
    # an average over the wing differs from the middle by waves as short as the wing
    assert ((average - there).std(axis=0) < 0.1 * SIGMA).all()


@pytest.mark.parametrize("spectrum", ["dryden", "von-karman"])
def test_dryden_turbulence_of_a_step(spectrum):
    """Filters of the present airspeeds, advanced, resolved in NED and added to the wind."""
    n, dt, rng = 7, 0.02, np.random.default_rng(62)
    sigma, length = rng.uniform(0.5, 3.0, (n, 3)), rng.uniform(3.0, 700.0, (n, 3))
    spans = rng.uniform(1.0, 5.0, n)
    first_order, third_order = adapters.filter_records(spectrum, np.ones(n), sigma, length, spans)
    parts = third_order.shape[2]
    states, numbers = rng.normal(size=(2, n, 7 * parts + 1))
    aircraft, local = allocate(AIRCRAFT, n), make_local_wind([RASCAL] * n)
    motion, wind = aircraft["truth"], aircraft["wind"]
    for name in ("position_ned", "velocity_ned"):
        motion[name] = rng.normal(0.0, 15.0, (n, 3))
    motion["position_ned"][:, 2] = -np.resize([100.0, 400.0, 450.0, 2000.0], n)
    motion["euler"] = rng.uniform([-0.8, -0.3, -np.pi], [0.8, 0.3, np.pi], (n, 3))
    local["mean_wind"] = rng.normal(0.0, 5.0, (n, 3))
    wind["wind_ned"] = before = rng.normal(0.0, 5.0, (n, 3))
    wind["wind_gradient_rates"] = rates = rng.normal(0.0, 0.1, (n, 3))
    through_air = motion["velocity_ned"] - local["mean_wind"]
    distance = np.linalg.norm(through_air, axis=1) * dt
    f = adapters.make_filters(spectrum, distance, sigma, length, spans)
    first = f.decay * states[:, : parts + 1] + f.noise * numbers[:, : parts + 1]
    third, drawn = (each[:, parts + 1 :].reshape(n, 2, parts, 3) for each in (states, numbers))
    third = np.einsum("naprc,napc->napr", f.transition, third)
    third += np.einsum("naprc,napc->napr", f.root, drawn)
    along, roll = (f.gain * first)[:, :parts].sum(axis=1), f.gain[:, -1] * first[:, -1]
    across, down = np.einsum("napk,napk->an", f.speed, third[:, :, :, :2])
    yaw, pitch = np.einsum("napk,napk->an", f.rate, third)
    axes = adapters.turbulence_axes(-motion["position_ned"][:, 2], through_air, motion["euler"])
    expected = before + np.einsum("nij,jn->ni", axes, np.stack([along, across, down]))

    scales = np.stack(MIXTURES[spectrum]), sigma, length, spans, dt
    filters = first_order, third_order, states
    used, hold = np.zeros(1, dtype=np.intp), np.array([1, True])
    add_dryden_turbulence(*scales, *filters, local, aircraft, numbers[None], used, hold)
    assert states == pytest.approx(np.hstack([first, third.reshape(n, -1)]), abs=1e-12)
    assert np.array(wind["wind_ned"]) == pytest.approx(expected, abs=1e-12)
    found = np.array(wind["wind_gradient_rates"])
    assert found == pytest.approx(rates + np.stack([roll, pitch, yaw], axis=1), abs=1e-12)
    assert abs(expected - before).max() > 0.5
