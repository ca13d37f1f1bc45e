"""Fly the missing runs of studies, read their rows, and write the tables made of them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inputs import Inputs
from tables import add_output_arguments, part_of, publish

from testbed.core.errors import InputError
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
    try:
        result = sweep(name, path, jobs=jobs, resume=True, report=_report, progress=_count)
    except InputError as error:  # such as runs of other code
        raise SystemExit(f"{error}; without {path} all runs are flown again") from None
    if any(result.outcomes[outcome] for outcome in WITHOUT_NUMBERS):
        raise SystemExit(f"{path}: {dict(result.outcomes)}")
    table = read_table(path)
    versions = json.loads(table.metadata["versions.json"])
    return list(table.rows()), ", ".join(f"{k} {v}" for k, v in versions.items())


def write_tables(
    about: str,
    results: Path,
    inputs: Mapping[str, Inputs],
    texts: Mapping[str, Callable[[Path, int], str]],
    arguments: Sequence[str] | None = None,
) -> None:
    """Fly missing runs, and print or insert tables.

    Args:
        about: docstring of the program.
        results: default folder of the Parquet files.
        inputs: of each text, by what its markers name.
        texts: functions of that folder and of the flights at a time, by the same; `--only` takes
            what follows the comma.
        arguments: of the command line; None: those of the process.
    """
    parser = argparse.ArgumentParser(description=about.split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=results, help="folder of the Parquet files")
    add_output_arguments(parser, inputs)
    options = parser.parse_args(arguments)
    same = True
    for mark, text in texts.items():
        if part_of(mark) in options.only:
            same &= publish(options, {mark: text(options.out, options.jobs)}, inputs)
    sys.exit(0 if same else 1)


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
