"""Studies behind the tables of the pages: flown where they are not yet, and read."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from testbed.study.sweep import sweep
from testbed.study.table import read_table

Cell = tuple[str, int]
Rows = Mapping[Cell, Mapping[str, float]]
"""The numbers of each run, by case and seed."""


def fly(name: str, path: Path, jobs: int) -> tuple[Rows, str]:
    """Fly what is missing of a study; its rows, and the versions they were flown with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    flown = sweep(name, path, jobs=jobs, resume=True, tell=_tell, progress=_count)
    if not flown.good:
        raise SystemExit(f"{path}: {dict(flown.outcomes)}")
    table = read_table(path)
    versions = json.loads(table.facts["versions.json"])
    rows = {(each["case"], each["seed"]): _numbers(each) for each in table.rows()}
    return rows, ", ".join(f"{k} {v}" for k, v in versions.items())


def _tell(text: str) -> None:
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
