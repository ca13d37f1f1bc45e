"""Flight logs in one form, and sources of recording columns in their messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.mavlink.codec import MavlinkError

RAD_PER_DEG = math.pi / 180.0
MODES = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    15: "GUIDED",
    24: "THERMAL",
    26: "AUTOLAND",
}  # of ArduPlane; those without hovering
_MAX_TIME_ERROR = 1.0  # s between a time and the median of it and its neighbours
_MIN_ORDERED = 0.75  # of the attitude messages
_ISA_PER_METRE, _ISA_POWER = 2.25577e-5, 4.25588  # of air density, troposphere


@dataclass(frozen=True, slots=True)
class MessageTable:
    """All M messages of one name, in order of time."""

    time: Array  # (M,) s
    fields: Mapping[str, Array]  # (M,) each


@dataclass(frozen=True, slots=True)
class ModeInterval:
    """An interval in one flight mode, s."""

    mode: int
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class LogSeries:
    """A column at the times of its messages."""

    source: str  # message and field
    time: Array  # (M,) s
    values: Array  # (M,) in the unit of the column
    held: bool = False  # values hold until the next; False: they are interpolated linearly


class Unavailable(Exception):
    """The reason why a log does not have a column."""


ColumnSource = Callable[["FlightLog"], LogSeries]  # raises Unavailable


class PositionFields(NamedTuple):
    """Fields of a message that has a position, with their scales to degrees and m."""

    message: str
    latitude: str
    longitude: str
    height: str  # above sea level
    angle_scale: float = 1.0
    height_scale: float = 1.0


class Firmware(NamedTuple):
    """What differs between the logs of autopilots.

    Attributes:
        modes: names by number.
        default_mode: of the flight that is imported.
        pitch_note: on commands, where the log does not have the parameters of STAB_PITCH_DOWN.
        servo_note: on servo outputs, where the log does not have their parameters; "": none.
    """

    modes: Mapping[int, str]
    default_mode: str
    pitch_note: str
    servo_note: str = ""


ARDUPLANE = Firmware(
    MODES,
    "FBWA",
    pitch_note=(
        "STAB_PITCH_DOWN and TRIM_THROTTLE are not in the log: the pitch demand is as logged, "
        "reduced by STAB_PITCH_DOWN; replay it with a tune in which STAB_PITCH_DOWN is 0"
    ),
    servo_note=(
        "SERVOn_ parameters are not in the log: outputs 1 to 4 are taken for aileron, elevator, "
        "throttle, rudder, with their pulses as logged"
    ),
)


class MotionSources(NamedTuple):
    """Where a kind of log has positions, velocities and UNIX times, the preferred source first.

    Attributes:
        positions: messages with positions.
        north: sources of the velocity to the north, m/s.
        east: of that to the east.
        unix: of UNIX time minus log time, s.
        wind_north: of the estimated wind to the north, m/s.
        wind_east: of that to the east.
    """

    positions: tuple[PositionFields, ...]
    north: tuple[ColumnSource, ...]
    east: tuple[ColumnSource, ...]
    unix: tuple[ColumnSource, ...]
    wind_north: tuple[ColumnSource, ...]
    wind_east: tuple[ColumnSource, ...]


@dataclass(frozen=True, slots=True)
class FlightLog:
    """A log of one vehicle, of any kind.

    Attributes:
        path: the file.
        tables: by message; only messages that columns are read from.
        params: latest values by name.
        modes: in order of time.
        notes: about damage and doubtful data.
        attitude: name of the attitude message, at whose times columns are sampled.
        columns: sources of each column, the preferred one first.
        remedy: how to get a missing message into such a log.
        home: sources of the altitudes above sea level and above home, m.
        motion: sources of positions, ground velocities and UNIX time.
        clock_starts: times at which the vehicle's clock started again, s: another flight, of this
            aircraft or of another one.
        receiver_start_unix_s: UNIX time of log time 0 by the clock of the receiver; None: the
            autopilot wrote the log.
        firmware: of the autopilot.
    """

    path: Path
    tables: Mapping[str, MessageTable]
    params: Mapping[str, float]
    modes: tuple[ModeInterval, ...]
    notes: tuple[str, ...]
    attitude: str
    columns: Mapping[str, tuple[ColumnSource, ...]]
    remedy: str
    home: tuple[ColumnSource, ColumnSource]
    motion: MotionSources
    clock_starts: tuple[float, ...] = ()
    receiver_start_unix_s: float | None = None
    firmware: Firmware = ARDUPLANE

    def flight_numbers(self, time: Array) -> NDArray[np.int64]:
        """Count the starts of the vehicle's clock before each time (M,)."""
        return np.searchsorted(self.clock_starts, time, side="right")

    def of_same_flight(self, series: LogSeries, time: Array) -> LogSeries | None:
        """Take the values of the flight that has these times; None: there are none."""
        same = self.flight_numbers(series.time) == self.flight_numbers(time[:1])
        if not same.any():
            return None
        return replace(series, time=series.time[same], values=series.values[same])


def increasing(time: Array) -> NDArray[np.bool_]:
    """Mask the times (M,) to keep so that they do not decrease.

    A time that is far from both neighbours is damaged and removed alone.
    """
    valid = undamaged(time)
    latest = np.maximum.accumulate(np.where(valid, time, -np.inf))
    keep: NDArray[np.bool_] = valid & (time >= latest)
    return keep


