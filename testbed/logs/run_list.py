"""List the runs in a folder; choose and delete old ones.

A run is a directory with `scenario.resolved.yaml` and a log or metrics. Nothing else is ever
deleted: not other directories, nor a run with files that are not as the testbed wrote them
(`file_record`), nor one that is being flown.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from testbed.core.errors import InputError
from testbed.core.field_docs import document_fields
from testbed.core.files import lock_file
from testbed.core.input_files import MAX_LOG_BYTES, open_regular, parse_json_map, read_bounded
from testbed.logs.file_record import delete_folder, foreign_files
from testbed.logs.run_directory import LOG_NAME, LOGS, METRICS_NAME, SCENARIO_NAME, folder_name

RUNNING, CUT_SHORT = "running", "cut short"
_NAME = re.compile(r"([0-9]{8}T[0-9]{6}Z)-[0-9a-f]{4}")
_MAX_METRICS_BYTES = 100_000_000
_MAX_SIMULATED_S = 1e12
_LAST_TIME = datetime.max.replace(tzinfo=UTC)


@document_fields
@dataclass(frozen=True, slots=True)
class RunEntry:
    """A run directory."""

    directory: Path  # as found: relative where the folder is
    scenario: str  # name
    begun: datetime  # UTC: of its name, else of its resolved scenario
    simulated_s: float | None  # s; None without metrics
    outcome: str  # of its metrics, else `RUNNING` or `CUT_SHORT`
    size: int  # bytes, of all files
    others: tuple[str, ...]  # files and folders that are not as the testbed wrote them


def list_runs(folder: Path = LOGS) -> list[RunEntry]:
    """Return the runs in a folder and in the folders below it, the oldest first.

    Symbolic links are not followed.

    Args:
        folder: of runs; it need not exist.
    """
    found = []
    for here, folders, files in os.walk(folder):
        if SCENARIO_NAME in files and (LOG_NAME in files or METRICS_NAME in files):
            folders.clear()
            with suppress(FileNotFoundError):  # deleted meanwhile
                found.append(_read_entry(Path(here)))
    return sorted(found, key=lambda entry: (entry.begun, entry.directory))


def select_runs(
    runs: Sequence[RunEntry],
    *,
    older_than: timedelta | None = None,
    keep: int | None = None,
    max_bytes: int | None = None,
    now: datetime | None = None,
) -> list[RunEntry]:
    """Choose the runs to delete, the oldest first; never one that `delete_runs` leaves.

    Args:
        runs: as of `list_runs`.
        older_than: choose runs that began longer ago.
        keep: choose none of the newest so many of each scenario; alone: choose all others.
        max_bytes: choose more, the oldest first, until the rest is no larger.
        now: the present time; None: of the clock.
    """
    newest: dict[str, int] = {}
    free = []
    for entry in reversed(runs):
        newest[entry.scenario] = newest.get(entry.scenario, 0) + 1
        deletable = entry.outcome != RUNNING and not entry.others
        if deletable and newest[entry.scenario] > (keep or 0):
            free.append(entry)
    free.reverse()
    limit = (now or datetime.now(UTC)) - older_than if older_than is not None else None
    if limit is None and max_bytes is None:
        return free
    chosen = [entry for entry in free if limit is not None and entry.begun < limit]
    if max_bytes is not None:
        left = sum(each.size for each in runs) - sum(each.size for each in chosen)
        for entry in (each for each in free if each not in chosen):
            if left <= max_bytes:
                break
            chosen.append(entry)
            left -= entry.size
    return [entry for entry in free if entry in chosen]


def delete_runs(runs: Iterable[RunEntry]) -> Iterator[RunEntry]:
    """Delete runs, and scenario folders that become empty; yield each run that is deleted.

    A run that is being flown or recovered, or has files that are not as the testbed wrote them,
    stays.

    Raises:
        InputError: a file cannot be deleted; its run is still one.
    """
    for entry in runs:
        try:
            if _delete(entry):
                yield entry
        except OSError as error:
            raise InputError(
                f"{error.filename or entry.directory}: cannot be deleted: {error.strerror}"
            ) from None


def _delete(entry: RunEntry) -> bool:
    with ExitStack() as closing:
        try:
            log = closing.enter_context(open_regular(entry.directory / LOG_NAME, MAX_LOG_BYTES))
        except InputError:
            pass  # it has none; one that cannot be read is not proven to be the testbed's
        else:
            if not lock_file(log):
                return False
        found = _find_files(entry.directory)
        if SCENARIO_NAME not in found or foreign_files(entry.directory):
            return False
        delete_folder(entry.directory)
    parent = entry.directory.parent
    if parent.name == folder_name(entry.scenario):
        with suppress(OSError):  # it has other runs
            parent.rmdir()
    return True


def _read_entry(directory: Path) -> RunEntry:
    metrics = {}
    with suppress(InputError, ValueError):
        metrics = parse_json_map(read_bounded(directory / METRICS_NAME, _MAX_METRICS_BYTES))
    outcome, scenario = metrics.get("outcome"), metrics.get("scenario")
    if not isinstance(outcome, str):
        outcome = RUNNING if _is_locked(directory / LOG_NAME) else CUT_SHORT
    return RunEntry(
        directory,
        scenario if isinstance(scenario, str) else directory.absolute().parent.name,
        _begun(directory),
        _duration(metrics.get("simulated_s")),
        outcome,
        sum(_find_files(directory).values()),
        foreign_files(directory),
    )


def _duration(value: object) -> float | None:
    """Return a number of seconds, of any JSON value; None: it is none."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # compared before it is converted: an integer of JSON may exceed all floats, and NaN fails
    return float(value) if number and 0 <= value <= _MAX_SIMULATED_S else None  # type: ignore[operator, arg-type]


def _begun(directory: Path) -> datetime:
    if match := _NAME.fullmatch(directory.name):
        with suppress(ValueError):
            return datetime.strptime(match[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    try:
        return datetime.fromtimestamp((directory / SCENARIO_NAME).lstat().st_mtime, UTC)
    except (ValueError, OverflowError):  # as some file systems have times beyond the year 9999
        return _LAST_TIME


def _find_files(directory: Path) -> dict[str, int]:
    """Return the sizes of all files below a directory by their paths relative to it."""
    sizes = {}
    for here, _, files in os.walk(directory):
        for name in files:
            path = Path(here, name)
            with suppress(FileNotFoundError):  # deleted meanwhile
                sizes[str(path.relative_to(directory))] = path.lstat().st_size
    return sizes


def _is_locked(log: Path) -> bool:
    with suppress(InputError), open_regular(log, MAX_LOG_BYTES) as file:
        return not lock_file(file)
    return False
