"""The mean wind: steady or recorded, its profile, and the path of the air.

It is uniform in the horizontal. Heights are above the ground, in m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.core.compile import jitable
from testbed.core.csv_table import CsvTable, read_table
from testbed.core.errors import InputError
from testbed.core.ranges import CLOCK, GUST_SPEED, WIND_COMPONENT, WIND_FROM, WIND_SPEED, Range
from testbed.core.records import Array, Record, Records, Vector, allocate, record_of, write_fields

UNIFORM, LOGARITHMIC, POWER = range(3)  # kinds of profile

# One row of a wind that is linear between its rows.
WIND_ROW = np.dtype(
    [
        ("time", "f8"),  # s
        ("velocity", "f8", 3),  # m/s NED, at the profile's reference height
        ("slope", "f8", 3),  # m/s², to the next row
        ("path", "f8", 3),  # m NED, of the air at the advection height since time 0
    ],
    align=True,
)


class Profile(NamedTuple):
    """A profile of the wind over height; see `profile_factor`."""

    kind: int = UNIFORM  # UNIFORM, LOGARITHMIC or POWER
    height: float = 1.0  # h_r, m, where the wind has the speed of its rows
    parameter: float = 1.0  # z₀, roughness, m, of LOGARITHMIC; exponent a of POWER


# A profile, and factors of the rows' velocity at the advection height.
PROFILE = record_of(Profile, ("advection", "f8", 3))


def wind_from_direction(speed: Array | float, direction: Array | float) -> Array:
    """Return the velocity (..., 3) m/s, NED, of winds from a direction.

    Args:
        speed: (...,) m/s.
        direction: (...,) rad clockwise from north, where the wind blows from.
    """
    downwind = np.asarray(direction) + np.pi
    speed = np.asarray(speed, dtype=np.float64)
    horizontal = [speed * np.cos(downwind), speed * np.sin(downwind)]
    return np.stack([*horizontal, np.zeros_like(horizontal[0])], axis=-1) + 0.0  # no -0 in a calm


@dataclass(frozen=True, slots=True)
class MeanWind:
    """A wind that is linear in time between M rows.

    Its profile scales the horizontal part.
    """

    rows: Records  # (M,) of WIND_ROW, from time 0; one row is a steady wind
    profile: Records  # (1,) of PROFILE

    @property
    def steady(self) -> bool:
        """True if the wind is the same at all times."""
        return len(self.rows) == 1

    @property
    def end_s(self) -> float:
        """Time of the last row, s."""
        return float(self.rows["time"][-1])

    @property
    def uniform(self) -> bool:
        """True if the wind is the same at all heights."""
        return bool(self.profile["kind"][0] == UNIFORM)

    def velocity_ned(self, time: float, height: float) -> Array:
        """Return the velocity (3,) m/s at a time, s, and a height, m."""
        rows, profile = self.rows.view(np.recarray), self.profile.view(np.recarray)[0]
        north, east, down = reference_wind(rows, time)
        factor = profile_factor(profile, height)
        return np.array([north * factor, east * factor, down])

    def displacement_ned(self, time: float) -> Array:
        """Return the path (3,) m of the air from time 0 to a time, s.

        The air is that at the advection height.
        """
        rows, profile = self.rows.view(np.recarray), self.profile.view(np.recarray)[0]
        displacement = np.empty(3)
        write_displacement(rows, profile, time, displacement)
        return displacement


def make_mean_wind(
    time: Array, velocity: Array, *, profile: Profile | None = None, advection_height: float = 0.0
) -> MeanWind:
    """Make a wind from its rows.

    Args:
        time: (M,) s, increasing from 0; (1,) for a steady wind.
        velocity: (M, 3) m/s NED, at the profile's reference height.
        profile: over height; None: uniform.
        advection_height: m, whose wind moves the frozen turbulence field and the fronts of gusts.
    """
    records, rows = allocate(PROFILE, 1), allocate(WIND_ROW, len(time))
    write_fields(records, profile or Profile())
    advection = np.ones(3)
    advection[:2] = profile_factor(records.view(np.recarray)[0], advection_height)
    records["advection"] = advection
    rows["time"], rows["velocity"] = time, velocity
    if len(time) > 1:
        width = np.diff(time)[:, np.newaxis]
        rows["slope"][:-1] = np.diff(velocity, axis=0) / width
        steps = width * 0.5 * (velocity[1:] + velocity[:-1])
        rows["path"][1:] = advection * np.cumsum(steps, axis=0)
    return MeanWind(rows, records)


@jitable
def profile_factor(profile: Record, height: float) -> float:
    """Return the part of the horizontal wind's speed at a height, m.

    LOGARITHMIC is ln(h/z₀) / ln(h_r/z₀), zero below z₀; MIL-F-8785C 3.7.3.2 has h_r = 20 ft.
    POWER is (h/h_r)^a, zero below the ground.
    """
    if profile.kind == LOGARITHMIC:
        roughness = profile.parameter
        scale = 1.0 / log(profile.height / roughness)
        return scale * log(max(height, roughness) / roughness)
    if profile.kind == POWER:
        return float((max(height, 0.0) / profile.height) ** profile.parameter)
    return 1.0


@jitable
def reference_wind(rows: Records, time: float) -> Vector:
    """Return the wind m/s NED at the profile's reference height at a time, s."""
    row = rows[_interval(rows, time)]
    since = time - row.time
    return (
        row.velocity[0] + since * row.slope[0],
        row.velocity[1] + since * row.slope[1],
        row.velocity[2] + since * row.slope[2],
    )


