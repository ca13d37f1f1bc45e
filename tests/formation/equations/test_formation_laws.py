"""The formation control, [HBH23] eqs. (6)-(15), against arithmetic, derivatives and its proof."""

import numpy as np
import pytest
from formation_cases import PAPERS_MU, same, velocities
from reference.adapters import (
    desired_velocity,
    formation_error,
    h,
    mu,
    rho_and_rate,
    speed_control,
    turn_control,
    velocity_frame,
)
from reference.formation_laws import Desired, SpeedSet

from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3

BARRIERS = {
    "example 4": SpeedBarrier(4, 0.02),
    "example 5": SpeedBarrier(5, 0.05),
    "example 6": SpeedBarrier(6, 1.0),
}
every_barrier = pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
WIDE = 1e9  # no speed is outside


def speed_set(n, low=16.0, high=30.0, margin=0.6):
    return SpeedSet(same(low, n), same(high, n), same(low + margin, n), same(high - margin, n))


# (6)


def test_6_by_hand():
    # Two agents; the leader at (100, 0, 0). Agent 1 sits 3 m short of its slot (-5, 5, 0), agent 2
    # 2 m right of and 1 m above its slot (-5, -5, 0). Agent 1 uses the leader with gain 2; agent 2
    # uses the leader with gains (1, 1, 0.5) and agent 1 with gain 0.5.
    own = np.array([[92.0, 5.0, 0.0], [95.0, -3.0, -1.0]])
    chi = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 0.0]])
    received = np.array([[100.0, 0.0, 0.0], *own])
    gains = np.zeros((2, 3, 3))
    gains[0, 0] = 2.0
    gains[1, 0] = [1.0, 1.0, 0.5]
    gains[1, 1] = 0.5
    xi = formation_error(own, chi[1:], np.stack([received] * 2), np.stack([chi] * 2), gains)
    # agent 1: 2 (q_g − q_1 + χ_1) = 2 (100 − 92 − 5, −5 + 5, 0)
    # agent 2: (100 − 95 − 5, 3 − 5, 0.5·1) + 0.5 (92 − 95 − 5 + 5, 5 + 3 − 5 − 5, 1)
    assert xi == pytest.approx(np.array([[6.0, 0.0, 0.0], [-1.5, -3.0, 1.0]]), abs=1e-14)


def test_6_against_the_sum_as_printed():
    rng = np.random.default_rng(1)
    n = 4
    q, q_g = rng.normal(0.0, 10.0, (n, 3)), rng.normal(0.0, 10.0, 3)
    chi = rng.normal(0.0, 5.0, (n, 3))
    beta, beta_ij = rng.normal(0.0, 1.0, (n, 3)), rng.normal(0.0, 1.0, (n, n, 3))
    beta_ij[np.arange(n), np.arange(n)] = 0.0
    others = np.stack([np.vstack([q_g, q])] * n)
    slots = np.stack([np.vstack([np.zeros(3), chi])] * n)
    gains = np.concatenate([beta[:, None], beta_ij], axis=1)
    for i in range(n):
        expected = np.diag(beta[i]) @ (q_g - q[i] + chi[i])
        for j in range(n):
            expected = expected + np.diag(beta_ij[i, j]) @ (q[j] - q[i] + (chi[i] - chi[j]))
        xi = formation_error(q, chi, others, slots, gains)[i]
        # a handful of terms of size 30
        assert xi == pytest.approx(expected, abs=1e-13 * 30)


def test_error_is_zero_only_with_all_in_their_slots():
    chi = np.array([[0.0, 0.0, 0.0], [-8.0, 4.0, 0.0], [-8.0, -4.0, 2.0]])
    all_rows = chi + np.array([64.0, -32.0, -128.0])
    xi = formation_error(
        all_rows[1:], chi[1:], np.stack([all_rows] * 2), np.stack([chi] * 2), np.ones((2, 3, 3))
    )
    assert (xi == 0.0).all()


# (7)-(12)


