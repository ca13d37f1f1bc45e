"""A study's file: a Parquet table with one row for each run, and what repeats them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed import __version__
from testbed.errors import InputError
from testbed.record.arrow_door import column_names, read_columns, write_columns
from testbed.scenario.yaml_door import word
from testbed.study.journal import Journal
from testbed.study.levels import Value, count_levels, level
from testbed.study.page import Spread
from testbed.study.plan import Plan
from testbed.study.rows import METRICS, SET, Row

SCHEMA = 1
_GROUP = 2_000  # rows in memory at once
_LARGEST = 2**63
FIRST = {"run": "int64", "case": "string", "seed": "int64"}
THEN = {"outcome": "string", "error": "string", "command": "string"}


@dataclass(frozen=True, slots=True)
class StudyTable:
    """A study's file.

    Args:
        columns: by name, in the file's order, one element for each run: what is missing is nan.
        facts: texts of the file: study.yaml, scenario.yaml, versions.json and others.
    """

    columns: Mapping[str, NDArray[Any]]
    facts: Mapping[str, str]

    @property
    def complete(self) -> bool:
        """Whether all runs of the plan are in it."""
        return self.facts["complete"] == "true"

    def rows(self) -> Iterator[dict[str, Any]]:
        """Row by row, as Python's own values; None where there is none."""
        names, count = tuple(self.columns), len(self.columns["run"])
        for index in range(count):
            values = (_python(self.columns[name][index]) for name in names)
            yield dict(zip(names, values, strict=True))


def read_table(path: Path | str, names: Iterable[str] | None = None) -> StudyTable:
    """Read a study's file, which may not be complete.

    Args:
        path: the file.
        names: columns to read, of those it has; all, if None. `run` is always there.

    Raises:
        InputError: there is no such file, or it is none of a study.
    """
    try:
        wanted = None if names is None else {"run", *names}
        columns, facts = read_columns(Path(path), wanted)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if facts.get("study.schema") != str(SCHEMA) or "run" not in columns:
        raise InputError(f"{path}: is no file of a study (write one that `testbed sweep` has made)")
    return StudyTable(columns, facts)


def read_rows(path: Path | str) -> list[dict[str, Any]]:
    """The rows of a study's file, by the names of its columns; None where there is no number.

    Raises:
        InputError: there is no such file, or it is none of a study.
    """
    return list(read_table(path).rows())


def metric_names(path: Path | str) -> tuple[str, ...]:
    """The numbers that a study's file has, as a page names them."""
    names = (name for name in column_names(Path(path)) if name.startswith(METRICS))
    return tuple(name.removeprefix(METRICS) for name in names)


def write_table(path: Path, plan: Plan, journal: Journal, facts: Mapping[str, str]) -> None:
    """Write what a journal has as a study's file; whoever reads it meanwhile has the one before.

    Args:
        path: the file.
        plan: of the study.
        journal: the rows that there are.
        facts: texts to be kept with it.

    Raises:
        InputError: it cannot be written.
    """
    metrics = journal.names()
    sets = {f"{SET}{key}": kind(spread) for key, spread in plan.study.page.vary.items()}
    fields = FIRST | sets | THEN | dict.fromkeys((f"{METRICS}{name}" for name in metrics), "double")
    whole = {
        "study.schema": str(SCHEMA),
        "complete": "true" if len(journal) == len(plan) else "false",
        **facts,
    }
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            write_columns(file, fields, _groups(plan, journal, sets, metrics), whole)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _groups(
    plan: Plan, journal: Journal, sets: Mapping[str, str], metrics: tuple[str, ...]
) -> Iterator[list[list[Any]]]:
    rows = journal.rows()
    texts = [kind == "string" for kind in sets.values()]
    while some := list(islice(rows, _GROUP)):
        yield list(
            map(list, zip(*(_cells(plan, row, texts, metrics) for row in some), strict=True))
        )


def _cells(plan: Plan, row: Row, texts: list[bool], metrics: tuple[str, ...]) -> list[Any]:
    run = plan[row.run]
    values = zip(run.point.values(), texts, strict=True)
    return [
        run.number,
        run.case,
        run.seed,
        *(_text(value) if text else value for value, text in values),
        row.outcome,
        row.error,
        run.command,
        *(row.metrics.get(name) for name in metrics),
    ]


def kind(spread: Spread) -> str:
    """The kind of column that the values of a key need."""
    if spread.drawn:
        return "double"
    values = [level(spread, index) for index in range(count_levels(spread))]
    if all(isinstance(value, bool) for value in values):
        return "bool"
    if any(isinstance(value, bool | str) for value in values):
        return "string"
    whole = all(isinstance(value, int) and abs(value) < _LARGEST for value in values)
    return "int64" if whole else "double"


def make_facts(plan: Plan, pages: Mapping[str, str], versions: Mapping[str, str]) -> dict[str, str]:
    """The texts that are kept with a study's file.

    Args:
        plan: of the study.
        pages: resolved scenarios by case.
        versions: of what flies.
    """
    first = pages[plan.cases[0]]
    named = {f"scenario.{case}.yaml": text for case, text in pages.items() if case}
    return {
        "study.name": plan.study.name,
        "study.yaml": plan.study.text,
        "scenario.yaml": first,
        **named,
        "versions.json": json.dumps(dict(versions)),
        "testbed.version": __version__,
        "runs": str(len(plan)),
    }


def _text(value: Value) -> str:
    return value if isinstance(value, str) else word(value)


def _python(value: Any) -> Any:  # noqa: ANN401 - a cell
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value
