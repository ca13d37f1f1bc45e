"""Estimates: which aircraft have errors, when they change, what is common, how large they are."""

import numpy as np
import pytest
from cases import ALL
from reference import adapters_sensors as kernels
from scipy.spatial.transform import Rotation
from scipy.stats import f as fisher
from sensors_samples import SEED, SPEED, assert_chance, make_flight, no_faults, suite

from testbed.core.compile import registered, registering
from testbed.core.frames import GRAVITY, wrap_pi
from testbed.core.records import VehicleState, allocate, write_fields
from testbed.sensors import ekf, estimators, sensor_step
from testbed.sensors.estimators import StateEstimators
from testbed.sensors.sensor_errors import ERRORS, add_jitter_to_all, make_sensor_errors, view_errors

HZ = 20
FLIGHT = make_flight(HZ, (4, 0, 0), (6, 1, 0), (2, 0, 0.1))
PIXHAWK, TRUTH = suite("pixhawk"), suite()
PITOT = suite(airspeed={"noise_pa": 3.0, "offset_pa": 10.0})
EXACT_FIX = suite(gps={"latency_s": 0.0}, estimator={"gps_delay_s": 0.0})
# At first filters take the air to come from along the nose, so that the wind is off by V α² / 2,
# 0.025 m/s. A minute later 1e-4 of that is left, in m and in m/s.
SETTLED = 1e-5


@pytest.fixture
def short_warm_up(monkeypatch):
    """Filters that run for a second before the flight, for tests that need no settled ones."""
    monkeypatch.setattr(estimators, "WARM_UP_S", 1.0)


def names(count):
    return [f"uav{i}" for i in range(count)]


def make(suites, *, aircraft=None, flight=FLIGHT, seed=SEED, **keys):
    aircraft = names(len(suites)) if aircraft is None else aircraft
    each = StateEstimators(aircraft, suites, seed=seed, rate_hz=flight.rate_hz, **keys)
    each.warm_up(kernels.aircraft_of(flight.at(0, len(suites))))
    return each


def write_estimates(each, aircraft, *, advance=True):
    """Write the next estimates, or the present errors on the truth."""
    steps = each.steps(aircraft)
    for step in steps[0] if advance else steps[1]:
        call, then = step if isinstance(step, tuple) else (step, None)
        if call(0.0):
            then(0.0)
    if each.exact:
        aircraft["estimate"] = aircraft["truth"]


def estimate(each, truth, *, advance=True, faults=None):
    """The next estimate of aircraft with this truth, or the present errors on it."""
    aircraft = kernels.aircraft_of(truth, faults)
    write_estimates(each, aircraft, advance=advance)
    return kernels.estimate_of(aircraft)


def fly(each, n, steps=None, flight=FLIGHT, failing=None):
    """Estimates of n aircraft at every step, or at so many."""
    steps = len(flight) if steps is None else steps
    aircraft, seen = kernels.aircraft_of(flight.at(0, n)), []
    for k in range(steps):
        write_fields(aircraft["truth"], flight.at(k, n))
        if failing is not None:
            write_fields(aircraft["faults"], failing(k))
        write_estimates(each, aircraft)
        seen.append(kernels.estimate_of(aircraft))
    return seen


def wrong(estimates, flight=FLIGHT):
    """Errors (K, N, ...) by the names of a motion."""
    out = {}
    for name in VehicleState._fields:
        seen = np.array([getattr(each, name) for each in estimates])
        out[name] = seen - getattr(flight.motion, name)[: len(seen), None]
    out["euler"] = wrap_pi(out["euler"])
    return out


def assert_same_bits(ours, theirs, rows=slice(None)):
    for one, other in zip(ours, theirs, strict=True):
        for name in VehicleState._fields:
            assert np.array_equal(getattr(one, name), getattr(other, name)[rows]), name


# Which estimates have errors


