"""Shaping filters over the distance flown, exact for the step.

A Dryden field is white noise through poles at 1/L, so a step of any size has a closed form. A
von Kármán field is a sum of independent Dryden fields of different lengths: (1 + x)^(−5/6) is a
mixture of 1/(t + x) with positive weights, and isotropy takes the transverse spectrum of each part
from its longitudinal one by the same linear rule, Φ_w = (Φ_u − Ω dΦ_u/dΩ)/2. Eight parts are
within 0.75 % of the von Kármán densities of u, v and w for L ω/V from 0 to 1000 (2 % to 2000), and
keep the variance of all components: of q and r within 0.1 % while πL/4b is below 2000.

The filters of the standard's handbook (MIL-HDBK-1797; second order for u, third for v and w) are
within 3.3 % up to L ω/V = 10 and 4.5 % up to 20, fall short by 31 % and 21 % at 50 and by 74 %
and 70 % at 1000, and lack 3 % and 4 % of the variance.

States are orthonormal (Takenaka-Malmquist functions of the poles): each has unit variance and none
is correlated with another, so that a root of the noise that a step adds
follows from its transition matrix Φ alone, Q = 1 − Φ Φᵀ. They stay so when heights and speeds
change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.air.spectra import roll_variance
from testbed.compiled import twin_of
from testbed.state import Array


class Mixture(NamedTuple):
    """Dryden fields that add up to a field."""

    share: Array  # (M) of the variance
    length: Array  # (M) of the field's length


# Weights by linear programming for the least largest relative error of both densities at 161
# logarithmically spaced L ω/V from 0 to 1000 and, tenfold, of the variance of the rates for πL/4b
# from 1 to 1000; the variance and the density at zero are held. Lengths fall by a factor of 3.25,
# searched for together with the first, and at last by 4.9.
MIXTURES = {
    "dryden": Mixture(np.ones(1), np.ones(1)),
    "von-karman": Mixture(
        np.array([0.75086, 0.1526, 0.047356, 0.029212, 0.009805, 0.006122, 0.001819, 0.002226]),
        np.array([1.245, 0.3828, 0.1177, 0.03619, 0.01113, 0.003421, 0.001052, 0.0002164]),
    ),
}
# The corner of a rate that coincides with the pole of its part is moved by this: the partial
# fractions divide by the gap.
PARTED = 1e-9
# (e^(−y) − 1 + y)/y² in rising powers of y, for y below 0.05 where the expression loses digits
SERIES = np.array([1 / 2, -1 / 6, 1 / 24, -1 / 120, 1 / 720, -1 / 5040, 1 / 40320])


class Filters(NamedTuple):
    """One step of N aircraft through M Dryden fields. Axes: 0 lateral with r, 1 vertical with q."""

    keep: Array  # (N, M + 1) of M longitudinal states and that of p
    fresh: Array  # (N, M + 1)
    gain: Array  # (N, M + 1) m/s, rad/s
    transition: Array  # (N, 2, M, 3, 3)
    root: Array  # (N, 2, M, 3, 3) lower triangular, root rootᵀ = 1 − transition transitionᵀ
    speed: Array  # (N, 2, M, 2) m/s per state
    rate: Array  # (N, 2, M, 3) rad/s per state


def count(spectrum: str) -> int:
    """How many states and numbers per step an aircraft has, 7 M + 1."""
    return 7 * len(MIXTURES[spectrum].share) + 1


def _transition(step: Array, corner: Array) -> Array:
    """exp(A h) (..., 3, 3), A of the poles 1, 1 and a: A_kk = −a_k, A_kj = −2 √(a_k a_j), j < k.

    Args:
        step: h (...), the distance over the part's length.
        corner: a (...), the rate's pole times that length; not 1.
    """
    decay, fast = np.exp(-step), np.exp(-corner * step)
    gap = corner - 1.0
    # ∫ e^(−a(h−s)) e^(−s) ds over the step, by the slower of the two
    once = -np.maximum(decay, fast) * np.expm1(-np.abs(gap) * step) / np.abs(gap)
    # ∫ e^(−a(h−s)) s e^(−s) ds
    short = step**2 * decay * np.polynomial.polynomial.polyval(gap * step, SERIES)
    twice = np.where(np.abs(gap * step) < 0.05, short, (step * decay - once) / gap)
    coupling = -2.0 * np.sqrt(corner)
    out = np.zeros((*np.shape(step), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = decay
    out[..., 1, 0] = -2.0 * step * decay
    out[..., 2, 0] = coupling * (once - 2.0 * twice)
    out[..., 2, 1] = coupling * once
    out[..., 2, 2] = fast
    return out


def _root(transition: Array, step: Array, corner: Array) -> Array:
    """The Cholesky factor (..., 3, 3) of 1 − Φ Φᵀ.

    The third pivot of a short step is of the order of its fifth power and below the rounding of
    the others; it is then zero, not the root of a negative number.
    """
    q11 = -np.expm1(-2.0 * step)
    q22 = q11 - transition[..., 1, 0] ** 2
    q33 = -np.expm1(-2.0 * corner * step) - transition[..., 2, 0] ** 2 - transition[..., 2, 1] ** 2
    q21 = -transition[..., 1, 0] * transition[..., 0, 0]
    q31 = -transition[..., 2, 0] * transition[..., 0, 0]
    q32 = -(transition[..., 1, :2] * transition[..., 2, :2]).sum(axis=-1)
    tiny = np.finfo(np.float64).tiny  # a flight that stands still adds no noise
    out = np.zeros_like(transition)
    out[..., 0, 0] = first = np.sqrt(q11)
    out[..., 1, 0] = a = q21 / np.maximum(first, tiny)
    out[..., 2, 0] = b = q31 / np.maximum(first, tiny)
    out[..., 1, 1] = second = np.sqrt(np.maximum(q22 - a**2, 0.0))
    out[..., 2, 1] = c = (q32 - a * b) / np.maximum(second, tiny)
    out[..., 2, 2] = np.sqrt(np.maximum(q33 - b**2 - c**2, 0.0))
    return out


def _rate(corner: Array) -> Array:
    """A part's a s (1 + √3 s)/((1 + s)² (s + a)) in its three states (..., 3): d/ds, lagged."""
    a, root3 = corner, np.sqrt(3.0)
    third = a**2 * (root3 * a - 1.0) / (np.sqrt(2.0 * a) * (1.0 + a) ** 2)
    first = a * (1.0 + root3) / (2.0 * np.sqrt(2.0) * (1.0 + a))
    second = (root3 * a - np.sqrt(2.0 * a) * third) / np.sqrt(2.0) - first
    return np.stack([first, second, third], axis=-1)


