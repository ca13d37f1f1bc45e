"""CSV files from elsewhere: a map from their columns and units to those of a recording."""

# No `from __future__ import annotations`: see scenario/fields.py.
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.frames import FOOT
from testbed.core.ranges import CLOCK, RECORDED
from testbed.core.records import Array
from testbed.flight_logs.log_position import POSITION, UNIX
from testbed.flight_logs.recorded_motion import (
    COMMANDS,
    NED,
    POLAR,
    VELOCITY,
    Motion,
    complete,
    default_origin,
    find_contradiction,
    with_known_positions,
)
from testbed.scenario.fields import Finding, Number, Section, raise_findings
from testbed.scenario.problems import did_you_mean
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import Node, error_at, read, walk

KNOT = 1852.0 / 3600.0  # m/s
_RAD = np.pi / 180.0
FACTORS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "m": 1.0,
    "km": 1e3,
    "cm": 1e-2,
    "mm": 1e-3,
    "ft": FOOT,
    "m/s": 1.0,
    "km/h": 1.0 / 3.6,
    "cm/s": 1e-2,
    "kn": KNOT,
    "ft/s": FOOT,
    "ft/min": FOOT / 60.0,
    "rad": 1.0,
    "deg": _RAD,
    "rad/s": 1.0,
    "deg/s": _RAD,
    "share": 1.0,
    "%": 0.01,
}  # to the unit of a recording; of latitude and longitude: `_GEODETIC`
_GEODETIC = {"deg": 1.0, "rad": 1.0 / _RAD, "1e-7 deg": 1e-7}

ColumnName = Annotated[str, Field(min_length=1, max_length=200)]
Sign = Annotated[Literal[1, -1], Field(description="-1: the column counts the other way.")]


class _MappedColumn(Section):
    """A column of the file."""

    column: ColumnName = Field(description="Its name in the first line of the file.")
    sign: Sign = 1
    no_value: Number | None = Field(
        None,
        description="Number of the file that stands for no value; rows with it are left out.",
    )


class TimeColumn(_MappedColumn):
    """A column of times."""

    unit: Literal["s", "ms", "us"] = Field("s", description="Its unit.")


class GeodeticColumn(_MappedColumn):
    """A column of latitudes or longitudes."""

    unit: Literal["deg", "rad", "1e-7 deg"] = Field("deg", description="Its unit.")


class LengthColumn(_MappedColumn):
    """A column of lengths."""

    unit: Literal["m", "km", "cm", "mm", "ft"] = Field("m", description="Its unit.")


class SpeedColumn(_MappedColumn):
    """A column of speeds."""

    unit: Literal["m/s", "km/h", "cm/s", "kn", "ft/s", "ft/min"] = Field(
        "m/s", description="Its unit."
    )


class AngleColumn(_MappedColumn):
    """A column of angles."""

    unit: Literal["rad", "deg"] = Field("rad", description="Its unit.")


class RateColumn(_MappedColumn):
    """A column of angular rates."""

    unit: Literal["rad/s", "deg/s"] = Field("rad/s", description="Its unit.")


class ShareColumn(_MappedColumn):
    """A column of shares, 0 to 1."""

    unit: Literal["share", "%"] = Field("share", description="Its unit.")


class ColumnMap(Section):
    """A map of columns: by column of the recording, where it comes from."""

    t_s: TimeColumn | None = Field(None, description="Time.")
    unix_s: TimeColumn | None = Field(None, description="Time since 1970, UTC.")
    latitude_deg: GeodeticColumn | None = Field(None, description="Geodetic latitude.")
    longitude_deg: GeodeticColumn | None = Field(None, description="Longitude, east positive.")
    height_m: LengthColumn | None = Field(None, description="Height above sea level.")
    north_m: LengthColumn | None = Field(None, description="Position north of the origin.")
    east_m: LengthColumn | None = Field(None, description="Position east of the origin.")
    down_m: LengthColumn | None = Field(
        None, description="Position below the origin; sign: -1 for a column of heights."
    )
    v_north_mps: SpeedColumn | None = Field(None, description="Ground velocity north.")
    v_east_mps: SpeedColumn | None = Field(None, description="Ground velocity east.")
    v_down_mps: SpeedColumn | None = Field(
        None, description="Velocity down; sign: -1 for a column of climb rates."
    )
    ground_speed_mps: SpeedColumn | None = Field(None, description="Horizontal ground speed.")
    course_rad: AngleColumn | None = Field(None, description="Course, clockwise from north.")
    roll_rad: AngleColumn | None = Field(None, description="Roll, right wing down positive.")
    pitch_rad: AngleColumn | None = Field(None, description="Pitch, nose up positive.")
    yaw_rad: AngleColumn | None = Field(None, description="Yaw, clockwise from north.")
    p_radps: RateColumn | None = Field(None, description="Roll rate.")
    q_radps: RateColumn | None = Field(None, description="Pitch rate.")
    r_radps: RateColumn | None = Field(None, description="Yaw rate.")
    airspeed_mps: SpeedColumn | None = Field(None, description="True airspeed.")
    throttle: ShareColumn | None = Field(None, description="Throttle.")
    theta_cmd_rad: AngleColumn | None = Field(None, description="Commanded pitch.")
    phi_cmd_rad: AngleColumn | None = Field(None, description="Commanded roll.")
    throttle_cmd: ShareColumn | None = Field(None, description="Commanded throttle.")

    @model_validator(mode="after")
    def _check(self) -> "ColumnMap":
        raise_findings(_findings(self))
        return self


