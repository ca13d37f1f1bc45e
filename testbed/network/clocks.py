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


def show(
    clocks: Clocks, measured_s: Array, rows: NDArray[np.int64], shown_s: Array, ahead_s: Array
) -> None:
    """Write what the clocks of S senders show, and what those of n receivers are ahead then.

    A receiver holds a stamp against its own clock, so what is wrong with both alike cancels: less
    what it is ahead, a stamp is on a scale on which the receiver's clock is right.

    Args:
        clocks: of N aircraft, the leader's first.
        measured_s: (N,) true time.
        rows: (S,) who sends.
        shown_s: (S,) s, is written.
        ahead_s: (n, S) s, is written.
    """
    true_s = measured_s[rows]
    shown_s[:] = true_s + clocks.offset[rows] + clocks.drift[rows] * true_s
    grain = clocks.resolution[rows]
    coarse = grain > 0.0
    shown_s[coarse] = np.floor(shown_s[coarse] / grain[coarse]) * grain[coarse]
    ahead_s[:] = clocks.offset[1:, None] + clocks.drift[1:, None] * true_s
