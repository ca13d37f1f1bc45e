"""Import of real flights: from a flight log to a recording for replay."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, open_regular
from testbed.core.records import Array
from testbed.mavlink import dataflash, tlog_flight
from testbed.mavlink.codec import MavlinkError, decode, frame_length
from testbed.mavlink.flight_log import (
    MODES,
    RAD_PER_DEG,
    FlightLog,
    LogSeries,
    MessageTable,
    Unavailable,
    first_available,
    longest_gap,
    mode_name,
    resample,
)
from testbed.mavlink.tlog import has_records

COMMANDS = ("theta_cmd_rad", "phi_cmd_rad", "throttle_cmd")
REQUIRED = (*COMMANDS, "phi_rad", "theta_rad", "psi_rad")
ANY = "any"
_MAX_GAP = 1.0  # s without attitude, at which an interval ends
_MIN_THROTTLE = 0.01  # largest throttle that is doubted
_MAX_SPEED = 350.0  # m/s of any aircraft
_MIN_COSINE = 0.1  # of 84°, in the restoration of commands
_HEAD_BYTES = 65536  # in which a tlog is recognised
_OTHER_FORMATS = {
    b"ULog": "a PX4 ULog",
    b"\x89MCAP": "an MCAP log (testbed view shows one)",
    b"FMT,": "a DataFlash log as text; give the .bin it was made from",
    b"\x1f\x8b": "compressed; unpack it first",
    b"PK\x03\x04": "a ZIP archive; unpack it first",
}


@dataclass(frozen=True, slots=True)
class ImportedFlight:
    """An interval of a flight, as columns of a recording.

    Attributes:
        columns: by name, t_s first; each (M,), M the number of attitude messages.
        sources: message and field of each column.
        missing: by column that the log does not have, the reason and the remedy.
        notes: about data quality.
        modes: flight modes in the interval.
    """

    columns: Mapping[str, Array]
    sources: Mapping[str, str]
    missing: Mapping[str, str]
    notes: tuple[str, ...]
    modes: tuple[str, ...]


def read_flight(
    path: Path,
    *,
    system: int | None = None,
    begin: float = -math.inf,
    end: float = math.inf,
    mode: str = "FBWA",
) -> ImportedFlight:
    """Read the longest interval in one mode, without gaps, of a .bin or .tlog.

    Times are s: in a .bin from the boot of the autopilot, in a .tlog from its first record.

    Args:
        path: the log; its content, not its name, decides on the format.
        system: id of the vehicle in a .tlog.
        begin: earliest time.
        end: latest time.
        mode: of ArduPlane, e.g. FBWA; `any`.

    Raises:
        MavlinkError: the file cannot be read, or does not contain such a flight.
    """
    log = _read_log(path, system)
    attitude = log.tables.get(log.attitude)
    if attitude is None:
        raise MavlinkError(f"{path}: no {log.attitude}; {log.remedy}")
    series, missing = _read_columns(log)
    time, other = _longest_interval(log, attitude, begin, end, mode, series)
    for name, one in list(series.items()):
        if (flown := _of_same_flight(log, one, time)) is None:
            reason = f"{one.source} has no value in the flight from {time[0]:.1f} s on"
            if name in REQUIRED:
                raise MavlinkError(f"{path}: {reason}, so no {name}; {log.remedy}")
            missing[name] = f"{reason}; {log.remedy}"
            del series[name]
        else:
            series[name] = flown
    restored, pitch_down_known = _restore_commands(log, series)
    columns = {"t_s": time} | {name: resample(one, time) for name, one in restored.items()}
    columns["throttle_cmd"] = np.clip(columns["throttle_cmd"], 0.0, 1.0)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * math.pi)
    sources = {name: one.source for name, one in restored.items()}
    notes = (*log.notes, *other, *_notes(log, series, time, pitch_down_known))
    return ImportedFlight(columns, sources, missing, notes, _modes(log, time))


def _read_log(path: Path, system: int | None) -> FlightLog:
    """Read a log of either kind."""
    with open_regular(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError) as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(dataflash.SIGNATURE):
        if system is not None:
            raise MavlinkError(f"--system {system}: {path} is of one vehicle; leave it out")
        return dataflash.read_log(path)
    if has_records(head):
        return tlog_flight.read_log(path, system)
    names = (name for magic, name in _OTHER_FORMATS.items() if head.startswith(magic))
    found = next(names, "neither")
    if not head:
        found = "empty"
    elif decode(head[: frame_length(head, 0)]):
        found = "MAVLink without times"
    raise MavlinkError(
        f"{path}: this is {found}; give a DataFlash log of ArduPlane (.bin) or a telemetry log "
        "(.tlog)"
    )


def _read_columns(log: FlightLog) -> tuple[dict[str, LogSeries], dict[str, str]]:
    """Read all columns, and explain the missing ones.

    Raises:
        MavlinkError: a command or attitude is missing.
    """
    series, missing = {}, {}
    for name, sources in log.columns.items():
        try:
            series[name] = first_available(log, sources)
        except Unavailable as reason:
            if name in REQUIRED:
                raise MavlinkError(f"{log.path}: {reason}, so no {name}; {log.remedy}") from None
            missing[name] = f"{reason}; {log.remedy}"
    return series, missing


def _flight_numbers(log: FlightLog, time: Array) -> NDArray[np.int64]:
    """Count the starts of the vehicle's clock before each time (M,)."""
    return np.searchsorted(log.clock_starts, time, side="right")