class Motion:
    """Leader, slots and three agents on smooth curves, with exact derivatives."""

    def __init__(self):
        rng = np.random.default_rng(6)
        self.size = rng.uniform(0.5, 4.0, (7, 3))
        self.pace = rng.uniform(0.3, 1.5, (7, 3))
        self.phase = rng.uniform(0.0, 6.0, (7, 3))
        self.drift = np.array([20.0, -6.0, 1.0]) * np.array([1, 0, 0, 0, 1, 1, 1])[:, None]
        self.gains = rng.uniform(0.2, 1.0, (3, 4, 3))
        self.gains[np.arange(3), np.arange(1, 4)] = 0.0
        self.k = np.array([2.0, 3.0, 2.5])

    def at(self, t, order):
        """Derivative number `order` of q_g, χ_1..χ_3, q_1..q_3 (7, 3)."""
        wave = self.size * self.pace**order
        wave = wave * np.sin(self.pace * t + self.phase + 0.5 * np.pi * order)
        return wave + {0: self.drift * t, 1: self.drift}.get(order, 0.0)

    def error(self, t, order):
        x = self.at(t, order)
        received, chi = np.vstack([x[0], x[4:]]), np.vstack([np.zeros(3), x[1:4]])
        return formation_error(
            x[4:], x[1:4], np.stack([received] * 3), np.stack([chi] * 3), self.gains
        )

    def desired(self, t, function, speeds=None):
        rate, acceleration = self.at(t, 1), self.at(t, 2)
        return desired_velocity(
            np.stack([rate[0]] * 3),
            np.stack([acceleration[0]] * 3),
            rate[1:4],
            acceleration[1:4],
            self.error(t, 0),
            self.error(t, 1),
            self.k,
            function,
            speeds or speed_set(3, low=-WIDE, high=WIDE, margin=0.0),
        )

    def velocity(self, t, function):
        """p_d straight from (7)."""
        rate, xi = self.at(t, 1), self.error(t, 0)
        values, _ = mu(function, (xi**2).sum(axis=1))
        return rate[0] + rate[1:4] + self.k[:, None] * values[:, None] * xi


FUNCTIONS = {"example 1": PAPERS_MU, "example 2": EXAMPLE_2, "example 3": EXAMPLE_3}
TIMES = np.linspace(0.0, 9.0, 31)


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_7_to_12_along_smooth_curves(function):
    motion, step = Motion(), 1e-5
    for t in TIMES:
        desired = motion.desired(t, function)
        p = motion.velocity(t, function)
        ahead, behind = motion.velocity(t + step, function), motion.velocity(t - step, function)
        speeds = [np.linalg.norm(each, axis=1) for each in (behind, p, ahead)]
        assert desired.speed == pytest.approx(speeds[1], rel=1e-14)
        assert desired.direction == pytest.approx(p / speeds[1][:, None], abs=1e-14)
        # third derivatives of p below 1e3: step²/6; rounding 30·2e-16/step; and a step over a knot
        # of a spline, step times the jump of μ'' k ‖ξ‖ ξ̇² of at most some 1e3
        assert desired.speed_rate == pytest.approx((speeds[2] - speeds[0]) / (2 * step), abs=1e-6)
        turned = ahead / speeds[2][:, None] - behind / speeds[0][:, None]
        assert desired.direction_rate == pytest.approx(turned / (2.0 * step), abs=1e-6)
        assert (desired.direction * desired.direction_rate).sum(axis=1) == pytest.approx(
            0.0, abs=1e-14
        )
        assert not desired.clamped.any()


def test_10_as_printed():
    motion, t = Motion(), 1.3
    q, q_rate, q_acceleration = (motion.at(t, order) for order in range(3))
    desired = motion.desired(t, PAPERS_MU)
    for i in range(3):
        chi, chi_rate = q[1:4], q_rate[1:4]
        beta, beta_ij = motion.gains[i, 0], motion.gains[i, 1:]
        xi = beta * (q[0] - q[4 + i] + chi[i])
        brackets = beta * (q_rate[4 + i] - q_rate[0] - chi_rate[i])
        for j in range(3):
            xi = xi + beta_ij[j] * (q[4 + j] - q[4 + i] + chi[i] - chi[j])
            brackets = brackets + beta_ij[j] * (
                q_rate[4 + i] - q_rate[4 + j] - (chi_rate[i] - chi_rate[j])
            )
        value, slope = (float(each[0]) for each in mu(PAPERS_MU, np.array([xi @ xi])))
        gradient = value * np.eye(3) + 2.0 * slope * np.outer(xi, xi)
        p_rate = q_acceleration[0] + q_acceleration[1 + i] - motion.k[i] * gradient @ brackets
        ours = (
            desired.speed_rate[i] * desired.direction[i]
            + desired.speed[i] * desired.direction_rate[i]
        )
        assert ours == pytest.approx(p_rate, abs=1e-13)


