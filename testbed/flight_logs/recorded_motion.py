"""The motion of a recorded aircraft: complete columns of a recording, from those that it has."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.frames import body_rates, course, flight_path_angle, turn_bank, wrap_pi
from testbed.core.geodetic import DEGREES, has_position, ned_from_geodetic, wrap_longitude
from testbed.core.ranges import ORIGIN_ELEVATION, RECORDED, TURN, Range
from testbed.core.records import Array, BoolArray, NedOrigin
from testbed.flight_logs.log_position import POSITION, UNIX
from testbed.guidance.recorded_path import MAX_GAP_S

NED = ("north_m", "east_m", "down_m")
VELOCITY = ("v_north_mps", "v_east_mps", "v_down_mps")
POLAR = ("ground_speed_mps", "course_rad")
EULER = ("roll_rad", "pitch_rad", "yaw_rad")
RATES = ("p_radps", "q_radps", "r_radps")
# Names of the same values in recordings for `testbed respond`.
ALIASES = {"phi_rad": "roll_rad", "theta_rad": "pitch_rad", "psi_rad": "yaw_rad"}
_HEADINGS = ("yaw_rad", "psi_rad")  # which count no turns in recordings of formations
PULSES = ("pwm_ail", "pwm_ele", "pwm_thr", "pwm_rud")
COMMANDS = ("theta_cmd_rad", "phi_cmd_rad", "throttle_cmd")
MAX_AWAY_M = 50_000.0  # from the origin of the flat frame
_MIN_PATH_M = 20.0  # along an axis, from which on velocity and position are compared
_RATIO = (0.8, 1.25)  # of the way by positions to that by velocities
_MIN_BANK, _MIN_SHARE = 0.1, 0.3  # rad RMS of the bank of turns; of it, as recorded
_MAX_YAW_ERROR = np.radians(60.0)  # mean of yaw minus course: a wind of 0.87 of the airspeed
_FORMATS = {
    "t_s": ".10g",
    UNIX: ".6f",
    **dict.fromkeys(POSITION[:2], ".9f"),
    **dict.fromkeys((POSITION[2], *NED), ".4f"),
}  # others have six digits
# What a map of columns should say instead, by the unit of a value out of range.
_OTHER_UNITS = {"rad": "unit: deg", "rad/s": "unit: deg/s", "": "unit: '%'"}
_COLUMNS = ("t_s", UNIX, *POSITION, *NED, *VELOCITY, *EULER, *RATES, "airspeed_mps", "throttle")


@dataclass(frozen=True, slots=True)
class Motion:
    """Columns of a recording.

    Attributes:
        columns: by name, t_s first; each (M,).
        sources: what each column comes from.
        origin: of north_m, east_m, down_m; None: their origin is not known.
        notes: about data quality.
    """

    columns: Mapping[str, Array]
    sources: Mapping[str, str]
    origin: NedOrigin | None = None
    notes: tuple[str, ...] = ()

    def rows(self, keep: BoolArray | slice) -> Motion:
        """Select rows."""
        return replace(self, columns={name: each[keep] for name, each in self.columns.items()})

    def stack(self, names: Sequence[str]) -> Array:
        """Return columns side by side (M, K)."""
        return np.stack([self.columns[name] for name in names], axis=-1)


def default_origin(motion: Motion, home_m: float | None) -> NedOrigin:
    """Return the origin at the first position, at home's height above sea level or the lowest."""
    latitude, longitude, _ = motion.stack(POSITION)[0].tolist()
    lowest = float(np.min(motion.columns["height_m"]))
    return NedOrigin(latitude, longitude, lowest if home_m is None else home_m)


