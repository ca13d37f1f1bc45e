"""Jitter: Gauss-Markov errors with closed-form statistics, and independent streams."""

import numpy as np
import pytest
from reference import adapters_sensors as kernels
from sensors_samples import suite

from testbed.core import random
from testbed.core.frames import GRAVITY
from testbed.core.random import named_stream
from testbed.core.records import VehicleState
from testbed.sensors.sensor_errors import add_jitter_to_all, make_jitter

DT = 0.02
# standard deviation and time constant of position, velocity and attitude (degrees)
EXACT = (0.0, 1.0)
GPS_INS = ((0.3, 10.0), (0.05, 0.2), (0.3, 0.2))


def truth(n):
    rng = np.random.default_rng(50)
    return VehicleState(*rng.normal(0.0, 1.0, (5, n, 3)), *rng.uniform(15.0, 30.0, (2, n)))


def sensors(position, velocity, attitude):
    return suite(
        position=dict(zip(("sigma_m", "time_constant_s"), position, strict=True)),
        velocity=dict(zip(("sigma_mps", "time_constant_s"), velocity, strict=True)),
        attitude=dict(zip(("sigma_deg", "time_constant_s"), attitude, strict=True)),
    )


class Jitter:
    """The jitter of aircraft, on their truth."""

    def __init__(self, names, suites, *, seed=1, dt=DT):
        self.errors = make_jitter(names, suites, seed=seed, dt=dt)

    def on(self, truth, *, advance=True):
        """The estimate of aircraft with this truth."""
        errors, aircraft = self.errors, kernels.aircraft_of(truth)
        numbers = errors.numbers.block, errors.numbers.used
        values = errors.coefficients, errors.values, True, *numbers
        while add_jitter_to_all(*values, aircraft, advance):
            errors.numbers.refill()
        return kernels.estimate_of(aircraft)


def jitters(names, errors=GPS_INS, *, seed=1, dt=DT):
    return Jitter(names, [sensors(*errors)] * len(names), seed=seed, dt=dt)


def errors_over(steps, each, n):
    """Errors of position, velocity and attitude (steps, n, 9)."""
    flying = truth(n)
    out = np.empty((steps, n, 9))
    for k in range(steps):
        estimate = each.on(flying)
        for at, name in enumerate(("position_ned", "velocity_ned", "euler")):
            out[k, :, 3 * at : 3 * at + 3] = getattr(estimate, name) - getattr(flying, name)
    return out


def names(count):
    return [f"uav{i}" for i in range(count)]


def test_variance_and_correlation_have_a_closed_form():
    """E[e(t) e(t + T)] = σ² exp(−T/τ), on 90 independent axes of 30 aircraft.

    Each axis gives an unbiased sample of the covariance; their mean lies within 4.5 standard
    errors of the truth but for a chance of 7e-6, and the seed is fixed. The standard errors are
    below 2 % of σ².
    """
    n, steps, dt = 30, 3000, 0.05
    sigmas, time_constants = (0.3, 0.05, 0.02), (0.4, 0.2, 0.05)
    args = zip((*sigmas[:2], np.degrees(sigmas[2])), time_constants, strict=True)
    seen = errors_over(steps, jitters(names(n), tuple(args), dt=dt), n)
    for at, (sigma, tau) in enumerate(zip(sigmas, time_constants, strict=True)):
        axes = seen[:, :, 3 * at : 3 * at + 3].reshape(steps, -1)
        for lag in (0, 1, 4, 10):
            samples = (axes[lag:] * axes[: steps - lag]).mean(axis=0)
            error = samples.std(ddof=1) / np.sqrt(samples.size)
            expected = sigma**2 * np.exp(-lag * dt / tau)
            assert error < 0.02 * sigma**2
            assert abs(samples.mean() - expected) < 4.5 * error, (at, lag)


def test_errors_start_with_their_variance():
    """Stationary from the first estimate: 3000 axes, 4.5 standard errors √(2/3000)."""
    first = errors_over(1, jitters(names(1000)), 1000)[0]
    for at, sigma in enumerate((0.3, 0.05, np.radians(0.3))):
        variance = (first[:, 3 * at : 3 * at + 3] ** 2).mean() / sigma**2
        assert abs(variance - 1.0) < 4.5 * np.sqrt(2.0 / 3000.0)


def test_axes_and_aircraft_are_independent():
    """Correlations of 36 series over 4000 nearly independent samples: 4.5/√4000."""
    white = ((1.0, 0.01), (1.0, 0.01), (np.degrees(1.0), 0.01))
    seen = errors_over(4000, jitters(names(4), white, dt=0.1), 4).reshape(4000, -1)
    correlations = np.corrcoef(seen.T) - np.eye(36)
    assert abs(correlations).max() < 4.5 / np.sqrt(4000.0)


def test_more_aircraft_leave_jitter_unchanged():
    alone = errors_over(600, jitters(["uav1", "uav2"]), 2)
    crowd = errors_over(600, jitters(["leader", "uav2", "other", "uav1"]), 4)
    # estimate − truth of other truths: the errors themselves agree to the bit, and the sums round
    np.testing.assert_allclose(crowd[:, [3, 1]], alone, rtol=0, atol=1e-15)
    assert abs(crowd[:, 0] - crowd[:, 1]).max() > 0.1


