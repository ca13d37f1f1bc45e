"""Clocks that stamp messages with errors: offset, drift and resolution.

Errors change time stamps only; the schedule of the simulation runs in true time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor

import numpy as np

from testbed.core.compile import jitable
from testbed.core.records import Record, Records, Values, allocate
from testbed.scenario.network import StampClock

MILLION = 1e6

# Part of the resolution by which a reading counts as having reached its next multiple. It covers
# the rounding of quotients such as 0.58 / 0.01, which is just below 58.
ROUNDING = 1e-6

# The clock of one aircraft.
CLOCK = np.dtype(
    [
        ("offset", "f8"),  # s ahead of true time at the start
        ("drift", "f8"),  # s gained per s
        ("resolution", "f8"),  # s, of a stamp; 0: that of the numbers
    ],
    align=True,
)


def make_clocks(names: Sequence[str], clocks: Mapping[str, StampClock]) -> Records:
    """Return the clocks (N,) of aircraft; those that the scenario does not name are exact."""
    records = allocate(CLOCK, len(names))
    for record, name in zip(records, names, strict=True):
        clock = clocks.get(name, StampClock())
        record["offset"] = clock.offset_s
        record["drift"] = clock.drift_ppm / MILLION
        record["resolution"] = clock.resolution_s
    return records


@jitable
def clock_reading(clock: Record, time_s: float) -> float:
    """Return the stamp, s, that a clock gives at a true time, s."""
    reading = float(time_s + clock.offset + clock.drift * time_s)
    if clock.resolution > 0.0:
        reading = floor(reading / clock.resolution + ROUNDING) * float(clock.resolution)
    return reading


@jitable
def clock_error(clock: Record, time_s: Values) -> Values:
    """Return how far a clock is ahead at a true time, s.

    In Python also of many clocks.

    A receiver compares a stamp with its own clock. A stamp minus the receiver's error is therefore
    on a time scale on which the receiver's clock is exact.
    """
    return clock.offset + clock.drift * time_s
