"""The speed barrier h that keeps an agent inside its speed set, [HBH23] examples 4-6."""

from __future__ import annotations

from math import tanh
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, Record, Records, Values, allocate

NO_BARRIER = 7  # h = 1, as in the paper's experiments: the speeds are saturated instead

BARRIER = np.dtype([("example", "i8"), ("nu", "f8")], align=True)


class Barrier(NamedTuple):
    """h by the number of its example in [HBH23].

    4: ν (s_hi − s)(s − s_lo), ν in s²/m². 5: tanh of example 4. 6: 1 but for parabolas within ν
    (m/s) of either bound and beyond. 7: no barrier, h = 1.
    """

    example: int
    nu: float


@kernel
def h(barrier: Record, s: float, s_min: float, s_max: float) -> Values:
    """Return the barrier and its slope at a ground speed s, m/s.

    Args:
        barrier: record of BARRIER.
        s: m/s.
        s_min: s_lo, m/s.
        s_max: s_hi, m/s.
    """
    nu = barrier.nu
    if barrier.example == NO_BARRIER:
        return 1.0, 0.0
    if barrier.example == 6:
        # how far s has left the flat part, in parts of ν: negative below it
        past = (max(s + nu - s_max, 0.0) - max(s_min + nu - s, 0.0)) / nu
        return 1.0 - past * past, -2.0 * past / nu
    value, slope = nu * (s_max - s) * (s - s_min), nu * (s_max + s_min - 2.0 * s)
    if barrier.example == 5:
        value = tanh(value)
        slope *= 1.0 - value * value
    return value, slope


def barrier_curve(barrier: Barrier, s: Array, s_min: float, s_max: float) -> tuple[Array, Array]:
    """Sample h and h' at ground speeds s (K,), m/s, for figures and checks."""
    out = np.empty((2, len(s)))
    _write_curve(barrier_records(barrier), np.ascontiguousarray(s, dtype=float), s_min, s_max, out)
    return out[0], out[1]


def barrier_records(*barriers: Barrier) -> Records:
    """Pack barriers into records (n,) of BARRIER."""
    records = allocate(BARRIER, len(barriers))
    for record, barrier in zip(records, barriers, strict=True):
        record["example"], record["nu"] = barrier
    return records


@entry
def _write_curve(barrier: Records, s: Array, s_min: float, s_max: float, out: Array) -> None:
    for k in range(len(s)):
        out[0, k], out[1, k] = h(barrier[0], s[k], s_min, s_max)