def complete(motion: Motion, origin: NedOrigin | None) -> Motion:
    """Add the columns of a replay leader that are missing.

    Positions about the origin come from latitude, longitude and height where these are there.
    What was not recorded is derived: velocities by differences of the positions, attitudes as in a
    coordinated turn along the path without wind, body rates by differences of the attitudes; the
    throttle is 0.

    Args:
        motion: with a position; without one it is returned as it is.
        origin: of the result; None: positions are north_m, east_m, down_m already.

    Raises:
        InputError: the positions are far from the origin.
    """
    columns, sources = dict(motion.columns), dict(motion.sources)

    def put(names: Sequence[str], values: Array, source: str) -> None:
        for name, value in zip(names, values.T, strict=True):
            columns[name], sources[name] = value, source

    if columns.keys() >= {*POSITION} and origin is not None:
        geodetic = np.stack([columns[name] for name in POSITION], axis=-1)
        ned = ned_from_geodetic(geodetic, origin)
        _check_distance(ned, geodetic, origin)
        put(NED, ned, "position about the origin")
    if not columns.keys() >= {*NED}:
        return motion
    for alias, name in ALIASES.items():
        if alias in columns and name not in columns:
            columns[name], sources[name] = columns[alias], sources[alias]
    if "throttle_cmd" in columns and "throttle" not in columns:
        columns["throttle"], sources["throttle"] = columns["throttle_cmd"], sources["throttle_cmd"]
    time = columns["t_s"]
    ned = np.stack([columns[name] for name in NED], axis=-1)
    _complete_velocity(columns, put, ned, time)
    velocity = np.stack([columns[name] for name in VELOCITY], axis=-1)
    _complete_attitude(columns, put, velocity, time)
    if "airspeed_mps" not in columns:
        speed = np.linalg.norm(velocity, axis=1)[:, np.newaxis]
        put(("airspeed_mps",), speed, "derived: ground speed, as without wind")
    if "throttle" not in columns:
        put(("throttle",), np.zeros((len(time), 1)), "0: not recorded")
    for alias, name in ALIASES.items():
        if alias not in columns:
            columns[alias], sources[alias] = columns[name], sources[name]
    return Motion(columns, sources, origin, motion.notes)


def _complete_velocity(
    columns: Mapping[str, Array],
    put: Callable[[Sequence[str], Array, str], None],
    ned: Array,
    time: Array,
) -> None:
    if columns.keys() >= {*POLAR} and not columns.keys() >= {*VELOCITY[:2]}:
        speed, angle = (columns[name] for name in POLAR)
        horizontal = np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=-1)
        put(VELOCITY[:2], horizontal, f"{POLAR[0]}, {POLAR[1]}")
    differences = np.gradient(ned, time, axis=0)
    for k, name in enumerate(VELOCITY):
        if name not in columns:
            put((name,), differences[:, k : k + 1], f"derived: differences of {NED[k]}")


def _complete_attitude(
    columns: Mapping[str, Array],
    put: Callable[[Sequence[str], Array, str], None],
    velocity: Array,
    time: Array,
) -> None:
    acceleration = np.gradient(velocity, time, axis=0)
    for name, values, source in (
        ("roll_rad", turn_bank(velocity, acceleration), "bank of a coordinated turn"),
        ("pitch_rad", flight_path_angle(velocity), "flight-path angle"),
        ("yaw_rad", np.mod(course(velocity), 2.0 * np.pi), "course"),
    ):
        if name not in columns:
            put((name,), values[:, np.newaxis], f"derived: {source}")
    if not columns.keys() >= {*RATES}:
        euler = np.unwrap(np.stack([columns[name] for name in EULER], axis=-1), axis=0)
        rates = body_rates(euler, np.gradient(euler, time, axis=0))
        put(RATES, rates, "derived: differences of the attitude")