def _findings(columns: ColumnMap) -> Iterator[Finding]:
    """Find columns that are not enough for a recording."""
    given = columns.model_fields_set
    if not given & {"t_s", UNIX}:
        yield (), "has no time (write t_s: {column: NAME} or unix_s: {column: NAME})"
    for group in (POSITION, NED, POLAR):
        missing = [name for name in group if name not in given]
        if 0 < len(missing) < len(group):
            there = next(name for name in group if name in given)
            yield (there,), f"needs {' and '.join(missing)} too"
    if given >= {*POSITION} and given & {*NED}:
        yield (
            (next(name for name in NED if name in given),),
            "is another position beside latitude_deg (write one)",
        )
    if not (given >= {*POSITION} or given >= {*NED} or given >= {*COMMANDS}):
        yield (
            (),
            f"has no position (write {', '.join(POSITION)} or {', '.join(NED)}) and no commands "
            f"({', '.join(COMMANDS)})",
        )


def read_mapped(path: Path, map_path: Path) -> Motion:
    """Read a CSV file by a map of its columns, all rows.

    Raises:
        ScenarioError: the map is wrong, or does not fit the file; with file, line and remedy.
        InputError: the file is wrong, with file and line.
    """
    tree = read(map_path)
    columns = validate(tree, ColumnMap)
    table = read_table(path)
    chosen: dict[str, _MappedColumn] = {
        name: each
        for name in ColumnMap.model_fields
        if (each := getattr(columns, name)) is not None
    }
    for name, each in chosen.items():
        if each.column not in table.header:
            place, _, _ = walk(tree, (name, "column"))
            known = ", ".join(table.header) or "none"
            hint = did_you_mean(each.column, table.header)
            raise error_at(
                place.place,
                f"{each.column!r} is no column of {path}{hint} (its columns: {known})",
                (name, "column"),
            )
    order = list(dict.fromkeys(each.column for each in chosen.values()))
    numbers = table.numbers(dict.fromkeys(order, CLOCK))  # in other units: `check_map` follows
    has_values = np.ones(len(numbers), dtype=bool)
    for each in chosen.values():
        if each.no_value is not None:
            has_values &= numbers[:, order.index(each.column)] != each.no_value
    notes: tuple[str, ...] = ()
    if not has_values.all():
        notes = (f"rows with no_value are left out: {np.count_nonzero(~has_values)}",)
        table, numbers = table.select(np.flatnonzero(has_values).tolist()), numbers[has_values]
    if len(numbers) < 2:
        raise InputError(f"{path}: {len(numbers)} rows of numbers; a flight needs at least two")
    found: dict[str, Array] = {}
    sources = {}
    for name, each in chosen.items():
        unit: str = each.unit  # type: ignore[attr-defined]
        factor = (_GEODETIC if isinstance(each, GeodeticColumn) else FACTORS)[unit]
        found[name] = each.sign * factor * numbers[:, order.index(each.column)]
        sign = "-" if each.sign < 0 else ""
        sources[name] = f"{sign}{each.column}, {unit}"
    if "t_s" not in found:
        found["t_s"], sources["t_s"] = found[UNIX] - found[UNIX][0], f"{UNIX} since the first row"
    table.check_time_steps(found["t_s"], np.inf, "")
    motion = Motion({"t_s": found["t_s"], **found}, sources, notes=notes)
    motion = with_known_positions(motion, str(path))
    check_map(motion, tree)
    clipped = {name: RECORDED[name].clip(values) for name, values in motion.columns.items()}
    return replace(motion, columns=clipped)


def check_map(motion: Motion, tree: Node) -> None:
    """Check that units, signs and axes of mapped columns agree with each other.

    Raises:
        ScenarioError: with the place in the map.
    """
    origin = default_origin(motion, None) if motion.columns.keys() >= {*POSITION} else None
    wrong = find_contradiction(motion) or find_contradiction(complete(motion, origin))
    if wrong is not None:
        name, text = wrong
        if name in VELOCITY[:2] and name not in motion.columns:
            name = POLAR[0]
        node, _, _ = walk(tree, (name,))
        raise error_at(node.place, text, (name,))
