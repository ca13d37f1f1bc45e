"""The speed barrier h that keeps an agent inside its speed set, [HBH23] examples 4-6."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array

NO_BARRIER = 7  # h = 1, as in the paper's experiments: the speeds are saturated instead


class Barrier(NamedTuple):
    """h by the number of its example in [HBH23].

    4: ν (s_hi − s)(s − s_lo), ν in s²/m². 5: tanh of example 4. 6: 1 but for parabolas within ν
    (m/s) of either bound and beyond. 7: no barrier, h = 1. Fields are numbers for all agents, or
    arrays (n,) with one for each: `per_agent`.
    """

    example: int | NDArray[np.int64]
    nu: float | Array


def per_agent(barriers: Sequence[Barrier]) -> Barrier:
    """One barrier for each of n agents."""
    example, nu = zip(*barriers, strict=True)
    return Barrier(np.array(example, dtype=np.int64), np.array(nu, dtype=np.float64))


def h(barrier: Barrier, s: Array, s_lo: Array, s_hi: Array) -> tuple[Array, Array]:
    """Value and slope of the barrier at ground speeds s (n,) and bounds (n,), m/s."""
    example, nu = barrier
    product = nu * (s_hi - s) * (s - s_lo)
    product_slope = nu * (s_hi + s_lo - 2.0 * s)
    smooth = np.tanh(product)
    # how far s has left the flat part of example 6, in parts of ν: negative below it
    width = np.where(example == 6, nu, 1.0)
    past = (np.maximum(s + width - s_hi, 0.0) - np.maximum(s_lo + width - s, 0.0)) / width
    chosen = [example == 4, example == 5, example == 6]
    shape = np.shape(s)
    choices = [np.broadcast_to(each, shape) for each in chosen]
    value = np.select(choices, [product, smooth, 1.0 - past * past], 1.0)
    slope = np.select(
        choices,
        [product_slope, product_slope * (1.0 - smooth * smooth), -2.0 * past / width],
        0.0,
    )
    return value, slope
