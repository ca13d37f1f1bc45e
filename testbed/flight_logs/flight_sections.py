"""Which rows of a flight log are imported: intervals in a flight mode, without gaps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.records import Array, BoolArray
from testbed.flight_logs.flight_log import (
    Firmware,
    FlightLog,
    LogSeries,
    MessageTable,
    mode_name,
)
from testbed.flight_logs.log_position import LogPosition
from testbed.mavlink.codec import MavlinkError

COMMANDS = ("theta_cmd_rad", "phi_cmd_rad", "throttle_cmd")
ANY = "any"
MAX_GAP = 1.0  # s without attitude, at which an interval ends


def longest_interval(
    log: FlightLog,
    attitude: MessageTable,
    begin: float,
    end: float,
    mode: str,
    series: Mapping[str, LogSeries],
) -> tuple[Array, tuple[str, ...]]:
    """Find the times of the longest interval with commands, and a note on others."""
    time, wanted = _wanted(log, attitude, begin, end, mode)
    flight = log.flight_numbers(time)
    for name in COMMANDS:
        if name not in series:
            continue
        known = series[name].time
        latest = np.searchsorted(known, time, side="right") - 1
        wanted &= (latest >= 0) & (log.flight_numbers(known)[np.maximum(latest, 0)] == flight)
    where = np.flatnonzero(wanted)
    pause = np.diff(time[where]) > MAX_GAP
    other_flight = np.diff(flight[where]) > 0
    breaks = np.flatnonzero((np.diff(where) > 1) | pause | other_flight) + 1
    intervals = [part for part in np.split(time[where], breaks) if len(part) > 1]
    if not intervals:
        raise MavlinkError(_no_interval(log, time, mode, begin, end))
    longest = max(intervals, key=lambda part: float(part[-1] - part[0]))
    others = ", ".join(
        f"{part[0]:.1f} to {part[-1]:.1f}" for part in intervals if part is not longest
    )
    starts = ", ".join(f"{start:.1f}" for start in log.clock_starts)
    restarts = (
        f"the vehicle's clock starts again at {starts} s, after a reboot or with another vehicle "
        "of this id; one flight is used"
    )
    note = f"the longest of {len(intervals)} intervals; --from and --to choose others: {others} s"
    return longest, (*([note] if others else []), *([restarts] if starts else []))


def _wanted(
    log: FlightLog, attitude: MessageTable, begin: float, end: float, mode: str
) -> tuple[Array, BoolArray]:
    """Return the times (M,) of the attitudes, and which are in the mode and between the ends."""
    number = None if mode == ANY else _mode_number(mode, log.firmware)
    time = attitude.time[np.concatenate([[True], np.diff(attitude.time) > 0.0])]
    wanted = (time >= begin) & (time <= end)
    if number is not None:
        in_mode = np.zeros(len(time), dtype=bool)
        for interval in log.modes:
            if interval.mode == number:
                in_mode |= (time >= interval.start) & (time <= interval.end)
        wanted &= in_mode
    return time, wanted


def all_rows(
    log: FlightLog,
    attitude: MessageTable,
    begin: float,
    end: float,
    mode: str,
    position: LogPosition,
) -> Array:
    """Find the times with a known position of the flight that has most of them."""
    time, wanted = _wanted(log, attitude, begin, end, mode)
    wanted &= position.near(time)
    flight = log.flight_numbers(time)
    if np.count_nonzero(wanted) < 2:
        raise MavlinkError(_no_interval(log, time, mode, begin, end))
    most = int(np.argmax(np.bincount(flight[wanted])))
    found: Array = time[wanted & (flight == most)]
    return found


def without_ends(time: Array, position: LogPosition) -> Array:
    """Leave out rows (M,) before the first position and after the last, if they are few."""
    known = (time >= position.time[0]) & (time <= position.time[-1])
    inside: Array = time[known]
    few = len(inside) > 1 and inside[0] - time[0] < MAX_GAP and time[-1] - inside[-1] < MAX_GAP
    return inside if few else time


def _no_interval(log: FlightLog, time: Array, mode: str, begin: float, end: float) -> str:
    modes = ", ".join(
        f"{mode_name(m.mode, log.firmware)} {m.start:.1f} to {m.end:.1f}" for m in log.modes
    )
    between = " between --from and --to" if np.isfinite([begin, end]).any() else ""
    return (
        f"{log.path}: nothing in {mode} mode{between}; it has attitude from "
        f"{time[0]:.1f} to {time[-1]:.1f} s and the modes {modes or '(none logged)'}; write "
        "another --mode, or --mode any"
    )


def modes_between(log: FlightLog, time: Array) -> tuple[str, ...]:
    """Return the names of the modes in the rows at times (M,)."""
    modes = [m.mode for m in log.modes if m.start < time[-1] and m.end > time[0]]
    return tuple(mode_name(mode, log.firmware) for mode in dict.fromkeys(modes))


def _mode_number(mode: str, firmware: Firmware) -> int:
    for number, name in firmware.modes.items():
        if name == mode.upper():
            return number
    raise MavlinkError(f"--mode {mode}: write any, or one of {', '.join(firmware.modes.values())}")
