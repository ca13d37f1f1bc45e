"""Result file of a study: a Parquet table with a row per run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import InputError
from testbed.core.files import (
    check_folder_writable,
    check_writable,
    report_write_errors,
    write_file,
)
from testbed.core.input_files import parse_json_map
from testbed.core.numbers import parse_whole
from testbed.core.version import __version__
from testbed.logs.arrow_io import column_names, read_columns, write_columns
from testbed.logs.run_directory import LOGS, create_run_directory
from testbed.scenario.yaml_io import to_inline
from testbed.studies.journal import METRICS, SET, Journal, JournalRow
from testbed.studies.plan import Plan
from testbed.studies.run_choice import RunChoice
from testbed.studies.study_schema import Value, Variation

STUDIES = LOGS / "studies"
FILE = "study.parquet"
SUFFIX = ".parquet"

SCHEMA = 2
_ROWS_AT_ONCE = 2_000  # in memory
_LARGEST = 2**63
_TOO_MANY = 10**15  # runs
FIRST_COLUMNS = {"run": "int64", "case": "string", "seed": "int64"}
NEXT_COLUMNS = {"outcome": "string", "error": "string", "command": "string"}


@dataclass(frozen=True, slots=True)
class StudyOutput:
    """Paths of a study's result file and of its journal."""

    path: Path

    @property
    def journal(self) -> Path:
        """Path of the journal."""
        return self.path.with_suffix(".journal")

    @property
    def exists(self) -> bool:
        """Return whether there is a result file or a journal."""
        return self.path.exists() or self.journal.exists()


def find_output(name: str, out: Path | None, *, resume: bool) -> StudyOutput:
    """Find the result file to resume, or the place of a new one.

    Args:
        name: of the study.
        out: a file ending in .parquet, or a directory. Default: the latest of the study, or a new
            one, in logs/studies/<name> below the current directory.
        resume: use an existing one, if there is one.

    Raises:
        InputError: there is one and `resume` is false, or it cannot be created.
    """
    if out is None:
        latest = _find_latest(name) if resume else None
        return latest or StudyOutput(create_run_directory(name, logs=STUDIES) / FILE)
    output = StudyOutput(out if out.suffix == SUFFIX else out / FILE)
    with report_write_errors(f"--out {out}"):
        check_folder_writable(output.path.parent)
        if output.path.parent.is_dir():
            check_writable(output.path)
    if output.exists and not resume:
        raise InputError(
            f"--out {out}: exists already (write --resume to continue it, or another path)"
        )
    with report_write_errors(f"--out {out}"):
        output.path.parent.mkdir(parents=True, exist_ok=True)
    return output


def _find_latest(name: str) -> StudyOutput | None:
    folder = STUDIES / name
    found = [StudyOutput(each / FILE) for each in folder.iterdir()] if folder.is_dir() else []
    existing = [each for each in found if each.exists]
    return max(existing, key=lambda each: each.path.parent.name, default=None)


@dataclass(frozen=True, slots=True)
class StudyTable:
    """Content of a result file.

    Args:
        path: of the file.
        columns: by name, in the file's order, one element for each run; missing numbers are NaN.
        metadata: texts of the file: study.yaml, scenario.yaml, versions.json and others.
    """

    path: Path
    columns: Mapping[str, NDArray[Any]]
    metadata: Mapping[str, str]

    @property
    def complete(self) -> bool:
        """Return whether it has all runs that are needed."""
        return self.metadata.get("complete") == "true"

    @property
    def planned(self) -> int:
        """Number of runs of the complete study; of an incomplete one the largest possible.

        Raises:
            InputError: the file has none.
        """
        text = self.metadata.get("runs", "")
        runs = parse_whole(text)
        if runs is None or not 0 <= runs < _TOO_MANY:
            raise InputError(f"{self.path}: metadata runs: {text[:40]!r} is not a number of runs")
        return runs

    def json(self, name: str) -> dict[str, Any]:
        """Return a JSON object of the metadata.

        Raises:
            InputError: there is none, or it is another value.
        """
        try:
            return parse_json_map(self.metadata.get(name, ""))
        except ValueError as error:
            raise InputError(f"{self.path}: metadata {name}: {error}") from None

    def rows(self) -> Iterator[dict[str, Any]]:
        """Iterate over the rows as Python values by column; None for a missing number."""
        names, count = tuple(self.columns), len(self.columns["run"])
        for index in range(count):
            values = (_python_value(self.columns[name][index]) for name in names)
            yield dict(zip(names, values, strict=True))


def read_table(path: Path | str, names: Iterable[str] | None = None) -> StudyTable:
    """Read the result file of a study, complete or not.

    Args:
        path: the file.
        names: columns to read, where they exist; None reads all. `run` is always read.

    Raises:
        InputError: the file does not exist, or is not the result of a study.
    """
    wanted = None if names is None else {"run", *names}
    columns, metadata = read_columns(Path(path), wanted)
    schema = metadata.get("study.schema")
    if schema is None or "run" not in columns:
        raise InputError(
            f"{path}: is not the result of a study (write a file that `testbed sweep` made)"
        )
    if schema != str(SCHEMA):
        raise InputError(
            f"{path}: is of version {schema[:20]}; this testbed reads version {SCHEMA} "
            "(fly the study again)"
        )
    _check_columns(Path(path), columns, wanted)
    return StudyTable(Path(path), columns, metadata)


