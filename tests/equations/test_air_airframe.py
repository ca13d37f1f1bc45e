"""What an airframe feels of air whose motion differs from point to point."""

import numpy as np
import pytest

from testbed.air import airframe, airframe_twin
from testbed.frames import rotation_ned_body
from testbed.state import Airframe

RASCAL = Airframe(span=2.795, area=0.982, arm=0.826, mass=6.58, lift_slope=5.0)
X8 = Airframe(span=2.1, area=0.75, arm=0.179, mass=3.364, lift_slope=4.02)
ATTITUDES = np.array([[0.0, 0.0, 0.0], [0.6, -0.2, 2.1], [-1.1, 0.4, -3.0]])


def placed(airframes=(RASCAL, X8, RASCAL), euler=ATTITUDES):
    body = airframe.points_body(list(airframes))
    position = np.array([[100.0, -50.0, -120.0]] * len(airframes))
    return position, np.asarray(euler), body


def test_air_that_turns_as_a_rigid_body_is_felt_as_that_turn():
    position, euler, body = placed()
    points = airframe.place(position, euler, body)
    turn_body = np.array([[0.3, -0.2, 0.1], [0.0, 0.5, -0.4], [-0.7, 0.0, 0.2]])
    wind = np.array([[3.0, -1.0, 0.5], [0.0, 8.0, 0.0], [-2.0, 2.0, -1.0]])
    turn_ned = (rotation_ned_body(euler) @ turn_body[:, :, None])[:, :, 0]
    arms = points - position[:, None, :]
    velocity = wind[:, None, :] + np.cross(turn_ned[:, None, :], arms)
    mean, rates = airframe.felt(velocity, euler, body)
    np.testing.assert_allclose(mean, wind, atol=1e-12)
    np.testing.assert_allclose(rates, turn_body, atol=1e-12)


def test_a_gust_that_bends_up_to_the_tips_is_felt_by_hand():
    """w = η³ under √(1 − η²) has a mean of 0 and turns by p = (2/b) (π/16) / (π/8) = 1/b.

    w = η² has a mean of 1/4 and does not turn.
    """
    _, euler, body = placed([RASCAL], [[0.0, 0.0, 0.0]])
    velocity = np.zeros((1, 5, 3))
    velocity[0, :3, 2] = airframe.WING**3
    mean, rates = airframe.felt(velocity, euler, body)
    assert mean[0, 2] == pytest.approx(0.0, abs=1e-12)
    assert rates[0, 0] == pytest.approx(1.0 / 2.795)
    velocity[0, :3, 2] = airframe.WING**2
    mean, rates = airframe.felt(velocity, euler, body)
    assert mean[0, 2] == pytest.approx(0.25)
    assert rates[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_weights_are_those_of_an_elliptic_loading():
    """Moments of √(1 − η²): ∫ η² = π/8 and ∫ η⁴ = π/16, over ∫ 1 = π/2."""
    eta, mean = airframe.WING, airframe.MEAN
    assert mean.sum() == pytest.approx(1.0)
    assert (mean * eta**2).sum() == pytest.approx(0.25)
    assert (mean * eta**4).sum() == pytest.approx(0.125)
    assert (airframe.SLOPE * eta).sum() == pytest.approx(1.0)


def test_the_points_turn_with_the_aircraft():
    position, _, body = placed([RASCAL], [[0.0, 0.0, 0.0]])
    points = airframe.place(position, np.array([[0.0, 0.0, np.pi / 2.0]]), body) - position
    # nose to the east: the right wing points south
    right = 0.5 * 2.795 * np.sqrt(0.5)
    assert points[0, airframe.RIGHT] == pytest.approx([-right, 0.0, 0.0], abs=1e-12)
    assert points[0, airframe.AHEAD] == pytest.approx([0.0, 0.826, 0.0], abs=1e-12)


def test_the_twin_does_the_same():
    rng = np.random.default_rng(3)
    position, _, body = placed()
    euler = rng.uniform(-1.2, 1.2, (3, 3))
    points = airframe.place(position, euler, body)
    rotations, written = np.empty((3, 3, 3)), np.empty(body.shape)
    airframe_twin.write_rotations(euler, rotations)
    airframe_twin.write_places(position, rotations, body, written)
    np.testing.assert_allclose(written, points, rtol=1e-14)
    velocity = rng.normal(0.0, 2.0, (3, 5, 3))
    ours, theirs = airframe.felt(velocity, euler, body), np.zeros((2, 3, 3))
    airframe_twin.add_felt(velocity, rotations, body, *theirs)
    for mine, twin in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(twin, mine, rtol=1e-12, atol=1e-13)
