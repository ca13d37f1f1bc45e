"""What autopilots believe: who errs and who does not, what is shared, and how large errors are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import f as fisher
from sensing_samples import (
    SEED,
    SPEED,
    assert_chance,
    make_flight,
    nothing_fails,
    page,
)

from testbed.frames import GRAVITY, wrap_pi
from testbed.sensing import belief, estimators
from testbed.sensing import errors as columns
from testbed.sensing.errors import SensorErrors, make_levels
from testbed.sensing.estimators import Estimators
from testbed.sensing.navigation import FORCE_BIAS, GYRO_BIAS
from testbed.state import VehicleState

HZ = 20
FLIGHT = make_flight(HZ, (4, 0, 0), (6, 1, 0), (2, 0, 0.1))
PIXHAWK, TRUTH = page("pixhawk"), page()
PITOT = page(airspeed={"noise_pa": 3.0, "offset_pa": 10.0})
EXACT_FIX = page(gps={"latency_s": 0.0}, estimator={"gps_delay_s": 0.0})
# At first filters take the air to come from along the nose, and so the wind to be off by V α² / 2,
# 0.025 m/s. A minute later 1e-4 of that is left, in m and in m/s.
SETTLED = 1e-5


@pytest.fixture
def at_once(monkeypatch):
    """Filters that were switched on a second before the flight: nothing here waits for them."""
    monkeypatch.setattr(estimators, "WARM_UP_S", 1.0)


def names(count):
    return [f"uav{i}" for i in range(count)]


def make(pages, *, aircraft=None, flight=FLIGHT, seed=SEED, **keys):
    aircraft = names(len(pages)) if aircraft is None else aircraft
    start = flight.at(0, len(pages))
    return Estimators(aircraft, pages, seed=seed, rate_hz=flight.rate_hz, start=start, **keys)


def fly(each, n, steps=None, flight=FLIGHT, failing=None):
    """Estimates of n aircraft at every step, or at so many."""
    steps = len(flight) if steps is None else steps
    broken = (lambda k: None) if failing is None else failing
    truth, seen = flight.at(0, n), []
    for k in range(steps):
        flight.write(k, truth)
        seen.append(kept(each.estimate(truth, fresh=True, failing=broken(k))))
    return seen


def kept(estimate):
    """A copy: the next one is written over it."""
    return VehicleState(*(array.copy() for array in estimate))


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


# Who errs


def test_the_truth_is_the_very_object():
    each, flown = make([TRUTH, TRUTH]), FLIGHT.at(3, 2)
    assert each.exact
    for fresh in (True, False):
        assert each.estimate(flown, fresh=fresh) is flown
        assert each.estimate(flown, fresh=fresh, failing=nothing_fails(2)) is flown


@pytest.mark.parametrize("sensors", [PIXHAWK, PITOT, page("gps-ins"), page(gps={}), page(gyro={})])
def test_a_page_with_a_sensor_is_not_the_truth(sensors, at_once):
    each, flown = make([TRUTH, sensors]), FLIGHT.at(0, 2)
    assert not each.exact
    assert each.estimate(flown, fresh=True) is not flown


def test_a_pitot_tube_alone_leaves_all_else_to_the_truth():
    flown = FLIGHT.at(0, 2)
    estimate = make([PITOT, TRUTH]).estimate(flown, fresh=True)
    for name in VehicleState._fields[:-2]:
        assert np.array_equal(getattr(estimate, name), getattr(flown, name))
    for name in ("airspeed", "equivalent_airspeed"):
        assert getattr(estimate, name)[0] != getattr(flown, name)[0]
        assert getattr(estimate, name)[1] == getattr(flown, name)[1]


def test_only_those_err_whose_pages_have_sensors(at_once):
    pages = [TRUTH, PIXHAWK, PITOT, page(gyro={"noise_dps_rthz": 0.1}), TRUTH]
    seen = wrong(fly(make(pages), 5))
    moves = {
        name: (errors.reshape(len(FLIGHT), 5, -1) != 0.0).any(axis=(0, 2)).tolist()
        for name, errors in seen.items()
    }
    for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler", "rates_body"):
        assert moves[name] == [False, True, False, True, False]
    for name in ("airspeed", "equivalent_airspeed"):
        assert moves[name] == [False, True, True, False, False]


def test_exact_sensors_behind_a_filter_give_the_truth():
    """A receiver without errors, at once: nothing to correct."""
    for errors in wrong(fly(make([EXACT_FIX] * 2), 2)).values():
        assert abs(errors).max() < SETTLED


def test_the_truth_is_left_alone(at_once):
    flown = FLIGHT.at(5, 2)
    before = VehicleState(*(each.copy() for each in flown))
    make([PIXHAWK, PIXHAWK]).estimate(flown, fresh=True)
    for array, copy in zip(flown, before, strict=True):
        assert np.array_equal(array, copy)


# When errors move on


def test_between_two_of_its_moments_errors_stay_as_they_are(at_once):
    each = make([PIXHAWK] * 3)
    fly(each, 3, 20)
    here, there = FLIGHT.at(20, 3), FLIGHT.at(21, 3)
    there = there._replace(position_ned=there.position_ned + 100.0)
    first = kept(each.estimate(here, fresh=True))
    later = each.estimate(there, fresh=False)
    for name in ("position_ned", "velocity_ned", "rates_body"):
        moved = getattr(later, name) - getattr(there, name)
        # sums and differences with 1e2 m round by 1e-14
        assert moved == pytest.approx(getattr(first, name) - getattr(here, name), abs=1e-12)
        assert abs(moved).min() > 0.0
    assert np.array_equal(later.airspeed, first.airspeed)  # a pitot tube is read now and then


def test_asking_in_between_changes_nothing(at_once):
    often, seldom = make([PIXHAWK, PITOT, TRUTH]), make([PIXHAWK, PITOT, TRUTH])
    for k in range(60):
        truth = FLIGHT.at(k, 3)
        ours, theirs = often.estimate(truth, fresh=True), seldom.estimate(truth, fresh=True)
        assert_same_bits([ours], [theirs])
        for _ in range(k % 3):
            again = often.estimate(truth, fresh=False)
            assert_same_bits([again], [theirs])


def test_runs_repeat_to_the_bit_and_another_seed_is_another_run(at_once):
    ours = fly(make([PIXHAWK, PITOT]), 2)
    assert_same_bits(ours, fly(make([PIXHAWK, PITOT]), 2))
    others = fly(make([PIXHAWK, PITOT], seed=SEED + 1), 2)
    assert (others[-1].position_ned[0] != ours[-1].position_ned[0]).all()


@pytest.mark.parametrize("neighbour", [TRUTH, PITOT, page("degraded"), page("gps-ins")])
@pytest.mark.parametrize(
    "own", [PIXHAWK, PITOT, page("gps-ins")], ids=["pixhawk", "pitot", "jitter"]
)
def test_one_more_aircraft_moves_nobodys_errors(own, neighbour, at_once):
    alone = fly(make([own] * 2, aircraft=["uav1", "uav2"]), 2, 40)
    crowd = make([neighbour, own, neighbour, own], aircraft=["leader", "uav2", "other", "uav1"])
    seen = fly(crowd, 4, 40)
    for name in ("position_ned", "velocity_ned", "euler", "rates_body", "airspeed"):
        ours, theirs = (np.array([getattr(e, name) for e in each]) for each in (alone, seen))
        assert np.array_equal(theirs[:, [3, 1]], ours), name


# What is shared


def test_what_receivers_share_is_no_error_between_aircraft():
    """Two in the same motion, kilometres apart: each is off by metres, and both by the same."""
    shared = page(
        gps={"shared_drift_m": [4.0, 6.0], "shared_time_constant_s": 20.0},
        barometer={"shared_drift_m": 3.0, "shared_time_constant_s": 20.0},
    )
    each, offset = make([shared] * 2), np.array([[0.0, 0.0, 0.0], [3000.0, -2000.0, 50.0]])
    errors = []
    for k in range(len(FLIGHT)):
        truth = FLIGHT.at(k, 2)
        truth = truth._replace(position_ned=truth.position_ned + offset)
        estimate = each.estimate(truth, fresh=True)
        errors.append(estimate.position_ned - truth.position_ned)
    errors = np.array(errors)
    assert (abs(errors).max(axis=(0, 1)) > 1.0).all()
    # 1e3 m round by 1e-13, which the filters, whose start was elsewhere, gather for a minute
    assert abs(errors[:, 0] - errors[:, 1]).max() < 1e-9


def test_relative_errors_are_those_of_ones_own():
    """Who differ in their own drift only differ by the filtered difference of these."""
    drift = {"shared_drift_m": [4.0, 6.0], "shared_time_constant_s": 20.0}
    own = {"own_drift_m": [0.2, 0.2], "own_time_constant_s": 20.0}
    shared = wrong(fly(make([page(gps=drift | own)] * 2), 2))
    with_it = shared["position_ned"]
    without = wrong(fly(make([page(gps=own)] * 2), 2))["position_ned"]
    assert abs(with_it).max() > 10.0 * abs(without).max()
    difference, expected = (each[:, 0] - each[:, 1] for each in (with_it, without))
    # linear but for the direction of the air, which the shared part of the velocity turns, and that
    # of the wind by as much again
    angle = 2.0 * abs(shared["velocity_ned"]).max() / SPEED
    assert abs(difference - expected).max() < angle * abs(expected).max()
    assert abs(difference).max() > 0.05


def test_however_wrong_a_barometer_is_a_filter_that_has_no_other_height_believes_it():
    """Switched on with it, or started again from it: its gate is no way to the truth."""
    pages = [page(barometer={"own_drift_m": 60.0, "own_time_constant_s": 1e6}) for _ in range(20)]
    each = make(pages)
    seen = wrong(fly(each, 20, 20))["position_ned"][-1, :, 2]
    errors = SensorErrors(names(20), make_levels(pages, 1 / HZ), seed=SEED, dt=1 / HZ).now
    drifts = errors[:, columns.BARO_OWN]  # which change by less than 1 m in a minute
    assert abs(drifts).max() > 60.0
    assert abs(seen - drifts).max() < 5.0


# From a filter's errors to a motion


def test_attitude_rates_and_accelerations_are_those_of_a_strapdown_system():
    """Turned by a small rotation about NED axes: matrices, to second order of its 1e-4 rad."""
    rng = np.random.default_rng(80)
    n, small = 20, 1e-4
    euler = rng.uniform([-1.0, -0.8, -3.0], [1.0, 0.8, 3.0], (n, 3))
    vectors = rng.normal(0.0, 5.0, (4, n, 3))
    speeds = rng.uniform(15.0, 25.0, (2, n))
    truth = VehicleState(vectors[0], vectors[1], vectors[2], euler, vectors[3], *speeds)
    out = VehicleState(*(each.copy() for each in truth))
    flown, states = small * rng.normal(size=(n, 9)), rng.normal(0.0, 0.1, (n, 17))
    errors = rng.normal(0.0, 0.1, (n, columns.COLUMNS))
    belief.believe(out, np.arange(n), flown, states, errors)
    rotation, believed = (
        Rotation.from_euler("ZYX", each.euler[:, ::-1]).as_matrix() for each in (truth, out)
    )
    turned = Rotation.from_rotvec(flown[:, :3]).as_matrix() @ rotation
    # second order: the square, magnified by the tangent and secant of the pitch, twice
    assert abs(believed - turned).max() < (5.0 * small) ** 2
    assert abs(believed - rotation).max() > small
    down = np.array([0.0, 0.0, GRAVITY])
    felt = np.einsum("nji,nj->ni", rotation, truth.acceleration_ned - down)
    felt += errors[:, columns.FORCE_BIAS] + errors[:, columns.FORCE_NOISE] - states[:, FORCE_BIAS]
    expected = np.einsum("nij,nj->ni", believed, felt) + down
    assert out.acceleration_ned == pytest.approx(expected, abs=1e-12)
    gyro = errors[:, columns.GYRO_BIAS] + errors[:, columns.GYRO_NOISE] - states[:, GYRO_BIAS]
    assert out.rates_body == pytest.approx(truth.rates_body + gyro, abs=1e-14)
    assert out.velocity_ned == pytest.approx(truth.velocity_ned + flown[:, 3:6], abs=1e-14)
    assert out.position_ned == pytest.approx(truth.position_ned + flown[:, 6:9], abs=1e-14)


def test_what_breaks_breaks_for_whom_it_breaks():
    """Rows of filters are not rows of aircraft: the first here has none."""
    each = make([TRUTH, EXACT_FIX, EXACT_FIX], breakable=True)

    def failing(k):
        jump = np.zeros((3, 3))
        jump[2, 0] = 3.0
        blocked = np.array([k >= 40, False, False])
        return nothing_fails(3)._replace(
            gps_jump=jump, pitot_blocked=blocked, pitot_drained=blocked
        )

    seen = wrong(fly(each, 3, 200, failing=failing))
    position = seen["position_ned"][:, :, 0]
    assert not position[:, 0].any()
    assert abs(position[:, 1]).max() < SETTLED
    assert position[-1, 2] > 2.0
    assert not seen["airspeed"][:40].any()
    assert (seen["airspeed"][40:, 0] < -19.0).all()
    assert not seen["airspeed"][:, 1:].any()


def test_a_lost_gps_is_the_filters_loss():
    """Six keep theirs, six do not, and a seventh has no filter to miss it."""
    keys = {"noise_dps_rthz": 1.0}
    noisy = page(gps={"latency_s": 0.0}, gyro=keys, estimator={"gps_delay_s": 0.0})
    each, lost = make([TRUTH, *[noisy] * 12], breakable=True), np.arange(13) % 2 == 0

    def failing(k):
        return nothing_fails(13)._replace(gps_lost=lost)

    velocity = wrong(fly(each, 13, failing=failing))["velocity_ned"][60:]
    size = np.sqrt((velocity**2).mean(axis=(0, 2)))
    assert size[0] == 0.0
    assert size[2::2].mean() > 1.5 * size[1::2].mean() > 0.0


# How large errors are


def test_filters_have_settled_when_the_flight_begins():
    """Straight on, errors of 150 aircraft at first are as large as after another minute.

    Own errors only, so that aircraft are independent; Fisher's test of two variances.
    """
    own = page(
        "pixhawk",
        gps={"shared_drift_m": [0.0, 0.0], "own_time_constant_s": 5.0},
        barometer={"shared_drift_m": 0.0, "own_time_constant_s": 5.0},
        gyro={"bias_time_constant_s": 10.0},
        accelerometer={"bias_time_constant_s": 10.0},
    )
    n = 150
    flight = make_flight(HZ, (60, 0, 0))
    seen = wrong(fly(make([own] * n, flight=flight), n, flight=flight), flight)
    for name in ("position_ned", "velocity_ned", "euler"):
        first, last = (seen[name][k].var(axis=0) for k in (0, -1))
        assert_chance(
            2.0
            * np.minimum(*(g(first / last, n - 1, n - 1) for g in (fisher.cdf, fisher.sf))).min()
        )


def test_errors_of_the_pixhawk_preset():
    """600 s of straights and circles of 120 m, 30 aircraft: root mean squares over all of them.

    The horizontal error is the one drift of 1.3 m on each axis that all share, over as long as it
    takes to change: another seed's may be half or twice as large, and so may the height's. Of the
    aircraft to each other it drops out.
    """
    flight = make_flight(
        25, *[(60, 0, 0), (60, 1, 0), (60, 0, 0), (60, -1, 0)] * 2, (60, 0, 0), (60, 1, 0)
    )
    n = 30
    seen = wrong(fly(make([PIXHAWK] * n, flight=flight), n, flight=flight), flight)

    def size(errors):
        return np.sqrt((errors**2).reshape(*errors.shape[:2], -1).sum(axis=2).mean())

    position, velocity, euler = seen["position_ned"], seen["velocity_ned"], seen["euler"]
    among = (position - position.mean(axis=1, keepdims=True)) * np.sqrt(n / (n - 1))
    sizes = {
        "horizontal": size(position[:, :, :2]),
        "height": size(position[:, :, 2]),
        "horizontal, of one's own": size(among[:, :, :2]),
        "velocity": size(velocity),
        "tilt": np.degrees(size(euler[:, :, :2])),
        "heading": np.degrees(size(euler[:, :, 2])),
        "airspeed": size(seen["airspeed"]),
    }
    ranges = {
        "horizontal": (0.5, 4.5),
        "height": (0.3, 2.5),
        "horizontal, of one's own": (0.3, 0.5),
        "velocity": (0.05, 0.3),
        "tilt": (0.2, 1.0),
        "heading": (0.3, 3.0),
        "airspeed": (0.1, 0.5),
    }
    for name, (least, most) in ranges.items():
        assert least < sizes[name] < most, name
