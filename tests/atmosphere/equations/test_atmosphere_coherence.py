"""The cross-spectra of two probes in von Kármán's field, by three other routes."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import gamma, kv

from testbed.atmosphere.spectra import KNEE, coherence, cross_spectra, energy

SPEED = 22.0  # m/s
SIGMA = np.array([1.6, 1.6, 1.2])  # m/s
LENGTH = np.array([263.0, 263.0, 100.0])  # m, of 100 m above the ground


def test_energy_integral_is_three_halves_of_variance():
    whole = quad(lambda x: np.exp(x) * energy(np.exp(x), 1.3, 150.0), -20.0, 20.0, limit=200)[0]
    assert 2.0 / 3.0 * whole == pytest.approx(1.3**2, rel=1e-6)


def test_cross_spectra_one_probe_are_the_standards():
    """MIL-F-8785C 3.7.1.1, per rad/s, which prints 1.339 for 1.33898 and so loses 1e-5."""
    f = np.geomspace(1e-4, 30.0, 50)
    x = (1.339 * LENGTH[:, np.newaxis] * 2.0 * np.pi * f / SPEED) ** 2
    level = SIGMA[:, np.newaxis] ** 2 * LENGTH[:, np.newaxis] / (np.pi * SPEED)
    printed = level * (1.0 + 8.0 / 3.0 * x) / (1.0 + x) ** (11.0 / 6.0)
    printed[0] = 2.0 * level[0] / (1.0 + x[0]) ** (5.0 / 6.0)
    found = cross_spectra(f, SPEED, SIGMA, LENGTH)
    np.testing.assert_allclose(found, 2.0 * np.pi * printed, rtol=3e-5)


def correlations(distance, length):
    """f and g of von Kármán's field, along and across a separation."""
    x = distance / (KNEE * length)
    root = 2.0 ** (2.0 / 3.0) / gamma(1.0 / 3.0) * np.cbrt(x)
    return root * kv(1.0 / 3.0, x), root * (kv(1.0 / 3.0, x) - 0.5 * x * kv(2.0 / 3.0, x))


@pytest.mark.parametrize("distance", [5.0, 50.0, 500.0])
def test_cross_spectra_integrate_to_the_correlation(distance):
    """Over all frequencies, at the probes' separation."""

    def share(axis, lateral, vertical):
        def at(x):
            f = np.exp([x])
            both = cross_spectra(f, SPEED, np.ones(3), LENGTH, lateral, vertical)
            return f[0] * both[axis, 0]

        return quad(at, -25.0, 9.0, limit=200, epsabs=1e-7)[0]

    along, across = correlations(distance, LENGTH)
    aside = [share(axis, distance, 0.0) for axis in range(3)]
    assert aside == pytest.approx([across[0], along[1], across[2]], abs=1e-5)
    above = [share(axis, 0.0, distance) for axis in range(3)]
    assert above == pytest.approx([across[0], across[1], along[2]], abs=1e-5)


def tensor(k, axis, length):
    """Φ_ii of unit variance at a wavenumber, rad/m."""
    square = sum(each * each for each in k)
    return (
        energy(np.sqrt(square), 1.0, length) / (4.0 * np.pi * square**2) * (square - k[axis] ** 2)
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("lateral", "vertical"), [(5.0, 0.0), (40.0, 0.0), (12.0, -9.0)])
@pytest.mark.parametrize("along", [0.003, 0.05])
def test_cross_spectra_match_integrated_tensor(axis, lateral, vertical, along):
    """By quadrature: Fourier integrals outside, a substitution without end inside."""
    length, root = LENGTH[axis], np.hypot(along, 1.0 / LENGTH[axis])
    distance = float(np.hypot(lateral, vertical))
    angle = np.arctan2(vertical, lateral)
    nodes, weights = np.polynomial.legendre.leggauss(300)
    s = 16.0 * nodes  # k = root sinh(s), which goes far out to where nothing is left

    def inside(p):  # p along the separation, q across it
        scale = np.hypot(root, p)
        q = scale * np.sinh(s)
        east, down = p * np.cos(angle) - q * np.sin(angle), p * np.sin(angle) + q * np.cos(angle)
        return (
            16.0 * weights * scale * np.cosh(s) * tensor((along, east, down), axis, length)
        ).sum()

    # what is even in q alone counts, and of that what is even in p
    whole = 2.0 * quad(inside, 0.0, np.inf, weight="cos", wvar=distance, limlst=200)[0]
    f = np.array([along * SPEED / (2.0 * np.pi)])
    found = cross_spectra(f, SPEED, np.ones(3), LENGTH, lateral, vertical)[axis, 0]
    alone = cross_spectra(f, SPEED, np.ones(3), LENGTH)[axis, 0]
    assert found == pytest.approx(2.0 * whole * 2.0 * np.pi / SPEED, abs=1e-6 * alone)


def test_coherence_is_one_together_and_zero_far_apart():
    f = np.geomspace(1e-3, 5.0, 40)
    assert (coherence(f, SPEED, LENGTH, 0.0) == 1.0).all()
    near = coherence(f, SPEED, LENGTH, 1e-3)
    assert ((near > 0.999) & (near <= 1.0)).all()
    assert abs(coherence(f, SPEED, LENGTH, 1e5)).max() < 1e-12


def test_coherence_falls_with_distance():
    """At every frequency."""
    f = np.geomspace(1e-3, 5.0, 40)
    both = np.array([coherence(f, SPEED, LENGTH, r) for r in (1.0, 5.0, 50.0, 500.0)])
    size = abs(both)
    falling = size[:-1] - size[1:] > 0.0
    assert (falling | (size[1:] < 0.2)).all()  # tails cross zero


def test_coherence_vertical_is_lateral_rotated():
    f, alike = np.geomspace(1e-3, 5.0, 40), np.full(3, 150.0)
    aside, above = (coherence(f, SPEED, alike, *apart) for apart in ((30.0, 0.0), (0.0, 30.0)))
    np.testing.assert_allclose(above, aside[[0, 2, 1]], rtol=1e-12)
