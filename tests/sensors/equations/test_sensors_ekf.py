"""The navigation filter against an INS with a Kalman filter; its gates, resets and output."""

from typing import NamedTuple

import numpy as np
import pytest
from cases import ALL
from reference.adapters_sensors import propagate_covariance
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensors_samples import (
    RADIUS,
    SEED,
    SPEED,
    THINNER,
    Filters,
    Flight,
    Ins,
    assert_chance,
    assert_variances,
    make_flight,
    suite,
)

from testbed.core.frames import GRAVITY
from testbed.core.records import allocate
from testbed.sensors.ekf import INITIAL_SIGMA, OUTPUT_TIME_CONSTANT_S, STATES
from testbed.sensors.estimators import make_settings
from testbed.sensors.sensor_errors import ERRORS, advance_errors, make_sensor_errors, view_errors

HZ = 50
DOWN = np.array([0.0, 0.0, GRAVITY])
GROUPS = {
    "tilt": slice(0, 2),
    "heading": slice(2, 3),
    "velocity": slice(3, 6),
    "position": slice(6, 9),
    "gyro bias": slice(9, 12),
    "force bias": slice(12, 15),
    "wind": slice(15, 17),
}


def test_settings_are_those_of_the_scenario():
    """By hand, in the filter's units: EKF3 adds (0.012 s noise)² at each step of 0.012 s."""
    own = suite(
        gps={"rate_hz": 4, "latency_s": 0.22},
        magnetometer={"rate_hz": 5},
        estimator={"gps_velocity_noise_mps": [0.3, 0.8], "gps_delay_s": 0.18, "reset_after_s": 7.0},
    )
    settings = make_settings([own, suite(gyro={})], HZ)
    variance = 0.012 * np.array([0.015**2, 0.35**2, 0.0, 0.001**2, 0.02**2, 0.1**2])
    for each in settings["process"]:
        assert each == pytest.approx(np.repeat(variance, [3, 3, 3, 3, 3, 2]), rel=1e-12)
    assert settings["fix_noise"][:, 3:].tolist() == [[0.5, 0.5, 3.0]] * 2
    assert settings["fix_noise"][:, :3].tolist() == [[0.3, 0.3, 0.8], [0.5, 0.5, 0.7]]
    assert settings["airspeed_noise"].tolist() == [1.4] * 2
    assert settings["heading_noise"] == pytest.approx(np.array([0.5, 0.5]), rel=2e-3)  # rad, 28.6°
    assert (settings["gate"].tolist(), settings["airspeed_gate"].tolist()) == ([5.0] * 2, [4.0] * 2)
    assert settings["reset_after_s"].tolist() == [7.0, 10.0]
    # a sensor that the scenario does not describe measures ten times in a second, and without delay
    assert settings["gps_hz"].tolist() == [4, 10]
    assert settings["barometer_hz"].tolist() == [10, 10]
    assert settings["compass_hz"].tolist() == [5, 10]
    assert settings["latency"].tolist() == [11, 0]
    assert settings["assumed_latency"].tolist() == [9, 0]


# Against an INS

SCALES = np.array([0.1, 0.2, 0.4, 1.0])
KINDS = (
    suite("pixhawk"),
    # fixes that overtake one another: the next is sent before the last has come
    suite(
        "pixhawk",
        gps={"rate_hz": 25},
        estimator={"gps_position_noise_m": 0.4, "airspeed_noise_mps": 0.5},
    ),
    suite("pixhawk", gps={"latency_s": 0.22, "rate_hz": 2}),
    suite("degraded"),
)
AS_ASSUMED = (0, 1)  # of these, whose latency is what the filter takes it to be


class Errors:
    """The random errors of sensors, step by step."""

    def __init__(self, names, suites, rate_hz):
        self._errors = make_sensor_errors(names, suites, seed=SEED, dt=1 / rate_hz)

    def advance(self):
        """Records (N,) of ERRORS, which the next step changes."""
        errors = self._errors
        advance_errors(errors.coefficients, errors.values, errors.numbers.draw())
        return view_errors(errors)


def scaled(errors, scale):
    """Records (N,) of ERRORS times a scale (N,)."""
    out = errors.copy()
    for name in ERRORS.names:
        out[name] = (out[name].T * scale).T
    return out


