"""Jitter: Gauss-Markov errors with closed-form statistics, and independent streams."""

import numpy as np
import pytest

from testbed.frames import GRAVITY
from testbed.sensing import jitter
from testbed.sensing.jitter import Jitter, NoiseLevel
from testbed.state import VehicleState
from testbed.streams import stream

DT = 0.02
QUIET = NoiseLevel(0.0, 1.0)
EXACT = (QUIET, QUIET, QUIET)
GPS_INS = (NoiseLevel(0.3, 10.0), NoiseLevel(0.05, 0.2), NoiseLevel(np.radians(0.3), 0.2))


def truth(n):
    rng = np.random.default_rng(50)
    return VehicleState(*rng.normal(0.0, 1.0, (5, n, 3)), *rng.uniform(15.0, 30.0, (2, n)))


def jitters(names, errors=GPS_INS, *, seed=1, dt=DT):
    return Jitter(names, [errors] * len(names), seed=seed, dt=dt)


def errors_over(steps, each, n):
    """Errors of position, velocity and attitude (steps, n, 9)."""
    flying = truth(n)
    out = np.empty((steps, n, 9))
    for k in range(steps):
        estimate = each.on(flying, fresh=True)
        for at, name in enumerate(("position_ned", "velocity_ned", "euler")):
            out[k, :, 3 * at : 3 * at + 3] = getattr(estimate, name) - getattr(flying, name)
    return out


def names(count):
    return [f"uav{i}" for i in range(count)]


def test_variance_and_correlation_are_those_of_the_closed_form():
    """E[e(t) e(t + T)] = σ² exp(−T/τ), on 90 independent axes of 30 aircraft.

    Each axis gives an unbiased sample of the covariance; their mean lies within 4.5 standard
    errors of the truth but for a chance of 7e-6, and the seed is fixed. The standard errors are
    below 2 % of σ².
    """
    n, steps, dt = 30, 3000, 0.05
    levels = [NoiseLevel(0.3, 0.4), NoiseLevel(0.05, 0.2), NoiseLevel(0.02, 0.05)]
    seen = errors_over(steps, jitters(names(n), tuple(levels), dt=dt), n)
    for at, level in enumerate(levels):
        axes = seen[:, :, 3 * at : 3 * at + 3].reshape(steps, -1)
        for lag in (0, 1, 4, 10):
            samples = (axes[lag:] * axes[: steps - lag]).mean(axis=0)
            error = samples.std(ddof=1) / np.sqrt(samples.size)
            expected = level.sigma**2 * np.exp(-lag * dt / level.time_constant_s)
            assert error < 0.02 * level.sigma**2
            assert abs(samples.mean() - expected) < 4.5 * error, (at, lag)


def test_errors_start_with_their_variance():
    """Stationary from the first estimate: 3000 axes, 4.5 standard errors √(2/3000)."""
    first = errors_over(1, jitters(names(1000)), 1000)[0]
    for at, sigma in enumerate((0.3, 0.05, np.radians(0.3))):
        variance = (first[:, 3 * at : 3 * at + 3] ** 2).mean() / sigma**2
        assert abs(variance - 1.0) < 4.5 * np.sqrt(2.0 / 3000.0)


def test_axes_and_aircraft_are_independent():
    """Correlations of 36 series over 4000 nearly independent samples: 4.5/√4000."""
    white = (NoiseLevel(1.0, 0.01),) * 3
    seen = errors_over(4000, jitters(names(4), white, dt=0.1), 4).reshape(4000, -1)
    correlations = np.corrcoef(seen.T) - np.eye(36)
    assert abs(correlations).max() < 4.5 / np.sqrt(4000.0)


def test_more_aircraft_move_no_dice():
    alone = errors_over(600, jitters(["uav1", "uav2"]), 2)
    crowd = errors_over(600, jitters(["leader", "uav2", "other", "uav1"]), 4)
    # estimate − truth of other truths: the errors themselves agree to the bit, and the sums round
    np.testing.assert_allclose(crowd[:, [3, 1]], alone, rtol=0, atol=1e-15)
    assert abs(crowd[:, 0] - crowd[:, 1]).max() > 0.1


def test_a_noisier_neighbour_moves_no_dice():
    loud = (NoiseLevel(9.0, 3.0), QUIET, NoiseLevel(0.1, 1.0))
    one = Jitter(["uav1", "uav2"], [GPS_INS, GPS_INS], seed=1, dt=DT)
    two = Jitter(["uav1", "uav2"], [GPS_INS, loud], seed=1, dt=DT)
    assert np.array_equal(errors_over(50, one, 2)[:, 0], errors_over(50, two, 2)[:, 0])


def test_the_same_seed_gives_the_same_bits_and_another_does_not():
    ours = errors_over(600, jitters(names(3)), 3)
    assert np.array_equal(errors_over(600, jitters(names(3)), 3), ours)
    others = errors_over(600, jitters(names(3), seed=2), 3)
    assert (others != ours).mean() > 0.99


def test_drawing_in_blocks_changes_nothing(monkeypatch):
    ours = errors_over(600, jitters(names(2)), 2)
    monkeypatch.setattr(jitter, "BLOCK", 7)
    assert np.array_equal(errors_over(600, jitters(names(2)), 2), ours)


