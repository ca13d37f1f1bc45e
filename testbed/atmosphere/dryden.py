"""Turbulence of each aircraft's own, MIL-F-8785C, by shaping filters over the distance flown.

A Dryden field is white noise through poles at 1/L, so a step of any size has a closed form. A
von Kármán field is a sum of independent Dryden fields of different lengths: (1 + x)^(−5/6) is a
mixture of 1/(t + x) with positive weights, and isotropy takes the transverse spectrum of each part
from its longitudinal one by the same linear rule, Φ_w = (Φ_u − Ω dΦ_u/dΩ)/2. Eight parts are
within 0.75 % of the von Kármán densities of u, v and w for L ω/V from 0 to 1000 (2 % to 2000), and
keep the variance of all components: of q and r within 0.1 % while πL/4b is below 2000.

The filters of the standard's handbook (MIL-HDBK-1797; second order for u, third for v and w) are
within 3.3 % up to L ω/V = 10 and 4.5 % up to 20, fall short by 31 % and 21 % at 50 and by 74 %
and 70 % at 1000, and lack 3 % and 4 % of the variance.

States are orthonormal (Takenaka-Malmquist functions of the poles): each has unit variance and no
two are correlated, so that a root of the noise that a step adds follows from its transition matrix
Φ alone, Q = 1 − Φ Φᵀ. They stay so when heights and airspeeds change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import exp, expm1, hypot, pi, sqrt
from typing import NamedTuple

import numpy as np

from testbed.atmosphere.mil_f_8785c import HIGH, LOW
from testbed.core.call_list import Call, Step
from testbed.core.compile import entry, kernel
from testbed.core.errors import InputError
from testbed.core.frames import COURSE_FLOOR, rotation_rows
from testbed.core.random import NormalNumbers, named_stream
from testbed.core.records import Array, Indices, Record, Records, Values, allocate


class DrydenMixture(NamedTuple):
    """Dryden fields whose sum has a spectrum."""

    variance: Array  # (M) parts of the variance
    length: Array  # (M) scale lengths, over the spectrum's


# Weights by linear programming for the least largest relative error of both densities at 161
# logarithmically spaced L ω/V from 0 to 1000 and, tenfold, of the variance of the rates for πL/4b
# from 1 to 1000; the variance and the density at zero are held. Lengths fall by a factor of 3.25,
# searched for together with the first, and at last by 4.9.
MIXTURES = {
    "dryden": DrydenMixture(np.ones(1), np.ones(1)),
    "von-karman": DrydenMixture(
        np.array([0.75086, 0.1526, 0.047356, 0.029212, 0.009805, 0.006122, 0.001819, 0.002226]),
        np.array([1.245, 0.3828, 0.1177, 0.03619, 0.01113, 0.003421, 0.001052, 0.0002164]),
    ),
}
# A rate's corner that coincides with the pole of its part is moved by this: the partial fractions
# divide by the difference.
SEPARATION = 1e-9
# (e^(−y) − 1 + y)/y² in falling powers of y, for y below 0.05 where the expression loses digits
SERIES = np.array([1 / 40320, -1 / 5040, 1 / 720, -1 / 120, 1 / 24, -1 / 6, 1 / 2])
TINY = float(np.finfo(np.float64).tiny)  # a flight that stands still adds no noise
# (1 + √3 s)/(1 + s)², the transverse Dryden filter: cos 15° and sin 15° of its first two states
BASIS = ((sqrt(3.0) + 1.0) / (2.0 * sqrt(2.0)), (sqrt(3.0) - 1.0) / (2.0 * sqrt(2.0)))

# One step of a filter of first order: longitudinal turbulence, or the roll rate.
FIRST_ORDER = np.dtype(
    [
        ("decay", "f8"),  # of the state
        ("noise", "f8"),  # per normal number
        ("gain", "f8"),  # m/s or rad/s per state
    ],
    align=True,
)
# One step of a filter of third order: lateral turbulence and yaw rate, or vertical and pitch rate.
THIRD_ORDER = np.dtype(
    [
        ("transition", "f8", (3, 3)),  # Φ
        ("root", "f8", (3, 3)),  # lower triangular; root rootᵀ = 1 − Φ Φᵀ
        ("speed", "f8", 2),  # m/s per state
        ("rate", "f8", 3),  # rad/s per state
    ],
    align=True,
)


class DrydenTurbulence:
    """The turbulence of N aircraft, each with a random stream keyed by its name.

    Args:
        names: N names of aircraft.
        seed: of the run.
        dt: s between samples.
        spans: N wingspans, m.
        spectrum: "dryden" or "von-karman".
        scales: gives σ (N, 3) m/s and L (N, 3) m at heights (N), such as `mil_f_8785c.Scales`.
        hold_s: how long the filters of a height and an airspeed are used, s.

    Raises:
        InputError: a span or a step is not positive.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        seed: int,
        dt: float,
        spans: Sequence[float],
        spectrum: str,
        scales: Callable[[Array], tuple[Array, Array]],
        hold_s: float = 0.5,
    ) -> None:
        for name, span in zip(names, spans, strict=True):
            if not 0.0 < span < np.inf:
                raise InputError(f"{name} has a wingspan of {span:g} m: write one above 0 m")
        if not 0.0 < dt < np.inf:
            raise InputError(f"turbulence every {dt:g} s: write a step above 0 s")
        n, parts = len(names), len(MIXTURES[spectrum].variance)
        self._scales, self._dt = scales, dt
        self._mixture = np.stack(MIXTURES[spectrum])
        self._spans = np.array(spans, dtype=np.float64)
        self._sigma, self._length = np.zeros((n, 3)), np.zeros((n, 3))
        self._first_order = allocate(FIRST_ORDER, n, parts + 1)
        self._third_order = allocate(THIRD_ORDER, n, 2, parts)
        self._hold_steps = max(1, round(hold_s / dt))
        # steps that the filters are still used, and whether they are to be computed first
        self._hold = np.zeros(2, dtype=np.intp)
        streams = [[(named_stream(seed, f"air/{name}"), 7 * parts + 1)] for name in names]
        self._numbers = NormalNumbers(streams)
        # of unit variance and uncorrelated: stationary from the start
        self._states = self._numbers.draw().copy()

    def bind(self, aircraft: Records, local: Records) -> Step:
        """Bind to aircraft (N,) of AIRCRAFT and their LOCAL_WIND (N,).

        Returns:
            The call that advances the filters by dt and adds their turbulence to the wind, and the
            step where it lacks random numbers or the scales of the present heights.
        """
        self._aircraft = aircraft
        call = Call(
            add_dryden_turbulence,
            *(self._mixture, self._sigma, self._length, self._spans, self._dt),
            *(self._first_order, self._third_order, self._states, local, aircraft),
            *(self._numbers.block, self._numbers.used, self._hold),
        )

        def renew(now: float) -> None:
            self._renew()
            call(now)

        return call, renew

    def _renew(self) -> None:
        """Compute the scales of the present heights, and draw numbers, where they are used up."""
        if self._hold[0] == 0:
            heights = -self._aircraft["truth"]["position_ned"][:, 2]
            self._sigma[:], self._length[:] = self._scales(heights)
            self._hold[:] = self._hold_steps, True
        if self._numbers.used[0] == len(self._numbers.block):
            self._numbers.refill()