class Routes(NamedTuple):
    """Two routes of N = kinds × scales filters along one flight, on the same sensors."""

    flight: Flight
    ours: np.ndarray  # (K, N, 17) errors of the filter
    theirs: np.ndarray  # (K, N, 17) errors of the INS
    filters: Filters
    ins: Ins

    @property
    def held(self):
        """How far the aircraft turns, rad, between three corrections, 0.1 s apart.

        One covariance takes the attitude at the end of each of these times, the other steps with
        it, so that gains differ before a correction and errors that are corrected after it.
        """
        return 0.2 * np.linalg.norm(self.flight.rates, axis=1).max()

    def per_scale(self, series, kind, scale):
        """A series of one kind of sensors, divided by the scale of its errors."""
        number = list(SCALES).index(scale)
        return series[:, len(SCALES) * kind + number] / scale


@pytest.fixture(scope="module")
def routes():
    """Four kinds of sensors at four scales of their errors, in straights, turns and climbs."""
    long = 2 if ALL else 0.5
    legs = (4 * long, 0, 0), (8 * long, 1, 0), (4 * long, 0, 0.15), (5 * long, -1, 0.05)
    flight = make_flight(50, *legs)
    kind = np.repeat(np.arange(len(KINDS)), len(SCALES))
    scale = np.tile(SCALES, len(KINDS))
    filters = Filters([KINDS[i] for i in kind], flight)
    ins = Ins(flight, filters.settings, INITIAL_SIGMA)
    drawn = Errors([f"k{i}" for i in range(len(KINDS))], KINDS, 50)
    tas_error, heading = np.array([[0.3], [0.03]]) * [0.9, -1.2, 0.5, 1.0]
    tas_error, heading = tas_error[kind] * scale, heading[kind] * scale
    ours, theirs = [], []
    for k in range(len(flight) - 4):  # the last step is one of measurements
        errors = scaled(drawn.advance()[kind], scale)
        tas = flight.airspeed[k] + tas_error
        sensed = {"errors": errors, "heading_bias": heading, "airspeed": tas}
        filters.step(k, **sensed, equivalent_airspeed=tas / THINNER)
        ours.append(filters.states - [*[0.0] * 15, *flight.wind[:2]])
        measure(ins, flight, k, filters.settings, **sensed)
        theirs.append(wrong(ins, flight, k))
    return Routes(flight, np.array(ours), np.array(theirs), filters, ins)


def measure(ins, flight, k, settings, *, errors, heading_bias, airspeed):
    """Let an INS measure a step of a flight."""
    hz = flight.rate_hz
    force = flight.rotation[k].T @ (flight.acceleration[k] - DOWN)
    gyro = errors["gyro_bias"] + errors["gyro_noise"]
    accelerometer = errors["accelerometer_bias"] + errors["accelerometer_noise"]
    ins.predict(flight.rates[k] + gyro, force + accelerometer)
    fixed = (k * settings["gps_hz"]) % hz < settings["gps_hz"]
    if fixed.any():
        ago = settings["latency"]
        at = np.maximum(k - ago, 0)
        straight_on = np.minimum(k - ago, 0)[:, None] / hz * flight.velocity[0]
        position = flight.position[at] + straight_on + errors["gps_noise"]
        position += errors["gps_shared"] + errors["gps_own"]
        ins.fix(flight.velocity[at] + errors["gps_velocity_noise"], position, fixed)
    if (10 * k) % hz < 10:
        height = errors["barometer_shared"] + errors["barometer_own"] + errors["barometer_noise"]
        ins.height(flight.position[k, 2] + height)
        ins.compass(flight.euler[k, 2] + heading_bias + errors["heading_noise"])
        ins.air(airspeed, airspeed / THINNER)


def wrong(ins, flight, k):
    """Estimate minus truth, of the wind too, and the biases that are subtracted: (N, 17)."""
    right = np.concatenate(
        [np.zeros(3), flight.velocity[k], flight.position[k], np.zeros(6), flight.wind[:2]]
    )
    out = ins.x - right
    out[:, :3] = Rotation.from_matrix(ins.rotation @ flight.rotation[k].T).as_rotvec()
    return out


