"""The leader's velocity frame and the slots in it, [HBH23] eqs. (22)-(29)."""

import numpy as np
import pytest
from reference.adapters import (
    frame_acceleration,
    frame_rate,
    from_ned,
    true_slots,
    velocity_rates,
)
from reference.adapters import slot_motions as slots
from reference.frames import velocity_frame as reference_frame

from testbed.core.frames import course, flight_path_angle
from testbed.core.velocity_frame import velocity_frame

STEP = 1e-4
each_frame = pytest.mark.parametrize(
    "velocity_frame", [reference_frame, velocity_frame], ids=["reference", "product"]
)
OFFSETS = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0]])


def velocity(sigma, gamma, speed=22.0):
    return speed * np.array(
        [[np.cos(gamma) * np.cos(sigma), np.cos(gamma) * np.sin(sigma), -np.sin(gamma)]]
    )


def random_velocities(count=200):
    rng = np.random.default_rng(5)
    return rng.normal(0.0, 1.0, (count, 3)) * rng.uniform(0.1, 40.0, (count, 1))


@each_frame
def test_the_frame_is_a_rotation(velocity_frame):
    frames = velocity_frame(random_velocities())
    product = frames @ frames.transpose(0, 2, 1)
    assert product == pytest.approx(np.broadcast_to(np.eye(3), product.shape), abs=1e-14)
    assert np.linalg.det(frames) == pytest.approx(1.0, abs=1e-14)


@each_frame
def test_frame_columns_are_forward_right_and_down(velocity_frame):
    v = random_velocities()
    frames = velocity_frame(v)
    assert frames[:, :, 0] == pytest.approx(v / np.linalg.norm(v, axis=1)[:, None], abs=1e-14)
    assert (frames[:, 2, 1] == 0.0).all()  # right lies in the horizontal
    assert (frames[:, 2, 2] > 0.0).all()  # down points down
    # right, seen along the course: north flight has east on its right
    assert velocity_frame(np.array([[20.0, 0.0, 0.0]]))[0] == pytest.approx(np.eye(3), abs=0)


@each_frame
def test_frame_is_the_printed_matrix_24(velocity_frame):
    v = random_velocities()
    sigma, gamma = np.arctan2(v[:, 1], v[:, 0]), -np.arcsin(v[:, 2] / np.linalg.norm(v, axis=1))
    assert course(v) == pytest.approx(sigma, abs=1e-14)
    assert flight_path_angle(v) == pytest.approx(gamma, abs=1e-7)  # arcsin is steep near ±1
    cs, ss, cg, sg = np.cos(sigma), np.sin(sigma), np.cos(gamma), np.sin(gamma)
    zero = np.zeros_like(cs)
    printed = np.array([[cg * cs, -ss, sg * cs], [cg * ss, cs, sg * ss], [-sg, zero, cg]])
    assert velocity_frame(v) == pytest.approx(printed.transpose(2, 0, 1), abs=1e-7)


def test_transpose_resolves_vectors_in_the_frame():
    rng = np.random.default_rng(15)
    v, vectors = random_velocities(), rng.normal(0.0, 20.0, (200, 3))
    expected = (velocity_frame(v).transpose(0, 2, 1) @ vectors[:, :, None])[:, :, 0]
    assert from_ned(v, vectors) == pytest.approx(expected, abs=1e-13)


@each_frame
def test_straight_up_counts_as_north(velocity_frame):
    up = velocity_frame(np.array([[0.0, 0.0, -10.0]]))[0]
    assert up == pytest.approx(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), abs=0)
    assert all(np.isfinite(rate).all() for rate in velocity_rates(up[None, 0], up[None, 1]))


@pytest.mark.parametrize("gamma", [0.0, 0.3, -1.1])
def test_25_and_26_the_frame_turns_with_its_rate(gamma):
    sigma_rate, gamma_rate = 0.4, -0.2

    def frame(t):
        return velocity_frame(velocity(0.3 + sigma_rate * t, gamma + gamma_rate * t))[0]

    rate = frame_rate(np.array([gamma]), np.array([sigma_rate]), np.array([gamma_rate]))[0]
    x, y, z = rate
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    difference = (frame(STEP) - frame(-STEP)) / (2.0 * STEP)
    # third derivatives below 1: STEP²/6; rounding 2e-16/STEP
    assert difference == pytest.approx(frame(0.0) @ skew, abs=1e-8)


