"""Speed barriers, [HBH23] examples 4-6 and the conditions (B1)-(B5) on them."""

import numpy as np
import pytest
from reference.adapters import h
from reference.formation_barrier import per_agent

from testbed.formation.barrier import NO_BARRIER, SpeedBarrier

LOW, HIGH, EPSILON = 16.0, 30.0, 0.6
BARRIERS = {
    "example 4": SpeedBarrier(4, 0.02),
    "example 5": SpeedBarrier(5, 0.05),
    "example 6": SpeedBarrier(6, 1.0),
    "example 6, wide": SpeedBarrier(6, 6.5),
}
every = pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)


def at(barrier, s, low=LOW, high=HIGH):
    s = np.atleast_1d(np.asarray(s, dtype=float))
    return h(barrier, s, np.full_like(s, low), np.full_like(s, high))


def test_by_hand():
    # at 20 of (16, 30): 10·4 = 40; slope 46 − 40 = 6
    values, slopes = at(SpeedBarrier(4, 0.02), 20.0)
    assert values[0] == pytest.approx(0.8, rel=1e-15)
    assert slopes[0] == pytest.approx(0.12, rel=1e-15)
    values, slopes = at(SpeedBarrier(5, 0.02), 20.0)
    assert values[0] == pytest.approx(np.tanh(0.8), rel=1e-15)
    assert slopes[0] == pytest.approx(0.12 / np.cosh(0.8) ** 2, rel=1e-14)
    # example 6 with ν = 2: a quarter, all, and none of the way through either parabola, and beyond
    values, slopes = at(SpeedBarrier(6, 2.0), [17.5, 16.0, 20.0, 28.5, 30.0, 31.0])
    assert values == pytest.approx([0.9375, 0.0, 1.0, 0.9375, 0.0, -1.25], abs=1e-15)
    assert slopes == pytest.approx([0.25, 1.0, 0.0, -0.25, -1.0, -1.5], abs=1e-15)


@every
def test_b1_to_b4_on_a_grid(barrier):
    inside = np.linspace(LOW, HIGH, 4003)[1:-1]
    below, above = np.linspace(LOW - 8.0, LOW, 1001), np.linspace(HIGH, HIGH + 8.0, 1001)
    assert (at(barrier, inside)[0] > 0.0).all()  # (B1)
    assert (at(barrier, below)[0][:-1] < 0.0).all()  # (B2)
    assert (at(barrier, above)[0][1:] < 0.0).all()
    assert at(barrier, [LOW, HIGH])[0] == pytest.approx(0.0, abs=1e-15)
    assert (at(barrier, above)[1] < 0.0).all()  # (B3)
    assert (at(barrier, below)[1] > 0.0).all()  # (B4)


def divisor(barrier, speeds, desired):
    values, slopes = at(barrier, speeds)
    return values[:, None] + (desired[None, :] - speeds[:, None]) * slopes[:, None]


@every
def test_b5_on_a_grid(barrier):
    speeds = np.linspace(LOW, HIGH, 2001)
    desired = np.linspace(LOW + EPSILON, HIGH - EPSILON, 201)
    assert (divisor(barrier, speeds, desired) > 0.0).all()


@every
def test_b5_fails_for_desired_speed_outside_its_set(barrier):
    # the hypothesis that the clamp on s_d protects: at s = s_lo the divisor is (s_d − s_lo) h'
    assert divisor(barrier, np.array([LOW]), np.array([LOW - 0.1])) < 0.0


@every
def test_the_slope_is_the_derivative(barrier):
    s = np.linspace(LOW - 3.0, HIGH + 3.0, 997)
    step = 1e-6
    difference = (at(barrier, s + step)[0] - at(barrier, s - step)[0]) / (2.0 * step)
    # rounding 2e-16/1e-6 of values up to 60; a second derivative of 2 that jumps within the step
    assert difference == pytest.approx(at(barrier, s)[1], abs=2e-6)


def test_no_barrier_is_one_everywhere():
    values, slopes = at(SpeedBarrier(NO_BARRIER, 0.0), [0.0, 20.0, 60.0])
    assert (values == 1.0).all()
    assert (slopes == 0.0).all()


def test_every_agent_has_bounds_of_its_own():
    s = np.array([20.0, 20.0])
    values, _ = h(SpeedBarrier(4, 1.0), s, np.array([10.0, 18.0]), np.array([30.0, 21.0]))
    assert values == pytest.approx([100.0, 2.0], rel=1e-15)


def test_every_agent_may_have_a_barrier_of_its_own():
    barriers = [*BARRIERS.values(), SpeedBarrier(NO_BARRIER, 0.0)]
    together = per_agent(barriers)
    n = len(barriers)
    for s in np.linspace(LOW - 6.0, HIGH + 6.0, 61):
        ours = at(together, np.full(n, s))
        for i, barrier in enumerate(barriers):
            alone = at(barrier, s)
            assert [float(each[i]) for each in ours] == [float(each[0]) for each in alone]
