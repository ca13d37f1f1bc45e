"""Fact 2: (B1), (B2) and a strictly decreasing h' in C¹ are enough for (B3) to (B5)."""

import numpy as np

from testbed.formation.assumptions import SpeedSet, check_barrier
from testbed.formation.barrier import barrier_curve, make_own

COUNT = 40


def concave(rng, low, high):
    """Make an h with zeros at the bounds and a slope that falls strictly, not symmetric.

    On t from −1 to 1, cosh λ + t sinh λ − e^(λ t) is zero at both ends and strictly concave, and so
    is 1 − t²; a sum with positive weights keeps both.
    """
    rates = rng.uniform(0.3, 2.0, 3) * rng.choice([-1.0, 1.0], 3)
    weights = rng.uniform(0.05, 1.0, 4)

    def h(s):
        t = (2.0 * s - low - high) / (high - low)
        value = weights[0] * (1.0 - t * t)
        for weight, rate in zip(weights[1:], rates, strict=True):
            value = value + weight * (np.cosh(rate) + t * np.sinh(rate) - np.exp(rate * t))
        return value

    return h


def test_fact_2_gives_b3_to_b5():
    """For random h, and S_d up to the bounds of S: H(s) = h(s) + (s_d − s) h'(s) > 0."""
    rng = np.random.default_rng(30)
    for _ in range(COUNT):
        low = rng.uniform(8.0, 20.0)
        high = low + rng.uniform(4.0, 20.0)
        function = concave(rng, low, high)
        barrier = make_own(function, low, high)
        # its hypotheses, of the function itself
        inside = np.linspace(low, high, 1001)[1:-1]
        outside = np.concatenate([np.linspace(low - 5.0, low, 100)[:-1], high + inside - low])
        assert (function(inside) > 0.0).all() and (function(outside) < 0.0).all()
        slope = barrier_curve(barrier, np.linspace(low - 5.0, high + 5.0, 2001), low, high)[1]
        assert (np.diff(slope) < 0.0).all()
        epsilon = rng.choice([1e-3, 0.3]) * (high - low)
        speeds = SpeedSet(*(np.array([v]) for v in (low, high, low + epsilon, high - epsilon)))
        assert not check_barrier([barrier], speeds)


def test_fact_2_needs_a_slope_that_falls():
    """With (B1) to (B4) and a slope that rises in the middle, (B5) fails near the other bound."""
    low, high = 16.0, 30.0

    def sag(s):
        t = (2.0 * s - low - high) / (high - low)
        return (1.0 - t * t) * (0.05 + t * t)

    speeds = SpeedSet(*(np.array([v]) for v in (low, high, low + 0.6, high - 0.6)))
    found = check_barrier([make_own(sag, low, high)], speeds)
    assert [each.text[:4] for each in found] == ["(B5)", "(B5)"]