def chi_along(t, gamma, sigma_rate, gamma_rate, bending=0.0, neglect=True):
    """χ, χ̇, χ̈ of a leader at t s whose σ̇ grows at `bending`; ω̇_g is left out, or it is not."""
    sigma = 0.3 + sigma_rate * t + 0.5 * bending * t * t
    frame = velocity_frame(velocity(sigma, gamma + gamma_rate * t))
    angles = np.array([gamma + gamma_rate * t])
    rates = np.array([sigma_rate + bending * t]), np.array([gamma_rate])
    acceleration = np.zeros((1, 3))
    if not neglect:
        acceleration = frame_acceleration(angles, *rates, np.array([bending]))
    return [each[0] for each in slots(frame, frame_rate(angles, *rates), acceleration, OFFSETS)]


def differences(*motion, **options):
    before, now, after = (chi_along(t, *motion, **options) for t in (-STEP, 0.0, STEP))
    first = (after[0] - before[0]) / (2.0 * STEP)
    second = (after[0] - 2.0 * now[0] + before[0]) / STEP**2
    return now, first, second


@pytest.mark.parametrize(
    ("gamma", "sigma_rate", "gamma_rate"),
    [(0.0, 0.3, 0.0), (0.2, 0.3, 0.0), (-0.2, -0.5, 0.0), (0.1, 0.0, 0.25)],
    ids=["level turn", "climbing turn", "descending turn", "pull-up"],
)
def test_28_and_29_are_derivatives_of_27(gamma, sigma_rate, gamma_rate):
    (_, chi_rate, chi_acceleration), first, second = differences(gamma, sigma_rate, gamma_rate)
    # offsets of 8 m, rates of 0.5: STEP²/6 · 1 m/s³; rounding of 1e-15 m over STEP and STEP²
    assert first == pytest.approx(chi_rate, abs=1e-8)
    assert second == pytest.approx(chi_acceleration, abs=1e-6)
    assert abs(chi_acceleration[1:]).max() > 0.1


def test_29_omits_only_the_angular_acceleration():
    gamma, sigma_rate, gamma_rate = 0.2, 0.4, 0.3
    (_, chi_rate, chi_acceleration), first, second = differences(gamma, sigma_rate, gamma_rate)
    assert first == pytest.approx(chi_rate, abs=1e-8)
    cg, sg = np.cos(gamma), np.sin(gamma)
    omega_rate = np.array([-sigma_rate * gamma_rate * cg, 0.0, -sigma_rate * gamma_rate * sg])
    frame = velocity_frame(velocity(0.3, gamma))[0]
    left_out = np.cross(omega_rate, OFFSETS) @ frame.T
    assert abs(left_out).max() > 0.1
    assert second - chi_acceleration == pytest.approx(left_out, abs=1e-6)


@pytest.mark.parametrize(
    ("gamma", "sigma_rate", "gamma_rate", "bending"),
    [(0.0, 0.0, 0.0, 0.5), (0.2, 0.4, 0.3, 0.0), (-0.3, -0.4, 0.2, 0.6), (0.0, 0.3, -0.3, -0.4)],
    ids=["rolling in", "climbing turn pulled up", "all of it", "pushed over, rolling out"],
)
def test_full_29_is_the_second_derivative_of_27(gamma, sigma_rate, gamma_rate, bending):
    motion = (gamma, sigma_rate, gamma_rate, bending)
    (_, chi_rate, chi_acceleration), first, second = differences(*motion, neglect=False)
    # third derivatives of 8 (σ̇³ + 3 σ̇ σ̈), some 6 m/s³: STEP²/6 of them
    assert first == pytest.approx(chi_rate, abs=2e-8)
    assert second == pytest.approx(chi_acceleration, abs=1e-6)
    neglected = chi_along(0.0, *motion)[2]
    assert abs(chi_acceleration - neglected).max() > 0.5


