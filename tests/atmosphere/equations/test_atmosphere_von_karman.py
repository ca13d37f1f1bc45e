"""Von Kármán turbulence: a sum of Dryden fields against the closed forms it stands for."""

import numpy as np
import pytest
from atmosphere_samples import (
    LONGEST,
    SAMPLES,
    Case,
    cases,
    closed_variance,
    discrete_variance,
    fly,
    freedom,
    inside,
    least,
    steps_of,
)
from scipy.stats import chi2

from testbed.atmosphere.dryden import MIXTURES
from testbed.atmosphere.spectra import VON_KARMAN, dryden, psd, von_karman

MIXTURE = MIXTURES["von-karman"]


@pytest.fixture(scope="module")
def flights():
    return [(case, fly(case, steps_of(case), SAMPLES)) for case in cases("von-karman")]


def mixed(wavenumber):
    """Longitudinal and transverse densities of the sum, L = 1 m."""
    parts = [dryden(wavenumber, length) for length in MIXTURE.length]
    return MIXTURE.variance @ np.array(parts).swapaxes(0, 1)


def test_mixture_keeps_variance_and_integral_length():
    assert MIXTURE.variance.sum() == pytest.approx(1.0, abs=1e-12)
    assert MIXTURE.variance @ MIXTURE.length == pytest.approx(1.0, abs=1e-5)
    assert (MIXTURE.variance > 0.0).all()


@pytest.mark.parametrize(("highest", "error"), [(LONGEST, 0.0075), (2.0 * LONGEST, 0.02)])
def test_mixture_has_the_closed_spectra(highest, error):
    wavenumber = np.append(0.0, np.geomspace(1e-3, highest, 3000))
    for sums, exact in zip(mixed(wavenumber), von_karman(wavenumber, np.ones(())), strict=True):
        assert np.abs(sums / exact - 1.0).max() < error


def test_handbook_filters_have_documented_error():
    """MIL-HDBK-1797's for u and for v and w; the largest error up to, and at, an L ω/V."""
    wavenumber = np.geomspace(1e-3, 1e3, 6001)
    s = 1j * wavenumber
    u = (1.0 + 0.25 * s) / (1.0 + 1.357 * s + 0.1987 * s**2)
    v = (1.0 + 2.7478 * s + 0.3398 * s**2) / (1.0 + 2.9958 * s + 1.9754 * s**2 + 0.1539 * s**3)
    exact = von_karman(wavenumber, np.ones(()))
    for response, level, density, longest, worst, at_50, at_1000 in (
        (u, 2.0 / np.pi, exact[0], 10.0, 0.033, -0.31, -0.74),
        (v, 1.0 / np.pi, exact[1], 20.0, 0.045, -0.21, -0.70),
    ):
        error = level * np.abs(response) ** 2 / density - 1.0
        assert np.abs(error[wavenumber <= longest]).max() == pytest.approx(worst, abs=0.001)
        assert np.interp(50.0, wavenumber, error) == pytest.approx(at_50, abs=0.005)
        assert error[-1] == pytest.approx(at_1000, abs=0.005)


def test_transverse_spectrum_follows_by_isotropy():
    """Φ_w = (Φ_u − Ω dΦ_u/dΩ)/2, by central differences of relative error 1e-7."""
    wavenumber, length = np.geomspace(1e-3, 10.0, 50), np.array(3.0)
    for spectrum in (dryden, von_karman):
        longitudinal, transverse = spectrum(wavenumber, length)
        up, down = (spectrum(wavenumber * (1.0 + e), length)[0] for e in (1e-4, -1e-4))
        slope = (up - down) / 2e-4
        assert transverse == pytest.approx(0.5 * (longitudinal - slope), rel=1e-6)


def test_psd_von_karman_worked_by_hand():
    """V = 20 m/s, L = 100 m, σ = 2 m/s at L ω/V = 1/1.339, where 1 + (1.339 L Ω)² is 2.

    Per rad/s Φ_u = 2 · 4 · 100/(π 20) 2^(−5/6) = 12.732395 · 0.561231 and
    Φ_w = 4 · 100/(π 20) · 11/3 · 2^(−11/6) = 6.366198 · 1.028924; per hertz 2π times as much.
    """
    frequency = np.array([20.0 / 100.0 / VON_KARMAN / (2.0 * np.pi)])
    found = psd("von-karman", frequency, 20.0, np.full(3, 2.0), np.full(3, 100.0), 2.8)
    assert found[0, 0] == pytest.approx(2.0 * np.pi * 7.145816, rel=1e-6)
    assert found[2, 0] == pytest.approx(2.0 * np.pi * 6.550331, rel=1e-6)
    assert found[1, 0] == found[2, 0]


@pytest.mark.parametrize("case", cases("von-karman"))
def test_filters_discrete_variance_is_the_closed_form(case):
    """Within 0.1 % for all components."""
    assert discrete_variance(case.filters()) == pytest.approx(closed_variance(case), rel=1e-3)


@pytest.mark.parametrize("corner", [1.0, 7.0, 50.0, 300.0, 2000.0])
def test_mixture_keeps_variance_of_rates_of_any_span(corner):
    """πL/4b as given: ∫ x²/(1 + (x/a)²) Φ_w dx of the sum and of the closed form."""
    grid = np.linspace(np.log(1e-7), np.log(1e9), 20001)
    x = np.exp(grid)
    weight = x**3 / (1.0 + (x / corner) ** 2)
    found = np.trapezoid(weight * mixed(x)[1], grid)
    exact = np.trapezoid(weight * von_karman(x, np.ones(()))[1], grid)
    assert found == pytest.approx(exact, rel=1e-3)


def test_spectra_lie_in_the_chi_square_band(flights):
    """At least 93 % of the bins over two decades, up to L ω/V = 1000; as the Dryden test."""
    shares = [inside(case, flight).mean() for case, flight in flights]
    assert min(shares) >= 0.93, shares
    assert np.mean(shares) < 0.97


def test_chi_square_band_rejects_dryden(flights):
    case, flight = flights[0]
    other = Case("dryden", case.airspeed, case.height, case.dt, case.seed)
    assert inside(case, flight, other)[:3].mean() < 0.8


def test_mean_squares_lie_in_their_bands(flights):
    found = []
    for case, flight in flights:
        share = (flight**2).mean(axis=(0, 1)) / closed_variance(case)
        degrees = freedom(case, len(flight), SAMPLES)
        low, high = chi2.ppf([[0.025], [0.975]], degrees) / degrees
        found += list((share > low) & (share < high))
    assert sum(found) >= least(len(found))


def test_rms_of_a_long_flight_is_within_2_percent():
    """8 h of 32 aircraft in steps of 5 s: the rms has a standard error below 0.5 %."""
    case, aircraft = Case("von-karman", 22.0, 120.0, 5.0, 101), 32
    flight = fly(case, 6000, aircraft)
    assert (1.0 / np.sqrt(2.0 * freedom(case, len(flight), aircraft)) < 0.005).all()
    rms = np.sqrt((flight**2).mean(axis=(0, 1)) / closed_variance(case))
    assert rms == pytest.approx(np.ones(6), abs=0.02)
