"""The kernels of the atmosphere against the numpy reference."""

import itertools
import os

import numpy as np
import pytest
from reference import adapters_atmosphere as adapters
from reference import atmosphere_dryden, atmosphere_wake, atmosphere_wind

from testbed.atmosphere.airframe_wind import make_local_wind, sample_ambient_wind
from testbed.atmosphere.dryden import MIXTURES, add_dryden_turbulence
from testbed.atmosphere.gusts import PlaneFrontGust, UniformGust, make_gusts
from testbed.atmosphere.mean_wind import LOGARITHMIC, POWER, Profile, make_mean_wind
from testbed.atmosphere.turbulence_field import empty_grid, make_field
from testbed.atmosphere.wake import WakeModel
from testbed.core.records import AIRCRAFT, Airframe, allocate

SIGMA = np.array([1.6, 1.6, 1.2])  # m/s
LENGTH = np.array([263.0, 263.0, 100.0])  # m, of 100 m above the ground
RASCAL = Airframe(span=2.8, area=1.0, arm=0.8, mass=6.5, lift_slope=5.0)
LOG_LAW = Profile(LOGARITHMIC, 10.0, 0.03)
PROFILES = (None, LOG_LAW, Profile(POWER, 10.0, 0.143))
TIMES = (0.0, 0.7, 3.0, 11.5, 19.9, 20.0)  # s; rows of the unsteady wind are at whole ones
FLIGHTS = int(os.environ.get("TESTBED_AIR_SAMPLES", "20"))


@pytest.fixture(scope="module")
def field():
    return make_field(1, SIGMA, LENGTH)


def attitudes(rng, n):
    return rng.uniform([-0.8, -0.3, -np.pi], [0.8, 0.3, np.pi], (n, 3))


# ------------------------------------------------------------------------------ the ambient wind


def wind_rows(rng):
    """Steady and unsteady winds, with each profile: arguments of `make_mean_wind`."""
    rows = rng.normal([4.0, -3.0, 0.3], 1.0, (21, 3))
    for profile, count in itertools.product(PROFILES, (1, 21)):
        keywords = {"profile": profile, "advection_height": 80.0}
        yield (np.arange(float(count)), rows[:count]), keywords


def both_winds(rows, keywords, grid, gusts, position, euler, time):
    """Mean, ambient, wind and rates (N, 3) of reference and kernel, and the reference's path."""
    n = len(position)
    local, aircraft = make_local_wind([RASCAL] * n), allocate(AIRCRAFT, n)
    for records in (local["mean_wind"], local["ambient_wind"], aircraft["wind"]["wind_ned"]):
        records[:] = np.nan
    aircraft["truth"]["position_ned"], aircraft["truth"]["euler"] = position, euler
    wind = make_mean_wind(*rows, **keywords)
    records = wind.rows, wind.profile, make_gusts(gusts, wind)
    sample_ambient_wind(*records, *grid, local, aircraft, time)
    kernel = (
        local["mean_wind"],
        local["ambient_wind"],
        *(aircraft["wind"][name] for name in ("wind_ned", "wind_gradient_rates")),
    )
    wind = atmosphere_wind.make_mean_wind(*rows, **keywords)
    mean, ambient, velocity, rates = reference = np.full((4, n, 3), np.nan)
    path = np.full(3, np.nan)
    atmosphere_wind.sample_ambient_wind(
        wind,
        grid,
        atmosphere_wind.make_gusts(gusts, wind),
        position,
        euler,
        np.array(local["sample_points"]),
        *(mean, path, ambient, velocity, rates),
        time,
    )
    return reference, tuple(map(np.array, kernel)), path