def rms(series):
    """The root of the mean square of all of a series."""
    return np.sqrt((series**2).mean())


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("kind", AS_ASSUMED)
def test_ekf_errors_are_an_ins_errors_to_second_order(routes, kind, name):
    """Multiply all errors by s: the difference of the two, over s, is a + b s + ...

    The share a of the errors is what the two covariances differ by. From 0.1 to 0.2 the rest grows
    half as much as from 0.2 to 0.4 if it is of second order, a quarter if of third, equally if a
    term goes as the root; without latencies, which do not scale.
    """
    group = GROUPS[name]
    errors = routes.per_scale(routes.theirs, kind, 0.1)[:, group]
    a, b, c = (
        routes.per_scale(routes.ours - routes.theirs, kind, scale)[:, group]
        for scale in (0.1, 0.2, 0.4)
    )
    assert rms(2.0 * a - b) < routes.held * rms(errors)
    assert 0.4 < rms(b - a) / rms(c - b) < 0.6


def test_ekf_errors_are_an_ins_errors_at_full_size(routes):
    """In standard deviations of the INS, the share that differs is at most twice the wrong angles.

    These are the attitude's error and that of the air's direction, velocity and wind over airspeed,
    at their largest: by them innovations and slopes of linear equations are wrong.
    """
    theirs = routes.theirs
    air_error = np.linalg.norm(theirs[:, :, 3:6], axis=2) + np.linalg.norm(
        theirs[:, :, 15:], axis=2
    )
    angle = np.linalg.norm(theirs[:, :, :3], axis=2) + air_error / SPEED
    sigma = np.sqrt(np.diagonal(routes.ins.covariance, axis1=1, axis2=2))
    for row, largest in enumerate(angle.max(axis=0)):
        share = rms(((routes.ours - theirs) / sigma)[:, row]) / rms((theirs / sigma)[:, row])
        assert share < routes.held + 2.0 * largest


def test_ekf_covariance_is_that_of_an_ins(routes):
    ours, theirs = (
        np.sqrt(np.diagonal(each.covariance, axis1=1, axis2=2))
        for each in (routes.filters, routes.ins)
    )
    assert abs(ours / theirs - 1.0).max() < routes.held


def test_covariance_grows_by_the_matrix_exponential():
    """To second order: half the time, an eighth of the difference."""
    rng = np.random.default_rng(62)
    rotation = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, (5, 3))).as_matrix()
    force = rng.normal(0.0, 10.0, (5, 3))
    root = rng.normal(size=(5, STATES, STATES))
    covariance, process = root @ root.swapaxes(1, 2), np.zeros((5, STATES))

    def difference(dt):
        out = propagate_covariance(covariance, rotation, force, process, np.full(5, dt))
        for i in range(5):
            flow = np.zeros((STATES, STATES))
            for axis, unit in enumerate(np.eye(3)):
                flow[3:6, axis] = np.cross(unit, force[i])
                flow[:3, 9 + axis] = flow[3:6, 12 + axis] = -rotation[i] @ unit
                flow[6 + axis, 3 + axis] = 1.0
            whole = expm(flow * dt)
            out[i] -= whole @ covariance[i] @ whole.T
        return abs(out).max()

    assert 7.0 < difference(0.04) / difference(0.02) < 9.0
    noisy = propagate_covariance(covariance, rotation, force, process + 3.0, np.full(5, 0.02))
    still = propagate_covariance(covariance, rotation, force, process, np.full(5, 0.02))
    assert noisy - still == pytest.approx(np.tile(0.06 * np.eye(STATES), (5, 1, 1)), abs=1e-12)


# Consistency


def assert_covariance(errors, covariance):
    """Errors (n, m) of n independent filters have their covariances (n, m, m): chi-square tests.

    Of each error, and of all together by Mahalanobis distance.
    """
    n, m = errors.shape
    assert_variances(errors / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), np.ones(m))
    whole = np.einsum("ni,nij,nj->", errors, np.linalg.inv(covariance), errors)
    assert_chance(2.0 * min(chi2.cdf(whole, n * m), chi2.sf(whole, n * m)))