def test_clamp_changes_desired_speed_and_rate_only():
    v = np.array([[20.0, 0.0, 0.0], [16.5, 0.0, 0.0], [29.5, 0.0, 0.0]])
    push = np.array([[1.0, 2.0, 0.0]] * 3)
    zero = np.zeros((3, 3))
    desired = desired_velocity(v, push, zero, zero, zero, zero, np.ones(3), PAPERS_MU, speed_set(3))
    assert desired.speed == pytest.approx([20.0, 16.6, 29.4], abs=0)
    assert desired.clamped.tolist() == [False, True, True]
    assert desired.speed_rate == pytest.approx([1.0, 0.0, 0.0], abs=0)
    assert desired.direction_rate[:, 1] == pytest.approx(2.0 / v[:, 0], rel=1e-15)


def test_every_agent_is_clamped_into_its_own_set():
    v = np.tile([20.0, 0.0, 0.0], (3, 1))
    zero = np.zeros((3, 3))
    speeds = SpeedSet(
        same(10.0, 3), same(40.0, 3), np.array([15.0, 21.0, 15.0]), np.array([25.0, 25.0, 19.5])
    )
    desired = desired_velocity(v, v, zero, zero, zero, zero, np.ones(3), PAPERS_MU, speeds)
    assert desired.speed.tolist() == [20.0, 21.0, 19.5]
    assert desired.clamped.tolist() == [False, True, True]
    assert desired.speed_rate.tolist() == [20.0, 0.0, 0.0]


def test_fact_1_holds_without_clamp_by_assumption_1():
    # ‖q̇_g + χ̇‖ at least κ inside S and k < κ/ρ̄ leave s_d at least ε = κ − k ρ̄ inside S
    rng = np.random.default_rng(9)
    n, kappa, k = 2000, 3.6, 3.0
    leader = velocities(rng, (n,), 16.0 + kappa, 30.0 - kappa)
    error = rng.normal(0.0, 1.0, (n, 3)) * rng.choice([0.1, 1.0, 100.0, 1e6], (n, 1))
    zero = np.zeros((n, 3))
    for function in FUNCTIONS.values():
        margin = kappa - k * function.bound
        desired = desired_velocity(
            leader,
            zero,
            zero,
            zero,
            error,
            zero,
            same(k, n),
            function,
            speed_set(n, margin=margin - 1e-12),
        )
        assert not desired.clamped.any()


# (14)


def closed_loop(speed, desired, barrier, a, b, pole, speeds):
    """ṡ = f + g u with f = −p s, g = p."""
    u, inside = speed_control(speed, desired, a, b, pole, barrier, speeds)
    return pole * (u - speed), inside


def wanted(speed_desired, speed_rate):
    n = len(speed_desired)
    direction = np.tile([1.0, 0.0, 0.0], (n, 1))
    return Desired(speed_desired, speed_rate, direction, np.zeros((n, 3)), np.zeros(n, dtype=bool))


def test_14_by_hand_without_a_barrier():
    # h = 1: ṡ = b 2³ + ṡ_d + a 2 = 0.8 + 0.3 + 2 = 3.1; u = ṡ/p + s
    u, _ = speed_control(
        np.array([20.0]),
        wanted(np.array([22.0]), np.array([0.3])),
        np.ones(1),
        same(0.1, 1),
        same(0.62, 1),
        SpeedBarrier(7, 0.0),
        speed_set(1),
    )
    assert u[0] == pytest.approx(25.0, rel=1e-14)


def test_14_by_hand_with_example_4():
    # s = 20, s_d = 22, ν = 0.02: h = 0.8, h' = 0.12, D = 0.8 + 2·0.12 = 1.04
    # ṡ = (0.1·8 + 0.3·0.8 + 2·0.8)/1.04 = 2.64/1.04
    u, _ = speed_control(
        np.array([20.0]),
        wanted(np.array([22.0]), np.array([0.3])),
        np.ones(1),
        same(0.1, 1),
        same(0.64, 1),
        SpeedBarrier(4, 0.02),
        speed_set(1),
    )
    assert u[0] == pytest.approx(20.0 + 2.64 / 1.04 / 0.64, rel=1e-14)