def test_ambient_wind_kernel_matches_reference():
    """Mean wind and gusts of every kind; the field has a test of its own."""
    n, rng = 7, np.random.default_rng(91)
    rates, differences = [], []
    some = [
        UniformGust((3.0, -1.0, 2.0), start=1.0, ramp=4.0, pulse=False),
        PlaneFrontGust((0.0, 2.0, 1.0), (5.0, 3.0), 1.2, 0.0, 30.0, None, True),
        PlaneFrontGust((1.0, 0.0, -2.0), (-9.0, 3.0), 4.0, 2.0, 50.0, 7.0, False),
    ]
    for rows, keywords in wind_rows(rng):
        for gusts, time in itertools.product((some, []), TIMES):
            position, euler = rng.normal(0.0, 40.0, (n, 3)), rng.uniform(-1.0, 1.0, (n, 3))
            position[:3, 2] = 3.0, 0.0, -0.02  # below, on and just above the ground
            reference, kernel, path = both_winds(
                rows, keywords, empty_grid(), gusts, position, euler, time
            )
            for one, two in zip(reference, kernel, strict=True):
                np.testing.assert_allclose(two, one, rtol=1e-11, atol=1e-12)
            mean, ambient, velocity, gradient = kernel
            wind = make_mean_wind(*rows, **keywords)
            np.testing.assert_allclose(wind.displacement_ned(time), path, rtol=1e-14)
            heights = -position[:, 2]
            np.testing.assert_array_equal(mean, adapters.mean_velocity(wind, time, heights))
            np.testing.assert_array_equal(ambient, velocity)  # no field
            found = adapters.active_gusts(make_gusts(gusts, wind), wind, time, position)
            other = atmosphere_wind.make_mean_wind(*rows, **keywords)
            active = atmosphere_wind.make_gusts(gusts, other).active(time, position, path)
            np.testing.assert_array_equal(found, active)
            rates.append(abs(gradient).max())
            differences.append(abs(velocity - mean).max())
            if not gusts and wind.uniform:
                assert rates.pop() == differences.pop() == 0.0
    assert np.median(rates) > 1e-4  # rad/s
    assert np.median(differences) > 1e-3  # m/s


def test_airframe_kernels_match_reference():
    rng = np.random.default_rng(3)
    airframes = [RASCAL, Airframe(span=2.1, area=0.75, arm=0.18, mass=3.4, lift_slope=4.0), RASCAL]
    body = np.array(make_local_wind(airframes)["sample_points"])
    position, euler = rng.normal(0.0, 100.0, (3, 3)), rng.uniform(-1.2, 1.2, (3, 3))
    points = atmosphere_wind.sample_points(position, euler, body)
    np.testing.assert_allclose(adapters.sample_points(position, euler, body), points, rtol=1e-14)
    air = rng.normal(0.0, 2.0, (3, 5, 3))
    pairs = (each.mean_and_gradient(air, euler, body) for each in (atmosphere_wind, adapters))
    for one, two in zip(*pairs, strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-12, atol=1e-13)


def test_field_kernel_matches_reference(field):
    """Where grids repeat, south and west of the origin, and near it."""
    rng = np.random.default_rng(8)
    for spread in (1.0, 1e3, 1e5):
        centre = rng.normal(0.0, spread, (50, 3))
        points = centre[:, np.newaxis] + rng.uniform(-1.5, 1.5, (50, 6, 3))
        one = atmosphere_wind.sample_field(field.grid, centre, points)
        two = adapters.sample_field(field.grid, centre, points)
        assert two.shape == one.shape
        # sums of other order, and positions of 1e5 m to 1e-11 m
        np.testing.assert_allclose(two, one, rtol=0.0, atol=1e-10)


