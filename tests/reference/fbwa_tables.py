"""Memory and commands of fly-by-wire A, which the kernel's adapter packs too.

Both are tables with one record per aircraft, so that a compiled law is handed one array in the
place of dozens. Fields of two numbers hold roll, then pitch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from testbed.core.records import Array

MEMORY = np.dtype(
    [
        ("period", "i8"),
        ("pressure", "f8"),  # m²/s², of the filtered airspeed
        ("smoothed_airspeed", "f8"),  # m/s
        ("scaler", "f8"),  # filtered
        ("gyro_first", "f8", (2,)),  # rad/s, states of the gyro's filter
        ("gyro_second", "f8", (2,)),  # rad/s
        ("target", "f8", (2,)),  # rad/s, filtered rate target, scaled
        ("error", "f8", (2,)),  # rad/s, filtered rate error, scaled
        ("derivative", "f8", (2,)),  # rad/s², filtered
        ("integral", "f8", (2,)),  # part of full output
        ("output", "f8", (2,)),  # sum before its limit, part of full output
    ]
)


class FbwaMemory(NamedTuple):
    """Memory of the law between two periods."""

    begun: bool  # False before the first period: filters start settled on what they first see
    commands: Array  # (periods, 3, N) roll, pitch, throttle under way, the newest first
    each: Any  # (N,) of MEMORY
    slew: Any = None  # state of the slew limiters, of the law that wrote it; None: at rest


class FbwaGains(NamedTuple):
    """Parameters of N autopilots in radians, prepared for the law at one rate.

    Surface gains are per full output, which ArduPlane calls 45 degrees.
    """

    dt: float
    command_periods: int  # whole periods of the command's latency
    command_fraction: float  # the rest, as a part of a period
    each: Any  # (N,) of autopilot.fbwa.GAINS


class Columns:
    """The fields of a table (N,) as contiguous arrays: (N,), or (2, N) for roll and pitch."""

    def __init__(self, table: Any) -> None:  # noqa: ANN401 - a structured array
        """Look into this table."""
        self._table = table

    def __getattr__(self, name: str) -> Array:
        """A field, copied."""
        column: Array = np.ascontiguousarray(self._table[name].T)
        return column
