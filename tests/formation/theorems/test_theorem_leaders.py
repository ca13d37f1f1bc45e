"""The theorem behind the product's virtual leaders, whose derivatives are exact."""

from functools import lru_cache

import numpy as np
import pytest
from closed_loop import fly
from reference.adapters import frame_acceleration, frame_rate
from theorem_cases import PATHS, STEEPER_MU, at_slots, leader, one_formation

from testbed.guidance.analytic_paths import (
    CirclePath,
    FigureEightPath,
    SinusoidalPath,
    StraightPath,
    derivatives,
    frame_rates,
)


@pytest.mark.parametrize("path", PATHS)
def test_leaders_equal_the_products_curves(path):
    climb, chi_dot = PATHS[path]
    place = {"position_ned": (50.0, -20.0, -300.0), "course": 0.4, "speed": 22.0}
    place["climb"] = 22.0 * np.sin(climb)
    if chi_dot == 0.0:
        curve = StraightPath(**place)
    else:
        radius = 22.0 * np.cos(climb) / abs(chi_dot)
        curve = CirclePath(**place, radius=radius, clockwise=chi_dot > 0.0)
    ours = leader(path, origin=place["position_ned"])
    for t in (0.0, 1.7, 33.0):
        theirs = derivatives(curve, np.array([t]))
        for found, expected in zip(ours.motion(t), theirs, strict=False):
            assert found == pytest.approx(expected, abs=1e-10)


class Curved:
    """The product's curves as leaders, each twice: with ω̇_g as it is, and neglected."""

    def __init__(self, curves):
        self.curves = curves
        self.known = np.tile([[1.0], [0.0]], (len(curves), 1))

    @lru_cache(maxsize=4)  # noqa: B019 - one test's
    def at(self, t):
        return [derivatives(curve, np.array([t])) for curve in self.curves]

    def motion(self, t):
        paths = zip(*self.at(t), strict=True)
        return tuple(np.repeat(np.concatenate(each), 2, axis=0) for each in paths)[:3]

    def turn(self, t):
        rates = zip(*map(frame_rates, self.at(t)), strict=True)
        sigma, gamma, sigma_acceleration, _ = (np.repeat(np.concatenate(r), 2) for r in rates)
        level = np.zeros_like(sigma)
        acceleration = frame_acceleration(level, sigma, gamma, sigma_acceleration)
        return frame_rate(level, sigma, gamma), self.known * acceleration


def test_leader_with_changing_turn_rate_is_followed():
    """Figure-eight and weave. With ω̇_g the agents converge; without it an error stays.

    Neglected, R_g [ω̇_g]x υ of up to 0.4 m/s² is missing from ṗ_d, so that s̃ and s_d θ stay at some
    of that over a = c = 1 per second, and q̃ at some of that over k μ(0) = 1.5 per second.
    """
    place = {"position_ned": (0.0, 0.0, -300.0), "course": 0.4, "speed": 22.0}
    curves = Curved(
        [
            FigureEightPath(**place, radius=70.0),
            SinusoidalPath(**place, amplitude=15.0, period=15.0),
        ]
    )
    formations = one_formation("circle", copies=4, mu=STEEPER_MU).change(leader=curves)
    errors = np.random.default_rng(26).uniform(-1.0, 1.0, (12, 3))
    for t, state in fly(formations, at_slots(formations, errors), np.linspace(0.0, 30.0, 201)):
        wanted = formations.wanted(t, state)
        assert not wanted.desired.clamped.any()
    known, neglected = np.linalg.norm(wanted.error, axis=1).reshape(2, 2, 3).swapaxes(0, 1)
    # k μ(0)/x of the paper's first graph is 3/2/6 per second: exp(−7.5) of a metre or two is left
    assert known.max() < 2e-3
    assert neglected.min() > 0.1