def _check_distance(ned: Array, geodetic: Array, origin: NedOrigin) -> None:
    away = float(np.max(np.abs(ned)))
    if away > MAX_AWAY_M:
        text = f"the flight is up to {1e-3 * away:,.0f} km from the origin, {_words(origin)}"
        better = _central_origin(geodetic)
        apart = np.max(np.abs(ned_from_geodetic(geodetic, better)[:, :2]), axis=1)
        if apart.max() <= MAX_AWAY_M:
            raise InputError(
                f"{text}; write another one: scenario.origin: {{latitude_deg: "
                f"{better.latitude_deg:.6f}, longitude_deg: {better.longitude_deg:.6f}, "
                f"elevation_m: {better.elevation_m:.0f}}}"
            )
        row = int(apart.argmax())
        raise InputError(
            f"{text}, and position {row + 1} of {len(apart)} is {1e-3 * apart[row]:,.0f} km from "
            f"the middle of all, {_words(better)}; a flat frame has at most "
            f"{1e-3 * MAX_AWAY_M:.0f} km: remove the rows whose position is wrong"
        )


def _central_origin(geodetic: Array) -> NedOrigin:
    """Return an origin at the median of positions (M, 3), on the ground below them."""
    first = geodetic[0, 1]
    east = wrap_longitude(geodetic[:, 1] - first, DEGREES)
    longitude = float(wrap_longitude(first + np.median(east), DEGREES))
    lowest = float(ORIGIN_ELEVATION.clip(geodetic[:, 2]).min())
    return NedOrigin(float(np.median(geodetic[:, 0])), longitude, lowest)


def _words(origin: NedOrigin) -> str:
    return f"{origin.latitude_deg:g}°, {origin.longitude_deg:g}°"


def find_contradiction(motion: Motion) -> tuple[str, str] | None:
    """Find a column whose unit, sign or axis contradicts the others.

    Returns:
        Its name and what is wrong; None: nothing is.
    """
    columns = motion.columns
    for name, values in columns.items():
        limits = TURN if name in _HEADINGS else RECORDED[name]
        if limits.outside(values).any():
            return name, _out_of_range(values, limits)
    if not columns.keys() >= {*NED, *VELOCITY}:
        return None
    elapsed = np.diff(columns["t_s"])
    near = elapsed <= MAX_GAP_S
    for position, name in zip(NED, VELOCITY, strict=True):
        led = (0.5 * (columns[name][1:] + columns[name][:-1]) * elapsed)[near]
        moved = np.diff(columns[position])[near]
        if max(np.abs(led).sum(), np.abs(moved).sum()) < _MIN_PATH_M:
            continue
        ratio = float(np.sum(moved * led) / max(np.sum(led * led), 1e-12))
        if not _RATIO[0] <= ratio <= _RATIO[1]:
            return name, (
                f"contradicts {position}, which changes {ratio:.3g} times as fast; write another "
                "unit, sign or column for one of them"
            )
    velocity = motion.stack(VELOCITY)
    needed = turn_bank(velocity, np.gradient(velocity, columns["t_s"], axis=0))
    square = float(np.sum(needed * needed))
    if "roll_rad" in columns and square > _MIN_BANK**2 * len(needed):
        ratio = float(np.sum(needed * columns["roll_rad"])) / square
        if ratio < -_MIN_SHARE:
            return "roll_rad", "is to the left in turns to the right; write the other sign"
    if "yaw_rad" not in columns:
        return None
    heading = columns["yaw_rad"] - course(velocity)
    mean = float(np.angle(np.mean(np.exp(1j * wrap_pi(heading)))))
    if abs(mean) > _MAX_YAW_ERROR:
        return "yaw_rad", (
            f"is {np.degrees(mean):.0f}° from the course in the mean; yaw is clockwise from north: "
            "write another sign or column"
        )
    return None


def _out_of_range(values: Array, limits: Range) -> str:
    """Describe values (M,) out of a range, and what a map of columns should say instead."""
    high, low = float(values.max()), float(values.min())
    remedy = _OTHER_UNITS.get(limits.unit, "another unit or column")
    found = f"is up to {high:g}, above {limits.high:.4g}"
    worst = high
    if not high > limits.high + limits.slack:
        found, worst = f"is down to {low:g}, below {limits.low:.4g}", low
    return f"{found}; write {remedy}, or no_value: {worst:g} if this stands for no value"