def test_without_sensors_the_estimate_is_the_truth():
    each, truth = make([TRUTH, TRUTH]), FLIGHT.at(3, 2)
    assert each.exact
    for advance in (True, False):
        assert_same_bits([estimate(each, truth, advance=advance)], [truth])


@pytest.mark.parametrize(
    "sensors", [PIXHAWK, PITOT, suite("gps-ins"), suite(gps={}), suite(gyro={})]
)
def test_with_a_sensor_estimates_are_not_exact(sensors, short_warm_up):
    assert not make([TRUTH, sensors]).exact


@pytest.mark.parametrize(
    ("suites", "entries"),
    [
        ([TRUTH, TRUTH], []),
        ([TRUTH, suite("gps-ins")], [add_jitter_to_all]),
        ([TRUTH, PITOT], [sensor_step.estimate_motions]),
        ([PITOT, PIXHAWK], [sensor_step.estimate_motions]),
        (
            [suite("gps-ins"), PITOT],
            [sensor_step.estimate_motions, add_jitter_to_all],
        ),
    ],
)
def test_steps_call_the_needed_entries(suites, entries, short_warm_up):
    each, aircraft = make(suites), kernels.aircraft_of(FLIGHT.at(0, 2))
    with registering():
        each.steps(aircraft)
        found = [entry.function for entry, _ in registered()]
    # those that advance, and those that keep the errors
    known = sensor_step.estimate_motions, add_jitter_to_all
    assert sorted((each for each in found if each in known), key=known.index) == [
        each for each in entries for _ in range(2)
    ]


def test_an_airspeed_sensor_changes_the_airspeed_only():
    truth = FLIGHT.at(0, 2)
    found = estimate(make([PITOT, TRUTH]), truth)
    for name in VehicleState._fields[:-2]:
        assert np.array_equal(getattr(found, name), getattr(truth, name))
    for name in ("airspeed", "equivalent_airspeed"):
        assert getattr(found, name)[0] != getattr(truth, name)[0]
        assert getattr(found, name)[1] == getattr(truth, name)[1]


def test_errors_are_those_of_aircraft_with_sensors(short_warm_up):
    suites = [TRUTH, PIXHAWK, PITOT, suite(gyro={"noise_dps_rthz": 0.1}), TRUTH]
    seen = wrong(fly(make(suites), 5))
    moves = {
        name: (errors.reshape(len(FLIGHT), 5, -1) != 0.0).any(axis=(0, 2)).tolist()
        for name, errors in seen.items()
    }
    for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler", "rates_body"):
        assert moves[name] == [False, True, False, True, False]
    for name in ("airspeed", "equivalent_airspeed"):
        assert moves[name] == [False, True, True, False, False]


def test_exact_sensors_behind_a_filter_give_the_truth():
    """A receiver without errors and latency."""
    for errors in wrong(fly(make([EXACT_FIX] * 2), 2)).values():
        assert abs(errors).max() < SETTLED


def test_estimators_leave_the_truth_unchanged(short_warm_up):
    aircraft = kernels.aircraft_of(FLIGHT.at(5, 2))
    before = aircraft["truth"].copy()
    write_estimates(make([PIXHAWK, suite("gps-ins")]), aircraft)
    assert aircraft["truth"].tobytes() == before.tobytes()


# When errors advance


def test_errors_stay_between_two_steps(short_warm_up):
    each = make([PIXHAWK] * 3)
    fly(each, 3, 20)
    here, there = FLIGHT.at(20, 3), FLIGHT.at(21, 3)
    there = there._replace(position_ned=there.position_ned + 100.0)
    first = estimate(each, here)
    later = estimate(each, there, advance=False)
    for name in ("position_ned", "velocity_ned", "rates_body"):
        moved = getattr(later, name) - getattr(there, name)
        # sums and differences with 1e2 m round by 1e-14
        assert moved == pytest.approx(getattr(first, name) - getattr(here, name), abs=1e-12)
        assert abs(moved).min() > 0.0
    assert np.array_equal(later.airspeed, first.airspeed)  # the last reading of the tube