def test_ekf_errors_have_the_covariance_of_the_filter():
    """200 filters whose sensors have the errors that they assume; biases and wind are constant.

    Sideslip has 1° here instead of 10°, and the airspeed so little noise that errors of its
    magnitude and direction do not mix.
    """
    slip = np.radians(1.0)
    still = {
        "gyro_bias_noise_radps2": 0.0,
        "accelerometer_bias_noise_mps3": 0.0,
        "wind_noise_mps2": 0.0,
        "airspeed_noise_mps": 0.5,
        "heading_noise_deg": 5.0,
    }
    n, hz = 200, 20
    flight = make_flight(hz, (10, 0, 0), (20, 1, 0), (10, 0, 0.1), (10, -1, 0.0))
    filters = Filters(
        [suite(gps={"latency_s": 0.0}, estimator={**still, "gps_delay_s": 0.0})] * n, flight
    )
    settings, states = filters.settings, filters.states
    settings["sideslip_variance"] = slip**2
    rng = np.random.default_rng(61)
    states += rng.normal(size=states.shape) * INITIAL_SIGMA
    noises = [
        ("gyro_noise", np.sqrt(settings["process"][:, 0:3] * hz)),
        ("accelerometer_noise", np.sqrt(settings["process"][:, 3:6] * hz)),
        ("gps_noise", settings["fix_noise"][:, 3:]),
        ("gps_velocity_noise", settings["fix_noise"][:, :3]),
        ("barometer_noise", settings["fix_noise"][:, 5]),
        ("heading_noise", settings["heading_noise"]),
    ]
    errors = allocate(ERRORS, n)
    for k in range(len(flight) - 1):
        for name, sigma in noises:
            errors[name] = sigma * rng.normal(size=sigma.shape)
        # sideslip: the air comes from a little aside, and fixes do not measure it
        truth = filters.flight.at(k, n)
        aside = SPEED * np.tan(slip * rng.normal(size=n))
        slipped = truth.velocity_ned + aside[:, None] * flight.rotation[k][:, 1]
        noise = settings["airspeed_noise"] * THINNER * rng.normal(size=n)
        tas = np.linalg.norm(slipped - flight.wind, axis=1) + noise
        slipping = truth._replace(velocity_ned=slipped)
        filters.step(k, slipping, errors=errors, airspeed=tas, equivalent_airspeed=tas / THINNER)
        if k in (1 * hz, 5 * hz, 15 * hz, 28 * hz, 48 * hz):
            assert (filters.filters["covariance_step"] == k).all()
            wrong = states - [*[0.0] * 15, *flight.wind[:2]]
            assert_covariance(wrong, filters.covariance)


# Gates and resets

STRAIGHT = make_flight(HZ, (80, 0, 0))
NORTH, EAST = 6, 7


def jumped(*offset):
    return np.array([offset])


def test_exact_sensors_leave_a_filter_exact():
    flight = make_flight(HZ, (5, 0, 0), (10, 1, 0), (5, 0, 0.1))
    filters = Filters(
        [suite("pixhawk", gps={"latency_s": 0.0}, estimator={"gps_delay_s": 0.0})], flight
    )
    result = filters.run(0, len(flight))
    # velocities of 20 m/s and their differences carry roundings of 1e-15, 1e3 of them
    assert abs(result).max() < 1e-10


def test_a_far_jump_is_rejected_until_the_reset():
    filters = Filters([suite("pixhawk")], STRAIGHT)
    assert abs(filters.run(0, 30 * HZ)).max() < 1e-9
    result = filters.run(30 * HZ, 60 * HZ, gps_jump=jumped(50.0, -20.0, 0.0))[:, 0]
    # the fix before was that of 29.8 s; the first that comes more than 10 s later is that of 40 s
    reset = 10 * HZ
    assert abs(result[:reset]).max() < 1e-9
    assert result[reset:, NORTH] == pytest.approx(50.0, abs=1e-9)
    assert result[reset:, EAST] == pytest.approx(-20.0, abs=1e-9)
    others = np.delete(result[reset:], (NORTH, EAST), axis=1)
    assert abs(others).max() < 1e-9
    # and back, when the receiver has recovered
    result = filters.run(60 * HZ, 75 * HZ)[:, 0]
    assert result[: 10 * HZ, NORTH] == pytest.approx(50.0, abs=1e-9)
    assert abs(result[10 * HZ :]).max() < 1e-9


