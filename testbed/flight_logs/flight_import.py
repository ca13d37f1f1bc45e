"""Import of real flights: from a flight log to a recording for replay."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, open_regular
from testbed.core.records import Array
from testbed.flight_logs import dataflash, px4_flight, tlog_flight, ulog_file
from testbed.flight_logs.flight_log import (
    RAD_PER_DEG,
    FlightLog,
    LogSeries,
    Unavailable,
    first_available,
    longest_gap,
    resample,
)
from testbed.flight_logs.flight_sections import (
    ANY,
    COMMANDS,
    MAX_GAP,
    all_rows,
    longest_interval,
    modes_between,
    without_ends,
)
from testbed.flight_logs.log_position import (
    UNIX,
    home_height,
    read_positions,
    read_wind_estimate,
    sample_motion,
    unix_time,
)
from testbed.mavlink.codec import MavlinkError, decode, frame_length
from testbed.mavlink.tlog import has_records

ATTITUDES = ("phi_rad", "theta_rad", "psi_rad")
REQUIRED = (*COMMANDS, *ATTITUDES)
_MIN_THROTTLE = 0.01  # largest throttle that is doubted
_MAX_SPEED = 350.0  # m/s of any aircraft
_MIN_COSINE = 0.1  # of 84°, in the restoration of commands
_HEAD_BYTES = 65536  # in which a tlog is recognised
_OTHER_FORMATS = {
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
        no_position: why the columns of `POSITION` are left out; "" if they are there.
        home_m: height of home above sea level; None: not known.
    """

    columns: Mapping[str, Array]
    sources: Mapping[str, str]
    missing: Mapping[str, str]
    notes: tuple[str, ...]
    modes: tuple[str, ...]
    no_position: str = ""
    home_m: float | None = None
    rates_hz: Mapping[str, float] = field(default_factory=dict)  # of the messages of each column


def read_flight(
    path: Path,
    *,
    system: int | None = None,
    begin: float = -math.inf,
    end: float = math.inf,
    mode: str | None = None,
) -> ImportedFlight:
    """Read the longest interval in one mode, without gaps, of a .bin, .tlog or .ulg.

    Times are s: in a .bin and a .ulg from the boot of the autopilot, in a .tlog from its first
    record.

    Args:
        path: the log; its content, not its name, decides on the format.
        system: id of the vehicle in a .tlog.
        begin: earliest time.
        end: latest time.
        mode: of the autopilot, e.g. FBWA; `any`. None: FBWA of ArduPlane, any of PX4.

    Raises:
        MissingExtraError: the library for such logs is not installed.
        MavlinkError: the file cannot be read, or does not contain such a flight.
    """
    return _import_flight(_read_log(path, system), begin, end, mode, motion=False)


def read_motions(
    path: Path, systems: Sequence[int] = (), *, mode: str = ANY
) -> dict[int | None, ImportedFlight]:
    """Read all rows with a known position of several vehicles, gaps between them or not.

    Commands are not needed.

    Args:
        path: a .tlog, or a .bin or .ulg of one vehicle.
        systems: of the .tlog; empty: all.
        mode: of the autopilot, or `any`.

    Returns:
        The flights by system; None of a log of one vehicle.

    Raises:
        MavlinkError: see `read_flight`.
    """
    logs: dict[int | None, FlightLog] = {}
    if _check_kind(path) != "tlog":
        logs = {None: _read_log(path, next(iter(systems), None))}
    else:
        contents = tlog_flight.read_contents(path)
        found = systems or contents.systems or (None,)
        logs = {system: tlog_flight.make_log(contents, system) for system in found}
        if len(logs) > 1:  # the others are wanted, too
            logs = {n: replace(log, notes=_without_senders(log.notes)) for n, log in logs.items()}
    ends = -math.inf, math.inf
    return {n: _import_flight(log, *ends, mode, motion=True) for n, log in logs.items()}


def _without_senders(notes: Sequence[str]) -> tuple[str, ...]:
    return tuple(note for note in notes if not note.startswith(tlog_flight.OTHER_SENDERS))