def make_filters(
    spectrum: str, distance: Array, sigma: Array, length: Array, span: Array
) -> Filters:
    """The filters of N aircraft for one step.

    Args:
        spectrum: "dryden" or "von-karman".
        distance: V dt (N), m, flown through the air in a step; 0 keeps everything as it is.
        sigma: σ_u, σ_v, σ_w (N, 3), m/s.
        length: L_u, L_v, L_w (N, 3), m, above 0.
        span: b (N), m, above 0.
    """
    mixture = MIXTURES[spectrum]
    strength = sigma[:, :, None] * np.sqrt(mixture.share)  # (N, 3, M) m/s
    lengths = length[:, :, None] * mixture.length  # (N, 3, M) m
    roll = np.sqrt(roll_variance(sigma[:, 2], length[:, 2], span))
    poles = np.column_stack([1.0 / lengths[:, 0], np.pi / (4.0 * span)])  # per m
    keep = np.exp(-distance[:, None] * poles)
    # the span's corners of r and q, 3b and 4b over π: section 3.7.5
    corner = np.pi * lengths[:, 1:] / (np.array([3.0, 4.0])[:, None] * span[:, None, None])
    corner = np.where(np.abs(corner - 1.0) < PARTED, 1.0 + PARTED, corner)
    step = distance[:, None, None] / lengths[:, 1:]
    transition = _transition(step, corner)
    # (1 + √3 s)/(1 + s)², the Dryden filter: cos 15° and sin 15° of its two states
    basis = np.array([np.sqrt(3.0) + 1.0, np.sqrt(3.0) - 1.0]) / (2.0 * np.sqrt(2.0))
    # r = ∂v/∂x and q = −∂w/∂x, x forward
    slope = strength[:, 1:] / lengths[:, 1:] * np.array([1.0, -1.0])[:, None]
    return Filters(
        keep=keep,
        fresh=np.sqrt(-np.expm1(-2.0 * distance[:, None] * poles)),
        gain=np.column_stack([strength[:, 0], roll]),
        transition=transition,
        root=_root(transition, step, corner),
        speed=strength[:, 1:, :, None] * basis,
        rate=slope[..., None] * _rate(corner),
    )


def blank_filters(spectrum: str, n: int) -> Filters:
    """Arrays for the filters of n aircraft."""
    parts = len(MIXTURES[spectrum].share)
    plain, blocks = (n, parts + 1), (n, 2, parts)
    shapes = (plain, plain, plain, (*blocks, 3, 3), (*blocks, 3, 3), (*blocks, 2), (*blocks, 3))
    return Filters(*(np.zeros(shape) for shape in shapes))


def write_filters(
    spectrum: str, distance: Array, sigma: Array, length: Array, span: Array, filters: Filters
) -> None:
    """As `make_filters`, into arrays that are there."""
    for old, new in zip(
        filters, make_filters(spectrum, distance, sigma, length, span), strict=True
    ):
        old[:] = new


FILTERS = twin_of(write_filters, "testbed.air.filters_twin")