def test_a_near_jump_is_followed_gradually():
    filters = Filters([suite("pixhawk")], STRAIGHT)
    filters.run(0, 30 * HZ)
    result = filters.run(30 * HZ, 60 * HZ, gps_jump=jumped(3.0, 0.0, 0.0))[:, 0, NORTH]
    state = filters.states[0, NORTH]
    assert result[0] == pytest.approx(0.0, abs=1e-9)  # the output has no step,
    # and changes at most by the part of the 3 m that a lag of 0.25 s corrects in a step; the first
    # correction without a lag is larger
    assert abs(np.diff(result)).max() < 3.0 / (HZ * OUTPUT_TIME_CONSTANT_S)
    assert 2.9 < result[-1] < 3.1
    assert result[-1] == pytest.approx(state, abs=0.01)


def test_corrections_reach_the_output_with_a_lag():
    """A correction of a state at k is missing from the output by exp(−(t − t_k) / 0.25 s)."""
    filters = Filters([suite("pixhawk")], STRAIGHT)
    missing = np.zeros(9)
    drawn = Errors(["a"], [suite("pixhawk")], HZ)
    for k in range(5 * HZ):
        errors = drawn.advance()
        x = filters.states[0].copy()
        result = filters.step(k, errors=errors)[0]
        (e,) = errors
        gyro = e["gyro_bias"] + e["gyro_noise"] - x[9:12]
        push = e["accelerometer_bias"] + e["accelerometer_noise"] - x[12:15]
        rotation = STRAIGHT.rotation[k]
        propagated = (
            x[:9]
            + np.concatenate([rotation @ gyro, np.cross(x[:3], -DOWN) + rotation @ push, x[3:6]])
            / HZ
        )
        missing *= np.exp(-1.0 / (HZ * OUTPUT_TIME_CONSTANT_S))
        missing += filters.states[0, :9] - propagated
        assert result == pytest.approx(filters.states[0, :9] - missing, abs=1e-12)
    assert abs(missing).max() > 1e-3


def only(rate_hz, **sensors):
    """Sensors that all measure at the first step of a second, and these at a rate of their own."""
    seldom = {"gps": 1, "barometer": 1, "magnetometer": 1}
    rates = {name: {"rate_hz": rate} for name, rate in {**seldom, **sensors}.items()}
    rates["gps"]["latency_s"] = 0.0
    return suite(**rates, estimator={"gps_delay_s": 0.0})


def before_it(name):
    """Filters before a step at which only this sensor measures, and the number of that step."""
    rates = {} if name == "airspeed" else {"gps" if name in ("velocity", "position") else name: 2}
    filters, k = Filters([only(HZ, **rates)] * 2, STRAIGHT), 75
    filters.run(0, k)
    filters.settings["sideslip_variance"] = 1e30  # sideslip changes nothing
    return filters, k


def wrong_by(name, amount):
    """Measurements of two sensors with errors (2,), spread over all that they measure together."""
    if name == "airspeed":
        tas = SPEED + amount
        new = np.ones(2, dtype=bool)
        return {"airspeed": tas, "equivalent_airspeed": tas / THINNER, "airspeed_sampled": new}
    errors = allocate(ERRORS, 2)
    match name:
        case "velocity":
            errors["gps_velocity_noise"] = amount[:, None] / np.sqrt(3.0)
        case "position":
            errors["gps_noise"][:, :2] = amount[:, None] / np.sqrt(2.0)
        case "barometer":
            errors["barometer_noise"] = amount
        case "magnetometer":
            errors["heading_noise"] = amount
    return {"errors": errors, "airspeed_sampled": np.zeros(2, dtype=bool)}


# The slope of yaw against tilt, of a nose that is up by a pitch.
_, PITCH, YAW = STRAIGHT.euler[0]
LEANING = [np.tan(PITCH) * np.cos(YAW), np.tan(PITCH) * np.sin(YAW), 1.0]
ALONG = (STRAIGHT.velocity[0] - STRAIGHT.wind) / SPEED
# Slopes of what is measured against the states, standard deviations and gates of the defaults.
GATED = {
    "velocity": (np.eye(STATES)[3:6], [0.5, 0.5, 0.7], 5.0),
    "position": (np.eye(STATES)[6:8], [0.5, 0.5], 5.0),
    "barometer": (np.eye(STATES)[[8]], [3.0], 5.0),
    "magnetometer": (np.array([[*LEANING, *[0] * 14]]), [np.radians(28.6)], 5.0),
    "airspeed": (np.array([[0, 0, 0, *ALONG, *[0] * 9, *-ALONG[:2]]]), [1.4 * THINNER], 4.0),
}


