"""Run directories: one per run, with fixed file names, found by the scenario's name."""

from __future__ import annotations

import os
import re
import secrets
from datetime import UTC, datetime
from pathlib import Path

from testbed.core.files import create_file
from testbed.logs.mcap_file import LogError

LOGS = Path("logs")
LOG_NAME, SCENARIO_NAME, METRICS_NAME = "run.mcap", "scenario.resolved.yaml", "metrics.json"
TLOG_NAME = "run.tlog"
_ATTEMPTS = 100  # at a free directory name


def create_run_directory(scenario: str, *, out: Path | None = None, logs: Path = LOGS) -> Path:
    """Create the directory of a new run.

    Without `out` it is `logs/<scenario>/<UTC>-<short id>`. Creating it reserves it: two runs that
    start at the same moment get different directories.

    Args:
        scenario: Name of the scenario.
        out: The run directory itself, new or empty.
        logs: The folder of all runs.

    Raises:
        LogError: It cannot be created, or `out` is not empty.
    """
    if out is not None:
        return _create_or_use(out)
    parent = logs / folder_name(scenario)
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for _ in range(_ATTEMPTS):
            now = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
            directory = parent / f"{now}-{secrets.token_hex(2)}"
            try:
                directory.mkdir()
            except FileExistsError:
                continue
            return directory
    except OSError as error:
        raise _creation_error(parent, error) from error
    raise LogError(f"{parent}: no free name for a run directory; name one")


def write_run_file(directory: Path, name: str, data: bytes) -> None:
    """Write a new file of a run.

    Two runs that were given the same empty directory at the same moment both write their scenario
    first: the second one fails here.

    Raises:
        LogError: The file exists, or cannot be written.
    """
    try:
        create_file(directory / name, data)
    except FileExistsError:
        raise LogError(
            f"{directory}: another run has just begun in it; name a new or an empty directory"
        ) from None
    except OSError as error:
        raise LogError(f"{directory / name}: cannot be written: {error.strerror}") from error


def find_run(run: str | os.PathLike[str], *, logs: Path = LOGS) -> Path:
    """Find the log of a run by directory, `.mcap` file, or scenario.

    A scenario's name stands for its latest run below `logs`.

    Raises:
        LogError: There is no such run; with what was looked for.
    """
    path = Path(run)
    # os.path, not Path: a name that is too long or in a closed folder is no run, and no error
    if os.path.isfile(path):
        return path
    for directory in (path, logs / path):
        if os.path.isfile(directory / LOG_NAME):
            return directory / LOG_NAME
        runs = _runs(directory)
        if runs:
            return runs[-1] / LOG_NAME
    if os.path.isfile(path / SCENARIO_NAME):
        raise LogError(f"{run}: no {LOG_NAME} in there: nothing was recorded")
    if os.path.isdir(path):
        raise LogError(f"{run}: no {LOG_NAME} in there, and no runs below")
    known = list_run_names(logs)
    hint = f"runs of: {', '.join(known)}" if known else "no runs yet"
    raise LogError(
        f"{run}: neither a run directory, nor a .mcap file, nor a scenario flown from here"
        f" ({logs}{os.sep} has {hint})"
    )


def list_run_names(logs: Path = LOGS, scenario: str = "") -> list[str]:
    """Return the scenarios that have runs, or the runs of one as `scenario/run`."""
    if scenario:
        return [f"{scenario}/{each.name}" for each in _runs(logs / scenario)]
    return sorted(each.name for each in logs.iterdir() if _runs(each)) if logs.is_dir() else []


def _create_or_use(out: Path) -> Path:
    if os.path.isfile(out):  # false for names that no file can have
        text = "cannot make the run directory: it is a file; name another one"
        raise LogError(f"out: {out}: {text}")
    try:
        out.mkdir(parents=True, exist_ok=True)
        occupied = any(out.iterdir())
    except OSError as error:
        raise _creation_error(out, error) from error
    if occupied:
        raise LogError(f"{out}: not empty; name a new or an empty directory")
    if not os.access(out, os.W_OK):
        raise LogError(f"{out}: not writable; name another directory")
    return out


def _runs(directory: Path) -> list[Path]:
    """List the runs in a folder, the latest last."""
    if not os.path.isdir(directory):
        return []

    def age(run: Path) -> tuple[str, int]:
        # names begin with the second of the start; within a second the later log is the later run
        return run.name.partition("-")[0], (run / LOG_NAME).stat().st_mtime_ns

    return sorted((p for p in directory.iterdir() if (p / LOG_NAME).is_file()), key=age)


def folder_name(scenario: str) -> str:
    """Turn a scenario's name into the name of one folder."""
    return re.sub(r"[^\w.-]+", "-", scenario).strip(".-") or "run"


def _creation_error(path: Path, error: OSError) -> LogError:
    return LogError(f"{path}: cannot make the run directory: {error.strerror}; name another one")