def _import_flight(
    log: FlightLog, begin: float, end: float, mode: str | None, *, motion: bool
) -> ImportedFlight:
    """Read columns of a log; see `read_flight`, and `read_motions` with `motion`."""
    path = log.path
    mode = log.firmware.default_mode if mode is None else mode
    attitude = log.tables.get(log.attitude)
    if attitude is None:
        raise MavlinkError(f"{path}: no {log.attitude}; {log.remedy}")
    position, no_position = None, ""
    try:
        position = read_positions(log, log.motion)
    except Unavailable as error:
        no_position = f"{error}; {log.remedy}"
        if motion:
            raise MavlinkError(f"{path}: {no_position}") from None
    series, missing = _read_columns(log, needed=ATTITUDES if position else REQUIRED)
    other: tuple[str, ...] = ()
    if motion and position is not None:
        time = all_rows(log, attitude, begin, end, mode, position)
    else:
        time, other = longest_interval(log, attitude, begin, end, mode, series)
        time = time if position is None else without_ends(time, position)
    for name, one in list(series.items()):
        if (flown := log.of_same_flight(one, time)) is None:
            reason = f"{one.source} has no value in the flight from {time[0]:.1f} s on"
            if name in ATTITUDES or (name in COMMANDS and position is None):
                raise MavlinkError(f"{path}: {reason}, so no {name}; {log.remedy}")
            missing[name] = f"{reason}; {log.remedy}"
            del series[name]
        else:
            series[name] = flown
    series |= read_wind_estimate(log, time)
    rates_hz = {name: rate for name, one in series.items() if (rate := _rate(one.time, time))}
    restored, pitch_down_known = _restore_commands(log, series)
    columns = {"t_s": time} | {name: resample(one, time) for name, one in restored.items()}
    if "throttle_cmd" in columns:
        columns["throttle_cmd"] = np.clip(columns["throttle_cmd"], 0.0, 1.0)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * math.pi)
    sources = {name: one.source for name, one in restored.items()}
    notes = [*log.notes, *other]
    if position is not None and position.preferred:
        notes.append(f"{position.preferred}: {position.source} is used in its place")
    if not motion:
        notes += _notes(log, series, time, pitch_down_known)
    if position is not None:
        try:
            added, where = sample_motion(log, position, series.get("v_down_mps"), time)
        except Unavailable as error:
            no_position = str(error)
        else:
            unix, clock, note = unix_time(log, time)
            notes += note
            columns |= added
            sources |= where
            if unix is not None:
                columns[UNIX], sources[UNIX] = unix, clock
    return ImportedFlight(
        columns,
        sources,
        missing,
        tuple(notes),
        modes_between(log, time),
        no_position,
        home_height(log, time),
        rates_hz,
    )


def _read_log(path: Path, system: int | None) -> FlightLog:
    kind = _check_kind(path)
    if kind != "tlog":
        if system is not None:
            raise MavlinkError(f"--system {system}: {path} is of one vehicle; leave it out")
        return dataflash.read_log(path) if kind == "bin" else px4_flight.read_log(path)
    return tlog_flight.make_log(tlog_flight.read_contents(path), system)


def _check_kind(path: Path) -> str:
    """Return "bin", "tlog" or "ulg", by the content of a file.

    Raises:
        MavlinkError: it is none of them.
    """
    with open_regular(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError) as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(dataflash.SIGNATURE):
        return "bin"
    if head.startswith(ulog_file.SIGNATURE):
        return "ulg"
    if has_records(head):
        return "tlog"
    names = (name for magic, name in _OTHER_FORMATS.items() if head.startswith(magic))
    found = next(names, "none of these")
    if not head:
        found = "empty"
    elif decode(head[: frame_length(head, 0)]):
        found = "MAVLink without times"
    raise MavlinkError(
        f"{path}: this is {found}; give a DataFlash log of ArduPlane (.bin), a telemetry log "
        "(.tlog), a log of PX4 (.ulg), or a CSV file with --columns MAP.yaml"
    )


def _read_columns(
    log: FlightLog, needed: tuple[str, ...]
) -> tuple[dict[str, LogSeries], dict[str, str]]:
    """Read all columns, and explain the missing ones.

    Raises:
        MavlinkError: a needed one is missing.
    """
    series, missing = {}, {}
    for name, sources in log.columns.items():
        try:
            series[name] = first_available(log, sources)
        except Unavailable as reason:
            if name in needed:
                raise MavlinkError(f"{log.path}: {reason}, so no {name}; {log.remedy}") from None
            missing[name] = f"{reason}; {log.remedy}"
    return series, missing


def _restore_commands(
    log: FlightLog, series: Mapping[str, LogSeries]
) -> tuple[dict[str, LogSeries], bool]:
    """Restore commands from logged demands, which ArduPlane reduced and a replay reduces again.

    Roll was multiplied by the cosine of the pitch. A pitch below zero was multiplied by the cosine
    of the roll; then STAB_PITCH_DOWN was subtracted.

    Returns:
        The series, and whether the parameters of STAB_PITCH_DOWN are in the log, or not needed, as
        commands are missing.
    """
    if not series.keys() >= {*COMMANDS}:
        return dict(series), True
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
        elif gap > MAX_GAP:
            notes.append(f"{name}: {one.source} has gaps of up to {gap:.1f} s")
    throttle = series.get("throttle_cmd")
    if throttle and 0.0 < float(np.max(throttle.values)) <= _MIN_THROTTLE:
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
        notes.append(log.firmware.pitch_note)
    if log.firmware.servo_note and not any(name.startswith("SERVO") for name in log.params):
        notes.append(log.firmware.servo_note)
    if rate_hz := log.params.get("SIM_RATE_HZ"):
        notes.append(
            f"the log is of SITL, SIM_RATE_HZ {rate_hz:g}, whose gyro filter depends on that rate: "
            f"respond --sitl-rate {rate_hz:g}"
        )
    if (height := home_height(log, time)) is not None:
        notes.append(
            f"home is {height:.0f} m above sea level: respond --origin-elevation {height:.0f}"
        )
    return tuple(notes)


def _rate(time: Array, rows: Array) -> float:
    """Return messages per second within rows (M,); 0: fewer than two."""
    period = _period(time[(time >= rows[0]) & (time <= rows[-1])])
    return 1.0 / period if 0.0 < period < math.inf else 0.0


def _period(time: Array) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else math.inf
