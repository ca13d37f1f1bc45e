"""Spectra and coherence of turbulence along a straight flight, in closed form.

Densities are one-sided and per hertz: their integral over f from 0 to ∞ is the variance, as
`scipy.signal.welch` estimates it. Section numbers and scale lengths L are MIL-F-8785C's: 3.7.1.1
(von Kármán), 3.7.1.2 (Dryden) and 3.7.5 (angular rates). MIL-HDBK-1797 writes the same spectra
with the lateral and vertical lengths halved.

Coherence is that of two probes in an isotropic von Kármán field. The field is frozen, and flown
through at a speed V by two probes side by side, r apart across the flight. Of the spectral tensor
Φ_ij = E(k)/(4πk²) (δ_ij − k_i k_j/k²) with von Kármán's

    E(k) = 55/(9π) σ² L (aLk)⁴ / (1 + (aLk)²)^(17/6)

(T. von Kármán, Progress in the statistical theory of turbulence, PNAS 34, 1948), the probes' cross-
spectrum is the integral over the two wavenumbers across the flight with the factor exp(i k·r). With
κ² = k₂² + k₃², β² = k₁² + 1/(aL)² and Hankel's transform

    H_ν = ∫∫ (β² + κ²)^(−ν−1) exp(i k₂ r) dk₂ dk₃ = 2π/Γ(ν+1) (r/2β)^ν K_ν(βr)

the components along the flight, along the separation and normal to both are in proportion to

    H_{5/6} − β² H_{11/6},   k₁² H_{11/6} + 3/11 H_{5/6},   8/11 H_{5/6} − H_{11/6}/(aL)²

because k₃² under the integral is −∂²/∂z², which makes H_{ν−1}/2ν of H_ν. The forms of H. P. A. H.
Irwin (1979) and of ESDU 86010 are the same; at r = 0 they are the one-point spectra of MIL-F-8785C.
"""

from __future__ import annotations

from math import gamma, pi, sqrt

import numpy as np

from testbed.core.records import Array

VON_KARMAN = 1.339  # a as MIL-F-8785C prints it; makes L the longitudinal integral length
KNEE = gamma(1.0 / 3.0) / (sqrt(pi) * gamma(5.0 / 6.0))  # a to all its digits
ENERGY = 55.0 / (9.0 * pi)


def dryden(wavenumber: Array, length: Array) -> tuple[Array, Array]:
    """Return the longitudinal and transverse spectra of unit variance, per rad/m (...).

    Args:
        wavenumber: Ω (...), rad/m.
        length: L (...), m.
    """
    square = (length * wavenumber) ** 2
    level = length / np.pi
    return 2.0 * level / (1.0 + square), level * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def von_karman(wavenumber: Array, length: Array) -> tuple[Array, Array]:
    """Return the longitudinal and transverse spectra of unit variance; arguments as of `dryden`."""
    square = (VON_KARMAN * length * wavenumber) ** 2
    level = length / np.pi
    longitudinal = 2.0 * level / (1.0 + square) ** (5.0 / 6.0)
    return longitudinal, level * (1.0 + 8.0 / 3.0 * square) / (1.0 + square) ** (11.0 / 6.0)


SPECTRA = {"dryden": dryden, "von-karman": von_karman}


def roll_variance(sigma: Array, length: Array, span: Array) -> Array:
    """Return the variance of p (...), rad²/s²: the integral over Ω of its spectrum.

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
    """Return the densities (6, F) of u, v, w, p, q, r.

    Units: m²/s² per Hz, and rad²/s² per Hz for the rates.

    The rates are of the air as an airframe of this span takes it up; both spectra share the roll
    rate's.

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


def energy(wavenumber: Array, sigma: float, length: float) -> Array:
    """Return the energy spectrum E(k), m³/s², at wavenumbers k, rad/m.

    2/3 of its integral over k is σ².
    """
    square = (KNEE * length * wavenumber) ** 2
    out: Array = ENERGY * sigma**2 * length * square**2 / (1.0 + square) ** (17.0 / 6.0)
    return out


def cross_spectra(
    frequency_hz: Array,
    airspeed: float,
    sigma: Array,
    length: Array,
    lateral: float = 0.0,
    vertical: float = 0.0,
) -> Array:
    """Return the cross-spectra (3, F) of two probes side by side, (m/s)²/Hz.

    They are real: side by side in a frozen field, neither probe meets anything before the other.
    Without a separation they are the spectra of one probe.

    Args:
        frequency_hz: (F,) at the probes.
        airspeed: of both along the same straight line, m/s.
        sigma: (3,) m/s, of the components along the flight, to the right and down. Each is a
            component of an isotropic field of its own σ and L.
        length: (3,) m.
        lateral: separation to the right, m.
        vertical: separation down, m.
    """
    along = 2.0 * pi * np.asarray(frequency_hz, dtype=np.float64) / airspeed
    distance = float(np.hypot(lateral, vertical))
    aside = (lateral / distance) ** 2 if distance else 1.0
    out = np.empty((3, len(along)))
    for axis, (of, scale) in enumerate(zip(sigma, length, strict=True)):
        knee = KNEE * float(scale)
        root = along**2 + knee**-2
        fast = _hankel(5.0 / 6.0, root, distance)
        slow = _hankel(11.0 / 6.0, root, distance)
        parallel = along**2 * slow + 3.0 / 11.0 * fast
        normal = 8.0 / 11.0 * fast - slow / knee**2
        shared = (
            fast - root * slow,
            aside * parallel + (1.0 - aside) * normal,
            (1.0 - aside) * parallel + aside * normal,
        )
        # E/(4πk⁴) over (β² + κ²)^(−17/6); one side has half of it, a hertz 2π/V rad/m
        density = ENERGY * float(of) ** 2 * float(scale) * knee ** (-5.0 / 3.0) / (4.0 * pi)
        out[axis] = 2.0 * density * shared[axis] * 2.0 * pi / airspeed
    return out


def coherence(
    frequency_hz: Array, airspeed: float, length: Array, lateral: float, vertical: float = 0.0
) -> Array:
    """Return the coherence (3, F) of two probes, −1..1: cross-spectrum over spectrum.

    Its square is what is also called coherence. Arguments as of `cross_spectra`.
    """
    one = np.ones(3)
    shared = cross_spectra(frequency_hz, airspeed, one, length, lateral, vertical)
    return shared / cross_spectra(frequency_hz, airspeed, one, length)


def _hankel(order: float, root: Array, distance: float) -> Array:
    """Return H_ν (F,) of β² (F,) in (rad/m)²; π β^(−2ν)/ν where the distance is zero."""
    from scipy.special import kv  # half a second to load, and no flight needs it

    near: Array = pi / order * root**-order
    reach = np.sqrt(root) * distance
    if not reach.any():
        return near
    # the same as above times x^ν K_ν(x), which is 2^(ν−1) Γ(ν) at zero
    out: Array = near * reach**order * kv(order, reach) / (2.0 ** (order - 1.0) * gamma(order))
    return out
