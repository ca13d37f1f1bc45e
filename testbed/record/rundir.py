"""Where the files of a run lie: one directory for each run, found again by name."""

from __future__ import annotations

import os
import re
import secrets
from datetime import UTC, datetime
from pathlib import Path

from testbed.record.door import LogError

LOGS = Path("logs")
LOG_NAME, SCENARIO_NAME = "run.mcap", "scenario.resolved.yaml"
_ATTEMPTS = 100


def create_run_directory(scenario: str, *, out: Path | None = None, logs: Path = LOGS) -> Path:
    """Make the directory of a new run and return it.

    Without `out` it is `logs/<scenario>/<UTC>-<short id>`. Making it is what claims it, so two
    runs that start at the same moment get one each.

    Args:
        scenario: Name of the scenario.
        out: The run directory itself, new or empty.
        logs: The folder of all runs.

    Raises:
        LogError: It cannot be made, or `out` holds something already.
    """
    if out is not None:
        return _claim(out)
    parent = logs / _one_folder(scenario)
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
        raise _refused(parent, error) from error
    raise LogError(f"{parent}: no free name for a run directory; give one with --out DIR")


def leave(directory: Path, name: str, data: bytes) -> None:
    """Write a file of a run that has none of this name.

    The first one claims a directory that was empty: of two runs that were given it at the same
    moment one goes on.

    Raises:
        LogError: There is one, or it cannot be written.
    """
    try:
        with open(directory / name, "xb") as file:
            file.write(data)
    except FileExistsError:
        raise LogError(
            f"--out {directory}: another run has just begun in it; name a new or an empty directory"
        ) from None
    except OSError as error:
        raise LogError(f"{directory / name}: cannot be written: {error.strerror}") from error


def find_run(run: str | Path, *, logs: Path = LOGS) -> Path:
    """The log of a run, named by its directory, by the `.mcap` file, or by its scenario.

    A scenario's name stands for its latest run below `logs`.

    Raises:
        LogError: There is no such run; says what was looked for.
    """
    path = Path(run)
    if path.is_file():
        return path
    for directory in (path, logs / path):
        if (directory / LOG_NAME).is_file():
            return directory / LOG_NAME
        runs = _runs(directory)
        if runs:
            return runs[-1] / LOG_NAME
    if (path / SCENARIO_NAME).is_file():
        raise LogError(f"{run}: no {LOG_NAME} in there: nothing was recorded")
    if path.is_dir():
        raise LogError(f"{run}: no {LOG_NAME} in there, and no runs below")
    known = sorted(p.name for p in logs.iterdir() if _runs(p)) if logs.is_dir() else []
    hint = f"runs of: {', '.join(known)}" if known else "no runs yet"
    raise LogError(
        f"{run}: neither a run directory, nor a .mcap file, nor a scenario flown from here"
        f" ({logs}{os.sep} has {hint})"
    )


def _claim(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
        occupied = any(out.iterdir())
    except OSError as error:
        raise _refused(out, error) from error
    if occupied:
        raise LogError(f"--out {out}: not empty; name a new or an empty directory")
    if not os.access(out, os.W_OK):
        raise LogError(f"--out {out}: not writable; name another directory")
    return out


def _runs(directory: Path) -> list[Path]:
    """Runs in a folder, the latest last."""
    if not directory.is_dir():
        return []

    def age(run: Path) -> tuple[str, int]:
        # names begin with the second of the start; within it the later log was written later
        return run.name.partition("-")[0], (run / LOG_NAME).stat().st_mtime_ns

    return sorted((p for p in directory.iterdir() if (p / LOG_NAME).is_file()), key=age)


def _one_folder(scenario: str) -> str:
    """A scenario's name as the name of one folder, whatever is in it."""
    return re.sub(r"[^\w.-]+", "-", scenario).strip(".-") or "run"


def _refused(path: Path, error: OSError) -> LogError:
    return LogError(
        f"{path}: cannot make the run directory: {error.strerror}; name another with --out DIR"
    )