def test_field_in_wind_and_gusts_matches_reference(field):
    """Field and gusts add up; the wind moves the field."""
    n, rng = 50, np.random.default_rng(9)
    rows = np.zeros(1), np.array([[5.0, -3.0, 0.0]])
    gusts = [UniformGust((3.0, -1.0, 2.0), start=1.0, ramp=4.0, pulse=False)]
    position, euler = rng.normal(0.0, 300.0, (n, 3)), rng.uniform(-1.0, 1.0, (n, 3))

    def sampled(grid, gusts):
        args = rows, {"profile": LOG_LAW}, grid, gusts, position, euler, 4.0
        reference, kernel, path = both_winds(*args)
        for one, two in zip(reference, kernel, strict=True):
            np.testing.assert_allclose(two, one, rtol=0.0, atol=1e-9)  # 1e-10 over half a metre
        return path, kernel

    path, (_, still, calm, level) = sampled(empty_grid(), [])
    _, (_, _, turbulent, gradient) = sampled(field.grid, [])
    _, (_, ambient, both, all_gradient) = sampled(field.grid, gusts)
    _, (_, gusty, gust_wind, gust_gradient) = sampled(empty_grid(), gusts)
    # sums of some 10 m/s, rounded
    np.testing.assert_allclose(both - gust_wind, turbulent - calm, atol=1e-12)
    np.testing.assert_allclose(all_gradient - gust_gradient, gradient - level, atol=1e-12)
    np.testing.assert_array_equal(ambient, gusty)  # turbulence does not displace wakes
    # of 50 positions within some scale lengths, of which few are independent
    assert (turbulent - calm).std(axis=0) == pytest.approx(SIGMA, rel=0.4)
    in_air = position - path
    there = adapters.sample_field(field.grid, in_air, in_air[:, np.newaxis])[:, 0]
    # an average over the wing differs from the middle by waves as short as the wing
    assert ((turbulent - calm - there).std(axis=0) < 0.1 * SIGMA).all()
    assert not np.array_equal(still, ambient)


# ------------------------------------------------------------------------------------ turbulence


@pytest.mark.parametrize("n", [1, 2, 60])
@pytest.mark.parametrize("spectrum", ["dryden", "von-karman"])
def test_dryden_kernels_match_reference(spectrum, n):
    """To rounding: sums of up to 48 terms of order one, in other orders."""
    rng = np.random.default_rng([61, n])
    sigma, length = rng.uniform(0.5, 3.0, (n, 3)), rng.uniform(3.0, 700.0, (n, 3))
    distance, spans = rng.uniform(0.0, 5.0, n), rng.uniform(1.0, 5.0, n)
    distance[0] = 0.0
    length[-1, 1] = 3.0 * spans[-1] / np.pi  # a corner on a pole, of the first part
    args = spectrum, distance, sigma, length, spans
    filters, found = atmosphere_dryden.make_filters(*args), adapters.make_filters(*args)
    for name, one, two in zip(filters._fields, filters, found, strict=True):
        if name == "root":  # the last pivot of a short step is the root of a rounding
            one, two = (each @ each.swapaxes(-1, -2) for each in (one, two))
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-12, err_msg=name)
    states, numbers = rng.normal(0.0, 1.0, (2, n, 7 * (filters.decay.shape[1] - 1) + 1))
    after, turbulence, rates = atmosphere_dryden.advance_filters(states, numbers, found)
    six = adapters.advance_filters(adapters.filter_records(*args), states, numbers)
    assert states == pytest.approx(after, abs=1e-12)
    assert six == pytest.approx(np.hstack([turbulence, rates]), abs=1e-12)
    velocity, euler = rng.normal(0.0, 15.0, (n, 3)), attitudes(rng, n)
    velocity[0] = 0.0
    heights = np.resize([-5.0, 100.0, 400.0, 450.0, 600.0, 2000.0], n)
    axes = atmosphere_dryden.turbulence_axes(heights, velocity, euler)
    assert adapters.turbulence_axes(heights, velocity, euler) == pytest.approx(axes, abs=1e-12)


