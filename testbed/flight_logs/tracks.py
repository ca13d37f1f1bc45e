"""Logs of the aircraft of a formation, read and placed on one clock."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, open_regular
from testbed.core.records import Array, BoolArray, NedOrigin
from testbed.core.start_time import MAX_START_NS
from testbed.flight_logs.flight_import import ImportedFlight, read_motions
from testbed.flight_logs.flight_sections import ANY
from testbed.flight_logs.log_position import POSITION, UNIX
from testbed.flight_logs.recorded_motion import NED, Motion, complete, find_contradiction, read_csv
from testbed.guidance.recorded_path import MAX_GAP_S


class LogFile(NamedTuple):
    """A log of one aircraft."""

    path: Path
    system: int | None  # of a .tlog; None: the only one

    def __str__(self) -> str:
        """Return the file, with the system."""
        return str(self.path) if self.system is None else f"{self.path}:{self.system}"


@dataclass(frozen=True, slots=True)
class Track:
    """The recorded motion of an aircraft on the clock of the formation.

    Attributes:
        name: of the aircraft in the scenario.
        log: of the flight.
        time: (M,) s since time 0 of the formation.
        motion: M rows.
        clock: where UNIX times come from.
        offset_s: UNIX time minus t_s.
    """

    name: str
    log: LogFile
    time: Array
    motion: Motion
    clock: str
    offset_s: float

    @property
    def rate_hz(self) -> float:
        """Rows per second."""
        return 1.0 / float(np.median(np.diff(self.time)))

    def known(self, at: Array) -> BoolArray:
        """Mask times (T,) between two rows at most `MAX_GAP_S` apart."""
        after = np.searchsorted(self.time, at - 1e-9)
        last = len(self.time) - 1
        here = np.clip(after, 0, last)
        before = np.clip(after - 1, 0, last)
        inside = (after <= last) & (at >= self.time[0] - 1e-9)
        found: BoolArray = inside & (self.time[here] - self.time[before] <= MAX_GAP_S)
        return found


def read_tracks(
    files: Sequence[str],
    names: Sequence[str],
    origin: NedOrigin,
    *,
    start_unix_s: float | None = None,
    offsets_s: Mapping[str, float] | None = None,
    mode: str = ANY,
) -> tuple[tuple[Track, ...], float]:
    """Read the logs of all aircraft of a formation and place them on one clock.

    Args:
        files: a log of each aircraft in the order of the names, FILE or FILE:SYSTEM; or one .tlog
            of all.
        names: of the aircraft.
        origin: of the scenario.
        start_unix_s: UNIX time of time 0; None: the first time that all logs have.
        offsets_s: by name of the aircraft, s to be added to its times.
        mode: flight mode of the rows to take, or `any`.

    Returns:
        The tracks, and the UNIX time of time 0.

    Raises:
        InputError: a log cannot be used, or there are more or fewer than aircraft.
    """
    shifts = offsets_s or {}
    unknown = [name for name in shifts if name not in names]
    if unknown:
        raise InputError(f"--offset {unknown[0]}: write one of {', '.join(names)}")
    tracks = []
    for name, (log, motion) in zip(names, _read_motions(files, names, mode), strict=True):
        try:
            full = complete(motion, origin)
        except InputError as error:
            raise InputError(f"{log}: {error}") from error
        if _is_csv(log.path) and (wrong := find_contradiction(full)) is not None:
            raise InputError(f"{log}: {wrong[0]} {wrong[1]}")
        tracks.append(_on_unix_time(name, log, full, shifts.get(name)))
    start = max(float(each.time[0]) for each in tracks) if start_unix_s is None else start_unix_s
    return tuple(replace(each, time=each.time - start) for each in tracks), start


def _read_motions(
    files: Sequence[str], names: Sequence[str], mode: str
) -> list[tuple[LogFile, Motion]]:
    """Read the motion of each aircraft; a .tlog is read once.

    Raises:
        InputError: there are more or fewer logs than aircraft.
    """
    logs = [_log_file(text) for text in files]
    if len(logs) == 1 and len(names) > 1 and logs[0].system is None and not _is_csv(logs[0].path):
        path = logs[0].path
        flights = read_motions(path, mode=mode)
        found = [(LogFile(path, system), _motion(flight)) for system, flight in flights.items()]
        _check_count([log for log, _ in found], names)
        return found
    _check_count(logs, names)
    systems: dict[Path, list[int]] = {}
    for log in logs:
        if log.system is not None:
            systems.setdefault(log.path, []).append(log.system)
    known = {path: read_motions(path, wanted, mode=mode) for path, wanted in systems.items()}
    return [(log, _read_motion(log, known, mode)) for log in logs]


def _read_motion(
    log: LogFile, known: Mapping[Path, Mapping[int | None, ImportedFlight]], mode: str
) -> Motion:
    if log.system is not None:
        return _motion(known[log.path][log.system])
    if _is_csv(log.path):
        motion = read_csv(log.path)
        if not (motion.columns.keys() >= {*POSITION} or motion.columns.keys() >= {*NED}):
            raise InputError(
                f"{log}: no position; a recording needs {', '.join(POSITION)}, or {', '.join(NED)} "
                "about the scenario's origin"
            )
        return motion
    flights = read_motions(log.path, mode=mode)
    if len(flights) > 1:
        raise InputError(
            f"{log}: several vehicles; write one of "
            f"{', '.join(f'{log.path}:{system}' for system in flights)}"
        )
    return _motion(next(iter(flights.values())))


def _motion(flight: ImportedFlight) -> Motion:
    return Motion(flight.columns, flight.sources, notes=flight.notes)


def _check_count(logs: Sequence[LogFile], names: Sequence[str]) -> None:
    if len(logs) != len(names):
        raise InputError(
            f"{len(logs)} log{'s' * (len(logs) != 1)} ({', '.join(map(str, logs))}) for "
            f"{len(names)} aircraft ({', '.join(names)}); write one for each, the leader's first: "
            "FILE, or FILE:SYSTEM of a .tlog with several"
        )


def _log_file(text: str) -> LogFile:
    head, _, tail = text.rpartition(":")
    if head and tail.isascii() and tail.isdigit() and not os.path.exists(text):
        return LogFile(Path(head), int(tail))
    return LogFile(Path(text), None)


def _on_unix_time(name: str, log: LogFile, motion: Motion, offset_s: float | None) -> Track:
    """Place a motion on UNIX time.

    Raises:
        InputError: the log has no time of day, or a wrong one.
    """
    time = motion.columns["t_s"]
    if UNIX in motion.columns:
        unix, clock = motion.columns[UNIX] + (offset_s or 0.0), motion.sources[UNIX]
        clock += f", {offset_s:+g} s" if offset_s else ""
    elif offset_s is not None:
        unix, clock = time + offset_s, "--offset"
    else:
        raise InputError(
            f"{log}: no {UNIX}: the log does not know the time of day; write --offset {name}=S, "
            "the UNIX time at its t_s of 0"
        )
    if not 0.0 <= unix[0] <= unix[-1] <= 1e-9 * MAX_START_NS:
        raise InputError(
            f"{log}: {UNIX} is {unix[0]:g} to {unix[-1]:g}; write s since 1970, up to 2037"
        )
    if (np.diff(unix) <= 0.0).any():
        raise InputError(f"{log}: {UNIX} does not increase; import the log again, or remove it")
    return Track(name, log, unix, motion, clock, float(unix[0] - time[0]))


def _is_csv(path: Path) -> bool:
    """Return whether a file is a recording as text."""
    with open_regular(path, MAX_FLIGHT_LOG_BYTES) as file:
        first = file.read(4096).partition(b"\n")[0]
    return b"t_s" in first and b"\0" not in first
