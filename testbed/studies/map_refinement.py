"""Refinement of a map: which points of a grid to fly next, from the results at those flown.

The grid is divided into square cells of 2^levels points a side, whose corners are flown first. A
cell is halved, that is its centre and the middles of its sides are flown, where the results on it
differ. Its halves are looked at in the same way, until the cells have one point a side. A cell that
is not halved is looked at again when the middle of one of its sides is flown with a neighbour: thus
a contour that enters it through this side is followed.
"""

from __future__ import annotations

import math

import numpy as np

from testbed.core.records import Array, BoolArray

# Of the range over the map: a cell in which the number changes by more is halved. A plane changes
# by 0.25 in each of four by four cells.
CHANGE = 0.3


def points_to_add(
    levels: int,
    values: Array,
    flown: BoolArray,
    completed: BoolArray,
    contour: float | None = None,
) -> BoolArray:
    """Return the points to fly next; none where the map is fine enough.

    A cell is halved if of the points on it some were completed and some were not; if the contour is
    between its least and its largest number; or if these differ by more than `CHANGE` of the range
    over the map. Only numbers of completed points count.

    Args:
        levels: how often a cell can be halved.
        values: numbers (m, n) on the full grid; NaN where there is none. m - 1 and n - 1 are
            multiples of 2^levels.
        flown: (m, n) whether a point was flown, all those chosen before.
        completed: (m, n) whether the flights of a point were completed.
        contour: a value of the number.

    Returns:
        Points (m, n) that were not flown.
    """
    step = 2**levels
    wanted = np.zeros(flown.shape, dtype=np.bool_)
    wanted[::step, ::step] = True
    if (wanted & ~flown).any():
        return wanted & ~flown
    numbers = np.where(flown & completed & np.isfinite(values), values, math.nan)
    known = numbers[np.isfinite(numbers)]
    most = CHANGE * float(np.ptp(known)) if known.size else math.inf
    rows, columns = (range(0, size - 1, step) for size in flown.shape)
    cells = [(i, k) for i in rows for k in columns]
    while step > 1:
        half = step // 2
        halves: list[tuple[int, int]] = []
        for i, k in cells:
            here = slice(i, i + step + 1), slice(k, k + step + 1)
            # only halving a cell flies its centre
            if flown[i + half, k + half]:
                halves += [(i + a, k + b) for a in (0, half) for b in (0, half)]
            elif _differ(numbers[here], completed[here][flown[here]], most, contour):
                wanted[i : i + step + 1 : half, k : k + step + 1 : half] = True
        cells, step = halves, half
    return wanted & ~flown


def _differ(numbers: Array, completed: BoolArray, most: float, contour: float | None) -> bool:
    """Return whether a cell is to be halved, by its numbers and the outcomes of its points."""
    if completed.any() and not completed.all():
        return True
    known = numbers[np.isfinite(numbers)]
    if known.size < 2:
        return False
    low, high = float(known.min()), float(known.max())
    return high - low > most or (contour is not None and low < high and low <= contour <= high)
