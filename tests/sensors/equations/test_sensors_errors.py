"""Errors of single sensors: spectra, common drifts, and the airspeed of a pitot tube."""

import numpy as np
import pytest
from reference import adapters_sensors as kernels
from scipy.integrate import quad
from scipy.signal import welch
from sensors_samples import (
    SEED,
    THINNER,
    assert_mean_in_time,
    assert_means,
    assert_variances,
    make_flight,
    no_faults,
    suite,
)

from testbed.core import random
from testbed.core.frames import GRAVITY
from testbed.core.records import VehicleState
from testbed.sensors.airspeed import make_airspeed_sensors
from testbed.sensors.sensor_errors import (
    ERROR_COUNT,
    ERRORS,
    advance_errors,
    is_sampled,
    make_constant_biases,
    make_noise_parameters,
    make_sensor_errors,
    view_errors,
)

DT = 0.02
# Every kind of error, each with numbers of its own. Correlation times are so short that a sample
# holds many, and so long that clusters of 20 steps and more are like continuous time.
SUITE = suite(
    gps={
        "noise_m": [0.4, 0.9],
        "velocity_noise_mps": [0.07, 0.15],
        "shared_drift_m": [1.3, 2.6],
        "shared_time_constant_s": 0.8,
        "own_drift_m": [0.5, 1.1],
        "own_time_constant_s": 1.5,
    },
    barometer={
        "noise_m": 0.2,
        "shared_drift_m": 0.7,
        "shared_time_constant_s": 1.2,
        "own_drift_m": 0.3,
        "own_time_constant_s": 2.0,
    },
    airspeed={"noise_pa": 4.0},
    gyro={"noise_dps_rthz": 0.03, "bias_dps": 0.1, "bias_time_constant_s": 1.0},
    accelerometer={"noise_mps2_rthz": 0.02, "bias_mps2": 0.05, "bias_time_constant_s": 1.4},
    magnetometer={"noise_deg": 2.0},
)
DEGREE = np.pi / 180.0
# Of fields of ERRORS, and an axis: root of the density, sigma and time constant of the drift. A
# white error of a measurement has the density sigma² dt.
ROOT = np.sqrt(DT)
SHARED = {
    ("gps_shared", 0): (0.0, 1.3, 0.8),
    ("gps_shared", 2): (0.0, 2.6, 0.8),
    ("barometer_shared", 0): (0.0, 0.7, 1.2),
}
OWN = {
    ("gps_own", 0): (0.0, 0.5, 1.5),
    ("gps_own", 2): (0.0, 1.1, 1.5),
    ("gps_noise", 0): (0.4 * ROOT, 0.0, 1.0),
    ("gps_noise", 2): (0.9 * ROOT, 0.0, 1.0),
    ("gps_velocity_noise", 0): (0.07 * ROOT, 0.0, 1.0),
    ("gps_velocity_noise", 2): (0.15 * ROOT, 0.0, 1.0),
    ("barometer_own", 0): (0.0, 0.3, 2.0),
    ("barometer_noise", 0): (0.2 * ROOT, 0.0, 1.0),
    ("pressure_noise", 0): (4.0 * ROOT, 0.0, 1.0),
    ("heading_noise", 0): (2.0 * DEGREE * ROOT, 0.0, 1.0),
}
# A gyro's error is the sum of a bias and noise, and so is an accelerometer's.
SUMS = {
    ("gyro", 0): (0.03 * DEGREE, 0.1 * DEGREE, 1.0),
    ("gyro", 2): (0.03 * DEGREE, 0.1 * DEGREE, 1.0),
    ("accelerometer", 0): (0.02, 0.05, 1.4),
    ("accelerometer", 2): (0.02, 0.05, 1.4),
}


def column(name, axis=0):
    """The number of a field of ERRORS and an axis, among all numbers."""
    return ERRORS.fields[name][1] // 8 + axis


