"""Statements iv) and v) of Theorem 1: the set of speeds S cannot be left, and is always entered.

(14) makes ḣ = b s̃² outside S, (A5), and ζ̇ = −a ζ − b h ζ³ for ζ = s̃/h inside, (A3).
"""

import numpy as np
import pytest
from closed_loop import fly
from reference.adapters import h
from reference.formation_barrier import per_agent
from theorem_cases import BARRIERS, at_slots, every_case, one_formation

# Steps of 2 ms while speeds far outside S rush in at up to 500 per second, longer ones later.
TIMES = np.concatenate(
    [
        np.arange(0.0, 0.2, 0.002),
        np.arange(0.2, 2.0, 0.02),
        np.linspace(2.0, 23.0, 211),
    ]
)
BY = np.array([1e-8, 1e-6, 1e-3, 1e-1, 1.0, 2.0])  # m/s


def near_the_bounds(formations, by):
    """Starts that fly to their slots from 30 m, with speeds this far inside or outside a bound."""
    n = len(formations.k)
    rng = np.random.default_rng(8)
    start = at_slots(formations, rng.uniform(-30.0, 30.0, (n, 3)))
    upper, by = rng.random(n) < 0.5, rng.choice(by, n)
    speeds = formations.speeds
    return start._replace(s=np.where(upper, speeds.max - by, speeds.min + by))


def test_speed_that_starts_in_s_stays_in_s():
    """|ζ| falls, at least as exp(−a t); so h(s) >= |s̃|/|ζ(0)| > 0 for ever, from any start in S.

    From then on when |ζ| h̄ < ε the speed is in S because s_d is, at least ε from the bounds:
    after ln(|ζ(0)| h̄/ε)/a = 22 s for starts 1e-8 m/s inside.
    """
    formations = every_case()
    start = near_the_bounds(formations, BY)
    speeds, found = formations.speeds, []
    for t, state in fly(formations, start, TIMES):
        assert ((state.s > speeds.min) & (state.s < speeds.max)).all(), t
        gap = formations.wanted(t, state).desired.speed - state.s
        found.append(abs(gap) / formations.h(state.s))
    found = np.array(found)
    assert found[0].max() > 1e7
    free = np.log(found[0] * formations.h_top / formations.margin) / formations.a
    assert free.max() < TIMES[-1]
    # an integration error of 1e-4 of the fall, and one of its steps of 0.1 s where s̃ is zero
    allowed = found[0] * np.exp(-formations.a * TIMES[:, None]) * (1.0 + 1e-4)
    assert (found < allowed + 1e-5).all()
    assert (abs(gap) < formations.margin).all()


def test_speed_that_starts_outside_s_enters_once():
    """ḣ = b s̃² > b ε², so that h(s) = 0 is reached before −h(s(0))/(b ε²); s moves only inwards."""
    formations = every_case()
    start = near_the_bounds(formations, -BY)
    speeds = formations.speeds
    latest = -formations.h(start.s) / (formations.b * formations.margin**2)
    assert (latest > 0.0).all()
    outside = np.ones(len(latest), dtype=bool)
    distance = np.full(len(latest), np.inf)
    for t, state in fly(formations, start, TIMES[TIMES < 6.0]):
        beyond = np.maximum(speeds.min - state.s, state.s - speeds.max)
        assert (outside | (beyond < 0.0)).all(), f"left S again before {t} s"
        assert ((beyond < distance) | ~outside).all(), f"moved away from S before {t} s"
        outside, distance = beyond >= 0.0, beyond
        assert (~outside | (t <= latest)).all(), f"not in S after {t} s"
    assert not outside.any()


NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


def time_to(barrier, start, end, speed_desired, b, low, high):
    """∫ h'(s)/(b (s − s_d)²) ds by Gauss's rule, (n,) of (n,): from dt = dh/(b s̃²), (A5)."""
    half = 0.5 * (end - start)
    total = np.zeros_like(half)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s = start + half * (1.0 + node)
        _, slope = h(barrier, s, low, high)
        total += half * weight * slope / (b * (s - speed_desired) ** 2)
    return total


def test_time_to_enter_s_equals_a_quadrature():
    """Behind straight leaders whose position they do not use, so that s_d = 22 m/s."""
    b, low, high = 0.1, 16.0, 30.0
    barrier = per_agent([*BARRIERS.values()] * 2)
    formations = one_formation(
        "straight", gains=np.zeros((1, 2, 3)), b=b, barrier=barrier, low=low, high=high, copies=6
    )
    start = np.repeat([14.5, 31.5], 3)
    state = at_slots(formations, np.zeros((6, 3)))._replace(s=start)
    checked = np.zeros(6)
    # 1.5 m/s outside, the rate of example 5 falls by a factor e in 1 m/s, crossed in 20 ms
    times = np.concatenate([np.arange(0.0, 0.06, 0.001), np.linspace(0.06, 0.6, 55)])
    for t, now in fly(formations, state, times):
        outside = (now.s < low) | (now.s > high)
        expected = time_to(barrier, start, now.s, 22.0, b, low, high)
        assert t == pytest.approx(expected[outside], rel=1e-6, abs=1e-12)
        checked += outside
    assert (checked > 10).all()
    assert (checked < len(times)).any()


def test_quadrature_against_a_closed_form():
    """Example 4: h' = 2 ν (m − s), m midway: with x = s − s_d, −(2 ν/b) [ln x − (s_d − m)/x]."""
    nu, b, low, high, s_d = 0.02, 0.1, 16.0, 30.0, 22.0
    x = np.array([32.0, 30.0]) - s_d
    closed = -2.0 * nu / b * np.diff(np.log(x) - (s_d - 23.0) / x)
    found = time_to(BARRIERS["example 4"], np.array([32.0]), np.array([30.0]), s_d, b, low, high)
    assert found == pytest.approx(closed, rel=1e-12)
