"""Fly the missing runs of a study, and read its rows."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from testbed.studies.sweep import sweep
from testbed.studies.table import read_table

WITHOUT_NUMBERS = ("lost", "failed", "invalid")  # a flight beyond a limit has them
Cell = tuple[str, int]
Rows = Mapping[Cell, Mapping[str, float]]
"""The numbers of each run, by case and seed."""


def fly(name: str, path: Path, jobs: int) -> tuple[Rows, str]:
    """Fly the missing runs of a study without `vary`; return the rows, and their versions."""
    rows, versions = fly_rows(name, path, jobs)
    return {(each["case"], each["seed"]): numbers(each) for each in rows}, versions


def fly_rows(name: str, path: Path, jobs: int) -> tuple[list[Mapping[str, Any]], str]:
    """Fly the missing runs; return the table's rows, and the versions they were flown with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    result = sweep(name, path, jobs=jobs, resume=True, report=_report, progress=_count)
    if any(result.outcomes[outcome] for outcome in WITHOUT_NUMBERS):
        raise SystemExit(f"{path}: {dict(result.outcomes)}")
    table = read_table(path)
    versions = json.loads(table.metadata["versions.json"])
    return list(table.rows()), ", ".join(f"{k} {v}" for k, v in versions.items())


def _report(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _count(flown: int, of: int) -> None:
    print(f"\r{flown} of {of}", end="" if flown < of else "\n", file=sys.stderr, flush=True)


def numbers(each: Mapping[str, object]) -> dict[str, float]:
    """Return the metrics of a row of the table."""
    head = "metrics."
    return {
        key.removeprefix(head): value
        for key, value in each.items()
        if key.startswith(head) and isinstance(value, float)
    }