def _check_columns(
    path: Path, columns: Mapping[str, NDArray[Any]], wanted: Iterable[str] | None
) -> None:
    """Check that the fixed columns exist, and the types of all.

    Raises:
        InputError: naming the first wrong column.
    """
    fixed = FIRST_COLUMNS | NEXT_COLUMNS
    for name in fixed if wanted is None else fixed.keys() & set(wanted):
        if name not in columns:
            raise InputError(f"{path}: has no column {name} (fly the study again)")
    for name, values in columns.items():
        kind = "double" if name.startswith(METRICS) else fixed.get(name)
        if kind is None:  # of a key that varies
            good = all(isinstance(each, bool | int | float | str) for each in values.tolist())
        elif kind == "string":
            good = all(isinstance(each, str) for each in values.tolist())
        else:
            good = values.dtype == (np.float64 if kind == "double" else np.int64)
        if not good:
            raise InputError(f"{path}: column {name}: is not of type {kind or 'number or text'}")


def read_rows(path: Path | str) -> list[dict[str, Any]]:
    """Read the rows of a result file, values by column; None: missing.

    Raises:
        InputError: the file does not exist, or is not the result of a study.
    """
    return list(read_table(path).rows())


def metric_columns(path: Path | str) -> tuple[str, ...]:
    """Return the names of the metrics of a result file, without prefix."""
    names = (name for name in column_names(Path(path)) if name.startswith(METRICS))
    return tuple(name.removeprefix(METRICS) for name in names)


def write_table(
    path: Path, plan: Plan, journal: Journal, choice: RunChoice, metadata: Mapping[str, str]
) -> None:
    """Write the needed rows of a journal as a result file, in one step.

    Args:
        path: the file.
        plan: of the study.
        journal: the finished runs.
        choice: which of them are needed; it has all rows of the journal.
        metadata: texts to store in the file.

    Raises:
        InputError: it cannot be written.
    """
    metrics = journal.names(choice.needs)
    varied = plan.study.config.vary
    sets = {f"{SET}{key}": column_type(values) for key, values in varied.items()}
    numbers = dict.fromkeys((f"{METRICS}{name}" for name in metrics), "double")
    fields = FIRST_COLUMNS | sets | NEXT_COLUMNS | numbers
    all_metadata = {
        "study.schema": str(SCHEMA),
        "complete": "true" if choice.done == choice.total else "false",
        "runs": str(choice.total),
        **metadata,
    }
    # durable: the journal is removed after the last write
    with report_write_errors(path), write_file(path, durable=True) as file:
        rows = journal.rows(choice.needs)
        write_columns(file, fields, _column_blocks(plan, rows, sets, metrics), all_metadata)


def _column_blocks(
    plan: Plan, rows: Iterator[JournalRow], sets: Mapping[str, str], metrics: tuple[str, ...]
) -> Iterator[list[list[Any]]]:
    """Yield the columns of a limited number of rows at a time."""
    are_texts = [kind == "string" for kind in sets.values()]
    while block := list(islice(rows, _ROWS_AT_ONCE)):
        cells = (_cells(plan, row, are_texts, metrics) for row in block)
        yield list(map(list, zip(*cells, strict=True)))


def _cells(
    plan: Plan, row: JournalRow, are_texts: list[bool], metrics: tuple[str, ...]
) -> list[Any]:
    run = plan[row.run]
    values = zip(run.point.values(), are_texts, strict=True)
    return [
        run.number,
        run.case,
        run.seed,
        *(_text(value) if is_text else value for value, is_text in values),
        row.outcome,
        row.error,
        run.command,
        *(row.metrics.get(name) for name in metrics),
    ]


def column_type(values: Variation) -> str:
    """Return the column type that the values of a key need."""
    if values.is_distribution:
        return "double"
    levels = [values.level(index) for index in range(values.level_count)]
    if all(isinstance(value, bool) for value in levels):
        return "bool"
    if any(isinstance(value, bool | str) for value in levels):
        return "string"
    whole = all(isinstance(value, int) and abs(value) < _LARGEST for value in levels)
    return "int64" if whole else "double"


def make_metadata(
    plan: Plan, scenarios: Mapping[str, str], versions: Mapping[str, str]
) -> dict[str, str]:
    """Return the texts to store in a result file.

    Args:
        plan: of the study.
        scenarios: resolved scenario files by case.
        versions: of the testbed and its libraries.
    """
    named = {f"scenario.{case}.yaml": text for case, text in scenarios.items() if case}
    return {
        "study.name": plan.study.name,
        "study.yaml": plan.study.text,
        "scenario.yaml": scenarios[plan.cases[0]],
        **named,
        "versions.json": json.dumps(dict(versions)),
        "testbed.version": __version__,
    }


def _text(value: Value) -> str:
    return value if isinstance(value, str) else to_inline(value)


def _python_value(value: Any) -> Any:  # noqa: ANN401 - a cell
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value
