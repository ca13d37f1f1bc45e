"""Interpolation between the rows of recordings."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array


def hermite(at: Array, time: Array, value: Array, slope: Array) -> tuple[Array, Array]:
    """Interpolate cubically between rows; return values and derivatives (T, K).

    Args:
        at: (T,) s, within the times of the rows.
        time: (M,) s, increasing, of at least two rows.
        value: (M, K).
        slope: (M, K) derivatives of the values, per s.
    """
    left = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    width = (time[left + 1] - time[left])[:, np.newaxis]
    u = (at - time[left])[:, np.newaxis] / width
    p0, p1 = value[left], value[left + 1]
    m0, m1 = slope[left] * width, slope[left + 1] * width
    square = 3.0 * (p1 - p0) - 2.0 * m0 - m1
    cube = 2.0 * (p0 - p1) + m0 + m1
    curve = p0 + u * (m0 + u * (square + u * cube))
    return curve, (m0 + u * (2.0 * square + 3.0 * u * cube)) / width