def _of_same_flight(log: FlightLog, series: LogSeries, time: Array) -> LogSeries | None:
    """Take the values of the flight that has these times; None: there are none."""
    same = _flight_numbers(log, series.time) == _flight_numbers(log, time[:1])
    if not same.any():
        return None
    return replace(series, time=series.time[same], values=series.values[same])


def _longest_interval(
    log: FlightLog,
    attitude: MessageTable,
    begin: float,
    end: float,
    mode: str,
    series: Mapping[str, LogSeries],
) -> tuple[Array, tuple[str, ...]]:
    """Find the times of the longest interval with commands, and a note on others."""
    number = None if mode == ANY else _mode_number(mode)
    time = attitude.time[np.concatenate([[True], np.diff(attitude.time) > 0.0])]
    wanted = (time >= begin) & (time <= end)
    flight = _flight_numbers(log, time)
    for name in COMMANDS:
        known = series[name].time
        latest = np.searchsorted(known, time, side="right") - 1
        wanted &= (latest >= 0) & (_flight_numbers(log, known)[np.maximum(latest, 0)] == flight)
    if number is not None:
        in_mode = np.zeros(len(time), dtype=bool)
        for interval in log.modes:
            if interval.mode == number:
                in_mode |= (time >= interval.start) & (time <= interval.end)
        wanted &= in_mode
    where = np.flatnonzero(wanted)
    pause = np.diff(time[where]) > _MAX_GAP
    other_flight = np.diff(flight[where]) > 0
    breaks = np.flatnonzero((np.diff(where) > 1) | pause | other_flight) + 1
    intervals = [part for part in np.split(time[where], breaks) if len(part) > 1]
    if not intervals:
        raise MavlinkError(_no_interval(log, time, mode))
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


def _mode_number(mode: str) -> int:
    for number, name in MODES.items():
        if name == mode.upper():
            return number
    raise MavlinkError(f"--mode {mode}: write any, or one of {', '.join(MODES.values())}")


def _no_interval(log: FlightLog, time: Array, mode: str) -> str:
    modes = ", ".join(f"{mode_name(m.mode)} {m.start:.1f} to {m.end:.1f}" for m in log.modes)
    return (
        f"{log.path}: nothing in {mode} between --from and --to; it has attitude from "
        f"{time[0]:.1f} to {time[-1]:.1f} s and the modes {modes or '(none logged)'}; write "
        "another --mode, or --mode any"
    )


def _modes(log: FlightLog, time: Array) -> tuple[str, ...]:
    modes = [m.mode for m in log.modes if m.start < time[-1] and m.end > time[0]]
    return tuple(mode_name(mode) for mode in dict.fromkeys(modes))


