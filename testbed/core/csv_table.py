"""Read recordings in CSV: columns of finite numbers by name."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, quote_word, read_bounded_text
from testbed.core.numbers import parse_number
from testbed.core.ranges import Range
from testbed.core.records import Array

MAX_ROWS = 2_000_000
MAX_CELLS = 10_000_000
_NOT_FINITE = ("nan", "inf", "infinity")


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A header and M rows of a text file.

    Blank lines and `#` lines are skipped.
    """

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]  # (M,)
    lines: tuple[int, ...]  # (1 + M,) of the header and the rows in the file, counted from 1

    def numbers(self, columns: Mapping[str, Range]) -> Array:
        """These columns (M, len(columns)).

        Args:
            columns: names with the ranges of their values.

        Raises:
            InputError: a column is missing or repeated, a row is not as long as the header, or a
                cell of these columns is not a finite number, or out of its range.
        """
        missing = [name for name in columns if name not in self.header]
        if missing:
            raise self.error_at(0, f"missing column {', '.join(missing)}; add it to the header")
        repeated = [name for name in columns if self.header.count(name) > 1]
        if repeated:
            raise self.error_at(
                0, f"column {', '.join(repeated)} is there several times; keep one of them"
            )
        for k, row in enumerate(self.rows, start=1):
            if len(row) != len(self.header):
                raise self.error_at(
                    k,
                    f"{len(row)} values under {len(self.header)} columns; write one value per "
                    "column",
                )
        at = [self.header.index(name) for name in columns]
        values = [
            [self._number(k, row[i], self.header[i]) for i in at]
            for k, row in enumerate(self.rows, start=1)
        ]
        found = np.array(values, dtype=np.float64).reshape(len(values), len(at))
        for k, (name, limits) in enumerate(columns.items()):
            self.check_range(name, found[:, k], limits)
            found[:, k] = limits.clip(found[:, k])
        return found

    def check_range(self, name: str, values: Array, limits: Range) -> None:
        """Check that values (M,) of all rows are in their range.

        Raises:
            InputError: naming the first row outside.
        """
        outside = limits.outside(values)
        if outside.any():
            k = int(np.argmax(outside))
            raise self.error_at(k + 1, limits.problem(name, float(values[k])))

    def select(self, rows: Sequence[int]) -> CsvTable:
        """Return a table of these rows, counted from 0."""
        return replace(
            self,
            rows=tuple(self.rows[k] for k in rows),
            lines=(self.lines[0], *(self.lines[k + 1] for k in rows)),
        )

    def column(self, name: str) -> list[str]:
        """A column as it is written (M,)."""
        at = self.header.index(name)
        return [row[at] for row in self.rows]

    def check_time_steps(self, time: Array, longest: float, remedy: str) -> None:
        """Check that times (M,) s increase, by at most `longest`.

        Raises:
            InputError: naming the two rows.
        """
        steps = np.diff(time)
        for wrong, text in (
            (steps <= 0.0, "t_s does not increase; sort the rows and remove repeated ones"),
            (steps > longest, f"a gap of more than {longest:g} s before this row; {remedy}"),
        ):
            if wrong.any():
                k = int(np.argmax(wrong))
                went = f"t_s goes from {time[k]:.12g} to {time[k + 1]:.12g}"
                raise self.error_at(k + 2, f"{went} after line {self.lines[k + 1]}: {text}")

    def error_at(self, row: int, text: str) -> InputError:
        """What is wrong with a row counted from 1, or with the header: 0."""
        return InputError(f"{self.path}:{self.lines[row]}: {text}")

    def _number(self, row: int, text: str, name: str) -> float:
        if not text:
            raise self.error_at(row, f"{name} is empty; write a number or remove the row")
        value = parse_number(text)
        if value is None:
            if text.lower().lstrip("+-") in _NOT_FINITE:
                raise self.error_at(
                    row, f"{name} is {text.lower()}; remove the row or write a finite number"
                )
            raise self.error_at(row, f"{name} is {quote_word(text)}; write a number")
        return value


def read_table(path: Path) -> CsvTable:
    """Read a CSV file whose first row is its header.

    Raises:
        InputError: it cannot be read.
    """
    rows, lines = [], []
    for line, row in read_rows(path):
        if row and not row[0].lstrip().startswith("#"):
            rows.append(tuple(cell.strip() for cell in row))
            lines.append(line)
    header = rows[0] if rows else ()
    return CsvTable(path, header, tuple(rows[1:]), tuple(lines) or (1,))


def read_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of a CSV file, with the numbers of their last lines.

    Raises:
        InputError: it cannot be read, is no text, or has too many bytes, rows or cells.
    """
    text = read_bounded_text(path, MAX_TABLE_BYTES)
    rows = cells = 0
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        for row in reader:
            rows, cells = rows + 1, cells + len(row)
            if rows > MAX_ROWS or cells > MAX_CELLS:
                raise InputError(
                    f"{path}:{reader.line_num}: more than {MAX_ROWS:,} rows or {MAX_CELLS:,} "
                    "values; write a shorter file"
                )
            yield reader.line_num, row
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: not a CSV text file ({error})") from error
