"""A recorded wind: from a CSV to velocities over the time of the run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.air.mean import blowing_from
from testbed.csv_table import Table, read_table
from testbed.errors import InputError
from testbed.state import Array

BY_AXES = ("north_mps", "east_mps")
BY_DIRECTION = ("speed_mps", "from_deg")
DOWN = "down_mps"


class RecordedWind(NamedTuple):
    """A wind as recorded: M rows, the first at time 0."""

    time: Array  # (M,) s, increasing
    velocity_ned: Array  # (M, 3) m/s


def read_wind(path: Path, longest_gap: float, duration: float) -> RecordedWind:
    """Read a recording with the columns t_s, a pair for the horizontal and perhaps down_mps.

    The pair is north_mps, east_mps, or speed_mps, from_deg (degrees clockwise from north). A row
    is a vector: between rows it is the vector that is interpolated, not the direction. Other
    columns are ignored; t_s counts from any zero.

    Args:
        path: of the file.
        longest_gap: s that rows may be apart.
        duration: s that the run lasts.

    Raises:
        InputError: with file, line and remedy, if the file is not such a recording.
    """
    table = read_table(path)
    pair = _pair(table)
    more = (DOWN,) if DOWN in table.header else ()
    data = table.numbers(("t_s", *pair, *more))
    if len(data) < 2:
        raise InputError(f"{path}: {len(data)} rows of numbers; a recording needs at least two")
    remedy = "fill in the missing rows, or raise air.wind.longest_gap_s"
    table.refuse_steps(data[:, 0], longest_gap, remedy)
    time = data[:, 0] - data[0, 0]
    spare = 2.0 * np.spacing(np.abs(data[:, 0]).max())  # of rounding in the stamps
    if time[-1] + spare < duration:
        raise InputError(
            f"{path}: the recorded wind lasts {time[-1]:.2f} s, the scenario {duration:.2f} s; "
            f"set scenario.duration_s to {math.floor(time[-1] + spare)} or less, or record longer"
        )
    velocity = np.zeros((len(data), 3))
    if pair == BY_AXES:
        velocity[:, :2] = data[:, 1:3]
    else:
        for row in np.flatnonzero(data[:, 1] < 0.0):
            text = f"speed_mps is {data[row, 1]:g}; write it without its sign, or turn from_deg"
            raise table.refusal(int(row) + 1, text)
        velocity[:] = blowing_from(data[:, 1], np.radians(data[:, 2]))
    if more:
        velocity[:, 2] = data[:, 3]
    return RecordedWind(time, velocity)


def _pair(table: Table) -> tuple[str, str]:
    """The columns of the horizontal wind; a half of one pair is that pair."""
    axes, direction = (
        [name for name in pair if name in table.header] for pair in (BY_AXES, BY_DIRECTION)
    )
    if axes and direction:
        raise table.refusal(
            0,
            f"has both {', '.join(axes)} and {', '.join(direction)}; keep north_mps, east_mps or "
            "speed_mps, from_deg",
        )
    if not axes and not direction:
        raise table.refusal(
            0, "has no wind; add the columns north_mps, east_mps or speed_mps, from_deg"
        )
    return BY_AXES if axes else BY_DIRECTION
