"""Tables of a report: rounded on the page and the terminal, with all digits as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.table import Table
from rich.text import Text

from testbed.reports.study.study_data import IntervalEstimate

Cell = str | int | float | IntervalEstimate
ABSENT = "–"


@dataclass(frozen=True)
class ReportTable:
    """A table with its heading.

    Args:
        name: of its CSV file.
        title: of its heading.
        columns: headings; an `IntervalEstimate` fills three columns of the CSV.
        rows: of as many cells.
        note: a sentence below the table.
        ends: indices of the rows with a line below them.
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
        """Make the table of the terminal, which `to_html` converts for the page."""
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
            table.add_row(*(Text(format_cell(cell)) for cell in row), end_section=i in self.ends)
        return table

    def by_metric(self) -> Iterator[tuple[str, ReportTable]]:
        """Yield metrics and their rows, without the column of the metric if there is one."""
        if self.columns[0] != "metric":
            yield "", self
            return
        for metric in dict.fromkeys(row[0] for row in self.rows):
            rows = [row[1:] for row in self.rows if row[0] == metric]
            yield str(metric), replace(self, columns=self.columns[1:], rows=rows, ends=frozenset())

    def to_csv(self) -> str:
        """Write the table as CSV with all digits; NaN is empty."""
        file = io.StringIO()
        has_interval = [
            any(isinstance(row[k], IntervalEstimate) for row in self.rows)
            for k, _ in enumerate(self.columns)
        ]
        writer = csv.writer(file, lineterminator="\n")
        heading: list[str] = []
        for name, three in zip(self.columns, has_interval, strict=True):
            heading += [name, f"{name} low", f"{name} high"] if three else [name]
        writer.writerow(heading)
        for row in self.rows:
            cells: list[Cell] = []
            for cell, three in zip(row, has_interval, strict=True):
                if isinstance(cell, IntervalEstimate):
                    cells += [cell.value, cell.low, cell.high]
                else:
                    cells += [cell, "", ""] if three else [cell]
            writer.writerow([_all_digits(cell) for cell in cells])
        return file.getvalue()


def format_cell(cell: Cell) -> str:
    """Format a cell for reading."""
    if isinstance(cell, IntervalEstimate):
        if math.isnan(cell.low):
            return format_number(cell.value)
        low, high = format_number(cell.low), format_number(cell.high)
        return f"{format_number(cell.value)} [{low}, {high}]"
    return format_number(cell) if isinstance(cell, float) else str(cell)


def format_number(value: float) -> str:
    """Format a number with three significant digits, without an exponent where that is short."""
    if not math.isfinite(value):
        return ABSENT
    if abs(value) >= 1e6 or 0.0 < abs(value) < 1e-4:
        return f"{value:.2e}"
    return f"{value:,.{min(max(_decimals(value), 0), 6)}f}"


def rounding_of(*values: float) -> float:
    """Return a unit of the last digit of the largest of these numbers, as they are printed."""
    return float(10.0 ** -_decimals(max(values, key=abs)))


def _decimals(value: float) -> int:
    """Return the decimals of three significant digits."""
    size = abs(value)
    return 2 - math.floor(math.log10(size)) if size > 0.0 and math.isfinite(size) else 0


def _all_digits(cell: Cell) -> str:
    if isinstance(cell, float):
        return repr(cell) if math.isfinite(cell) else ""
    return str(cell)
