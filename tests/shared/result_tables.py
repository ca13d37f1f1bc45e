"""Markdown tables of the result pages, for the tests that compare them."""

from __future__ import annotations

import re
from collections.abc import Iterable

from places import ROOT

MARKS = "†‡"  # of flights that were not completed
SIMULATIONS = "docs/results/simulations.md"
EXPERIMENTS = "docs/results/experiments.md"
PAPER, CONDITIONS = "RMS error, m | numbers of", "Simulation 3, RMS error, m | profile"
HARD_PATHS, FREEDOMS = "RMS error, m | profile | laps", "left open"
Row = list[str]


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def tables(name: str) -> list[list[Row]]:
    """Return the Markdown tables of a page: rows of cells, the heading first."""
    found: list[list[Row]] = [[]]
    for line in page(name).splitlines():
        if line.startswith("|"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if not all(re.fullmatch(":?-+:?", cell) for cell in cells):
                found[-1].append(cells)
        elif found[-1]:
            found.append([])
    return [table for table in found if table]


def table(name: str, heading: str) -> list[Row]:
    """Return the rows of the one table whose heading begins so, empty first cells filled in."""
    (found,) = (
        each for each in tables(name) if " | ".join(each[0]).strip("| ").startswith(heading)
    )
    rows, first = [], ""
    for cells in found[1:]:
        first = cells[0] or first
        rows.append([first, *cells[1:]])
    return rows


def the_row(rows: list[Row], *start: str) -> Row:
    """Return the cells after the start of the one row that begins so."""
    (found,) = (each for each in rows if each[: len(start)] == list(start))
    return found[len(start) :]


def six(cells: Row) -> Row:
    """Return the cells of the followers of a row of SIMULATIONS, without the means."""
    return [*cells[:3], *cells[4:7]]


def missing_texts(name: str, texts: Iterable[str]) -> list[str]:
    """Return the texts that a page does not have, whatever its line breaks."""
    prose = " ".join(page(name).split())
    return [text for text in texts if " ".join(text.split()) not in prose]