@pytest.mark.parametrize("name", GATED)
def test_a_measurement_beyond_its_gate_is_rejected(name):
    """The innovation against gate² times the filter's variance of it, summed over its axes."""
    slopes, sigma, gate = GATED[name]
    filters, k = before_it(name)
    far = wrong_by(name, np.array([1e3, 1e3]))
    # the covariance that the gate uses is that of a step in which all is rejected
    filters.step(k, **far, gps_jump=np.full((2, 3), 1e3) * (name in ("velocity", "position")))
    known = np.trace(slopes @ filters.covariance[0] @ slopes.T)
    limit = gate * np.sqrt(known + np.sum(np.square(sigma)))
    filters, k = before_it(name)
    before = filters.states.copy()
    filters.step(k, **wrong_by(name, limit * np.array([1.0 - 1e-9, 1.0 + 1e-9])))
    moved = abs(filters.states - before).max(axis=1)
    assert moved[0] > 0.01
    assert moved[1] < 1e-9


def test_a_lasting_velocity_error_causes_a_reset():
    filters = Filters([suite("pixhawk")], STRAIGHT)
    filters.run(0, 20 * HZ)
    errors = allocate(ERRORS, 1)
    errors["gps_velocity_noise"] = [0.0, 40.0, 0.0]
    result = filters.run(20 * HZ, 32 * HZ, errors=errors)[:, 0]
    assert abs(result[: 10 * HZ]).max() < 1e-9
    assert result[10 * HZ, 4] == pytest.approx(40.0, abs=1e-9)


def test_a_reset_forgets_what_was_known():
    """Its covariance is that of a fix, and it is correlated with nothing."""
    filters = Filters([suite("pixhawk")], STRAIGHT)
    filters.run(0, 30 * HZ)
    jump = {"gps_jump": jumped(50.0, -20.0, 0.0)}
    filters.run(30 * HZ, 40 * HZ, **jump)
    filters.settings["barometer_hz"] = filters.settings["compass_hz"] = 0
    filters.step(40 * HZ, airspeed_sampled=np.zeros(1, dtype=bool), **jump)
    (covariance,) = filters.covariance
    expected = np.zeros((2, STATES))
    expected[0, NORTH], expected[1, EAST] = filters.settings["fix_noise"][0, 3:5] ** 2
    assert np.array_equal(covariance[[NORTH, EAST]], expected)
    assert np.array_equal(covariance[:, [NORTH, EAST]], expected.T)


def test_height_of_the_gps_replaces_the_barometers():
    """Where it is the source of height, fixes are fused or reset in three axes."""
    filters = Filters([suite("pixhawk", estimator={"height_source": "gps"})], STRAIGHT)
    drifting = allocate(ERRORS, 1)
    drifting["barometer_own"] = 30.0
    near = filters.run(0, 30 * HZ, errors=drifting, gps_jump=jumped(0.0, 0.0, 3.0))[-1, 0, 8]
    assert near == pytest.approx(3.0, abs=0.3)
    far = filters.run(30 * HZ, 41 * HZ, gps_jump=jumped(0.0, 0.0, -200.0))[:, 0, 8]
    assert abs(far[: 10 * HZ] - near).max() < 0.3
    assert far[10 * HZ] == pytest.approx(-200.0, abs=0.01)  # less the lag of what was fused


def test_slow_air_changes_no_filter():
    """Airspeed is fused where it is above 1 m/s, sideslip where its part from ahead is.

    The air comes from 45° aside; where the reading is the airspeed, sideslip alone has an effect.
    """
    speed, reading = np.array([[0.9, 0.9, 1.1, 1.1, 1.6], [0.5, 0.9, 0.5, 1.1, 1.6]])
    filters = Filters([only(HZ)] * 5, STRAIGHT)
    filters.run(0, 75)
    through = STRAIGHT.rotation[75][:, :2].sum(axis=1) / np.sqrt(2.0)
    filters.states[:, 3:6] = speed[:, None] * through - STRAIGHT.velocity[75]
    filters.states[:, 15:] = 0.0
    new = np.ones(5, dtype=bool)
    filters.step(75, airspeed=reading, equivalent_airspeed=reading, airspeed_sampled=new)
    moved = abs(filters.states[:, 15:]).max(axis=1) > 1e-6
    assert moved.tolist() == [False, False, True, False, True]


