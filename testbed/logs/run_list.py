"""List the runs in a folder; choose and delete old ones.

A run is a directory with `scenario.resolved.yaml` and a log or metrics. Nothing else is ever
deleted: not other directories, nor a run with files that the testbed does not write, nor one that
is being flown.
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
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.logs.run_directory import LOG_NAME, LOGS, METRICS_NAME, SCENARIO_NAME, folder_name

RUNNING, CUT_SHORT = "running", "cut short"
_NAME = re.compile(r"(\d{8}T\d{6}Z)-[0-9a-f]{4}")
# What the testbed writes into a run directory: log, exports, copies of code, the report.
_OURS = re.compile(r"run\..+|scenario\.resolved\.yaml|metrics\.json|report\.html|\w+\.py")
_MAX_METRICS_BYTES = 100_000_000


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
    others: tuple[str, ...]  # files and folders that the testbed does not write


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

    A run that is being flown or recovered, or has files that the testbed does not write, stays.

    Raises:
        InputError: a file cannot be deleted.
    """
    for entry in runs:
        try:
            if _delete(entry):
                yield entry
        except OSError as error:
            raise InputError(f"{entry.directory}: cannot be deleted: {error.strerror}") from None


def _delete(entry: RunEntry) -> bool:
    names = os.listdir(entry.directory)
    if SCENARIO_NAME not in names or _others(entry.directory, names):
        return False
    with ExitStack() as closing:
        if LOG_NAME in names:
            log = closing.enter_context((entry.directory / LOG_NAME).open("rb"))
            if not lock_file(log):
                return False
        # the scenario last: without it this is no run directory
        for name in sorted(names, key=lambda name: name == SCENARIO_NAME):
            (entry.directory / name).unlink()
    entry.directory.rmdir()
    parent = entry.directory.parent
    if parent.name == folder_name(entry.scenario):
        with suppress(OSError):  # it has other runs
            parent.rmdir()
    return True


def _read_entry(directory: Path) -> RunEntry:
    names = sorted(os.listdir(directory))
    metrics = {}
    with suppress(InputError, ValueError):
        metrics = parse_json_map(read_bounded(directory / METRICS_NAME, _MAX_METRICS_BYTES))
    outcome, simulated = metrics.get("outcome"), metrics.get("simulated_s")
    if not isinstance(outcome, str):
        outcome = RUNNING if _is_locked(directory / LOG_NAME) else CUT_SHORT
    scenario = metrics.get("scenario")
    return RunEntry(
        directory,
        scenario if isinstance(scenario, str) else directory.absolute().parent.name,
        _begun(directory),
        float(simulated) if isinstance(simulated, int | float) else None,
        outcome,
        sum((directory / name).lstat().st_size for name in names),
        _others(directory, names),
    )


def _begun(directory: Path) -> datetime:
    if match := _NAME.fullmatch(directory.name):
        with suppress(ValueError):
            return datetime.strptime(match[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    return datetime.fromtimestamp((directory / SCENARIO_NAME).stat().st_mtime, UTC)


def _others(directory: Path, names: Iterable[str]) -> tuple[str, ...]:
    return tuple(
        name for name in names if not _OURS.fullmatch(name) or not (directory / name).is_file()
    )


def _is_locked(log: Path) -> bool:
    with suppress(OSError), log.open("rb") as file:
        return not lock_file(file)
    return False