def longest_section(motion: Motion, begin: float, end: float) -> tuple[Motion, tuple[str, ...]]:
    """Select the longest section without gaps between two times, and a note on others.

    Args:
        motion: rows at increasing times.
        begin: earliest t_s.
        end: latest t_s.

    Raises:
        InputError: there is none.
    """
    time = motion.columns["t_s"]
    inside = np.flatnonzero((time >= begin) & (time <= end))
    parts = np.split(inside, np.flatnonzero(np.diff(time[inside]) > MAX_GAP_S) + 1)
    parts = [part for part in parts if len(part) > 1]
    if not parts:
        raise InputError(
            f"no two rows between --from and --to are within {MAX_GAP_S:g} s; t_s is from "
            f"{time[0]:g} to {time[-1]:g}"
        )
    longest = max(parts, key=lambda part: float(time[part[-1]] - time[part[0]]))
    others = ", ".join(
        f"{time[part[0]]:.1f} to {time[part[-1]]:.1f}" for part in parts if part is not longest
    )
    note = f"the longest of {len(parts)} sections; --from and --to choose others: {others} s"
    return motion.rows(slice(longest[0], longest[-1] + 1)), (note,) if others else ()


def to_csv(motion: Motion) -> str:
    """Return the columns as the text of a CSV file."""
    text = io.StringIO()
    formats = [_FORMATS.get(name, ".6g") for name in motion.columns]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(motion.columns)
    for row in zip(*(values.tolist() for values in motion.columns.values()), strict=True):
        writer.writerow([f"{value:{form}}" for value, form in zip(row, formats, strict=True)])
    return text.getvalue()


def read_csv(path: Path) -> Motion:
    """Read a recording that `testbed import` wrote, or another one with columns of these names.

    Raises:
        InputError: it is no such file; the message has file, line and remedy.
    """
    table = read_table(path)
    names = [name for name in (*_COLUMNS, *COMMANDS, *PULSES) if name in table.header]
    if "t_s" not in names:
        raise table.error_at(0, "missing column t_s; `testbed import --columns MAP.yaml` makes it")
    numbers = table.numbers({name: RECORDED[name] for name in names})
    if len(numbers) < 2:
        raise InputError(f"{path}: {len(numbers)} rows of numbers; a flight needs at least two")
    table.check_time_steps(numbers[:, 0], np.inf, "")
    columns = dict(zip(names, numbers.T, strict=True))
    return with_known_positions(Motion(columns, dict.fromkeys(names, path.name)), str(path))


def with_known_positions(motion: Motion, file: str) -> Motion:
    """Leave out rows of a file at 0°, 0°, and wrap longitudes to −180° to 180°.

    Receivers write latitude and longitude 0 until they know their position.

    Raises:
        InputError: fewer than two rows are left.
    """
    if not motion.columns.keys() >= {*POSITION[:2]}:
        return motion
    known = has_position(*(motion.columns[name] for name in POSITION[:2]))
    found = motion.rows(known) if not known.all() else motion
    longitude = found.columns[POSITION[1]]
    if not RECORDED[POSITION[1]].outside(longitude).any():  # an error of the caller's
        longitude = wrap_longitude(longitude, DEGREES)
        found = replace(found, columns={**found.columns, POSITION[1]: longitude})
    missing = int(np.count_nonzero(~known))
    if missing > len(known) - 2:
        raise InputError(
            f"{file}: {POSITION[0]} and {POSITION[1]} are 0 in {missing} of {len(known)} rows: the "
            "receiver knew no position (name columns of another source)"
        )
    if missing:
        at = motion.columns["t_s"][~known]
        note = (
            "rows at latitude and longitude 0, where the receiver knew no position, are left out: "
            f"{missing}, t_s {at[0]:g} to {at[-1]:g}"
        )
        found = replace(found, notes=(*found.notes, note))
    return found
