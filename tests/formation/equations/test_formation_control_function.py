"""Control functions, [HBH23] eqs. (5), (13) and examples 1-3."""

import numpy as np
import pytest
from reference.adapters import mu, rho_and_rate
from reference.formation_control_function import per_agent

from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1

FUNCTIONS = {
    "paper's simulations": example_1(50.0, 1.0, 0.5),
    "paper's experiments": example_1(2.5e5, 1.0, 0.5),
    "m = 0.8": example_1(3.0, 2.0, 0.8),
    "m = 1": example_1(3.0, 0.5, 1.0),
    "example 2": EXAMPLE_2,
    "example 3": EXAMPLE_3,
}
SPLINES = {"example 2": EXAMPLE_2, "example 3": EXAMPLE_3}


def scale(function):
    """Where the function bends, m²."""
    return 1.0 if function.spline else function.nu1 / function.nu2


every = pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)


def value(function, z):
    return mu(function, np.atleast_1d(np.asarray(z, dtype=float)))[0]


def test_the_splines_have_the_published_coefficients():
    # a few hundred roundings of numbers below 150
    r6, r10 = np.sqrt(6.0), np.sqrt(10.0)
    assert EXAMPLE_2.nu1 == pytest.approx(10.0 * r6 / 9.0 - 3.0, abs=1e-13)
    assert EXAMPLE_2.nu2 == pytest.approx(2.0 - 7.0 * r6 / 9.0, abs=1e-13)
    assert EXAMPLE_3.nu1 == pytest.approx(75.0 * r10 / 4.0 - 100.0 / 3.0, abs=1e-12)
    assert EXAMPLE_3.nu2 == pytest.approx(2000.0 / 27.0 - 2375.0 * r10 / 54.0, abs=1e-12)


@pytest.mark.parametrize("function", SPLINES.values(), ids=SPLINES)
def test_the_splines_are_smooth_at_their_knots(function):
    for knot in (function.flat, function.far):
        # the second derivatives stay below 300, so 1e-9 to either side changes less than 1e-6
        values, slopes = mu(function, np.array([knot - 1e-9, knot, knot + 1e-9]))
        assert values == pytest.approx(values[1], abs=1e-8)
        assert slopes == pytest.approx(slopes[1], abs=1e-6)
    assert value(function, [0.0, 0.5 * function.flat, function.flat]) == pytest.approx(1.0, abs=0)
    far = np.array([function.far, 2.0, 100.0])
    assert value(function, far) == pytest.approx(far**-0.5, rel=1e-15)


def test_example_1_by_hand():
    # (50 + 1·14)^(−1/2) = 1/8 at ‖(1, 2, 3)‖² = 14; its slope is −½·64^(−3/2) = −1/1024
    values, slopes = mu(FUNCTIONS["paper's simulations"], np.array([14.0]))
    assert values[0] == 0.125
    assert slopes[0] == -1.0 / 1024.0


@every
def test_the_bound_is_the_largest_length_of_rho(function):
    z = scale(function) * np.geomspace(1e-6, 1e10, 400_001)
    length = np.sqrt(z) * value(function, z)
    assert length.max() <= function.bound * (1.0 + 1e-12)  # rounding of two powers
    # neighbours on the grid are 1e-4 apart; at the far end 1 − √(1/(1 + 1e−10)) is less still
    assert length.max() >= function.bound * (1.0 - 1e-8)


@every
def test_the_integral_of_mu_has_no_bound(function):
    # (C1): ∫μ grows by at least a constant in every decade, so it has no bound
    z = scale(function) * np.geomspace(1.0, 1e12, 13)
    grown = [
        np.trapezoid(value(function, part), part)
        for part in (np.geomspace(a, b, 2001) for a, b in zip(z[:-1], z[1:], strict=True))
    ]
    assert min(grown) > 0.1
    assert min(grown[1:]) > 0.99 * max(grown[0], 0.1)


@every
def test_the_slope_is_the_derivative(function):
    z = scale(function) * np.geomspace(1e-3, 1e3, 997)
    if function.spline:  # third derivatives jump at the knots
        z = z[(abs(z - function.flat) > 1e-4) & (abs(z - function.far) > 1e-4)]
    step = 1e-5 * z
    difference = (value(function, z + step) - value(function, z - step)) / (2.0 * step)
    _, slope = mu(function, z)
    # central differences: step²/6 of the third derivative and a rounding over the step
    size = value(function, z) / z
    assert abs(difference - slope).max() <= 1e-7 * abs(size).max()
    assert (abs(difference - slope) <= 1e-6 * size + 1e-9 * abs(slope).max()).all()


@every
def test_rate_of_rho_is_gradient_13_times_rate(function):
    rng = np.random.default_rng(3)
    x = rng.normal(0.0, 1.0, (200, 3)) * rng.choice([0.1, 0.5, 1.0, 30.0], (200, 1))
    x_rate = rng.normal(0.0, 1.0, (200, 3))
    rho, rate = rho_and_rate(function, x, x_rate)
    z = (x**2).sum(axis=1)
    values, slopes = mu(function, z)
    gradient = values[:, None, None] * np.eye(3) + 2.0 * slopes[:, None, None] * (
        x[:, :, None] * x[:, None, :]
    )
    assert rho == pytest.approx(values[:, None] * x, rel=1e-14)
    expected = (gradient @ x_rate[:, :, None])[:, :, 0]
    assert rate == pytest.approx(expected, rel=1e-12, abs=1e-13 * abs(expected).max())
    step = 1e-6
    ahead, _ = rho_and_rate(function, x + step * x_rate, x_rate)
    behind, _ = rho_and_rate(function, x - step * x_rate, x_rate)
    # 1e-6 times a jump of the second derivative (below 300) where a step crosses a knot
    assert (ahead - behind) / (2.0 * step) == pytest.approx(rate, abs=5e-4 * abs(rate).max())


@pytest.mark.parametrize(
    ("nu1", "nu2", "m"),
    [(0.0, 1.0, 0.5), (1.0, 0.0, 0.5), (1.0, -1.0, 0.5), (1.0, 1.0, 0.49), (1.0, 1.0, 1.01)],
)
def test_what_breaks_c1_or_c2_is_refused(nu1, nu2, m):
    with pytest.raises(ValueError, match=f"nu1 = {nu1}, nu2 = {nu2}, m = {m}"):
        example_1(nu1, nu2, m)


def test_each_agent_may_have_a_function_of_its_own():
    """To the bit, at errors that reach every piece of each spline."""
    rng = np.random.default_rng(4)
    functions = list(FUNCTIONS.values())
    together = per_agent(functions)
    assert together.bound.tolist() == [each.bound for each in functions]
    for _ in range(100):
        x, x_rate = rng.normal(0.0, 1.0, (2, len(functions), 3))
        x *= rng.choice([0.1, 0.4, 1.0, 30.0], (len(functions), 1))
        z = (x**2).sum(axis=1)
        for i, function in enumerate(functions):
            alike = per_agent([function] * len(functions))
            for ours, theirs in (
                (mu(together, z), mu(alike, z)),
                (rho_and_rate(together, x, x_rate), rho_and_rate(alike, x, x_rate)),
            ):
                assert all(np.array_equal(a[i], b[i]) for a, b in zip(ours, theirs, strict=True))
            # a power by an array and by a number may differ in the last bit
            for ours, number in zip(mu(together, z), mu(function, z), strict=True):
                assert ours[i] == pytest.approx(number[i], rel=1e-15)
