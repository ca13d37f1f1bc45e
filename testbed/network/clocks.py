"""Clocks that stamp messages, and are wrong: stamps move, ticks do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.scenario.network import StampClock
from testbed.state import Array

MILLION = 1e6


class Clocks(NamedTuple):
    """Of N aircraft (N,) each."""

    offset: Array  # s ahead of true time at the start
    drift: Array  # s gained per s
    resolution: Array  # s, of a stamp; 0: as fine as numbers are


def make_clocks(names: Sequence[str], clocks: Mapping[str, StampClock]) -> Clocks:
    """The clocks of a page; those that it does not name are right."""
    each = [clocks.get(name, StampClock()) for name in names]
    return Clocks(
        np.array([one.offset_s for one in each]),
        np.array([one.drift_ppm / MILLION for one in each]),
        np.array([one.resolution_s for one in each]),
    )


def shows(clocks: Clocks, measured_s: Array, rows: NDArray[np.int64]) -> Array:
    """What the clock of each of S senders shows, (S,) s.

    Args:
        clocks: of N aircraft, the leader's first.
        measured_s: (S,) true time.
        rows: (S,) who sends.
    """
    shown: Array = measured_s + clocks.offset[rows] + clocks.drift[rows] * measured_s
    grain = clocks.resolution[rows]
    coarse = grain > 0.0
    shown[coarse] = np.floor(shown[coarse] / grain[coarse]) * grain[coarse]
    return shown


def ahead(clocks: Clocks, measured_s: Array) -> Array:
    """By how much the clock of each of n followers is ahead at these true times (S,), (n, S) s.

    A receiver holds a stamp against its own clock, so what is wrong with both alike cancels: less
    this, a stamp is on a scale on which the receiver's clock is right.
    """
    out: Array = clocks.offset[1:, None] + clocks.drift[1:, None] * measured_s
    return out
