"""A real flight from its log, in the columns of the recordings that are replayed here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.mavlink import dataflash, telemetry
from testbed.mavlink.door import MavlinkError, decode, frame_length
from testbed.mavlink.logged import (
    MODES,
    RADIAN,
    Draw,
    Log,
    Rows,
    Series,
    first,
    laid,
    longest_gap,
    mode_name,
)
from testbed.mavlink.tlog import holds_records
from testbed.state import Array

COMMANDS = ("theta_cmd_rad", "phi_cmd_rad", "throttle_cmd")
ANY = "any"
_PAUSE = 1.0  # s without attitude, at which a stretch ends
_SNIFFED = 65536  # bytes in which a tlog shows that it is one
_OTHERS = {
    b"ULog": "a PX4 ULog",
    b"\x89MCAP": "an MCAP log (testbed view shows one)",
    b"FMT,": "a DataFlash log as text; give the .bin it was made from",
    b"\x1f\x8b": "compressed; unpack it first",
    b"PK\x03\x04": "a ZIP archive; unpack it first",
}


@dataclass(frozen=True, slots=True)
class Flight:
    """One stretch of a flight.

    Attributes:
        columns: by name, t_s first; each (M,), M the number of attitude messages.
        sources: where each column came from.
        missing: columns that are not there, and what would have told them.
        notes: what to know of it.
        modes: flown in it.
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
) -> Flight:
    """Read the longest stretch of a flight in one mode, without pauses, from a .bin or .tlog.

    Times are s: of a .bin since the autopilot booted, of a .tlog since its first record.

    Args:
        path: the log; what it is shows in its bytes, not in its name.
        system: which vehicle of a .tlog.
        begin: nothing earlier is taken.
        end: nothing later is.
        mode: of ArduPlane, as FBWA; `any`.

    Raises:
        MavlinkError: naming what is wrong with the file, or not in it.
    """
    log, attitude, draws, sought = _read(path, system)
    rows = log.rows.get(attitude)
    if rows is None:
        raise MavlinkError(f"{path}: no {attitude}; {log.remedy}")
    series, missing = _draw(log, draws, sought)
    known = max(series[name].time[0] for name in COMMANDS)
    time, other = _stretch(log, rows, max(begin, known), end, mode)
    columns = {"t_s": time} | {name: laid(one, time) for name, one in series.items()}
    columns["throttle_cmd"] = np.clip(columns["throttle_cmd"], 0.0, 1.0)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * math.pi)
    sources = {name: one.source for name, one in series.items()}
    down = _pitch_down(log, columns["throttle_cmd"])
    if down is not None:
        columns["theta_cmd_rad"] = columns["theta_cmd_rad"] + down
        sources["theta_cmd_rad"] += " + STAB_PITCH_DOWN"
    notes = (*log.notes, *other, *_notes(log, series, time, down is not None))
    return Flight(columns, sources, missing, notes, _modes(log, time))


def _read(
    path: Path, system: int | None
) -> tuple[Log, str, Mapping[str, tuple[Draw, ...]], Mapping[str, str]]:
    """The log, the name of its attitude, how its columns are drawn, and from what."""
    try:
        with path.open("rb") as file:
            head = file.read(_SNIFFED)
    except OSError as error:
        raise MavlinkError(f"{path}: cannot be read: {error.strerror}") from error
    if head.startswith(dataflash.BEGINNING):
        if system is not None:
            raise MavlinkError(f"--system {system}: {path} is of one vehicle; leave it out")
        return dataflash.read_log(path), dataflash.ATTITUDE, dataflash.COLUMNS, dataflash.SOUGHT
    if holds_records(head):
        log = telemetry.read_log(path, system)
        return log, telemetry.ATTITUDE, telemetry.COLUMNS, telemetry.SOUGHT
    what = next((said for magic, said in _OTHERS.items() if head.startswith(magic)), "neither")
    if not head:
        what = "empty"
    elif decode(head[: frame_length(head, 0)]):
        what = "MAVLink without times"
    raise MavlinkError(
        f"{path}: this is {what}; give a DataFlash log of ArduPlane (.bin) or a telemetry log "
        "(.tlog)"
    )


def _draw(
    log: Log, draws: Mapping[str, tuple[Draw, ...]], sought: Mapping[str, str]
) -> tuple[dict[str, Series], dict[str, str]]:
    """Every column the log has, and of the others what would have told them."""
    series, missing = {}, {}
    for name, ways in draws.items():
        if found := first(log, ways):
            series[name] = found
        elif name in COMMANDS or name not in sought:
            raise MavlinkError(
                f"{log.path}: no {sought.get(name, name)}, so no {name}; {log.remedy}"
            )
        else:
            missing[name] = f"no {sought[name]}; {log.remedy}"
    return series, missing