def test_other_levels_leave_jitter_unchanged():
    quiet, loud = sensors(*GPS_INS), sensors((9.0, 3.0), EXACT, (6.0, 1.0))
    one = Jitter(["uav1", "uav2"], [quiet, quiet])
    two = Jitter(["uav1", "uav2"], [quiet, loud])
    assert np.array_equal(errors_over(50, one, 2)[:, 0], errors_over(50, two, 2)[:, 0])


def test_jitter_depends_on_the_seed_alone():
    ours = errors_over(600, jitters(names(3)), 3)
    assert np.array_equal(errors_over(600, jitters(names(3)), 3), ours)
    others = errors_over(600, jitters(names(3), seed=2), 3)
    assert (others != ours).mean() > 0.99


def test_block_size_does_not_change_jitter(monkeypatch):
    ours = errors_over(600, jitters(names(2)), 2)
    monkeypatch.setattr(random, "BLOCK", 7)
    assert np.array_equal(errors_over(600, jitters(names(2)), 2), ours)


def test_a_stream_is_its_seed_and_its_name():
    draws = {
        (seed, name): tuple(named_stream(seed, name).standard_normal(4))
        for seed in (1, 2, 12)
        for name in ("sensors/a", "sensors/b", "2/sensors/a")
    }
    assert len(set(draws.values())) == len(draws)
    assert tuple(named_stream(1, "sensors/a").standard_normal(4)) == draws[1, "sensors/a"]


def test_without_sigmas_there_is_no_jitter():
    assert jitters(["a", "b"], (EXACT, EXACT, EXACT)).errors is None
    assert jitters(["a"]).errors is not None


def test_an_aircraft_without_jitter_is_exact():
    flying = truth(2)
    estimate = Jitter(["a", "b"], [suite(), sensors(*GPS_INS)]).on(flying)
    for name in ("position_ned", "velocity_ned", "euler"):
        assert np.array_equal(getattr(estimate, name)[0], getattr(flying, name)[0])
        assert (getattr(estimate, name)[1] != getattr(flying, name)[1]).all()
    # there and back through the body frame
    assert estimate.acceleration_ned[0] == pytest.approx(flying.acceleration_ned[0], abs=1e-14)


def test_rates_and_airspeeds_have_no_jitter():
    flying = truth(2)
    estimate = jitters(["a", "b"]).on(flying)
    for name in ("rates_body", "airspeed", "equivalent_airspeed"):
        assert np.array_equal(getattr(estimate, name), getattr(flying, name))


def about(axis, angle):
    """Rotation by an angle about an axis of the frame, built from the elementary matrix."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [k for k in range(3) if k != axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    sign = -1.0 if axis == 1 else 1.0
    out[i, j], out[j, i] = -sign * s, sign * s
    return out


def test_accelerations_turn_with_the_attitude():
    tilted = (EXACT, EXACT, (6.0, 1.0))
    flying = truth(6)
    estimate = jitters(names(6), tilted).on(flying)
    gravity = np.array([0.0, 0.0, GRAVITY])
    for i in range(6):
        rotations = [
            about(2, yaw) @ about(1, pitch) @ about(0, roll)
            for roll, pitch, yaw in (flying.euler[i], estimate.euler[i])
        ]
        specific_force = rotations[0].T @ (flying.acceleration_ned[i] - gravity)
        expected = rotations[1] @ specific_force + gravity
        assert estimate.acceleration_ned[i] == pytest.approx(expected, abs=1e-13)
        assert abs(expected - flying.acceleration_ned[i]).max() > 0.05


def test_a_tilted_horizon_accelerates_by_gravity():
    # unaccelerated and level; estimated roll δ: g sin δ to the east, g (1 − cos δ) down
    tilted = (EXACT, EXACT, (1.2, 1.0))
    zero = np.zeros((40, 3))
    level = VehicleState(zero, zero, zero, zero, zero, np.full(40, 20.0), np.full(40, 20.0))
    estimate = jitters(names(40), tilted).on(level)
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


def test_jitter_stays_between_two_steps():
    """An estimate in between is another truth with the same errors, and draws no numbers."""
    flying = truth(2)
    moved = flying._replace(position_ned=flying.position_ned + 100.0)
    often, seldom = jitters(names(2)), jitters(names(2))
    for _ in range(5):
        at_first = often.on(flying)
        for _ in range(3):
            between = often.on(moved, advance=False)
            error = between.position_ned - moved.position_ned
            # 100 m more carry a rounding of 1e-14 m
            assert error == pytest.approx(at_first.position_ned - flying.position_ned, abs=1e-13)
            assert np.array_equal(between.velocity_ned, at_first.velocity_ned)
            assert np.array_equal(between.euler, at_first.euler)
        again = seldom.on(flying)
        assert np.array_equal(again.position_ned, at_first.position_ned)