def test_estimates_between_steps_change_no_errors(short_warm_up):
    often, seldom = make([PIXHAWK, PITOT, TRUTH]), make([PIXHAWK, PITOT, TRUTH])
    for k in range(60):
        truth = FLIGHT.at(k, 3)
        ours, theirs = estimate(often, truth), estimate(seldom, truth)
        assert_same_bits([ours], [theirs])
        for _ in range(k % 3):
            again = estimate(often, truth, advance=False)
            assert_same_bits([again], [theirs])


def test_estimates_depend_on_the_seed_alone(short_warm_up):
    ours = fly(make([PIXHAWK, PITOT]), 2)
    assert_same_bits(ours, fly(make([PIXHAWK, PITOT]), 2))
    others = fly(make([PIXHAWK, PITOT], seed=SEED + 1), 2)
    assert (others[-1].position_ned[0] != ours[-1].position_ned[0]).all()


@pytest.mark.parametrize("neighbour", [TRUTH, PITOT, suite("degraded"), suite("gps-ins")])
@pytest.mark.parametrize(
    "own", [PIXHAWK, PITOT, suite("gps-ins")], ids=["pixhawk", "pitot", "jitter"]
)
def test_more_aircraft_leave_estimates_unchanged(own, neighbour, short_warm_up):
    alone = fly(make([own] * 2, aircraft=["uav1", "uav2"]), 2, 40)
    crowd = make([neighbour, own, neighbour, own], aircraft=["leader", "uav2", "other", "uav1"])
    seen = fly(crowd, 4, 40)
    for name in ("position_ned", "velocity_ned", "euler", "rates_body", "airspeed"):
        ours, theirs = (np.array([getattr(e, name) for e in each]) for each in (alone, seen))
        assert np.array_equal(theirs[:, [3, 1]], ours), name


# Common errors


def test_shared_drifts_are_no_relative_error():
    """Two in the same motion, kilometres apart: each is off by metres, and both by the same."""
    shared = suite(
        gps={"shared_drift_m": [4.0, 6.0], "shared_time_constant_s": 20.0},
        barometer={"shared_drift_m": 3.0, "shared_time_constant_s": 20.0},
    )
    each, offset = make([shared] * 2), np.array([[0.0, 0.0, 0.0], [3000.0, -2000.0, 50.0]])
    errors = []
    for k in range(len(FLIGHT)):
        truth = FLIGHT.at(k, 2)
        truth = truth._replace(position_ned=truth.position_ned + offset)
        errors.append(estimate(each, truth).position_ned - truth.position_ned)
    errors = np.array(errors)
    assert (abs(errors).max(axis=(0, 1)) > 1.0).all()
    # 1e3 m round by 1e-13, which the filters, started elsewhere, gather for a minute
    assert abs(errors[:, 0] - errors[:, 1]).max() < 1e-9


def test_relative_errors_are_those_of_own_drifts():
    """Two that differ in their own drifts only, by the filtered difference of these."""
    drift = {"shared_drift_m": [4.0, 6.0], "shared_time_constant_s": 20.0}
    own = {"own_drift_m": [0.2, 0.2], "own_time_constant_s": 20.0}
    shared = wrong(fly(make([suite(gps=drift | own)] * 2), 2))
    with_it = shared["position_ned"]
    without = wrong(fly(make([suite(gps=own)] * 2), 2))["position_ned"]
    assert abs(with_it).max() > 10.0 * abs(without).max()
    difference, expected = (each[:, 0] - each[:, 1] for each in (with_it, without))
    # linear but for the direction of the air, which the shared part of the velocity turns, and that
    # of the wind by as much again
    angle = 2.0 * abs(shared["velocity_ned"]).max() / SPEED
    assert abs(difference - expected).max() < angle * abs(expected).max()
    assert abs(difference).max() > 0.05


