"""Fewer numbers that draw the same curve.

Time is cut into buckets of equal length. Of each, the first, the last, the smallest and the
largest value stay, and so does the start of every stretch that is not a number: extremes are never
lost, and gaps stay gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array

BUCKETS = 250  # about four pixels wide on the page


def kept(*columns: Array, buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Which of K frames stay, in order, of curves (K,) that are drawn over each other."""
    frames = len(columns[0])
    if frames <= 4 * buckets:
        return np.arange(frames)
    width = -(-frames // buckets)
    # the last bucket is filled up with its last frame
    index = np.minimum(np.arange(width * -(-frames // width)), frames - 1).reshape(-1, width)
    chosen: list[NDArray[Any]] = [index[:, 0], index[:, -1]]
    rows = np.arange(len(index))
    for column in columns:
        values = column[index]
        unknown = np.isnan(values)
        low = np.where(unknown, np.inf, values).argmin(axis=1)
        high = np.where(unknown, -np.inf, values).argmax(axis=1)
        chosen += [index[rows, low], index[rows, high]]
        absent = np.isnan(column)
        chosen.append(np.flatnonzero(absent[1:] & ~absent[:-1]) + 1)
    return np.unique(np.concatenate(chosen))


def percentiles(values: Array, shares: Sequence[float]) -> Array:
    """Percentiles (len(shares), K) of what is a number in rows (K, n), interpolated.

    Args:
        values: of n aircraft; a row without a number has no percentiles.
        shares: 0..1.
    """
    ordered = np.sort(values, axis=1)  # what is not a number comes last
    count = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(values))
    out = np.empty((len(shares), len(values)))
    for k, share in enumerate(shares):
        place = share * np.maximum(count - 1, 0)
        low = np.floor(place).astype(np.intp)
        high = np.minimum(low + 1, np.maximum(count - 1, 0))
        weight = place - low
        out[k] = (1.0 - weight) * ordered[rows, low] + weight * ordered[rows, high]
    return out