def columns(*names):
    """The numbers of these fields of ERRORS, of all their axes."""
    widths = {name: ERRORS[name].itemsize // 8 for name in names}
    return [column(name, axis) for name, width in widths.items() for axis in range(width)]


GPS_OWN = column("gps_own")  # those common to all aircraft come before


def names(count):
    return [f"uav{i}" for i in range(count)]


def errors_over(steps, suites, *, aircraft=None, dt=DT, seed=SEED):
    """Errors (steps, N, 29) from the very first."""
    aircraft = names(len(suites)) if aircraft is None else aircraft
    errors = make_sensor_errors(aircraft, suites, seed=seed, dt=dt)
    seen = [errors.values.copy()]
    for _ in range(steps - 1):
        advance_errors(errors.coefficients, errors.values, errors.numbers.draw())
        seen.append(errors.values.copy())
    return np.stack(seen)


def allan_variance(series, draws):
    """Of series (K, ...) in clusters of so many draws: half the mean square of differences."""
    clusters = len(series) // draws
    means = series[: clusters * draws].reshape(clusters, draws, *series.shape[1:]).mean(axis=1)
    return 0.5 * np.diff(means, axis=0) ** 2


def closed_form(root, sigma, time_constant, tau):
    """Allan variance of white noise and of a first-order Gauss-Markov drift (IEEE Std 952)."""
    square = 2.0 * sigma**2 / time_constant
    near = 3.0 - 4.0 * np.exp(-tau / time_constant) + np.exp(-2.0 * tau / time_constant)
    drift = square * time_constant**2 / tau * (1.0 - time_constant / (2.0 * tau) * near)
    return root**2 / tau + drift


def test_noise_parameters_are_those_of_the_scenario():
    """The tables above, against which the samples below are tested."""
    (sigma,), (tau,) = make_noise_parameters([SUITE], DT)
    for key, (root, drift, time_constant) in {**SHARED, **OWN}.items():
        assert sigma[column(*key)] == pytest.approx(drift or root / np.sqrt(DT), rel=1e-12)
        assert tau[column(*key)] == (time_constant if drift else 0.0)
    for key, (root, drift, time_constant) in SUMS.items():
        both = bias_and_noise(*key)
        assert sigma[both] == pytest.approx([drift, root / np.sqrt(DT)], rel=1e-12)
        assert tau[both].tolist() == [time_constant, 0.0]
    assert not make_noise_parameters([suite()], DT).sigma.any()


def bias_and_noise(sensor, axis):
    return [column(f"{sensor}_bias", axis), column(f"{sensor}_noise", axis)]


@pytest.fixture(scope="module")
def many():
    """60 aircraft for 120 s."""
    return errors_over(6000, [SUITE] * 60)


@pytest.mark.parametrize("draws", [20, 60, 300])
def test_allan_variances_of_own_errors(many, draws):
    """Clusters of 0.4, 1.2 and 6 s; the aircraft are independent samples."""
    for key, numbers in OWN.items():
        seen = allan_variance(many[:, :, column(*key)], draws).mean(axis=0)
        assert_means(seen, closed_form(*numbers, draws * DT))
    for key, numbers in SUMS.items():
        seen = allan_variance(many[:, :, bias_and_noise(*key)].sum(axis=2), draws).mean(axis=0)
        assert_means(seen, closed_form(*numbers, draws * DT))


def test_allan_variances_of_shared_errors():
    """One series of 800 s, 400 correlation times and more."""
    seen = errors_over(40_000, [SUITE])[:, 0]
    for draws in (20, 60, 200):
        for key, numbers in SHARED.items():
            variance = allan_variance(seen[:, column(*key)], draws)
            assert_mean_in_time(variance, closed_form(*numbers, draws * DT))


def test_spectra_of_noise_drifts_and_their_sums(many):
    """Welch's estimate against the densities, one-sided and so twice the given ones.

    A drift drawn in steps has the density of the discrete process, which is that of the continuous
    one, 2 σ² τ / (1 + (2π f τ)²), at frequencies far below 1/dt.
    """
    frequency = np.array([0.5, 1.0, 2.0, 4.0])
    cases = [
        ([column(*key)], OWN[key]) for key in (("gps_velocity_noise", 0), ("barometer_own", 0))
    ]
    cases += [(bias_and_noise(*key), numbers) for key, numbers in SUMS.items()]
    for which, (root, sigma, time_constant) in cases:
        series = many[:, :, which].sum(axis=2)
        at, seen = welch(series, fs=1.0 / DT, nperseg=1000, axis=0, detrend=False)
        expected = root**2 + 2.0 * sigma**2 * time_constant / (
            1.0 + (2.0 * np.pi * frequency * time_constant) ** 2
        )
        # a bin of 0.05 Hz; leakage of the Hann window and aliases are below 1 % of these densities,
        # a fifth of the standard error of 60 aircraft with 11 half-overlapping segments each
        assert_means(seen[np.searchsorted(at, frequency)].T, 2.0 * expected)


def test_errors_are_stationary_from_the_first_step():
    levels = make_noise_parameters([SUITE], DT).sigma[0]
    assert (levels > 0.0).all()
    seen = errors_over(31, [SUITE] * 400)
    for step in (0, 1, 30):
        assert_variances(seen[step, :, GPS_OWN:], levels[GPS_OWN:] ** 2)
    first = np.array([errors_over(1, [SUITE], seed=seed)[0, 0, :4] for seed in range(400)])
    assert_variances(first, levels[:4] ** 2)


@pytest.mark.parametrize("hz", [50, 100])
def test_inertial_noise_density_is_independent_of_rate(hz):
    """The variance of an angle, and of a speed, after 1 s of white noise of density N² is N²."""
    steps = hz
    seen = errors_over(10 * steps, [SUITE] * 40, dt=1.0 / hz)
    for name, root in (("gyro_noise", 0.03 * DEGREE), ("accelerometer_noise", 0.02)):
        sums = seen[:, :, columns(name)].reshape(10, steps, -1).sum(axis=1) / hz
        assert_variances(sums.ravel(), root**2)


def test_constant_biases_have_their_means_and_sigmas():
    keys = {
        "airspeed": {"offset_pa": 3.0, "offset_sigma_pa": 5.0, "scale": 0.1, "scale_sigma": 0.02},
        "magnetometer": {"offset_deg": -4.0, "offset_sigma_deg": 2.0},
    }
    offsets = make_constant_biases(names(1000), [suite(**keys)] * 1000, SEED)
    expected = ((3.0, 5.0), (0.1, 0.02), (-4.0 * DEGREE, 2.0 * DEGREE))
    for drawn, (mean, sigma) in zip(offsets, expected, strict=True):
        assert_variances(drawn - mean, sigma**2)
        assert_means(drawn, mean)
    assert abs(np.corrcoef(offsets) - np.eye(3)).max() < 4.5 / np.sqrt(1000.0)
    for drawn in make_constant_biases(names(3), [suite()] * 3, SEED):
        assert not drawn.any()


def test_a_scale_never_reverses_the_pressure():
    wild = suite(airspeed={"scale": -0.9, "scale_sigma": 5.0})
    drawn = make_constant_biases(names(200), [wild] * 200, SEED).scale
    assert drawn.min() == -1.0
    assert (drawn > -1.0).any()


# Random streams


def test_more_aircraft_leave_random_streams_unchanged():
    alone = errors_over(600, [SUITE] * 2, aircraft=["uav1", "uav2"])
    crowd = errors_over(600, [SUITE] * 4, aircraft=["leader", "uav2", "other", "uav1"])
    assert np.array_equal(crowd[:, [3, 1]], alone)
    both = [["uav1", "uav2"], ["leader", "uav2", "other", "uav1"]]
    few, more = (make_constant_biases(each, [suite("pixhawk")] * len(each), SEED) for each in both)
    for ours, theirs in zip(few, more, strict=True):
        assert np.array_equal(theirs[[3, 1]], ours)


def test_other_sensors_leave_random_streams_unchanged():
    before = errors_over(300, [SUITE, SUITE])
    louder = SUITE.model_copy(update={"gyro": suite("degraded").gyro, "barometer": None})
    after = errors_over(300, [louder, SUITE])
    same = np.ones(ERROR_COUNT, dtype=bool)
    same[columns("barometer_shared", "barometer_own", "barometer_noise")] = False
    assert not after[:, 0, ~same].any()
    same[columns("gyro_bias", "gyro_noise")] = False
    assert np.array_equal(after[:, 0, same], before[:, 0, same])
    assert np.array_equal(after[:, 1], before[:, 1])
    noise = (after / before)[:, 0, columns("gyro_noise")]  # the same numbers, another sigma
    assert noise == pytest.approx(0.1 / 0.03, rel=1e-12)


def test_constant_biases_depend_on_their_sensor_alone():
    whole = make_constant_biases(names(5), [suite("pixhawk")] * 5, SEED)
    bare = make_constant_biases(names(5), [suite(magnetometer={"offset_sigma_deg": 4.0})] * 5, SEED)
    assert bare.heading == pytest.approx(2.0 * whole.heading, rel=1e-12)
    assert not bare.pressure.any()


def test_block_size_does_not_change_errors(monkeypatch):
    ours = errors_over(600, [SUITE] * 2)
    monkeypatch.setattr(random, "BLOCK", 7)
    assert np.array_equal(errors_over(600, [SUITE] * 2), ours)


def test_errors_depend_on_the_seed_alone():
    ours = errors_over(300, [SUITE] * 2)
    assert np.array_equal(errors_over(300, [SUITE] * 2), ours)
    assert (errors_over(300, [SUITE] * 2, seed=SEED + 1) != ours).all()


def test_own_errors_are_independent():
    """Correlations of 54 series over 4000 nearly independent samples: 5/√4000 by Bonferroni."""
    short = suite(
        gps={**SUITE.gps.model_dump(), "shared_time_constant_s": 0.1, "own_time_constant_s": 0.1},
        barometer={"noise_m": 0.2, "shared_drift_m": 0.7, "shared_time_constant_s": 0.1}
        | {"own_drift_m": 0.3, "own_time_constant_s": 0.1},
        airspeed={"noise_pa": 4.0},
        gyro={"noise_dps_rthz": 0.03, "bias_dps": 0.1, "bias_time_constant_s": 0.1},
        accelerometer={"noise_mps2_rthz": 1, "bias_mps2": 0.05, "bias_time_constant_s": 0.1},
        magnetometer={"noise_deg": 2.0},
    )
    seen = errors_over(4000, [short] * 2, dt=1.0)
    assert np.array_equal(seen[:, 0, :4], seen[:, 1, :4])
    series = np.concatenate([seen[:, 0], seen[:, 1, 4:]], axis=1)
    correlations = np.corrcoef(series.T) - np.eye(54)
    assert abs(correlations).max() < 5.0 / np.sqrt(4000.0)


# Shared drifts


def products(suites, which, steps=30_000):
    """Products of the two aircraft's errors and their squares, over time, from 10 s on."""
    seen = errors_over(steps, suites)[500:, :, which].reshape(steps - 500, 2, -1).sum(axis=2)
    return seen[:, 0] * seen[:, 1], seen**2


def test_shared_drifts_correlate_two_receivers():
    """σs² / (σs² + σo²), for the north of the GPS and for the barometer."""
    for sensor, shared, own in (("gps", 1.3, 0.5), ("barometer", 0.7, 0.3)):
        both = [column(f"{sensor}_shared"), column(f"{sensor}_own")]
        product, squares = products([SUITE, SUITE], both)
        correlation = shared**2 / (shared**2 + own**2)
        variance = shared**2 + own**2
        assert_mean_in_time(product, correlation * variance)
        assert_mean_in_time(squares, np.array([variance, variance]))


def test_shared_drifts_of_other_speeds_correlate():
    """2 √(τ1 τ2) / (τ1 + τ2), of continuous time; of steps of 0.02 s within 1e-4 of that."""
    slow = suite(gps={"shared_drift_m": [1.0, 1.0], "shared_time_constant_s": 2.0})
    fast = suite(gps={"shared_drift_m": [3.0, 1.0], "shared_time_constant_s": 0.5})
    product, _ = products([slow, fast], [0], steps=60_000)
    assert_mean_in_time(product, 3.0 * 2.0 * np.sqrt(2.0 * 0.5) / (2.0 + 0.5))


def test_shared_drifts_cancel_between_equal_receivers():
    only = suite(gps={"shared_drift_m": [1.3, 2.6]}, barometer={"shared_drift_m": 1.0})
    seen = errors_over(500, [only] * 3)
    assert np.array_equal(seen[:, 0], seen[:, 1])
    assert np.array_equal(seen[:, 0], seen[:, 2])
    assert abs(seen[:, 0, :4]).min(axis=0).max() > 0.0
    assert not seen[:, :, 4:].any()


# Airspeed sensors

RATE_HZ = 50
FLIGHT = make_flight(RATE_HZ, (4, 0, 0))


def still(tas, height=0.0, thinner=THINNER):
    """Level motions at airspeeds (N,)."""
    tas = np.asarray(tas, dtype=float)
    zero = np.zeros((len(tas), 3))
    position = zero - [0.0, 0.0, 1.0] * np.reshape(height, (-1, 1))
    return VehicleState(position, zero, zero, zero, zero, tas, tas / thinner)


def read(suites, truths, failing=None, seed=SEED):
    """Equivalent and true airspeeds (K, 2, N) at each of these motions."""
    n = len(truths[0].airspeed)
    aircraft = names(n)
    errors = make_sensor_errors(aircraft, suites, seed=seed, dt=1 / RATE_HZ)
    biases = make_constant_biases(aircraft, suites, seed)
    sensors, out = make_airspeed_sensors(suites, biases, RATE_HZ), []
    for step, truth in enumerate(truths):
        faults = no_faults(n) if failing is None else failing(step)
        advance_errors(errors.coefficients, errors.values, errors.numbers.draw())
        noise = view_errors(errors)["pressure_noise"].copy()
        out.append(kernels.airspeeds(sensors, truth, faults, noise, step, RATE_HZ))
    return np.array(out)


def bernoulli(eas):
    """Dynamic pressure, Pa: ρ0 EAS² / 2."""
    return 0.5 * 1.225 * eas**2


def test_pressure_bias_and_scale_change_the_airspeed():
    """By hand: 20 m/s are 245 Pa; 49 Pa more are √1.2 times as fast, and −0.19 of it 0.9."""
    sensors = [
        suite(airspeed={"offset_pa": 49.0}),
        suite(airspeed={"scale": -0.19}),
        suite(airspeed={"offset_pa": -300.0}),
    ]
    ((eas, tas),) = read(sensors, [still([20.0 * THINNER] * 3)])
    assert eas[:2] == pytest.approx([20.0 * np.sqrt(1.2), 18.0], rel=1e-12)
    assert tas[:2] == pytest.approx(eas[:2] * THINNER, rel=1e-12)
    assert 0.0 < eas[2] < 0.02  # no pressure: no airspeed, but above 0


def test_pressure_noise_changes_the_airspeed():
    sensor = suite(airspeed={"noise_pa": 4.0, "smoothing_s": 0.0, "rate_hz": RATE_HZ})
    seen = read([sensor] * 50, [still([20.0] * 50)] * 40)[:, 0]
    noise = bernoulli(seen) - bernoulli(20.0 / THINNER)
    assert_variances(noise.ravel(), 4.0**2)
    assert_means(noise.ravel(), 0.0)


def test_filtered_pressure_follows_a_step():
    sensor = suite(airspeed={"rate_hz": 10, "smoothing_s": 0.28})
    slow, fast = still([15.0]), still([25.0])
    pressure = bernoulli(read([sensor], [slow] * 10 + [fast] * 90)[:, 0, 0])
    before, after = bernoulli(15.0 / THINNER), bernoulli(25.0 / THINNER)
    share = (pressure - before) / (after - before)
    # a sample every fifth step; the first after the change is at step 10
    samples = np.maximum(np.arange(100) // 5 - 1, 0)
    assert share == pytest.approx(1.0 - np.exp(-0.1 * samples / 0.28), abs=1e-12)


@pytest.mark.parametrize("rate_hz", [50, 20, 7, 1])
def test_samples_are_taken_at_their_rate(rate_hz):
    taken = np.flatnonzero([is_sampled(rate_hz, step, RATE_HZ) for step in range(-100, 200)])
    assert len(taken) == 6 * rate_hz
    assert taken[0] == 0  # at the second
    apart = np.diff(taken)
    assert set(apart) <= {RATE_HZ // rate_hz, -(-RATE_HZ // rate_hz)}


def test_an_airspeed_sensor_left_out_is_exact():
    result = [FLIGHT.at(k, 2) for k in range(100)]
    result = [each._replace(airspeed=each.airspeed + 0.01 * k) for k, each in enumerate(result)]
    seen = read([suite(), suite("pixhawk")], result)
    for (eas, tas), truth in zip(seen, result, strict=True):
        assert eas[0] == truth.equivalent_airspeed[0]
        assert tas[0] == truth.airspeed[0]
        assert eas[1] != truth.equivalent_airspeed[1]


def isa_static_pressure(height):
    """Of the standard atmosphere (ISO 2533) at heights above sea level in m, Pa."""
    return 101325.0 * (1.0 - 0.0065 * height / 288.15) ** (GRAVITY / (287.05287 * 0.0065))


def isa_density(height):
    return isa_static_pressure(height) / (287.05287 * (288.15 - 0.0065 * height))


def test_isa_pressure_is_hydrostatic():
    fallen, _ = quad(lambda h: GRAVITY * isa_density(h), 300.0, 500.0)
    assert isa_static_pressure(300.0) - isa_static_pressure(500.0) == pytest.approx(fallen)
    assert isa_density(0.0) == pytest.approx(1.225, rel=1e-5)


@pytest.mark.parametrize("climbed", [-80.0, -5.0, 5.0, 80.0])
def test_a_blocked_tube_reads_its_trapped_pressure(climbed):
    """q0 + p(h0) − p(h), at any airspeed; once open, the tube is exact at once.

    The density of the height now stands for that of the way: half of its change, which is
    Δh / 20 km, is the error of the pressure's change.
    """
    start = 400.0
    here, there = (
        still([20.0, 20.0], h, np.sqrt(1.225 / isa_density(h))) for h in (start, start + climbed)
    )
    there = there._replace(airspeed=1.3 * there.airspeed)
    there = there._replace(equivalent_airspeed=1.3 * there.equivalent_airspeed)

    def failing(tick):
        blocked = np.array([10 <= tick < 20, False])
        return no_faults(2)._replace(pitot_blocked=blocked)

    result = [here] * 15 + [there] * 15
    seen = read([suite()] * 2, result, failing)[:, 0]
    pressure = bernoulli(here.equivalent_airspeed[0])
    trapped = pressure + isa_static_pressure(start) - isa_static_pressure(start + climbed)
    assert bernoulli(seen[10:15, 0]) == pytest.approx(pressure, rel=1e-12)
    change = bernoulli(seen[15:20, 0]) - pressure
    if trapped > 0.0:
        assert change == pytest.approx(trapped - pressure, rel=abs(climbed) / 20_000.0)
    else:  # below the static pressure there is no airspeed
        assert seen[15:20, 0].max() < 0.02
    assert np.array_equal(seen[20:, 0], [there.equivalent_airspeed[0]] * 10)
    assert np.array_equal(seen[:, 1], [each.equivalent_airspeed[1] for each in result])


def test_a_blocked_tube_with_an_open_drain_reads_zero():
    def failing(tick):
        blocked = np.array([tick >= 10])
        return no_faults(1)._replace(pitot_blocked=blocked, pitot_drained=np.array([True]))

    seen = read([suite()], [still([20.0])] * 20, failing)[:, 0, 0]
    assert np.array_equal(seen[:10], [20.0 / THINNER] * 10)
    assert (seen[10:] < 0.02).all()
    smoothed = suite(airspeed={"rate_hz": RATE_HZ, "smoothing_s": 0.28})
    pressure = bernoulli(read([smoothed], [still([20.0])] * 60, failing)[:, 0, 0])
    calls = np.arange(1, 51)
    expected = bernoulli(20.0 / THINNER) * np.exp(-calls / RATE_HZ / 0.28)
    assert pressure[10:] == pytest.approx(expected, rel=1e-12)


def test_a_tube_blocked_twice_traps_the_new_pressure():
    low, high = still([20.0], 100.0), still([20.0], 150.0)
    blocked_at = {*range(10, 20), *range(30, 40)}

    def failing(tick):
        return no_faults(1)._replace(pitot_blocked=np.array([tick in blocked_at]))

    seen = read([suite()], [low] * 15 + [high] * 25, failing)[:, 0, 0]
    assert seen[15] > 21.0
    assert seen[30:] == pytest.approx(20.0 / THINNER, rel=1e-12)
