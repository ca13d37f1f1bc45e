"""Fly the missing runs of a study, and read its rows."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from testbed.studies.sweep import sweep
from testbed.studies.table import read_table

Cell = tuple[str, int]
Rows = Mapping[Cell, Mapping[str, float]]
"""The numbers of each run, by case and seed."""


def fly(name: str, path: Path, jobs: int) -> tuple[Rows, str]:
    """Fly the missing runs; return the rows, and the versions they were flown with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    result = sweep(name, path, jobs=jobs, resume=True, report=_report, progress=_count)
    if not result.completed:
        raise SystemExit(f"{path}: {dict(result.outcomes)}")
    table = read_table(path)
    versions = json.loads(table.metadata["versions.json"])
    rows = {(each["case"], each["seed"]): _numbers(each) for each in table.rows()}
    return rows, ", ".join(f"{k} {v}" for k, v in versions.items())


def _report(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _count(flown: int, of: int) -> None:
    print(f"\r{flown} of {of}", end="" if flown < of else "\n", file=sys.stderr, flush=True)


def _numbers(each: Mapping[str, object]) -> dict[str, float]:
    head = "metrics."
    return {
        key.removeprefix(head): value
        for key, value in each.items()
        if key.startswith(head) and isinstance(value, float)
    }