def test_the_rate_of_the_rate_is_the_derivative_of_26():
    gamma, sigma_rate, gamma_rate, bending = 0.4, -0.3, 0.25, 0.7

    def rate(t):
        return frame_rate(
            np.array([gamma + gamma_rate * t]),
            np.array([sigma_rate + bending * t]),
            np.array([gamma_rate]),
        )

    difference = (rate(STEP) - rate(-STEP)) / (2.0 * STEP)
    ours = frame_acceleration(*(np.array([v]) for v in (gamma, sigma_rate, gamma_rate, bending)))
    assert difference == pytest.approx(ours, abs=1e-8)
    # by hand where it is level: σ̈ about the vertical, and the axis tips over at σ̇ γ̇
    level = frame_acceleration(*(np.array([v]) for v in (0.0, 0.2, 0.3, 0.5)))
    assert level[0] == pytest.approx([-0.06, 0.0, 0.5], abs=1e-16)


def test_a_slot_by_hand():
    # leader flies east and turns right at 0.1 rad/s: 5 m behind is west, 5 m right is south
    frame = velocity_frame(np.array([[0.0, 20.0, 0.0]]))
    rate = frame_rate(np.zeros(1), np.array([0.1]), np.zeros(1))
    offset = np.array([[-5.0, 5.0, 2.0]])
    chi, chi_rate, chi_acceleration = slots(frame, rate, np.zeros((1, 3)), offset)
    assert chi[0, 0] == pytest.approx([-5.0, -5.0, 2.0], abs=1e-15)
    assert chi_rate[0, 0] == pytest.approx([0.5, -0.5, 0.0], abs=1e-15)
    assert chi_acceleration[0, 0] == pytest.approx([0.05, 0.05, 0.0], abs=1e-16)
    # and its turn quickens by 0.2 rad/s²: 5 m to the right fall back at 1 m/s², to the west, and
    # 5 m behind swing out at 1 m/s², to the north
    bending = np.array([[0.0, 0.0, 0.2]])
    _, _, rolling_in = slots(frame, rate, bending, offset)
    assert rolling_in[0, 0] == pytest.approx([0.05 + 1.0, 0.05 - 1.0, 0.0], abs=1e-15)


def test_true_slots_by_hand():
    # the leader climbs east at 3 : 4; 5 m behind it lie 4 m west and 3 m down of it
    position = np.array([[100.0, 200.0, -50.0], [90.0, 190.0, -60.0], [90.0, 190.0, -60.0]])
    motion = np.array([[0.0, 16.0, -12.0], [12.0, 16.0, 0.0], [0.0, 3.0, -4.0]])
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, 5.0, 9.0]])
    slot, error, angles = true_slots(position, motion, offsets, np.array([np.nan, 70.0]))
    # a follower that holds an altitude is 5 m behind on the map, whatever its offset's depth
    assert slot == pytest.approx(np.array([[95.0, 196.0, -47.0], [95.0, 195.0, -70.0]]), abs=1e-12)
    assert error == pytest.approx(np.array([[-5.0, -6.0, -13.0], [-5.0, -5.0, 10.0]]), abs=1e-12)
    assert angles[0] == pytest.approx([20.0, 5.0], rel=1e-15)
    assert angles[2] == pytest.approx([0.0, np.arctan2(4.0, 3.0)], rel=1e-15)


def test_velocity_rates_are_derivatives_of_its_angles():
    rng = np.random.default_rng(8)
    v = rng.normal(0.0, 10.0, (200, 3))
    v[:, 0] += np.where(v[:, 0] < 0.0, -5.0, 5.0)  # away from the vertical
    acceleration = rng.normal(0.0, 5.0, (200, 3))
    chi_dot, gamma_dot = velocity_rates(v, acceleration)
    step = 1e-5
    ahead, behind = v + step * acceleration, v - step * acceleration
    turned = course(ahead) - course(behind)
    turned -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
    climbed = flight_path_angle(ahead) - flight_path_angle(behind)
    # third derivatives below (20/5)³: 1e-10/6 · 64 · 2; rounding 4e-16/1e-5
    assert turned / (2.0 * step) == pytest.approx(chi_dot, abs=5e-8)
    assert climbed / (2.0 * step) == pytest.approx(gamma_dot, abs=5e-8)