def _stretch(
    log: Log, rows: Rows, begin: float, end: float, mode: str
) -> tuple[Array, tuple[str, ...]]:
    """Times of the longest stretch, and a word on the others."""
    wanted = None if mode == ANY else _mode_number(mode)
    time = rows.time[np.concatenate([[True], np.diff(rows.time) > 0.0])]
    taken = (time >= begin) & (time <= end)
    if wanted is not None:
        flown = np.zeros(len(time), dtype=bool)
        for span in log.spans:
            if span.mode == wanted:
                flown |= (time >= span.begin) & (time <= span.end)
        taken &= flown
    where = np.flatnonzero(taken)
    breaks = np.flatnonzero((np.diff(where) > 1) | (np.diff(time[where]) > _PAUSE)) + 1
    stretches = [part for part in np.split(time[where], breaks) if len(part) > 1]
    if not stretches:
        raise MavlinkError(_never(log, time, mode))
    longest = max(stretches, key=lambda part: float(part[-1] - part[0]))
    others = ", ".join(
        f"{part[0]:.1f} to {part[-1]:.1f}" for part in stretches if part is not longest
    )
    said = f"the longest of {len(stretches)} stretches; --from and --to choose others: {others} s"
    return longest, (said,) if others else ()


def _mode_number(mode: str) -> int:
    for number, name in MODES.items():
        if name == mode.upper():
            return number
    raise MavlinkError(f"--mode {mode}: write any, or one of {', '.join(MODES.values())}")


def _never(log: Log, time: Array, mode: str) -> str:
    spans = ", ".join(f"{mode_name(s.mode)} {s.begin:.1f} to {s.end:.1f}" for s in log.spans)
    return (
        f"{log.path}: nothing in {mode} between --from and --to; it has attitude from "
        f"{time[0]:.1f} to {time[-1]:.1f} s and the modes {spans or '(none told)'}; write another "
        "--mode, or --mode any"
    )


def _modes(log: Log, time: Array) -> tuple[str, ...]:
    flown = [s.mode for s in log.spans if s.begin < time[-1] and s.end > time[0]]
    return tuple(mode_name(mode) for mode in dict.fromkeys(flown))


def _pitch_down(log: Log, throttle: Array) -> Array | None:
    """What ArduPlane took off the pitch demand before it logged it, rad; the replay does it again.

    None: the log does not tell.
    """
    down = log.params.get("STAB_PITCH_DOWN")
    trim = log.params.get("TRIM_THROTTLE")
    if down is None or not trim:
        return None
    return RADIAN * down * np.maximum(1.0 - 100.0 * throttle / trim, 0.0)


def _notes(
    log: Log, series: Mapping[str, Series], time: Array, pitch_down: bool
) -> tuple[str, ...]:
    notes = []
    for name, one in series.items():
        gap = longest_gap(one, time)
        if one.held and name in COMMANDS and _interval(one.time) > 2.0 * _interval(time):
            notes.append(
                f"{name}: {one.source} came {1.0 / _interval(one.time):.3g} times a second; a step "
                f"may be {gap:.2g} s late"
            )
        elif gap > _PAUSE:
            notes.append(f"{name}: {one.source} is silent for up to {gap:.1f} s")
    if not pitch_down:
        notes.append(
            "STAB_PITCH_DOWN and TRIM_THROTTLE are not in the log: what they took off the pitch "
            "demand stays off; replay it with a tune in which STAB_PITCH_DOWN is 0"
        )
    if not any(name.startswith("SERVO") for name in log.params):
        notes.append(
            "SERVOn_ parameters are not in the log: outputs 1 to 4 are taken for aileron, "
            "elevator, throttle, rudder, as they were sent"
        )
    above_sea, above_home = (draw(log) for draw in log.home)
    if above_sea and above_home:
        height = laid(above_sea, time[:1])[0] - laid(above_home, time[:1])[0]
        notes.append(
            f"home is {height:.0f} m above sea level: respond --origin-elevation {height:.0f}"
        )
    return tuple(notes)


def _interval(time: Array) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else math.inf


def write_flight(flight: Flight, write: Callable[[str], object]) -> None:
    """Write a flight as CSV."""
    write(",".join(flight.columns) + "\n")
    numbers = [values.tolist() for values in flight.columns.values()]
    for t, *row in zip(*numbers, strict=True):
        write(",".join([f"{t:.10g}", *(f"{value:.6g}" for value in row)]) + "\n")