def _restore_commands(
    log: FlightLog, series: Mapping[str, LogSeries]
) -> tuple[dict[str, LogSeries], bool]:
    """Restore commands from logged demands, which ArduPlane reduced and a replay reduces again.

    Roll was multiplied by the cosine of the pitch. A pitch below zero was multiplied by the cosine
    of the roll; then STAB_PITCH_DOWN was subtracted.

    Returns:
        The series, and whether the parameters of STAB_PITCH_DOWN are in the log.
    """
    roll, pitch = series["phi_cmd_rad"], series["theta_cmd_rad"]
    commands = pitch.values
    source = pitch.source
    throttle = np.clip(resample(series["throttle_cmd"], pitch.time), 0.0, 1.0)
    pitch_down = _pitch_down(log, throttle)
    if pitch_down is not None:
        commands = commands + pitch_down
        source += " + STAB_PITCH_DOWN"
    nose_down = commands / _cosine(resample(series["phi_rad"], pitch.time))
    return {
        **series,
        "phi_cmd_rad": replace(
            roll, values=roll.values / _cosine(resample(series["theta_rad"], roll.time))
        ),
        "theta_cmd_rad": replace(
            pitch, source=source, values=np.where(commands < 0.0, nose_down, commands)
        ),
    }, pitch_down is not None


def _cosine(angle: Array) -> Array:
    """Compute the magnitude of a cosine; a lower bound keeps quotients finite."""
    return np.maximum(np.abs(np.cos(angle)), _MIN_COSINE)


def _pitch_down(log: FlightLog, throttle: Array) -> Array | None:
    """Compute what STAB_PITCH_DOWN subtracted from the logged pitch demand, rad.

    None: its parameters are not in the log.
    """
    down = log.params.get("STAB_PITCH_DOWN")
    trim = log.params.get("TRIM_THROTTLE")
    if down is None or not trim:
        return None
    return RAD_PER_DEG * down * np.maximum(1.0 - 100.0 * throttle / trim, 0.0)


def _notes(
    log: FlightLog, series: Mapping[str, LogSeries], time: Array, pitch_down: bool
) -> tuple[str, ...]:
    notes = []
    for name, one in series.items():
        gap = longest_gap(one, time)
        if one.held and name in COMMANDS and _period(one.time) > 2.0 * _period(time):
            notes.append(
                f"{name}: {one.source} came {1.0 / _period(one.time):.3g} times a second; a step "
                f"may be {gap:.2g} s late"
            )
        elif gap > _MAX_GAP:
            notes.append(f"{name}: {one.source} has gaps of up to {gap:.1f} s")
    throttle = series["throttle_cmd"]
    if 0.0 < float(np.max(throttle.values)) <= _MIN_THROTTLE:
        notes.append(
            f"throttle_cmd never exceeds 1 %: {throttle.source} may be a share of 1 instead of per "
            "cent, as of other vehicles"
        )
    altitude = resample(series["altitude_m"], time) if "altitude_m" in series else time * 0.0
    jumps = int(np.count_nonzero(np.abs(np.diff(altitude)) > _MAX_SPEED * np.diff(time)))
    if jumps:
        notes.append(
            f"altitude_m: {series['altitude_m'].source} changes {jumps} times faster than "
            f"{_MAX_SPEED:.0f} m/s"
        )
    if not pitch_down:
        notes.append(
            "STAB_PITCH_DOWN and TRIM_THROTTLE are not in the log: the pitch demand is as logged, "
            "reduced by STAB_PITCH_DOWN; replay it with a tune in which STAB_PITCH_DOWN is 0"
        )
    if not any(name.startswith("SERVO") for name in log.params):
        notes.append(
            "SERVOn_ parameters are not in the log: outputs 1 to 4 are taken for aileron, "
            "elevator, throttle, rudder, with their pulses as logged"
        )
    if rate_hz := log.params.get("SIM_RATE_HZ"):
        notes.append(
            f"the log is of SITL, SIM_RATE_HZ {rate_hz:g}, whose gyro filter depends on that rate: "
            f"respond --sitl-rate {rate_hz:g}"
        )
    with suppress(Unavailable):
        above_sea, above_home = (source(log) for source in log.home)
        height = resample(above_sea, time[:1])[0] - resample(above_home, time[:1])[0]
        notes.append(
            f"home is {height:.0f} m above sea level: respond --origin-elevation {height:.0f}"
        )
    return tuple(notes)


def _period(time: Array) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else math.inf


def write_flight(flight: ImportedFlight, write: Callable[[str], object]) -> None:
    """Write a flight as CSV."""
    write(",".join(flight.columns) + "\n")
    numbers = [values.tolist() for values in flight.columns.values()]
    for t, *row in zip(*numbers, strict=True):
        write(",".join([f"{t:.10g}", *(f"{value:.6g}" for value in row)]) + "\n")