@every_barrier
def test_a3_speed_lyapunov_function_decreases(barrier):
    """Ż = −a s̃²/h² − b s̃⁴/h³ of Z = ½ (s̃/h)² for a desired speed that moves."""
    rng = np.random.default_rng(10)
    n = 3000
    speeds, margin = speed_set(n), 0.6
    s = rng.uniform(16.02, 29.98, n)
    s_d = rng.uniform(16.0 + margin, 30.0 - margin, n)
    s_d_rate = rng.normal(0.0, 2.0, n)
    a, b, pole = rng.uniform(0.1, 2.0, (3, n))
    s_rate, inside = closed_loop(s, wanted(s_d, s_d_rate), barrier, a, b, pole, speeds)
    assert inside.all()
    height, slope = h(barrier, s, speeds.min, speeds.max)
    error = s - s_d
    fall = error / height * ((s_rate - s_d_rate) * height - error * slope * s_rate) / height**2
    proved = -a * error**2 / height**2 - b * error**4 / height**3
    # (ṡ is a difference of u and s, so that it carries a rounding of p s)
    size = (
        abs(error)
        / height**3
        * (abs(s_d_rate * height) + (abs(s_rate) + 30.0 * pole) * (height + abs(error * slope)))
    )
    assert (abs(fall - proved) <= 1e-13 * size).all()
    assert (proved[abs(error) > 0.1] < 0.0).all()


@every_barrier
def test_outside_its_set_the_speed_comes_back_in(barrier):
    n = 400
    s = np.concatenate([np.linspace(8.0, 16.0, n), np.linspace(30.0, 38.0, n)])
    speeds = speed_set(2 * n)
    for s_d in (16.6, 23.0, 29.4):
        s_rate, inside = closed_loop(
            s,
            wanted(same(s_d, 2 * n), same(5.0, 2 * n)),
            barrier,
            same(1.0, 2 * n),
            same(0.1, 2 * n),
            same(0.64, 2 * n),
            speeds,
        )
        assert not inside.any()
        # bounded away from zero, so it takes a finite time: b 0.6²/|h'|, and |h'| is at most 2/ν
        # of a parabola 8 m/s beyond the bound of example 6
        assert (s_rate[:n] > 0.001).all()
        assert (s_rate[n:] < -0.001).all()


@every_barrier
def test_14_is_continuous_at_the_edge_of_the_set(barrier):
    s_d, s_d_rate = 20.0, 1.5
    for edge, inwards in ((16.0, 1.0), (30.0, -1.0)):
        s = edge + inwards * np.array([-1e-7, -1e-12, 0.0, 1e-12, 1e-7])
        s_rate, inside = closed_loop(
            s,
            wanted(same(s_d, 5), same(s_d_rate, 5)),
            barrier,
            same(1.0, 5),
            same(0.1, 5),
            same(0.64, 5),
            speed_set(5),
        )
        assert inside.tolist() == [False, False, False, True, True]
        # slopes of ṡ of some 100 per second from either side
        assert s_rate == pytest.approx(s_rate[2], abs=1e-4)


def test_far_outside_tanh_pulls_hard_and_stays_finite():
    # Example 5, ν = 1/20, s = 34, s_d = 22: 0.1·144/|0.05·(46 − 68)(1 − tanh²(3.6))| = 4389 m/s²
    s = np.array([34.0, 60.0, 0.1])
    s_rate, _ = closed_loop(
        s,
        wanted(same(22.0, 3), np.zeros(3)),
        SpeedBarrier(5, 0.05),
        np.ones(3),
        same(0.1, 3),
        same(0.64, 3),
        speed_set(3),
    )
    assert s_rate[0] == pytest.approx(-14.4 / (1.1 / np.cosh(3.6) ** 2), rel=1e-10)
    assert s_rate[0] == pytest.approx(-4400.0, abs=50.0)
    assert np.isfinite(s_rate).all()  # the slope underflowed at 60 m/s
    assert s_rate[1] < 0.0 < s_rate[2]


# (15)


def pointing_cases(n=500):
    rng = np.random.default_rng(12)
    velocity = velocities(rng, (n,), 15.0, 31.0)
    y_d = velocities(rng, (n,), 1.0, 1.0)
    y_d_rate = rng.normal(0.0, 0.5, (n, 3))
    y_d_rate -= (y_d_rate * y_d).sum(axis=1)[:, None] * y_d
    zero = np.zeros(n)
    c = rng.uniform(0.05, 1.0, n)
    return velocity, Desired(same(20.0, n), zero, y_d, y_d_rate, zero.astype(bool)), c


