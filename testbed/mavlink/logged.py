"""What a flight log says, whichever kind it is, and how columns are drawn from its messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array

RADIAN = math.pi / 180.0
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
}  # of ArduPlane; those in which a wing flies
_DAMAGED = 1.0  # s between a time and those around it
_ISA_PER_METRE, _ISA_POWER = 2.25577e-5, 4.25588  # of air density, troposphere


@dataclass(frozen=True, slots=True)
class Rows:
    """All messages of one name: M of them, in the order of their times."""

    time: Array  # (M,) s
    fields: Mapping[str, Array]  # (M,) each


@dataclass(frozen=True, slots=True)
class Span:
    """A time in which a mode was flown, s."""

    mode: int
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class Series:
    """A column before it is laid on the rows of the attitude."""

    source: str  # the message and field it came from
    time: Array  # (M,) s
    values: Array  # (M,) in the column's unit
    held: bool = False  # each value holds until the next; otherwise a line joins them


Draw = Callable[["Log"], Series | None]


@dataclass(frozen=True, slots=True)
class Log:
    """A flight of one vehicle.

    Attributes:
        rows: by message; only what columns can be drawn from.
        params: by name, as they were last told.
        spans: of modes, in order.
        notes: what was damaged or doubtful.
        remedy: how a message that is missing gets into such a log.
        home: draw altitudes above sea level and above home, m.
    """

    path: Path
    rows: Mapping[str, Rows]
    params: Mapping[str, float]
    spans: tuple[Span, ...]
    notes: tuple[str, ...]
    remedy: str
    home: tuple[Draw, Draw]


def in_order(time: Array) -> NDArray[np.bool_]:
    """Which of these times (M,) to keep so that they never run backwards.

    One that is far from both its neighbours is a damaged one, and takes no others with it.
    """
    if len(time) > 2:
        around = np.pad(time, 1, mode="reflect")
        middle = np.median(np.stack([around[:-2], time, around[2:]]), axis=0)
        sound = np.abs(time - middle) <= _DAMAGED
    else:
        sound = np.isfinite(time)
    latest = np.maximum.accumulate(np.where(sound, time, -np.inf))
    keep: NDArray[np.bool_] = sound & (time >= latest)
    return keep


def mode_name(mode: int) -> str:
    """What ArduPlane calls a mode."""
    return MODES.get(mode, f"mode {mode}")


def entry(message: str, name: str, scale: float = 1.0, *, held: bool = False) -> Draw:
    """Draw a column from one field; messages in which it is not a number are left out."""

    def draw(log: Log) -> Series | None:
        rows = log.rows.get(message)
        values = None if rows is None else rows.fields.get(name)
        if rows is None or values is None:
            return None
        known = np.isfinite(values)
        if not known.any():
            return None
        return Series(f"{message}.{name}", rows.time[known], scale * values[known], held)

    return draw


def changed(draw: Draw, change: Callable[[Array], Array], said: str) -> Draw:
    """Draw what another does and change its values; `said` tells the source, {} the other's."""

    def drawn(log: Log) -> Series | None:
        series = draw(log)
        if series is None:
            return None
        return Series(said.format(series.source), series.time, change(series.values), series.held)

    return drawn


def true_airspeed(equivalent: Draw, ratios: tuple[Draw, ...], altitudes: tuple[Draw, ...]) -> Draw:
    """Draw true airspeed from equivalent.

    Args:
        equivalent: m/s.
        ratios: true over equivalent airspeed, where the autopilot logged it.
        altitudes: m above sea level, for the standard atmosphere's ratio otherwise.
    """

    def draw(log: Log) -> Series | None:
        series = equivalent(log)
        if series is None:
            return None
        for ratio in ratios:
            if (known := ratio(log)) and (known.values > 0.5).all():
                factor, how = np.interp(series.time, known.time, known.values), known.source
                break
        else:
            for altitude in altitudes:
                if known := altitude(log):
                    height = np.interp(series.time, known.time, known.values)
                    factor = (1.0 - _ISA_PER_METRE * height) ** (-0.5 * _ISA_POWER)
                    how = f"the standard atmosphere at {known.source}"
                    break
            else:
                factor, how = np.ones_like(series.time), "1, for want of an altitude"
        return Series(f"{series.source} × {how}", series.time, series.values * factor)

    return draw


def first(log: Log, draws: tuple[Draw, ...]) -> Series | None:
    """The first of these that the log has."""
    for draw in draws:
        if series := draw(log):
            return series
    return None


def laid(series: Series, time: Array) -> Array:
    """The series at these times (M,); before its first value and after its last these hold."""
    if series.held:
        latest = np.searchsorted(series.time, time, side="right") - 1
        return series.values[np.maximum(latest, 0)]
    return np.interp(time, series.time, series.values)


def longest_gap(series: Series, time: Array) -> float:
    """The longest time in s between two values, or one and an end of `time`, within `time`."""
    inside = series.time[(series.time > time[0]) & (series.time < time[-1])]
    before = series.time[series.time <= time[0]][-1:]
    after = series.time[series.time >= time[-1]][:1]
    begin = before if len(before) else time[:1]
    end = after if len(after) else time[-1:]
    return float(np.max(np.diff(np.concatenate([begin, inside, end])), initial=0.0))