@jitable
def write_displacement(rows: Records, profile: Record, time: float, displacement: Array) -> None:
    """Write the path (3,) m of the air from time 0 to a time, s.

    The air is that at the advection height.
    """
    row = rows[_interval(rows, time)]
    since = time - row.time
    for axis in range(3):
        advection = profile.advection[axis]
        if len(rows) == 1:
            displacement[axis] = time * (advection * row.velocity[axis])
        else:
            average = row.velocity[axis] + 0.5 * since * row.slope[axis]
            displacement[axis] = row.path[axis] + since * advection * average


@jitable
def _interval(rows: Records, time: float) -> int:
    """Return the row at the beginning of the interval that holds a time, s."""
    return 0 if len(rows) == 1 else int(np.searchsorted(rows["time"][1:-1], time))


BY_AXES = ("north_mps", "east_mps")
BY_DIRECTION = ("speed_mps", "from_deg")
DOWN = "down_mps"
COLUMNS: Mapping[str, Range] = {
    "t_s": CLOCK,
    **dict.fromkeys(BY_AXES, WIND_COMPONENT),
    **dict(zip(BY_DIRECTION, (WIND_SPEED, WIND_FROM), strict=True)),
    DOWN: GUST_SPEED,
}


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
    data = table.numbers({name: COLUMNS[name] for name in ("t_s", *horizontal, *vertical)})
    if len(data) < 2:
        raise InputError(f"{path}: {len(data)} rows of numbers; a recording needs at least two")
    remedy = "fill in the missing rows, or raise air.wind.max_gap_s"
    table.check_time_steps(data[:, 0], max_gap, remedy)
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
        table.check_range("horizontal speed", np.hypot(*data[:, 1:3].T), WIND_SPEED)
    else:
        velocity[:] = wind_from_direction(data[:, 1], np.radians(data[:, 2]))
    if vertical:
        velocity[:, 2] = data[:, 3]
    return RecordedWind(time, velocity)


def _horizontal_columns(table: CsvTable) -> tuple[str, str]:
    """Return the columns of the horizontal wind; one of two is enough to choose them."""
    axes, direction = (
        [name for name in names if name in table.header] for names in (BY_AXES, BY_DIRECTION)
    )
    if axes and direction:
        raise table.error_at(
            0,
            f"has both {', '.join(axes)} and {', '.join(direction)}; keep north_mps, east_mps or "
            "speed_mps, from_deg",
        )
    if not axes and not direction:
        raise table.error_at(
            0, "has no wind; add the columns north_mps, east_mps or speed_mps, from_deg"
        )
    return BY_AXES if axes else BY_DIRECTION
