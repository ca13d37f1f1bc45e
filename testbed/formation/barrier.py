"""The speed barrier h that keeps an agent inside its speed set, [HBH23] examples 4-6."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.state import Array

NO_BARRIER = 7  # h = 1, as in the paper's experiments: the speeds are saturated instead


class Barrier(NamedTuple):
    """h by the number of its example in [HBH23].

    4: ν (s_hi − s)(s − s_lo), ν in s²/m². 5: tanh of example 4. 6: 1 but for parabolas within ν
    (m/s) of either bound and beyond. 7: no barrier, h = 1.
    """

    example: int
    nu: float


def h(barrier: Barrier, s: Array, s_lo: Array, s_hi: Array) -> tuple[Array, Array]:
    """Value and slope of the barrier at ground speeds s (n,) and bounds (n,), m/s."""
    if barrier.example == NO_BARRIER:
        value, slope = np.ones_like(s), np.zeros_like(s)
    elif barrier.example == 6:
        # how far s has left the flat part, in parts of ν: negative below it, positive above
        nu = barrier.nu
        past = (np.maximum(s + nu - s_hi, 0.0) - np.maximum(s_lo + nu - s, 0.0)) / nu
        value, slope = 1.0 - past * past, -2.0 * past / nu
    else:
        value = barrier.nu * (s_hi - s) * (s - s_lo)
        slope = barrier.nu * (s_hi + s_lo - 2.0 * s)
        if barrier.example == 5:
            value = np.tanh(value)
            slope = slope * (1.0 - value * value)
    return value, slope