def test_15_by_hand():
    # Flying north, wanting east at c = 0.1: w = c y_d = (0, 0.1, 0), so ω = e1 × w = (0, 0, 0.1);
    # wanting 30° up: w = 0.1 (cos 30°, 0, −½), so ω = (0, 0.05, 0).
    y_d = np.array([[0.0, 1.0, 0.0], [np.cos(np.pi / 6.0), 0.0, -0.5]])
    desired = Desired(same(20.0, 2), np.zeros(2), y_d, np.zeros((2, 3)), np.zeros(2, dtype=bool))
    pitching, yawing = turn_control(np.array([[20.0, 0.0, 0.0]] * 2), desired, same(0.1, 2))
    assert pitching == pytest.approx([0.0, 0.05], abs=1e-16)
    assert yawing == pytest.approx([0.1, 0.0], abs=1e-16)


def test_15_against_the_product_as_printed():
    velocity, desired, c = pointing_cases()
    pitching, yawing = turn_control(velocity, desired, c)
    frames = velocity_frame(velocity)
    for i in range(len(c)):
        y = velocity[i] / np.linalg.norm(velocity[i])
        y_d, y_d_rate = desired.direction[i], desired.direction_rate[i]
        skew = np.array([[0.0, -y[2], y[1]], [y[2], 0.0, -y[0]], [-y[1], y[0], 0.0]])
        omega = frames[i].T @ skew @ (c[i] * y_d - (y @ y_d_rate) * y_d + (y @ y_d) * y_d_rate)
        assert omega == pytest.approx([0.0, pitching[i], yawing[i]], abs=1e-14)


def test_a9_direction_lyapunov_function_decreases():
    """Ẏ = −c (1 − (y_dᵀy)²) of Y = 1 − y_dᵀy for a desired direction that moves."""
    velocity, desired, c = pointing_cases()
    pitching, yawing = turn_control(velocity, desired, c)
    frames = velocity_frame(velocity)
    y = frames[:, :, 0]
    # (3) with v = e1: ẏ = R [ω]x e1 = ω3 (right) − ω2 (down)
    y_rate = yawing[:, None] * frames[:, :, 1] - pitching[:, None] * frames[:, :, 2]
    y_d, y_d_rate = desired.direction, desired.direction_rate
    fall = -(y_d_rate * y + y_d * y_rate).sum(axis=1)
    proved = -c * (1.0 - (y_d * y).sum(axis=1) ** 2)
    assert fall == pytest.approx(proved, abs=1e-14)
    assert abs(y_d_rate).max() > 0.5


# all of them


def test_the_world_may_be_turned_about_the_vertical():
    rng = np.random.default_rng(14)
    n, angle = 50, 1.1
    turn = np.array(
        [
            [np.cos(angle), -np.sin(angle), 0.0],
            [np.sin(angle), np.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    vectors = [velocities(rng, (n,), 18.0, 28.0), *rng.normal(0.0, 3.0, (5, n, 3))]
    own = velocities(rng, (n,), 17.0, 29.0)

    def controls(matrix):
        leader, *others = (each @ matrix.T for each in vectors)
        desired = desired_velocity(leader, *others, same(3.0, n), PAPERS_MU, speed_set(n))
        mine = own @ matrix.T
        u, _ = speed_control(
            np.linalg.norm(mine, axis=1),
            desired,
            same(1.0, n),
            same(0.1, n),
            same(0.64, n),
            SpeedBarrier(5, 0.05),
            speed_set(n),
        )
        return desired, u, *turn_control(mine, desired, same(0.1, n))

    straight, turned = controls(np.eye(3)), controls(turn)
    assert turned[0].direction == pytest.approx(straight[0].direction @ turn.T, abs=1e-14)
    assert turned[0].direction_rate == pytest.approx(straight[0].direction_rate @ turn.T, abs=1e-13)
    # (14) divides by D, down to some hundredths here
    for ours, theirs in zip(turned[1:], straight[1:], strict=True):
        assert ours == pytest.approx(theirs, rel=1e-10, abs=1e-13)


def test_rho_points_along_the_error():
    x = np.random.default_rng(2).normal(0.0, 5.0, (50, 3))
    rho, _ = rho_and_rate(PAPERS_MU, x, x)
    assert np.cross(rho, x) == pytest.approx(np.zeros((50, 3)), abs=1e-14)
