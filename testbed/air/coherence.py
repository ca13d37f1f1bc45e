"""Spectra and coherence of two probes in an isotropic von Kármán field, in closed form.

A frozen field is flown through at a speed V by two probes side by side, r apart across the flight.
Of the spectral tensor Φ_ij = E(k)/(4πk²) (δ_ij − k_i k_j/k²) with von Kármán's

    E(k) = 55/(9π) σ² L (aLk)⁴ / (1 + (aLk)²)^(17/6)

(T. von Kármán, Progress in the statistical theory of turbulence, PNAS 34, 1948), all that the
probes share is the integral over the two wavenumbers across the flight with the factor
exp(i k·r). With κ² = k₂² + k₃², β² = k₁² + 1/(aL)² and Hankel's transform

    H_ν = ∫∫ (β² + κ²)^(−ν−1) exp(i k₂ r) dk₂ dk₃ = 2π/Γ(ν+1) (r/2β)^ν K_ν(βr)

the components along the flight, along the separation and normal to both are in proportion to

    H_{5/6} − β² H_{11/6},   k₁² H_{11/6} + 3/11 H_{5/6},   8/11 H_{5/6} − H_{11/6}/(aL)²

because k₃² under the integral is −∂²/∂z², which makes H_{ν−1}/2ν of H_ν. The forms of H. P. A. H.
Irwin (1979) and of ESDU 86010 are the same; at r = 0 they are the one-point spectra of
MIL-F-8785C. L is that standard's scale length, the same for all components of isotropic air:
MIL-HDBK-1797 writes the same curves with the lateral and vertical lengths halved.
"""

from __future__ import annotations

from math import gamma, pi, sqrt

import numpy as np

from testbed.state import Array

# a: a wave of k = 1/(aL) is at the knee of the spectrum; the standard's 1.339 to all its digits
KNEE = gamma(1.0 / 3.0) / (sqrt(pi) * gamma(5.0 / 6.0))
ENERGY = 55.0 / (9.0 * pi)


def energy(wavenumber: Array, sigma: float, length: float) -> Array:
    """E(k) in m³/s² at wavenumbers k in rad/m; 2/3 of its integral over k is σ²."""
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
    """Cross-spectra (3, F) of two probes side by side, one-sided, in (m/s)²/Hz.

    They are real: in frozen air side by side nothing comes sooner to one of them. Without a
    separation they are the spectra of one probe, whose integrals over the frequency are σ².

    Args:
        frequency_hz: (F,) of what the probes feel.
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
    frequency_hz: Array,
    airspeed: float,
    length: Array,
    lateral: float,
    vertical: float = 0.0,
) -> Array:
    """Coherence (3, F) of two probes: their cross-spectrum over the spectrum of one; −1..1.

    Its square is what is also called coherence. Arguments as of `cross_spectra`.
    """
    one = np.ones(3)
    together = cross_spectra(frequency_hz, airspeed, one, length, lateral, vertical)
    return together / cross_spectra(frequency_hz, airspeed, one, length)


def _hankel(order: float, root: Array, distance: float) -> Array:
    """H_ν (F,) of β² (F,) in (rad/m)²; π β^(−2ν)/ν where the distance is zero."""
    from scipy.special import kv  # half a second to load, and no flight needs it

    near: Array = pi / order * root**-order
    reach = np.sqrt(root) * distance
    if not reach.any():
        return near
    # the same as above times x^ν K_ν(x), which is 2^(ν−1) Γ(ν) at zero
    out: Array = near * reach**order * kv(order, reach) / (2.0 ** (order - 1.0) * gamma(order))
    return out
