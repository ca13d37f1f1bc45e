"""The average and the gradient of a wind over an airframe."""

import numpy as np
import pytest
from reference.adapters_atmosphere import mean_and_gradient, sample_points
from reference.frames import rotation_ned_body

from testbed.atmosphere.airframe_wind import AHEAD, MEAN, RIGHT, SLOPE, WING, make_local_wind
from testbed.core.records import Airframe

RASCAL = Airframe(span=2.795, area=0.982, arm=0.826, mass=6.58, lift_slope=5.0)
X8 = Airframe(span=2.1, area=0.75, arm=0.179, mass=3.364, lift_slope=4.02)
ATTITUDES = np.array([[0.0, 0.0, 0.0], [0.6, -0.2, 2.1], [-1.1, 0.4, -3.0]])


def placed(airframes=(RASCAL, X8, RASCAL), euler=ATTITUDES):
    body = np.ascontiguousarray(make_local_wind(airframes)["sample_points"])
    position = np.array([[100.0, -50.0, -120.0]] * len(airframes))
    return position, np.asarray(euler), body


def test_gradient_rigid_rotation_gives_its_rates():
    """Air that rotates as a rigid body has the gradients of that rotation."""
    position, euler, body = placed()
    points = sample_points(position, euler, body)
    rates_body = np.array([[0.3, -0.2, 0.1], [0.0, 0.5, -0.4], [-0.7, 0.0, 0.2]])
    wind = np.array([[3.0, -1.0, 0.5], [0.0, 8.0, 0.0], [-2.0, 2.0, -1.0]])
    rates_ned = (rotation_ned_body(euler) @ rates_body[:, :, None])[:, :, 0]
    arms = points - position[:, None, :]
    velocity = wind[:, None, :] + np.cross(rates_ned[:, None, :], arms)
    mean, rates = mean_and_gradient(velocity, euler, body)
    np.testing.assert_allclose(mean, wind, atol=1e-12)
    np.testing.assert_allclose(rates, rates_body, atol=1e-12)


def test_gradient_curved_gust_worked_by_hand():
    """w = η³ under √(1 − η²) has a mean of 0 and a roll rate p = (2/b) (π/16) / (π/8) = 1/b.

    w = η² has a mean of 1/4 and no rate.
    """
    _, euler, body = placed([RASCAL], [[0.0, 0.0, 0.0]])
    velocity = np.zeros((1, 5, 3))
    velocity[0, :3, 2] = WING**3
    mean, rates = mean_and_gradient(velocity, euler, body)
    assert mean[0, 2] == pytest.approx(0.0, abs=1e-12)
    assert rates[0, 0] == pytest.approx(1.0 / 2.795)
    velocity[0, :3, 2] = WING**2
    mean, rates = mean_and_gradient(velocity, euler, body)
    assert mean[0, 2] == pytest.approx(0.25)
    assert rates[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_wing_weights_are_of_an_elliptic_loading():
    """Moments of √(1 − η²): ∫ η² = π/8 and ∫ η⁴ = π/16, over ∫ 1 = π/2."""
    eta, mean = WING, MEAN
    assert mean.sum() == pytest.approx(1.0)
    assert (mean * eta**2).sum() == pytest.approx(0.25)
    assert (mean * eta**4).sum() == pytest.approx(0.125)
    assert (SLOPE * eta).sum() == pytest.approx(1.0)


def test_sample_points_rotate_with_the_aircraft():
    position, _, body = placed([RASCAL], [[0.0, 0.0, 0.0]])
    points = sample_points(position, np.array([[0.0, 0.0, np.pi / 2.0]]), body) - position
    # nose to the east: the right wing points south
    right = 0.5 * 2.795 * np.sqrt(0.5)
    assert points[0, RIGHT] == pytest.approx([-right, 0.0, 0.0], abs=1e-12)
    assert points[0, AHEAD] == pytest.approx([0.0, 0.826, 0.0], abs=1e-12)