def test_a_barometer_drift_is_the_error_of_the_height():
    """However large: the filter starts from it, or is reset to it, and has no other height."""
    suites = [suite(barometer={"own_drift_m": 60.0, "own_time_constant_s": 1e6}) for _ in range(20)]
    each = make(suites)
    seen = wrong(fly(each, 20, 20))["position_ned"][-1, :, 2]
    first = view_errors(make_sensor_errors(names(20), suites, seed=SEED, dt=1 / HZ))
    drifts = first["barometer_own"]  # which change by less than 1 m in a minute
    assert abs(drifts).max() > 60.0
    assert abs(seen - drifts).max() < 5.0


# From the errors of a filter to an estimate


def test_apply_errors_turns_as_a_strapdown_system():
    """Turned by a small rotation about NED axes: matrices, to second order of its 1e-4 rad."""
    rng = np.random.default_rng(80)
    n, small = 20, 1e-4
    euler = rng.uniform([-1.0, -0.8, -3.0], [1.0, 0.8, 3.0], (n, 3))
    vectors = rng.normal(0.0, 5.0, (4, n, 3))
    speeds = rng.uniform(15.0, 25.0, (2, n))
    truth = VehicleState(vectors[0], vectors[1], vectors[2], euler, vectors[3], *speeds)
    output, states = small * rng.normal(size=(n, 9)), rng.normal(0.0, 0.1, (n, 17))
    errors = allocate(ERRORS, n)
    errors.view("f8")[...] = rng.normal(0.0, 0.1, errors.view("f8").shape)
    out = kernels.apply_errors(truth, np.arange(n), output, states, errors)
    rotation, estimated = (
        Rotation.from_euler("ZYX", each.euler[:, ::-1]).as_matrix() for each in (truth, out)
    )
    turned = Rotation.from_rotvec(output[:, :3]).as_matrix() @ rotation
    # second order: the square, magnified by the tangent and secant of the pitch, twice
    assert abs(estimated - turned).max() < (5.0 * small) ** 2
    assert abs(estimated - rotation).max() > small
    down = np.array([0.0, 0.0, GRAVITY])
    force = np.einsum("nji,nj->ni", rotation, truth.acceleration_ned - down)
    bias = states[:, ekf.ACCELEROMETER_BIAS : ekf.ACCELEROMETER_BIAS + 3]
    force += errors["accelerometer_bias"] + errors["accelerometer_noise"] - bias
    expected = np.einsum("nij,nj->ni", estimated, force) + down
    assert out.acceleration_ned == pytest.approx(expected, abs=1e-12)
    bias = states[:, ekf.GYRO_BIAS : ekf.GYRO_BIAS + 3]
    rates = truth.rates_body + errors["gyro_bias"] + errors["gyro_noise"] - bias
    assert out.rates_body == pytest.approx(rates, abs=1e-14)
    assert out.velocity_ned == pytest.approx(truth.velocity_ned + output[:, 3:6], abs=1e-14)
    assert out.position_ned == pytest.approx(truth.position_ned + output[:, 6:9], abs=1e-14)


# Faults


def test_faults_affect_their_aircraft_only():
    """Rows of filters are not rows of aircraft: the first here has none."""
    each = make([TRUTH, EXACT_FIX, EXACT_FIX], sensor_faults=True)

    def failing(k):
        jump = np.zeros((3, 3))
        jump[2, 0] = 3.0
        blocked = np.array([k >= 40, False, False])
        return no_faults(3)._replace(gps_jump=jump, pitot_blocked=blocked, pitot_drained=blocked)

    seen = wrong(fly(each, 3, 200, failing=failing))
    position = seen["position_ned"][:, :, 0]
    assert not position[:, 0].any()
    assert abs(position[:, 1]).max() < SETTLED
    assert position[-1, 2] > 2.0
    assert not seen["airspeed"][:40].any()
    assert (seen["airspeed"][40:, 0] < -19.0).all()
    assert not seen["airspeed"][:, 1:].any()