def undamaged(time: Array) -> NDArray[np.bool_]:
    """Mask the times (M,) that are close to one of their neighbours."""
    valid: NDArray[np.bool_]
    if len(time) > 2:
        around = np.pad(time, 1, mode="reflect")
        middle = np.median(np.stack([around[:-2], time, around[2:]]), axis=0)
        valid = np.abs(time - middle) <= _MAX_TIME_ERROR
    else:
        valid = np.isfinite(time)
    return valid


def check_order(path: Path, attitude: str, kept: int, total: int) -> None:
    """Check that the attitudes have one clock.

    Args:
        path: the log.
        attitude: name of the message.
        kept: messages whose times increase.
        total: all messages.

    Raises:
        MavlinkError: too many times are out of order.
    """
    if kept < _MIN_ORDERED * total:
        raise MavlinkError(
            f"{path}: {total - kept} of {total} times of {attitude} step back or jump: the log is "
            "damaged, or mixes several clocks; give a log of one vehicle"
        )


def order_notes(left_out: Mapping[str, int], mode: str) -> tuple[str, ...]:
    """Say how many messages of each name were left out because of their times.

    Args:
        left_out: counts by name.
        mode: name of the message that has the flight mode.
    """
    counts = ", ".join(f"{count} {name}" for name, count in left_out.items() if count)
    notes = [f"left out, because their times step back or jump: {counts}"] if counts else []
    if left_out.get(mode):
        notes.append(f"the flight mode is unknown from a {mode} that was left out to the next one")
    return tuple(notes)


def mode_name(mode: int, firmware: Firmware = ARDUPLANE) -> str:
    """Return the autopilot's name of a mode."""
    return firmware.modes.get(mode, f"mode {mode}")


def field_source(
    message: str, name: str, scale: float = 1.0, *, held: bool = False
) -> ColumnSource:
    """Make a source that reads one field, without messages in which it is not finite."""

    def source(log: FlightLog) -> LogSeries:
        table = log.tables.get(message)
        if table is None:
            raise Unavailable(f"no {message}")
        values = table.fields.get(name)
        if values is None:
            raise Unavailable(f"{message} has no {name}")
        valid = np.isfinite(values)
        if not valid.any():
            raise Unavailable(f"{message}.{name} is never a finite number")
        return LogSeries(f"{message}.{name}", table.time[valid], scale * values[valid], held)

    return source


def transformed_source(
    source: ColumnSource, function: Callable[[Array], Array], description: str
) -> ColumnSource:
    """Make a source that applies a function to another one's values.

    Args:
        source: the other one.
        function: of the values.
        description: of the result, with {} for the other source.
    """

    def transformed(log: FlightLog) -> LogSeries:
        series = source(log)
        text = description.format(series.source)
        return LogSeries(text, series.time, function(series.values), series.held)

    return transformed


def true_airspeed_source(
    equivalent: ColumnSource, ratio: ColumnSource, altitudes: tuple[ColumnSource, ...]
) -> ColumnSource:
    """Make a source of true airspeed.

    Args:
        equivalent: equivalent airspeed, m/s.
        ratio: true over equivalent airspeed, as logged by the autopilot.
        altitudes: m above sea level, for the ratio of the standard atmosphere if none is logged.
    """

    def source(log: FlightLog) -> LogSeries:
        series = equivalent(log)
        factor, origin = _airspeed_ratio(log, series.time, ratio, altitudes)
        return LogSeries(f"{series.source} × {origin}", series.time, series.values * factor)

    return source


def _airspeed_ratio(
    log: FlightLog, time: Array, ratio: ColumnSource, altitudes: tuple[ColumnSource, ...]
) -> tuple[Array, str]:
    """Return true over equivalent airspeed at times (M,), and where it comes from."""
    with suppress(Unavailable):
        known = ratio(log)
        if (known.values > 0.5).all():
            return np.interp(time, known.time, known.values), known.source
    with suppress(Unavailable):
        altitude = first_available(log, altitudes)
        height = np.interp(time, altitude.time, altitude.values)
        factor: Array = (1.0 - _ISA_PER_METRE * height) ** (-0.5 * _ISA_POWER)
        return factor, f"the standard atmosphere at {altitude.source}"
    return np.ones_like(time), "1, as no altitude is logged"


def no_source(log: FlightLog) -> LogSeries:
    """Provide no column."""
    raise Unavailable


def first_available(log: FlightLog, sources: tuple[ColumnSource, ...]) -> LogSeries:
    """Read the first of these sources that the log has.

    Raises:
        Unavailable: it has none, for all these reasons.
    """
    reasons = []
    for source in sources:
        try:
            return source(log)
        except Unavailable as error:
            reasons.append(str(error))
    raise Unavailable(", ".join(dict.fromkeys(reasons)))


def resample(series: LogSeries, time: Array) -> Array:
    """Sample a series at times (M,); outside its times its first and last values hold."""
    if series.held:
        latest = np.searchsorted(series.time, time, side="right") - 1
        return series.values[np.maximum(latest, 0)]
    return np.interp(time, series.time, series.values)


def longest_gap(series: LogSeries, time: Array) -> float:
    """Return the longest time, s, without a value of the series within `time`."""
    inside = series.time[(series.time > time[0]) & (series.time < time[-1])]
    before = series.time[series.time <= time[0]][-1:]
    after = series.time[series.time >= time[-1]][:1]
    start = before if len(before) else time[:1]
    end = after if len(after) else time[-1:]
    return float(np.max(np.diff(np.concatenate([start, inside, end])), initial=0.0))