# Lost and late fixes


def test_airspeed_bounds_the_velocity_without_gps():
    """100 s with turns, with airspeed and sideslip and without, on the same inertial sensors.

    With them, the error is that of the filter's covariance, but for chance: the root of a
    chi-square of 20 over 20 is below 1.7 with 1 - 2e-5. Without, tilt and biases are integrated,
    and it is three times that and growing.
    """
    n, hz = 10, 20
    flight = make_flight(hz, (30, 0, 0), (40, 1, 0), (20, 0, 0), (40, -1, 0), (10, 0, 0))
    filters = Filters(
        [suite("pixhawk", gps={"latency_s": 0.1}, estimator={"gps_delay_s": 0.1})] * (2 * n), flight
    )
    drawn = Errors([f"uav{i}" for i in range(n)], [suite("pixhawk")] * n, hz)
    measured = np.arange(2 * n) < n
    lost, back = 30 * hz, 130 * hz
    result, sigma = np.empty((len(flight), 2 * n, 9)), np.empty(len(flight))
    for k in range(len(flight)):
        errors = np.tile(drawn.advance(), 2)
        new = filters.sensed(k)["airspeed_sampled"] & measured
        outage = np.full(2 * n, lost <= k < back)
        result[k] = filters.step(k, errors=errors, gps_lost=outage, airspeed_sampled=new)
        sigma[k] = np.sqrt(np.trace(filters.covariance[0, 3:5, 3:5]))
    speed = np.linalg.norm(result[:, :, 3:5], axis=2)
    bounded, free = (
        np.sqrt((speed[:, which] ** 2).mean(axis=1)) for which in (measured, ~measured)
    )
    assert (bounded[lost:back] < 1.7 * sigma[lost:back]).all()
    assert bounded[lost:back].max() > 2.0 * bounded[:lost].max()  # than with a GPS
    assert free[back - 1] > 3.0 * bounded[lost:back].max()
    # 5 s after the GPS is back all is as it was, to the noise of 10 aircraft
    settled = slice(back + 5 * hz, None)
    for seen in (bounded, free):
        assert seen[settled].max() < 2.0 * bounded[:lost].max()


LATE_S = np.array([0.1, -0.06, 0.3])


def test_a_wrong_latency_is_an_error_along_the_track():
    """In straight flight by −V Δ over the ground, and nothing else, as settled as after 80 s."""
    filters = Filters(
        [suite("pixhawk", gps={"latency_s": 0.12 + late}) for late in LATE_S], STRAIGHT
    )
    result = filters.run(0, len(STRAIGHT))[-1]
    along = -LATE_S[:, None] * STRAIGHT.velocity[-1, :2]
    assert result[:, 6:8] == pytest.approx(along, abs=1e-3)
    assert abs(result[:, [*range(6), 8]]).max() < 1e-3


def test_a_late_gps_in_a_turn_is_an_error_of_its_angle():
    """Position is off by the chord of Ω Δ, velocity turned back by that angle.

    To a hundredth: the inertial sensors, which are not late, contradict a little.
    """
    flight = make_flight(HZ, (5, 0, 0), (60, 1, 0), wind=(0.0, 0.0, 0.0))
    filters = Filters([suite("pixhawk", gps={"latency_s": 0.22})], flight)
    result = filters.run(0, 60 * HZ)[-1, 0]
    ahead = flight.velocity[60 * HZ - 1, :2] / SPEED
    right = np.array([-ahead[1], ahead[0]])
    turn = SPEED / RADIUS
    assert result[6:8] @ ahead == pytest.approx(-SPEED * np.sin(0.1 * turn) / turn, rel=0.01)
    assert result[3:5] @ right == pytest.approx(-SPEED * np.sin(0.1 * turn), rel=0.01)
