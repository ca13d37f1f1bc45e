"""Reference for `atmosphere.dryden`: the same equations in numpy, for all aircraft at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.frames import rotation_ned_body
from testbed.atmosphere.dryden import MIXTURES, SEPARATION
from testbed.atmosphere.mil_f_8785c import high_altitude_weight
from testbed.atmosphere.spectra import roll_variance
from testbed.core.frames import COURSE_FLOOR
from testbed.core.records import Array

# (e^(−y) − 1 + y)/y² in rising powers of y, for y below 0.05 where the expression loses digits
SERIES = np.array([1 / 2, -1 / 6, 1 / 24, -1 / 120, 1 / 720, -1 / 5040, 1 / 40320])


class Filters(NamedTuple):
    """One step of N aircraft through M Dryden fields. Axes: 0 lateral with r, 1 vertical with q."""

    decay: Array  # (N, M + 1) of M longitudinal states and that of p
    noise: Array  # (N, M + 1)
    gain: Array  # (N, M + 1) m/s, rad/s
    transition: Array  # (N, 2, M, 3, 3)
    root: Array  # (N, 2, M, 3, 3) lower triangular, root rootᵀ = 1 − transition transitionᵀ
    speed: Array  # (N, 2, M, 2) m/s per state
    rate: Array  # (N, 2, M, 3) rad/s per state


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
        distance: V dt (N), m, flown through the air in a step; at 0 the states stay.
        sigma: σ_u, σ_v, σ_w (N, 3), m/s.
        length: L_u, L_v, L_w (N, 3), m, above 0.
        span: b (N), m, above 0.
    """
    mixture = MIXTURES[spectrum]
    strength = sigma[:, :, None] * np.sqrt(mixture.variance)  # (N, 3, M) m/s
    lengths = length[:, :, None] * mixture.length  # (N, 3, M) m
    roll = np.sqrt(roll_variance(sigma[:, 2], length[:, 2], span))
    poles = np.column_stack([1.0 / lengths[:, 0], np.pi / (4.0 * span)])  # per m
    decay = np.exp(-distance[:, None] * poles)
    # the span's corners of r and q, 3b and 4b over π: section 3.7.5
    corner = np.pi * lengths[:, 1:] / (np.array([3.0, 4.0])[:, None] * span[:, None, None])
    corner = np.where(np.abs(corner - 1.0) < SEPARATION, 1.0 + SEPARATION, corner)
    step = distance[:, None, None] / lengths[:, 1:]
    transition = _transition(step, corner)
    # (1 + √3 s)/(1 + s)², the Dryden filter: cos 15° and sin 15° of its two states
    basis = np.array([np.sqrt(3.0) + 1.0, np.sqrt(3.0) - 1.0]) / (2.0 * np.sqrt(2.0))
    # r = ∂v/∂x and q = −∂w/∂x, x forward
    slope = strength[:, 1:] / lengths[:, 1:] * np.array([1.0, -1.0])[:, None]
    return Filters(
        decay=decay,
        noise=np.sqrt(-np.expm1(-2.0 * distance[:, None] * poles)),
        gain=np.column_stack([strength[:, 0], roll]),
        transition=transition,
        root=_root(transition, step, corner),
        speed=strength[:, 1:, :, None] * basis,
        rate=slope[..., None] * _rate(corner),
    )


def advance_filters(state: Array, draw: Array, filters: Filters) -> tuple[Array, Array, Array]:
    """The filters' next states and what they give.

    Args:
        state: (N, 7 M + 1): M longitudinal, one of p, M × 3 lateral, M × 3 vertical.
        draw: standard normal numbers (N, 7 M + 1).
        filters: of this step.

    Returns:
        The states (N, 7 M + 1); longitudinal, lateral and vertical turbulence (N, 3), m/s; p, q
        and r of the air (N, 3), rad/s.
    """
    plain = filters.decay.shape[1]
    blocks = filters.transition.shape[:-1]  # (N, 2, M, 3)
    out = np.empty_like(state)
    out[:, :plain] = filters.decay * state[:, :plain] + filters.noise * draw[:, :plain]
    old, new = state[:, plain:].reshape(blocks), draw[:, plain:].reshape(blocks)
    transverse = (filters.transition @ old[..., None] + filters.root @ new[..., None])[..., 0]
    out[:, plain:] = transverse.reshape(len(state), -1)
    turbulence, rates = np.empty((len(state), 3)), np.empty((len(state), 3))
    turbulence[:, 0] = (filters.gain * out[:, :plain])[:, :-1].sum(axis=1)
    turbulence[:, 1:] = (filters.speed * transverse[..., :2]).sum(axis=(2, 3))
    rates[:, 0] = filters.gain[:, -1] * out[:, plain - 1]
    rates[:, :0:-1] = (filters.rate * transverse).sum(axis=(2, 3))  # r, then q
    return out, turbulence, rates


def turbulence_axes(height: Array, velocity_through_air_ned: Array, euler: Array) -> Array:
    """The matrices (N, 3, 3) that take turbulence from its axes to NED, MIL-F-8785C 3.7.2, 3.7.3.

    Up to 1000 ft longitudinal turbulence is along the horizontal motion through the air and
    vertical turbulence is vertical; from 2000 ft its axes are the body's. Between, the two vectors
    are mixed linearly, so the matrix there is no rotation: where a bank parts the two frames it
    shortens.

    Args:
        height: above the ground (N), m.
        velocity_through_air_ned: (N, 3), m/s.
        euler: roll, pitch, yaw (N, 3), rad.
    """
    north, east = velocity_through_air_ned[:, 0], velocity_through_air_ned[:, 1]
    horizontal = np.hypot(north, east)
    moving = horizontal > COURSE_FLOOR
    upright = np.where(moving, horizontal, 1.0)
    cosine, sine = np.where(moving, north / upright, 1.0), np.where(moving, east / upright, 0.0)
    level = np.zeros((len(height), 3, 3))
    level[:, 0, 0] = level[:, 1, 1] = cosine
    level[:, 0, 1] = -sine
    level[:, 1, 0] = sine
    level[:, 2, 2] = 1.0
    above = high_altitude_weight(height)[:, None, None]
    return (1.0 - above) * level + above * rotation_ned_body(euler)


def add_turbulence(
    state: Array,
    filters: Filters,
    position: Array,
    velocity: Array,
    euler: Array,
    mean: Array,
    wind: Array,
    rates: Array,
    draw: Array,
) -> None:
    """Step the filters, and add what they give to the wind and to the turns of the air.

    Args:
        state: (N, 7 M + 1), as in `advance_filters`; changed in place.
        filters: of this step.
        position: (N, 3) m, NED.
        velocity: (N, 3) m/s over the ground, NED.
        euler: (N, 3) rad.
        mean: (N, 3) m/s, the mean wind.
        wind: (N, 3) m/s; added to.
        rates: (N, 3) rad/s; added to.
        draw: standard normal numbers (N, 7 M + 1).
    """
    state[:], turbulence, turns = advance_filters(state, draw, filters)
    axes = turbulence_axes(-position[:, 2], velocity - mean, euler)
    wind += (axes @ turbulence[:, :, np.newaxis])[:, :, 0]
    rates += turns
