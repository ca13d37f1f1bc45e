"""Functions of JSBSim's <function> elements that `math` does not have."""

from __future__ import annotations

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Array


@kernel
def whole(x: float) -> float:
    """Return a number without its fraction."""
    found: float = x - np.fmod(x, 1.0)
    return found


@kernel
def table_2(row: float, column: float, rows: Array, columns: Array, data: Array) -> float:
    """Interpolate linearly in both variables, which are held to the table.

    Args:
        row: looked up in `rows` (R,), which increase.
        column: looked up in `columns` (C,), which increase.
        rows: breakpoints.
        columns: breakpoints.
        data: (R, C)
    """
    r, along = _interval(row, rows)
    c, across = _interval(column, columns)
    low = (1.0 - along) * data[r - 1, c - 1] + along * data[r, c - 1]
    high = (1.0 - along) * data[r - 1, c] + along * data[r, c]
    value: float = low + across * (high - low)
    return value


@kernel
def _interval(x: float, points: Array) -> tuple[int, float]:
    """Return the number of the breakpoint above a value, and its share of the way there."""
    k = 1
    while k < len(points) - 1 and points[k] < x:
        k += 1
    share = (x - points[k - 1]) / (points[k] - points[k - 1])
    return k, min(max(share, 0.0), 1.0)