def test_a_stream_is_its_seed_and_its_name():
    draws = {
        (seed, name): tuple(stream(seed, name).standard_normal(4))
        for seed in (1, 2, 12)
        for name in ("sensors/a", "sensors/b", "2/sensors/a")
    }
    assert len(set(draws.values())) == len(draws)
    assert tuple(stream(1, "sensors/a").standard_normal(4)) == draws[1, "sensors/a"]


def test_without_errors_the_truth_itself_is_returned():
    each, flying = jitters(["a", "b"], EXACT), truth(2)
    assert each.exact
    assert each.on(flying, fresh=True) is flying
    assert not jitters(["a"]).exact


def test_one_exact_aircraft_among_others_is_exact():
    mixed, flying = Jitter(["a", "b"], [EXACT, GPS_INS], seed=1, dt=DT), truth(2)
    estimate = mixed.on(flying, fresh=True)
    for name in ("position_ned", "velocity_ned", "euler"):
        assert np.array_equal(getattr(estimate, name)[0], getattr(flying, name)[0])
        assert (getattr(estimate, name)[1] != getattr(flying, name)[1]).all()
    # there and back through the body frame
    assert estimate.acceleration_ned[0] == pytest.approx(flying.acceleration_ned[0], abs=1e-14)


def test_rates_and_airspeeds_are_exact_and_the_truth_is_left_alone():
    each, flying = jitters(["a", "b"]), truth(2)
    before = VehicleState(*(array.copy() for array in flying))
    estimate = each.on(flying, fresh=True)
    for name in ("rates_body", "airspeed", "equivalent_airspeed"):
        assert np.array_equal(getattr(estimate, name), getattr(flying, name))
    for array, copy in zip(flying, before, strict=True):
        assert np.array_equal(array, copy)


def about(axis, angle):
    """Rotation by an angle about an axis of the frame, built from the elementary matrix."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [k for k in range(3) if k != axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    sign = -1.0 if axis == 1 else 1.0
    out[i, j], out[j, i] = -sign * s, sign * s
    return out


def test_accelerations_are_felt_and_turned_with_the_estimated_attitude():
    tilted = (QUIET, QUIET, NoiseLevel(0.1, 1.0))
    flying = truth(6)
    estimate = jitters(names(6), tilted).on(flying, fresh=True)
    gravity = np.array([0.0, 0.0, GRAVITY])
    for i in range(6):
        rotations = [
            about(2, yaw) @ about(1, pitch) @ about(0, roll)
            for roll, pitch, yaw in (flying.euler[i], estimate.euler[i])
        ]
        felt = rotations[0].T @ (flying.acceleration_ned[i] - gravity)
        expected = rotations[1] @ felt + gravity
        assert estimate.acceleration_ned[i] == pytest.approx(expected, abs=1e-13)
        assert abs(expected - flying.acceleration_ned[i]).max() > 0.05


def test_a_tilted_horizon_makes_gravity_an_acceleration():
    # unaccelerated and level; believed to roll by δ: g sin δ to the east, g (1 − cos δ) down
    tilted = (QUIET, QUIET, NoiseLevel(0.02, 1.0))
    zero = np.zeros((40, 3))
    level = VehicleState(zero, zero, zero, zero, zero, np.full(40, 20.0), np.full(40, 20.0))
    estimate = jitters(names(40), tilted).on(level, fresh=True)
    roll, pitch, yaw = estimate.euler.T
    # to second order in the errors, the heading aside
    forward = np.cos(yaw) * estimate.acceleration_ned[:, 0] + (
        np.sin(yaw) * estimate.acceleration_ned[:, 1]
    )
    right = np.cos(yaw) * estimate.acceleration_ned[:, 1] - (
        np.sin(yaw) * estimate.acceleration_ned[:, 0]
    )
    assert right == pytest.approx(GRAVITY * np.sin(roll), abs=1e-12)
    assert forward == pytest.approx(-GRAVITY * np.sin(pitch) * np.cos(roll), abs=1e-12)
    assert estimate.acceleration_ned[:, 2] == pytest.approx(
        GRAVITY * (1.0 - np.cos(roll) * np.cos(pitch)), abs=1e-12
    )


def test_between_two_of_its_moments_an_error_stays_as_it_is():
    """Asked in between, an estimate is another truth with the same errors, and draws nothing."""
    flying = truth(2)
    moved = flying._replace(position_ned=flying.position_ned + 100.0)
    often, seldom = jitters(names(2)), jitters(names(2))
    for _ in range(5):
        at_first = VehicleState(*(array.copy() for array in often.on(flying, fresh=True)))
        for _ in range(3):
            between = often.on(moved, fresh=False)
            error = between.position_ned - moved.position_ned
            # 100 m more carry a rounding of 1e-14 m
            assert error == pytest.approx(at_first.position_ned - flying.position_ned, abs=1e-13)
            assert np.array_equal(between.velocity_ned, at_first.velocity_ned)
            assert np.array_equal(between.euler, at_first.euler)
        again = seldom.on(flying, fresh=True)
        assert np.array_equal(again.position_ned, at_first.position_ned)
