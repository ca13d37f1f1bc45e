"""The Lyapunov functions of the proof, Appendix A of [HBH23], along the closed loop."""

import numpy as np
import pytest
from closed_loop import fly, moved
from reference.adapters import mu
from theorem_bounds import exponential_bound, lyapunov
from theorem_cases import (
    SIMULATION_2,
    STEEPER_MU,
    at_slots,
    directions,
    graph,
    one_formation,
    random_formations,
    scattered,
    turned_away,
)


def along(formations, t, state, function, step):
    """The derivative of function(formations, t, state) along the flow, by central differences."""
    rate = formations.rate(t, state)
    ahead = function(formations, t + step, moved(state, rate, step))
    behind = function(formations, t - step, moved(state, rate, -step))
    return (ahead - behind) / (2.0 * step)


def states_in_flight():
    """Random formations at random states, and where they fly to: 3 times 200 agents."""
    rng = np.random.default_rng(11)
    formations = random_formations(rng, 40, 5)
    times = np.linspace(0.0, 1.0, 101)
    for step, (t, state) in enumerate(fly(formations, scattered(rng, formations), times)):
        if step % 50 == 0:
            yield formations, t, state


def check(function, proved):
    """A derivative along the closed loop against what is proved of it.

    Central differences err by the square of their step, so that steps of 2e-4 s and 1e-4 s differ
    by three times the error of the second; rounding errs by 1e-15 of 1e3 m over 1e-4 s.
    """
    for formations, t, state in states_in_flight():
        wanted = formations.wanted(t, state)
        coarse, fine = (along(formations, t, state, function, step) for step in (2e-4, 1e-4))
        expected = proved(formations, state, wanted)
        tolerance = abs(fine - coarse) + 1e-6 * abs(expected).clip(1e-2)
        assert np.median(tolerance / abs(expected)) < 1e-4
        assert (abs(fine - expected) < tolerance).all()
        assert (expected < 0.0).all()


def test_a3_lyapunov_function_of_the_speed():
    """Ż = −a s̃²/h² − b s̃⁴/h³ of Z = ½ (s̃/h)², with s_d and ṡ_d from the states of all agents."""

    def z(formations, t, state):
        gap = state.s - formations.wanted(t, state).desired.speed
        return 0.5 * (gap / formations.h(state.s)) ** 2

    def proved(formations, state, wanted):
        gap, h = state.s - wanted.desired.speed, formations.h(state.s)
        return -formations.a * gap**2 / h**2 - formations.b * gap**4 / h**3

    check(z, proved)


def test_a9_lyapunov_function_of_the_direction():
    """Ẏ = −c (1 − (y_dᵀ y)²) of Y = 1 − y_dᵀ y, with y_d and ẏ_d from the states of all agents."""

    def y(formations, t, state):
        return 0.5 * ((state.y - formations.wanted(t, state).desired.direction) ** 2).sum(axis=1)

    def proved(formations, state, wanted):
        return -formations.c * (1.0 - (wanted.desired.direction * state.y).sum(axis=1) ** 2)

    check(y, proved)


def error_of(formations, t, state):
    return formations.wanted(t, state).error


def test_a12_derivative_of_the_position_error():
    """q̃̇ = k ρ(ξ) + s̃ y + s_d ỹ, and ξ = −(A + B) q̃ by (A14)."""
    for formations, t, state in states_in_flight():
        wanted = formations.wanted(t, state)
        value, _ = mu(formations.mu, (wanted.xi**2).sum(axis=1))
        s_d, y_d = wanted.desired.speed[:, None], wanted.desired.direction
        proved = (
            (formations.k * value)[:, None] * wanted.xi
            + (state.s[:, None] - s_d) * state.y
            + s_d * (state.y - y_d)
        )
        found = along(formations, t, state, error_of, 1e-3)
        # the slots' third derivative is below 25 m/s (0.2/s)²; step²/6 of it
        assert found == pytest.approx(proved, abs=1e-6)
        m, n = formations.offsets.shape[:2]
        error = np.moveaxis(wanted.error.reshape(m, n, 3), 2, 1)[..., None]
        xi = -np.moveaxis((formations.couplings @ error)[..., 0], 1, 2).reshape(m * n, 3)
        assert wanted.xi == pytest.approx(xi, abs=1e-10)


# As in the second experiment, but for a hundredth of the gains: its own are in tenths of a metre.
DIAGONAL = graph(
    0.01 * np.array([[105.0, 105.0, 31.5]] * 2),
    [(0, 1, 0.01 * np.array([50.0, 50.0, 15.0])), (1, 0, 0.01 * np.array([50.0, 50.0, 15.0]))],
)


@pytest.mark.parametrize(
    ("gains", "sharp"), [(SIMULATION_2, 40.0), (DIAGONAL, 5.0)], ids=["directed", "diagonal"]
)
def test_a26_lyapunov_function_falls_exponentially(gains, sharp):
    """V(t) <= exp(−ℓ5 (t − t')) V(t') for all t' < t, with every constant of the proof computed.

    From starts so close that ℓ5 says something: V falls at no more than 5 ℓ5 in the end, and at
    40 ℓ5 where hearing is one-way, which costs D a factor of 9 between its numbers.
    """
    n = len(gains)
    formations = one_formation("helix", gains=gains, mu=STEEPER_MU, k=np.linspace(2.5, 3.0, n))
    rng = np.random.default_rng(12)
    start = at_slots(formations, directions(rng, n))
    start = start._replace(
        s=start.s + rng.uniform(-0.5, 0.5, n),
        y=turned_away(start.y, rng.uniform(0.02, 0.1, n), directions(rng, n)),
    )
    times = np.linspace(0.0, 12.0, 241)
    flight = [(state, formations.wanted(t, state)) for t, state in fly(formations, start, times)]
    constants = exponential_bound(formations, flight)
    v = np.array([lyapunov(formations, constants, *at) for at in flight])
    assert v[-1] > 1e-11 * v[0]  # below, what is left is the error of the integration
    rate = -np.diff(np.log(v)) / np.diff(times)
    assert (rate > constants.rate).all()
    assert rate[-1] < sharp * constants.rate