@entry
def add_dryden_turbulence(
    mixture: Array,
    sigma: Array,
    length: Array,
    spans: Array,
    dt: float,
    first_order: Records,
    third_order: Records,
    states: Array,
    local: Records,
    aircraft: Records,
    block: Array,
    used: Indices,
    hold: Indices,
) -> bool:
    """Advance the filters of all aircraft and add their turbulence to the wind.

    True: there are no random numbers or no scales, and nothing is written.

    Turbulence is longitudinal (forward), lateral (right) and vertical (down). Rates are those with
    which the air rotates about body axes: an airframe that turned with it would feel none.

    Args:
        mixture: (2, M) of `DrydenMixture`.
        sigma: σ_u, σ_v, σ_w (N, 3) m/s.
        length: L_u, L_v, L_w (N, 3) m, above 0.
        spans: b (N) m, above 0.
        dt: s.
        first_order: (N, M + 1) of FIRST_ORDER: M longitudinal ones, and that of p.
        third_order: (N, 2, M) of THIRD_ORDER: lateral with r, vertical with q.
        states: (N, 7 M + 1): M longitudinal, one of p, M × 3 lateral, M × 3 vertical; written.
        local: (N,) of LOCAL_WIND.
        aircraft: (N,) of AIRCRAFT; truth is read, the wind is added to.
        block: (B, N, 7 M + 1) of `NormalNumbers`.
        used: (1,) of these; written.
        hold: (2,) steps that the filters are still used, and whether they are first to be those of
            the present heights and airspeeds; written.
    """
    if hold[0] == 0 or used[0] == len(block):
        return True
    numbers, update = block[used[0]], hold[1] != 0
    used[0] += 1
    hold[0] -= 1
    hold[1] = 0
    for i in range(len(aircraft)):
        motion, wind, mean = aircraft[i].truth, aircraft[i].wind, local[i].mean_wind
        north = motion.velocity_ned[0] - mean[0]
        east = motion.velocity_ned[1] - mean[1]
        if update:
            down = motion.velocity_ned[2] - mean[2]
            distance = sqrt(north * north + east * east + down * down) * dt
            write_filters(
                mixture, distance, sigma[i], length[i], spans[i], first_order[i], third_order[i]
            )
        u, v, w, p, q, r = advance_filters(first_order[i], third_order[i], states[i], numbers[i])
        axes = turbulence_axes(-motion.position_ned[2], north, east, motion.euler)
        for axis in range(3):
            row = axes[axis]
            wind.wind_ned[axis] += row[0] * u + row[1] * v + row[2] * w
        wind.wind_gradient_rates[0] += p
        wind.wind_gradient_rates[1] += q
        wind.wind_gradient_rates[2] += r
    return False