@pytest.mark.parametrize("spectrum", ["dryden", "von-karman"])
def test_dryden_entry_matches_reference(spectrum):
    """The wind of a step, with filters of the present airspeeds."""
    n, dt, rng = 7, 0.02, np.random.default_rng(62)
    sigma, length = rng.uniform(0.5, 3.0, (n, 3)), rng.uniform(3.0, 700.0, (n, 3))
    spans = rng.uniform(1.0, 5.0, n)
    first_order, third_order = adapters.filter_records(spectrum, np.ones(n), sigma, length, spans)
    states, numbers = rng.normal(size=(2, n, 7 * third_order.shape[2] + 1))
    aircraft, local = allocate(AIRCRAFT, n), make_local_wind([RASCAL] * n)
    motion, wind = aircraft["truth"], aircraft["wind"]
    for name in ("position_ned", "velocity_ned"):
        motion[name] = rng.normal(0.0, 15.0, (n, 3))
    motion["position_ned"][:, 2] = -np.resize([100.0, 400.0, 450.0, 2000.0], n)
    motion["euler"], local["mean_wind"] = attitudes(rng, n), rng.normal(0.0, 5.0, (n, 3))
    wind["wind_ned"] = before = rng.normal(0.0, 5.0, (n, 3))
    through_air = motion["velocity_ned"] - local["mean_wind"]
    distance = np.linalg.norm(through_air, axis=1) * dt
    filters = adapters.make_filters(spectrum, distance, sigma, length, spans)
    expected, rates, expected_states = before.copy(), np.zeros((n, 3)), states.copy()
    atmosphere_dryden.add_turbulence(
        expected_states,
        filters,
        *(np.array(motion[name]) for name in ("position_ned", "velocity_ned", "euler")),
        np.array(local["mean_wind"]),
        *(expected, rates, numbers),
    )
    mixture = np.stack(MIXTURES[spectrum])
    scales = mixture, sigma, length, spans, dt
    filters = first_order, third_order, states
    used, hold = np.zeros(1, dtype=np.intp), np.array([1, True])
    add_dryden_turbulence(*scales, *filters, local, aircraft, numbers[None], used, hold)
    assert states == pytest.approx(expected_states, abs=1e-12)
    assert np.array(wind["wind_ned"]) == pytest.approx(expected, abs=1e-12)
    assert np.array(wind["wind_gradient_rates"]) == pytest.approx(rates, abs=1e-12)
    assert abs(expected - before).max() > 0.5


# ----------------------------------------------------------------------------------------- wakes


def flight(rng, count):
    """Motions of aircraft that fly behind and beside one another and wander."""
    start = np.stack(
        [-6.0 * np.arange(count), rng.normal(0.0, 2.0, count), rng.normal(0.0, 0.5, count)], axis=-1
    )
    turn, wave = rng.normal(0.0, 0.3), rng.uniform(0.5, 2.0, (count, 3))
    for tick in range(60):
        time = 0.02 * tick
        wander = 0.3 * np.sin(wave * time)
        heading = turn * time
        forward = np.array([np.cos(heading), np.sin(heading), 0.0])
        velocity = 20.0 * forward + 0.3 * wave * np.cos(wave * time)
        place = 20.0 * time * forward + wander
        yield (
            start + place,
            velocity,
            rng.normal(0.0, 3.0, (count, 3)),
            np.stack([wander[:, 0], 0.2 * wander[:, 1], heading + 0.1 * wander[:, 2]], axis=-1),
        )


def test_wake_kernel_matches_reference():
    rng = np.random.default_rng(3)
    largest = 0.0
    for _ in range(FLIGHTS):
        count = int(rng.integers(1, 7))
        spans, masses = rng.uniform(1.5, 3.0, count), rng.uniform(2.0, 8.0, count)
        airframes = [
            Airframe(span=span, area=0.98198, arm=0.8, mass=mass, lift_slope=5.0)
            for span, mass in zip(spans.tolist(), masses.tolist(), strict=True)
        ]
        args = {
            "sheds": rng.random(count) < 0.8,
            "affected": rng.random(count) < 0.8,
            "core_spans": rng.uniform(0.01, 0.1),
            "decay_s": rng.choice([None, 5.0]),
            "memory_s": rng.choice([0.5, 4.0]),
            "dt": rng.choice([0.02, 0.1]),
            "density": 1.18,
        }
        model, reference = WakeModel(airframes, **args), atmosphere_wake.Wakes(airframes, **args)
        for motion in flight(rng, count):
            ambient = rng.normal(0.0, 3.0, (count, 3))
            wind, roll = np.zeros((count, 3)), np.zeros(count)
            reference.add(*motion, ambient, wind, roll)
            found = adapters.add_wakes(model, *motion, ambient)
            assert found[0] == pytest.approx(wind, abs=1e-11)
            assert found[1] == pytest.approx(roll, abs=1e-11)
            largest = max(largest, abs(wind).max())
    assert largest > 0.3
