"""What turbulence should look like along a straight flight: spectra in closed form.

Every density is one-sided and per hertz, so that its integral over f from 0 to ∞ is the variance,
as `scipy.signal.welch` estimates it. Sections and lengths are MIL-F-8785C's: 3.7.1.1 (von Kármán),
3.7.1.2 (Dryden) and 3.7.5 (rates). The rates are of the air as an airframe of this span takes it
up; both spectra share the roll rate's.
"""

from __future__ import annotations

import numpy as np

from testbed.state import Array

VON_KARMAN = 1.339  # of MIL-F-8785C; makes L the longitudinal integral length


def dryden(wavenumber: Array, length: Array) -> tuple[Array, Array]:
    """Longitudinal and transverse spectra of unit variance, per rad/m (...).

    Args:
        wavenumber: Ω (...), rad/m.
        length: L (...), m.
    """
    square = (length * wavenumber) ** 2
    level = length / np.pi
    return 2.0 * level / (1.0 + square), level * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def von_karman(wavenumber: Array, length: Array) -> tuple[Array, Array]:
    """Longitudinal and transverse spectra of unit variance, as `dryden`."""
    square = (VON_KARMAN * length * wavenumber) ** 2
    level = length / np.pi
    longitudinal = 2.0 * level / (1.0 + square) ** (5.0 / 6.0)
    return longitudinal, level * (1.0 + 8.0 / 3.0 * square) / (1.0 + square) ** (11.0 / 6.0)


SPECTRA = {"dryden": dryden, "von-karman": von_karman}


def roll_variance(sigma: Array, length: Array, span: Array) -> Array:
    """Variance of p (...), rad²/s²: the integral over Ω of its spectrum.

    Args:
        sigma: σ_w (...), m/s.
        length: L_w (...), m.
        span: b (...), m.
    """
    level = sigma**2 / length * 0.8 * (np.pi * length / (4.0 * span)) ** (1.0 / 3.0)
    return level * np.pi**2 / (8.0 * span)


def psd(
    spectrum: str, frequency_hz: Array, airspeed: float, sigma: Array, length: Array, span: float
) -> Array:
    """One-sided densities (6, F) of u, v, w, m²/s² per Hz, and p, q, r, rad²/s² per Hz.

    Args:
        spectrum: "dryden" or "von-karman".
        frequency_hz: (F), 0 Hz and more.
        airspeed: V > 0, m/s.
        sigma: σ_u, σ_v, σ_w, m/s.
        length: L_u, L_v, L_w, m.
        span: b, m.
    """
    wavenumber = 2.0 * np.pi * frequency_hz / airspeed
    unit = SPECTRA[spectrum]
    u = sigma[0] ** 2 * unit(wavenumber, length[0])[0]
    v = sigma[1] ** 2 * unit(wavenumber, length[1])[1]
    w = sigma[2] ** 2 * unit(wavenumber, length[2])[1]
    # An airframe averages over its span: corners at π/4b for p and q and π/3b for r.
    vertical = 1.0 + (4.0 * span / np.pi * wavenumber) ** 2
    lateral = 1.0 + (3.0 * span / np.pi * wavenumber) ** 2
    p = roll_variance(sigma[2], length[2], np.asarray(span)) * 8.0 * span / np.pi**2 / vertical
    q = wavenumber**2 * w / vertical
    r = wavenumber**2 * v / lateral
    return 2.0 * np.pi / airspeed * np.stack([u, v, w, p, q, r])