@kernel
def write_filters(
    mixture: Array,
    distance: float,
    sigma: Array,
    length: Array,
    span: float,
    first_order: Records,
    third_order: Records,
) -> None:
    """Write the filters of one aircraft for one step.

    Args:
        mixture: (2, M) of `DrydenMixture`.
        distance: V dt, m, flown through the air in the step; at 0 the states stay.
        sigma: σ_u, σ_v, σ_w, m/s.
        length: L_u, L_v, L_w, m, above 0.
        span: b, m, above 0.
        first_order: (M + 1) of FIRST_ORDER; written.
        third_order: (2, M) of THIRD_ORDER; written.
    """
    parts = mixture.shape[1]
    for m in range(parts + 1):
        one = first_order[m]
        if m < parts:
            pole = 1.0 / (length[0] * mixture[1, m])
            one.gain = sigma[0] * sqrt(mixture[0, m])
        else:
            pole = pi / (4.0 * span)
            # the variance of p: `spectra.roll_variance`
            rolling = (pi * length[2] / (4.0 * span)) ** (1.0 / 3.0)
            level = sigma[2] ** 2 / length[2] * 0.8 * rolling
            one.gain = sqrt(level * pi**2 / (8.0 * span))
        one.decay = exp(-distance * pole)
        one.noise = sqrt(-expm1(-2.0 * distance * pole))
    for axis in range(2):
        for m in range(parts):
            three = third_order[axis, m]
            strength = sigma[1 + axis] * sqrt(mixture[0, m])
            scale = length[1 + axis] * mixture[1, m]
            # the span's corners of r and q, 3b and 4b over π: section 3.7.5
            corner = pi * scale / ((3.0 + axis) * span)
            if abs(corner - 1.0) < SEPARATION:
                corner = 1.0 + SEPARATION
            step = distance / scale
            phi = _transition(step, corner)
            _write_lower(three.transition, phi)
            _write_lower(three.root, _root(phi, step, corner))
            for k in range(2):
                three.speed[k] = strength * BASIS[k]
            # r = ∂v/∂x and q = −∂w/∂x, x forward
            slope = strength / scale * (1.0 - 2.0 * axis)
            rates = _rates(corner)
            for k in range(3):
                three.rate[k] = slope * rates[k]


@kernel
def _transition(step: float, corner: float) -> Values:
    """Return the lower triangle of Φ = exp(A h), row by row.

    A has the poles 1, 1 and a: A_kk = −a_k, A_kj = −2 √(a_k a_j), j < k.

    Args:
        step: h, the distance over the part's length.
        corner: a, the rate's pole times that length; not 1.
    """
    decay, fast = exp(-step), exp(-corner * step)
    gap = corner - 1.0
    # ∫ e^(−a(h−s)) e^(−s) ds over the step, by the slower of the two
    once = -max(decay, fast) * expm1(-abs(gap) * step) / abs(gap)
    # ∫ e^(−a(h−s)) s e^(−s) ds
    if abs(gap * step) < 0.05:
        series = 0.0
        for each in SERIES:
            series = each + series * (gap * step)
        twice = step * step * decay * series
    else:
        twice = (step * decay - once) / gap
    coupling = -2.0 * sqrt(corner)
    return decay, -2.0 * step * decay, decay, coupling * (once - 2.0 * twice), coupling * once, fast


@kernel
def _root(phi: Values, step: float, corner: float) -> Values:
    """Return the Cholesky factor of 1 − Φ Φᵀ, its lower triangle row by row.

    The third pivot of a short step is of the order of its fifth power and below the rounding of
    the others; it is then zero, not the root of a negative number.
    """
    q11 = -expm1(-2.0 * step)
    q22 = q11 - phi[1] ** 2
    q33 = -expm1(-2.0 * corner * step) - phi[3] ** 2 - phi[4] ** 2
    first = sqrt(q11)
    a = -phi[1] * phi[0] / max(first, TINY)
    b = -phi[3] * phi[0] / max(first, TINY)
    second = sqrt(max(q22 - a * a, 0.0))
    c = (-(phi[1] * phi[3] + phi[2] * phi[4]) - a * b) / max(second, TINY)
    return first, a, second, b, c, sqrt(max(q33 - b * b - c * c, 0.0))


