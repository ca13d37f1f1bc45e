"""Read a recorded wind from a CSV file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.atmosphere.mean_wind import wind_from_direction
from testbed.core.csv_table import Table, read_table
from testbed.core.errors import InputError
from testbed.core.records import Array

BY_AXES = ("north_mps", "east_mps")
BY_DIRECTION = ("speed_mps", "from_deg")
DOWN = "down_mps"


class RecordedWind(NamedTuple):
    """A recorded wind: M rows, the first at time 0."""

    time: Array  # (M,) s, increasing
    velocity_ned: Array  # (M, 3) m/s


def read_wind(path: Path, max_gap: float, duration: float) -> RecordedWind:
    """Read a recording with the columns t_s, two for the horizontal wind, and optionally down_mps.

    The two are north_mps, east_mps, or speed_mps, from_deg (degrees clockwise from north). Each row
    is a vector: between rows the vector is interpolated, not the direction. Other columns are
    ignored; t_s counts from any zero.

    Args:
        path: of the file.
        max_gap: s between rows at most.
        duration: s, of the run.

    Raises:
        InputError: with file, line and remedy, if the file is not such a recording.
    """
    table = read_table(path)
    horizontal = _horizontal_columns(table)
    vertical = (DOWN,) if DOWN in table.header else ()
    data = table.numbers(("t_s", *horizontal, *vertical))
    if len(data) < 2:
        raise InputError(f"{path}: {len(data)} rows of numbers; a recording needs at least two")
    remedy = "fill in the missing rows, or raise air.wind.max_gap_s"
    table.refuse_steps(data[:, 0], max_gap, remedy)
    time = data[:, 0] - data[0, 0]
    tolerance = 2.0 * np.spacing(np.abs(data[:, 0]).max())  # rounding of the stamps
    if time[-1] + tolerance < duration:
        raise InputError(
            f"{path}: the recorded wind lasts {time[-1]:.2f} s, the scenario {duration:.2f} s; "
            f"set scenario.duration_s to {math.floor(time[-1] + tolerance)} or less, or record "
            "longer"
        )
    velocity = np.zeros((len(data), 3))
    if horizontal == BY_AXES:
        velocity[:, :2] = data[:, 1:3]
    else:
        for row in np.flatnonzero(data[:, 1] < 0.0):
            text = f"speed_mps is {data[row, 1]:g}; write it without its sign, or turn from_deg"
            raise table.refusal(int(row) + 1, text)
        velocity[:] = wind_from_direction(data[:, 1], np.radians(data[:, 2]))
    if vertical:
        velocity[:, 2] = data[:, 3]
    return RecordedWind(time, velocity)


def _horizontal_columns(table: Table) -> tuple[str, str]:
    """Return the columns of the horizontal wind; one of two is enough to choose them."""
    axes, direction = (
        [name for name in names if name in table.header] for names in (BY_AXES, BY_DIRECTION)
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
