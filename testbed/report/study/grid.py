"""A table that has its numbers whole: shown short on the page and the terminal, whole as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.table import Table
from rich.text import Text

from testbed.report.study.numbers import Estimate

Cell = str | int | float | Estimate
ABSENT = "–"


@dataclass(frozen=True)
class Grid:
    """A table with its heading.

    Args:
        name: of its CSV file.
        title: above it.
        columns: headings; an `Estimate` below one fills three columns of a CSV.
        rows: of as many cells.
        note: a sentence below it.
        ends: after which rows there is a line.
        code: the last column holds commands, which are never cut.
    """

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    ends: frozenset[int] = frozenset()
    code: bool = False

    def to_rich(self) -> Table:
        """For the terminal; `to_html` makes the page's of it."""
        table = Table(box=None, pad_edge=False, header_style="bold", show_edge=False)
        for k, heading in enumerate(self.columns):
            text = k == 0 or all(isinstance(row[k], str) for row in self.rows)
            last = self.code and k == len(self.columns) - 1
            table.add_column(
                heading,
                justify="left" if text else "right",
                no_wrap=not (text or last),
                overflow="fold",
            )
        for i, row in enumerate(self.rows):
            table.add_row(*(Text(shown(cell)) for cell in row), end_section=i in self.ends)
        return table

    def by_metric(self) -> Iterator[tuple[str, Grid]]:
        """A table for each metric, which is said once above it; itself where it has no metrics."""
        if self.columns[0] != "metric":
            yield "", self
            return
        for metric in dict.fromkeys(row[0] for row in self.rows):
            rows = [row[1:] for row in self.rows if row[0] == metric]
            yield str(metric), replace(self, columns=self.columns[1:], rows=rows, ends=frozenset())

    def to_csv(self) -> str:
        """Numbers that read back to the same bits; what is not a number is empty."""
        file = io.StringIO()
        wide = [
            any(isinstance(row[k], Estimate) for row in self.rows)
            for k, _ in enumerate(self.columns)
        ]
        writer = csv.writer(file, lineterminator="\n")
        heading: list[str] = []
        for name, three in zip(self.columns, wide, strict=True):
            heading += [name, f"{name} low", f"{name} high"] if three else [name]
        writer.writerow(heading)
        for row in self.rows:
            cells: list[Cell] = []
            for cell, three in zip(row, wide, strict=True):
                if isinstance(cell, Estimate):
                    cells += [cell.value, cell.low, cell.high]
                else:
                    cells += [cell, "", ""] if three else [cell]
            writer.writerow([_whole(cell) for cell in cells])
        return file.getvalue()


def shown(cell: Cell) -> str:
    """A cell for reading."""
    if isinstance(cell, Estimate):
        if math.isnan(cell.low):
            return number(cell.value)
        return f"{number(cell.value)} [{number(cell.low)}, {number(cell.high)}]"
    return number(cell) if isinstance(cell, float) else str(cell)


def number(value: float) -> str:
    """Three digits, without an exponent where that is short."""
    if not math.isfinite(value):
        return ABSENT
    size = abs(value)
    if size >= 1e6 or 0.0 < size < 1e-4:
        return f"{value:.2e}"
    digits = 2 - math.floor(math.log10(size)) if size > 0.0 else 0
    return f"{value:,.{min(max(digits, 0), 6)}f}"


def _whole(cell: Cell) -> str:
    if isinstance(cell, float):
        return repr(cell) if math.isfinite(cell) else ""
    return str(cell)
