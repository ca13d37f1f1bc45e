"""The speed barrier h that keeps an agent inside its speed set, [HBH23] examples 4-6."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.records import Array
from testbed.formation.barrier import SpeedBarrier


def per_agent(barriers: Sequence[SpeedBarrier]) -> SpeedBarrier:
    """One barrier for each of n agents."""
    example, nu = zip(*barriers, strict=True)
    return SpeedBarrier(np.array(example, dtype=np.int64), np.array(nu, dtype=np.float64))


def h(barrier: SpeedBarrier, s: Array, s_lo: Array, s_hi: Array) -> tuple[Array, Array]:
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
