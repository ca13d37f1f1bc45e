"""The starts that Theorem 1 excludes: y exactly opposite to y_d, an unstable equilibrium of (15).

θ̇ = −c sin θ for the angle θ from y_d to y, (A9): at θ = π nothing turns y, and δ = π − θ grows by
δ̇ = c sin δ.
"""

import numpy as np
import pytest
from closed_loop import angle, fly
from theorem_cases import STEEPER_MU, at_slots, graph, one_formation, turned_away


def test_flight_opposite_to_desired_direction_persists():
    """North-bound leader, agent south-bound behind it: every number of the law is exact."""
    formations = one_formation("straight", course=0.0, gains=graph([1.0]), offsets=[[-5, 3, 1]])
    start = at_slots(formations, np.array([[-10.0, 0.0, 0.0]]))
    assert start.y.tolist() == [[1.0, 0.0, 0.0]]
    for t, state in fly(formations, start._replace(y=-start.y), np.linspace(0.0, 20.0, 101)):
        assert state.y.tolist() == [[-1.0, 0.0, 0.0]], t
    wanted = formations.wanted(t, state)
    assert wanted.error[0, 0] < -20.0 * 2.0 * 16.0  # (O1) fails: they fly apart at 32 m/s or more
    assert 16.0 < state.s[0] < 30.0  # (O3) does not


TOWARDS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.3, -0.8, 0.5]])  # right, up, askew


@pytest.mark.parametrize(
    ("path", "deviations", "longest", "integration"),
    [("straight climb", [1e-8, 1e-6, 1e-4, 1e-2], 12.0, 1e-4), ("helix", [1e-3, 1e-2], 7.5, 2e-3)],
)
def test_deviation_from_opposite_grows_at_the_rate_c(path, deviations, longest, integration):
    """tan(δ/2) = tan(δ(0)/2) exp(c t), δ in rad, to the right, up and askew, started in the slot.

    An agent has turned by a right angle after −ln tan(δ(0)/2)/c: 9.6 s for 1e-8 rad at c = 2.
    What is left then falls as exp(−c t). On a straight path y_d is constant until the agent comes
    around, and steps of 30 ms leave errors of 4e-5 of δ; on the helix y_d turns meanwhile, and they
    leave 1e-6 rad: steps of 20 ms leave a quarter of either.
    """
    c, n = 2.0, 3 * len(deviations)
    formations = one_formation(path, gains=graph([1.0]), c=c, mu=STEEPER_MU, copies=n)
    start = at_slots(formations, np.zeros((n, 3)))
    deviations = np.repeat(deviations, 3)
    y = turned_away(-start.y, deviations, np.tile(TOWARDS, (n // 3, 1)))
    logarithms = []
    times = np.arange(0.0, longest, 0.03)
    for t, state in fly(formations, start._replace(y=y), times):
        wanted = formations.wanted(t, state)
        theta = angle(state.y, wanted.desired.direction)
        logarithms.append(np.log(np.tan(0.5 * (np.pi - theta))))
    logarithms = np.array(logarithms)
    growing = logarithms < 0.0
    proved = np.log(np.tan(0.5 * deviations)) + c * times[:, None]
    assert growing.sum(axis=0) == pytest.approx(-proved[0] / c / times[1], abs=2.0)
    assert abs(logarithms - proved)[growing].max() < integration
    assert theta.max() < 0.02
    assert ((wanted.rate.q - wanted.slot_velocity) * wanted.error).sum(axis=1).max() < 0.0
