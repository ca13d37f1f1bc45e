"""Where a study's file lies: in a directory of its own each time it is begun, or as asked for."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from testbed.errors import InputError
from testbed.record.rundir import LOGS, create_run_directory

STUDIES = LOGS / "studies"
FILE = "study.parquet"
SUFFIX = ".parquet"


@dataclass(frozen=True, slots=True)
class StudyFile:
    """A study's file, and beside it, until it is complete, its journal."""

    path: Path

    @property
    def journal(self) -> Path:
        """Rows as they came."""
        return self.path.with_suffix(".journal")

    @property
    def begun(self) -> bool:
        """Whether there is anything of it."""
        return self.path.exists() or self.journal.exists()


def find_file(name: str, out: Path | None, *, resume: bool) -> StudyFile:
    """The file of a study: a new one, or with `resume` the one that was begun, if there is one.

    Args:
        name: the study's name.
        out: a file ending in .parquet, or a directory; default the latest, or a new one, in
            logs/studies/<name> below the current directory.
        resume: take the one that was begun.

    Raises:
        InputError: there is one already, or it cannot be made.
    """
    if out is None:
        latest = _latest(name) if resume else None
        return latest or StudyFile(create_run_directory(name, logs=STUDIES) / FILE)
    place = StudyFile(out if out.suffix == SUFFIX else out / FILE)
    if place.begun and not resume:
        raise InputError(
            f"--out {out}: there is a study already; go on with it with --resume, or write another "
            "place"
        )
    try:
        place.path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}") from None
    if not os.access(place.path.parent, os.W_OK):
        raise InputError(f"--out {out}: not writable; write another place")
    return place


def _latest(name: str) -> StudyFile | None:
    """The study of this name that was begun last from here."""
    folder = STUDIES / name
    found = [StudyFile(each / FILE) for each in folder.iterdir()] if folder.is_dir() else []
    begun = [each for each in found if each.begun]
    return max(begun, key=lambda each: each.path.parent.name, default=None)
