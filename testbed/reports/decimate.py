"""Fewer samples that draw the same curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array

BUCKETS = 250  # about four pixels wide on the page


def decimate(*columns: Array, buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Select the samples that draw the same curves.

    Time is cut into buckets of equal length. Each keeps its first, last, smallest and largest
    value, and the start of every stretch of NaN: no extreme is lost, and gaps stay gaps.

    Args:
        columns: (K,) each, of curves that are drawn together.
        buckets: number of buckets; up to four times as many samples are all kept.

    Returns:
        Indices in order.
    """
    samples = len(columns[0])
    if samples <= 4 * buckets:
        return np.arange(samples)
    width = -(-samples // buckets)
    # the last bucket is filled up with the last sample
    index = np.minimum(np.arange(width * -(-samples // width)), samples - 1).reshape(-1, width)
    chosen: list[NDArray[Any]] = [index[:, 0], index[:, -1]]
    rows = np.arange(len(index))
    for column in columns:
        values = column[index]
        missing = np.isnan(values)
        low = np.where(missing, np.inf, values).argmin(axis=1)
        high = np.where(missing, -np.inf, values).argmax(axis=1)
        chosen += [index[rows, low], index[rows, high]]
        absent = np.isnan(column)
        chosen.append(np.flatnonzero(absent[1:] & ~absent[:-1]) + 1)
    return np.unique(np.concatenate(chosen))


def percentiles(values: Array, shares: Sequence[float]) -> Array:
    """Compute percentiles (len(shares), K) of the finite values in each row, interpolated.

    Args:
        values: (K, n), of n aircraft; a row of NaN has NaN as percentiles.
        shares: 0..1.
    """
    ordered = np.sort(values, axis=1)  # NaN comes last
    count = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(values))
    out = np.empty((len(shares), len(values)))
    for k, share in enumerate(shares):
        position = share * np.maximum(count - 1, 0)
        low = np.floor(position).astype(np.intp)
        high = np.minimum(low + 1, np.maximum(count - 1, 0))
        weight = position - low
        out[k] = (1.0 - weight) * ordered[rows, low] + weight * ordered[rows, high]
    return out
