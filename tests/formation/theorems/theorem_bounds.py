"""What is proved about a flight before it is flown: bounds and rates from the start alone.

Write L = A + B, of non-negative gains and nonsingular, and x = L⁻¹ 1. Then x > 0, and the
largest weighted error m = max_i ‖q̃_i‖/x_i obeys a scalar differential inequality, for any directed
graph and any mixture of k and μ. Take the agent i where the maximum is reached. By (A13)

    ξ_i = −(L_ii q̃_i − Σ_j β_ij q̃_j),   ‖q̃_j‖ ≤ x_j m,   Σ_j β_ij x_j = L_ii x_i − 1 =: l − 1

so that −ξ_i/m lies in the ball of radius l − 1 about l e, with e = q̃_i/‖q̃_i‖. A vector of length r
in it has 1 ≤ r ≤ 2 l − 1 and a component along e of at least (r² + 2 l − 1)/(2 l). With (A12),
q̃̇_i = k_i μ_i(‖ξ_i‖²) ξ_i + s̃_i y_i + s_d ỹ_i, therefore

    ṁ ≤ −min_i (k_i/x_i) min_r μ_i(r² m²) (r² + 2 l_i − 1)/(2 l_i) m + max_i (|s̃_i| + s_d ‖ỹ_i‖)/x_i

and the last term is known: θ̇ = −c sin θ and |s̃/h| falls at least like exp(−a t), (A9) and (A3).
Near zero error the rate is at least min_i k_i μ_i(0)/x_i.
"""

from typing import NamedTuple

import numpy as np
from closed_loop import angle
from reference.adapters import mu

PIECES = 32  # intervals of r on which the inner minimum is bounded from below


def weights(formations):
    """x and l = L_ii x_i (N,) where the gains are the same on the three axes."""
    coupling = formations.couplings
    assert (coupling == coupling[:, :1]).all()
    m, _, n, _ = coupling.shape
    x = np.linalg.solve(coupling[:, 0], np.ones((m, n, 1)))[:, :, 0]
    assert (x > 0.0).all()
    return x.ravel(), (np.diagonal(coupling[:, 0], axis1=1, axis2=2) * x).ravel()


class Envelope:
    """The bound on max_i ‖q̃_i‖/x_i for all times after one at which every speed is in S."""

    def __init__(self, formations, t, state):
        self.formations, self.n = formations, formations.offsets.shape[1]
        self.x, self.reach = weights(formations)
        wanted, height = formations.wanted(t, state), formations.h(state.s)
        assert (height > 0.0).all()
        self.speed_error = formations.h_top * abs(state.s - wanted.desired.speed) / height
        self.half_angle = np.tan(0.5 * angle(state.y, wanted.desired.direction))
        self.value = self.largest(np.linalg.norm(wanted.error, axis=1) / self.x)  # m (M,)
        self.start = self.t = t

    def largest(self, values):
        return values.reshape(-1, self.n).max(axis=1)

    def rate(self, t, m):
        """The right-hand side of the inequality (M,)."""
        f, wide, since = self.formations, np.repeat(m, self.n), t - self.start
        r = 1.0 + (2.0 * self.reach - 2.0) * np.linspace(0.0, 1.0, PIECES + 1)[:, None]
        # every μ here rises at most once and falls after it: smallest at an interval's end
        values, _ = mu(f.mu, (r * wide) ** 2)
        along = (r[:-1] ** 2 + 2.0 * self.reach - 1.0) / (2.0 * self.reach)
        least = (np.minimum(values[1:], values[:-1]) * along).min(axis=0)
        speed = np.minimum(self.speed_error * np.exp(-f.a * since), f.speeds.max - f.speeds.min)
        direction = 2.0 * np.sin(np.arctan(self.half_angle * np.exp(-f.c * since)))
        push = (speed + f.speeds.desired_max * direction) / self.x
        return self.largest(push) + self.largest(-f.k / self.x * least * wide)

    def advance(self, t):
        """Bounds on ‖q̃_i‖ (N,) at the time t, in one step of Heun's rule."""
        dt = t - self.t
        first = self.rate(self.t, self.value)
        second = self.rate(t, self.value + dt * first)
        self.value, self.t = self.value + 0.5 * dt * (first + second), t
        return np.repeat(self.value, self.n) * self.x


class Constants(NamedTuple):
    """The constants of the proof of Theorem 1 for one flight."""

    d: np.ndarray  # (n,) the diagonal of D
    l1: float
    r: np.ndarray  # (n,) 2 − Y(0)
    rate: float  # ℓ5, 1/s


def exponential_bound(formations, flight):
    """ℓ1 and ℓ5 of one formation's flight: its states with what the law made of them.

    Gains may differ between axes where A + B is symmetric on each: D = 1 then serves all three,
    and the eigenvalues are those of the block matrix.
    """
    coupling = formations.couplings[0]
    n = coupling.shape[1]
    if (coupling == coupling.transpose(0, 2, 1)).all():
        d = np.ones(n)
    else:
        # D L + Lᵀ D is positive definite for d = (L⁻ᵀ 1)/(L⁻¹ 1), L a nonsingular M-matrix
        assert (coupling == coupling[0]).all()
        d = np.linalg.solve(coupling[0].T, np.ones(n)) / np.linalg.solve(coupling[0], np.ones(n))
    q = d[:, None] * coupling
    l0 = np.linalg.eigvalsh(q + q.transpose(0, 2, 1)).min() / 3.0
    assert l0 > 0.0
    l1 = np.linalg.eigvalsh(q.transpose(0, 2, 1) @ q).max() / l0
    xi_square = np.array([(wanted.xi**2).sum(axis=1) for _, wanted in flight])
    height = np.array([formations.h(state.s) for state, _ in flight])
    highest, lowest = mu(formations.mu, np.zeros(n))[0], mu(formations.mu, xi_square.max(axis=0))[0]
    start, wanted = flight[0]
    r = 1.0 + (wanted.desired.direction * start.y).sum(axis=1)
    l2 = l0 * formations.k * lowest**2 / (highest * d)
    l3 = formations.c * r / 2.0
    l4 = formations.a * height.min(axis=0) ** 2 / formations.h_top**2
    return Constants(d, l1, r, min(l2.min(), l3.min(), l4.min()))


def lyapunov(formations, constants, state, wanted):
    """V, (A26), for μ of example 1 with m = ½: M(z) = ∫ μ = 2 (√(ν1 + ν2 z) − √ν1)/ν2."""
    f, function = formations, formations.mu
    assert function.m == 0.5
    root = np.sqrt(function.nu1 + function.nu2 * (wanted.xi**2).sum(axis=1))
    x = constants.d * f.k * 2.0 * (root - function.nu1**0.5) / function.nu2
    y = 0.5 * ((state.y - wanted.desired.direction) ** 2).sum(axis=1)
    z = 0.5 * ((state.s - wanted.desired.speed) / f.h(state.s)) ** 2
    of_direction = 4.0 * f.speeds.max**2 / (f.c * constants.r) * y
    return (x / constants.l1 + of_direction + 2.0 * f.h_top**2 / f.a * z).sum()