@kernel
def _rates(corner: float) -> Values:
    """Return the coefficients of a part's rate in its three states.

    The rate is the lagged derivative, a s (1 + √3 s)/((1 + s)² (s + a)).
    """
    a, root3 = corner, sqrt(3.0)
    third = a**2 * (root3 * a - 1.0) / (sqrt(2.0 * a) * (1.0 + a) ** 2)
    first = a * (1.0 + root3) / (2.0 * sqrt(2.0) * (1.0 + a))
    return first, (root3 * a - sqrt(2.0 * a) * third) / sqrt(2.0) - first, third


@kernel
def _write_lower(out: Array, triangle: Values) -> None:
    k = 0
    for row in range(3):
        for column in range(row + 1):
            out[row, column] = triangle[k]
            k += 1


@kernel
def advance_filters(
    first_order: Records, third_order: Records, states: Array, numbers: Array
) -> Values:
    """Advance the filters of one aircraft by one step.

    Args:
        first_order: (M + 1) of FIRST_ORDER.
        third_order: (2, M) of THIRD_ORDER.
        states: (7 M + 1); written.
        numbers: (7 M + 1), standard normal.

    Returns:
        Longitudinal, lateral and vertical turbulence, m/s; p, q and r of the air, rad/s.
    """
    parts = len(first_order) - 1
    along = 0.0
    for k in range(parts + 1):
        one = first_order[k]
        states[k] = one.decay * states[k] + one.noise * numbers[k]
        if k < parts:
            along += one.gain * states[k]
    roll = first_order[parts].gain * states[parts]
    at = parts + 1
    across = down = pitch = yaw = 0.0
    for axis in range(2):
        velocity, turn = 0.0, 0.0
        for k in range(parts):
            three = third_order[axis, k]
            a, b, c = _advance_third_order(three, states, numbers, at)
            states[at], states[at + 1], states[at + 2] = a, b, c
            turn += three.rate[0] * a
            turn += three.rate[1] * b
            turn += three.rate[2] * c
            velocity += three.speed[0] * a
            velocity += three.speed[1] * b
            at += 3
        if axis == 0:
            across, yaw = velocity, turn
        else:
            down, pitch = velocity, turn
    return along, across, down, roll, pitch, yaw


@kernel
def _advance_third_order(three: Record, states: Array, numbers: Array, at: int) -> Values:
    """Return the next three states of a part, from `at` on."""
    phi, root = three.transition, three.root
    a, b, c = states[at], states[at + 1], states[at + 2]
    x, y, z = numbers[at], numbers[at + 1], numbers[at + 2]
    first = phi[0, 0] * a
    first += root[0, 0] * x
    second = phi[1, 0] * a
    second += root[1, 0] * x
    second += phi[1, 1] * b
    second += root[1, 1] * y
    third = phi[2, 0] * a
    third += root[2, 0] * x
    third += phi[2, 1] * b
    third += root[2, 1] * y
    third += phi[2, 2] * c
    third += root[2, 2] * z
    return first, second, third


@kernel
def turbulence_axes(height: float, north: float, east: float, euler: Array) -> Values:
    """Return the matrix, row by row, from turbulence axes to NED, MIL-F-8785C 3.7.2 and 3.7.3.

    Up to 1000 ft longitudinal turbulence is along the horizontal motion through the air and
    vertical turbulence is vertical; from 2000 ft on its axes are the body's. Between, the two
    vectors are mixed linearly, so the matrix there is no rotation: in a bank it shortens.

    Args:
        height: above the ground, m.
        north: m/s through the air.
        east: m/s through the air.
        euler: roll, pitch, yaw, rad.
    """
    horizontal = hypot(north, east)
    cosine, sine = 1.0, 0.0
    if horizontal > COURSE_FLOOR:
        cosine, sine = north / horizontal, east / horizontal
    above = min(max((height - LOW) / (HIGH - LOW), 0.0), 1.0)
    below = 1.0 - above
    x, y, z = rotation_rows(euler)
    return (
        (above * x[0] + below * cosine, above * x[1] - below * sine, above * x[2]),
        (above * y[0] + below * sine, above * y[1] + below * cosine, above * y[2]),
        (above * z[0], above * z[1], above * z[2] + below),
    )