def test_without_gps_the_velocity_of_a_filter_is_worse():
    """Six filters have a GPS, six have lost it, and an aircraft without a filter has no error."""
    keys = {"noise_dps_rthz": 1.0}
    noisy = suite(gps={"latency_s": 0.0}, gyro=keys, estimator={"gps_delay_s": 0.0})
    each, lost = make([TRUTH, *[noisy] * 12], sensor_faults=True), np.arange(13) % 2 == 0

    def failing(k):
        return no_faults(13)._replace(gps_lost=lost)

    velocity = wrong(fly(each, 13, failing=failing))["velocity_ned"][60:]
    size = np.sqrt((velocity**2).mean(axis=(0, 2)))
    assert size[0] == 0.0
    assert size[2::2].mean() > 1.5 * size[1::2].mean() > 0.0


# How large errors are


def test_filters_have_settled_at_the_start():
    """Straight on, errors of 60 aircraft, or 150, at first are as large as after another minute.

    Own errors only, so that aircraft are independent; Fisher's test of two variances.
    """
    own = suite(
        "pixhawk",
        gps={"shared_drift_m": [0.0, 0.0], "own_time_constant_s": 5.0},
        barometer={"shared_drift_m": 0.0, "own_time_constant_s": 5.0},
        gyro={"bias_time_constant_s": 10.0},
        accelerometer={"bias_time_constant_s": 10.0},
    )
    n = 150 if ALL else 60
    flight = make_flight(HZ, (60, 0, 0))
    seen = wrong(fly(make([own] * n, flight=flight), n, flight=flight), flight)
    for name in ("position_ned", "velocity_ned", "euler"):
        first, last = (seen[name][k].var(axis=0) for k in (0, -1))
        assert_chance(
            2.0
            * np.minimum(*(g(first / last, n - 1, n - 1) for g in (fisher.cdf, fisher.sf))).min()
        )


def test_errors_of_the_pixhawk_preset():
    """Straights and circles of 120 m, 12 aircraft or 30: root mean squares over all of them.

    The horizontal error is the common drift of 1.3 m on each axis, over as long as it takes to
    change: another seed's may be half or twice as large, and so may the height's. It is no error
    of the aircraft relative to each other.
    """
    legs = [(60, 0, 0), (60, 1, 0), (60, 0, 0), (60, -1, 0)] * 3
    flight = make_flight(25, *legs[: 10 if ALL else 2])
    n = 30 if ALL else 12
    seen = wrong(fly(make([PIXHAWK] * n, flight=flight), n, flight=flight), flight)

    def size(errors):
        return np.sqrt((errors**2).reshape(*errors.shape[:2], -1).sum(axis=2).mean())

    position, velocity, euler = seen["position_ned"], seen["velocity_ned"], seen["euler"]
    among = (position - position.mean(axis=1, keepdims=True)) * np.sqrt(n / (n - 1))
    sizes = {
        "horizontal": size(position[:, :, :2]),
        "height": size(position[:, :, 2]),
        "horizontal, own": size(among[:, :, :2]),
        "velocity": size(velocity),
        "tilt": np.degrees(size(euler[:, :, :2])),
        "heading": np.degrees(size(euler[:, :, 2])),
        "airspeed": size(seen["airspeed"]),
    }
    ranges = {
        "horizontal": (0.5, 4.5),
        "height": (0.3, 2.5),
        "horizontal, own": (0.3, 0.5),
        "velocity": (0.05, 0.3),
        "tilt": (0.2, 1.0),
        "heading": (0.3, 3.0),
        "airspeed": (0.1, 0.5),
    }
    for name, (least, most) in ranges.items():
        assert least < sizes[name] < most, name
