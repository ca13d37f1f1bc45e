"""A user's own μ and h: tables of them, and the checks of (C1), (C2) and (B1) to (B5)."""

import re

import numpy as np
import pytest

from testbed.formation import barrier, control_function
from testbed.formation.assumptions import SpeedSet, check_barrier
from testbed.formation.barrier import SpeedBarrier, barrier_curve, barriers_of
from testbed.formation.control_function import (
    EXAMPLE_2,
    EXAMPLE_3,
    control_function_curve,
    example_1,
)

LOW, HIGH = 16.0, 30.0
S_D = SpeedSet(*(np.array([each]) for each in (LOW, HIGH, LOW + 0.6, HIGH - 0.6)))


def own_barrier(function, low=LOW, high=HIGH):
    return barrier.make_own(function, low, high)


@pytest.mark.parametrize(
    "function",
    [example_1(50.0, 1.0, 0.5), example_1(2.5e5, 1.0, 0.5), example_1(3.0, 0.5, 1.0), EXAMPLE_2,
     EXAMPLE_3],
    ids=["nu1 50", "nu1 250,000", "m = 1", "example 2", "example 3"],
)  # fmt: skip
def test_own_mu_is_that_of_the_examples(function):
    """To 10⁻³ of μ and 5 % of its slope, where that jumps; beyond the table too."""
    own = control_function.make_own(lambda z: control_function_curve(function, z)[0])
    z = np.concatenate([[0.0], np.geomspace(1e-6, 1e13, 4001)])
    value, slope = control_function_curve(function, z)
    found, found_slope = control_function_curve(own, z)
    np.testing.assert_allclose(found, value, rtol=1e-3)
    np.testing.assert_allclose(2.0 * z * found_slope, 2.0 * z * slope, atol=0.05 * value.max())
    assert own.bound == pytest.approx(function.bound, rel=1e-3)


@pytest.mark.parametrize(
    "example", [SpeedBarrier(4, 0.02), SpeedBarrier(5, 0.05), SpeedBarrier(6, 2.0)]
)
def test_own_h_is_that_of_the_examples(example):
    own = own_barrier(lambda s: barrier_curve(example, s, LOW, HIGH)[0])
    s = np.linspace(LOW - 5.0, HIGH + 5.0, 3001)
    value, slope = barrier_curve(example, s, LOW, HIGH)
    found, found_slope = barrier_curve(own, s, LOW, HIGH)
    np.testing.assert_allclose(found, value, atol=1e-3 * np.ptp(value))
    np.testing.assert_allclose(found_slope, slope, atol=0.05 * np.abs(slope).max())
    # bounds of the airspeed move with the wind, and a record keeps the function
    moved = barrier_curve(own, s + 3.0, LOW + 3.0, HIGH + 3.0)
    np.testing.assert_allclose(moved, (found, found_slope), atol=1e-9)
    (again,) = barriers_of(barrier.barrier_records(own))
    np.testing.assert_array_equal(barrier_curve(again, s, LOW, HIGH), (found, found_slope))
    # a straight line beyond the table
    far, far_slope = barrier_curve(own, np.array([HIGH + 5.0, HIGH + 9.0]), LOW, HIGH)
    assert far[1] - far[0] == pytest.approx(4.0 * far_slope[0]) and far_slope[0] == far_slope[1]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda z: (1.0 + z) ** -1.2, r"\(C1\) fails: for large z, mu falls as z\^\(-1.2\)"),
        (lambda z: (1.0 + z) ** -0.3, r"\(C2\) fails: for large z, mu falls as z\^\(-0.3\)"),
        (lambda z: np.ones_like(z), r"\(C2\) fails"),
        (lambda z: 1.0 / (1.0 + z) - 1e-6, r"mu\(.*\) is -.* \(write a mu above 0 everywhere\)"),
        (lambda z: np.minimum(1.0, (z + 1e-300) ** -0.5), r"near z = (0.9|1.0)\d* m² \(write a sm"),
    ],
    ids=["integral", "growth", "constant", "negative", "kink"],
)
def test_own_mu_without_c1_c2_is_an_error(function, message):
    with pytest.raises(ValueError, match=message):
        control_function.make_own(function)


def sag(s):
    """Satisfy (B1) to (B4), with a slope that rises in the middle, so that (B5) fails."""
    t = (2.0 * s - LOW - HIGH) / (HIGH - LOW)
    return (1.0 - t * t) * (0.05 + t * t)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda s: (s - LOW) * (HIGH - s) * (s - 23.0) ** 2 - 1.0, r"\(B1\) fails: h is -1 at"),
        (lambda s: 0.02 * (s - LOW) * (HIGH + 1.0 - s), r"\(B2\) fails: h is .* at 30"),
        (lambda s: np.tanh(0.5 * (HIGH - s) * (s - LOW)), r"\(B3\) fails: h' is -?\d.* at 3\d"),
        (lambda s: np.tanh(0.5 * (HIGH - s) * (s - LOW)), r"\(B4\) fails: h' is -?\d.* at 1\d"),
        (sag, r"\(B5\) fails: towards s_d = 16.6 m/s the divisor"),
    ],
    ids=["B1", "B2", "B3", "B4", "B5"],
)
def test_own_h_without_b1_to_b5_is_found(function, message):
    found = [each.text for each in check_barrier([own_barrier(function)], S_D)]
    assert any(re.match(message, each) for each in found), found


def test_own_h_with_a_kink_is_an_error():
    with pytest.raises(ValueError, match=r"h has no continuous derivative.* near 2[23].* m/s"):
        own_barrier(lambda s: 1.0 - np.abs(2.0 * s - LOW - HIGH) / (HIGH - LOW))
