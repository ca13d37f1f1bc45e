"""Table and figure of docs/speed.md: which rates the errors of Table 1 ask for.

usage: make rates  (ARGS="--jobs N")

Flies the study `convergence` into a Parquet file, and goes on where an earlier call was stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from flown import Rows, fly
from tables import insert, row

from testbed.views.figure_door import draw
from testbed.views.panels import BLUE, GREEN, ORANGE, Band, Line, Panel, Sheet

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "convergence.png"
KEPT = Path("logs") / "studies" / "rates" / "convergence.parquet"
STUDY, PAGE_MARK = "convergence", "make rates"
SIMULATIONS = {"simulation-3": BLUE, "simulation-2": GREEN, "simulation-1": ORANGE}
CELLS = [(of, f"uav{k}") for of in ("rectangles", "circles") for k in (1, 2, 3)]
# Case by rate, Hz; the one without a name is flown at the rates that the pages have.
LADDERS: Mapping[str, Mapping[int, str]] = {
    "physics": {100: "-physics-100", 200: "", 400: "-physics-400", 800: "-physics-800"},
    "autopilot": {25: "-autopilot-25", 50: "", 100: "-autopilot-100", 200: "-autopilot-200"},
    "control and messages": {25: "", 50: "-control-50", 100: "-control-100"},
    "frames": {25: "", 50: "-frames-50"},
}
TWICE = "-twice"
BAR = 0.02


def errors(rows: Rows, case: str) -> dict[str, float]:
    """The RMS errors of Table 1 in one case, m."""
    flown = rows[case, 1]
    return {f"{name}, {of}": flown[f"portions.{of}.rms_m.{name}"] for of, name in CELLS}


def changes(rows: Rows, before: str, after: str) -> dict[str, float]:
    """By which part each error changes from one case to another."""
    old, new = errors(rows, before), errors(rows, after)
    return {cell: new[cell] / old[cell] - 1.0 for cell in old}


def table(rows: Rows) -> Iterator[str]:
    """The largest change of any error when a rate is doubled."""
    yield row("rate", "Hz", *(name.replace("simulation-", "Simulation ") for name in SIMULATIONS))
    yield "|---|---|" + "--:|" * len(SIMULATIONS)
    for what, ladder in LADDERS.items():
        rates = list(ladder)
        for low, high in zip(rates, rates[1:], strict=False):
            yield _compared(rows, what, f"{low} → {high}", ladder[low], ladder[high])
    yield _compared(rows, "all of them", "× 2", "", TWICE)


def _compared(rows: Rows, what: str, rates: str, before: str, after: str) -> str:
    cells = []
    for name in SIMULATIONS:
        each = changes(rows, name + before, name + after)
        worst = max(each, key=lambda cell: abs(each[cell]))
        bold = "**" if abs(each[worst]) > BAR else ""
        cells.append(f"{bold}{100.0 * each[worst]:+.2f} %{bold} ({worst})")
    return row(what, rates, *cells)


def beyond(rows: Rows) -> float:
    """How far errors are from where ever smaller steps of the flight model lead, largest part.

    The method is of first order: the last doubling is followed by as much again.
    """
    _, own, *_, before, last = LADDERS["physics"].values()
    parts = []
    for name in SIMULATIONS:
        here, old, new = (errors(rows, name + case) for case in (own, before, last))
        parts += [abs((2.0 * new[cell] - old[cell]) / here[cell] - 1.0) for cell in here]
    return max(parts)


def figure(rows: Rows) -> Sheet:
    """Every error against each rate, beside what it is at the rates of the pages."""
    panels = []
    for what, ladder in LADDERS.items():
        if len(ladder) < 3:
            continue
        x = np.array(list(ladder), dtype=float)
        lines = []
        for name, colour in SIMULATIONS.items():
            moved = [changes(rows, name, name + case) for case in ladder.values()]
            for number, cell in enumerate(moved[0]):
                y = 100.0 * np.array([each[cell] for each in moved])
                circle = cell.endswith("circles")
                said = f"{name}, {cell.split(', ')[1]}" if number in (0, 3) else ""
                marker = "s" if circle else "o"
                lines.append(Line(x, y, colour, said, 1.0, marker=marker, marks=0))
        within = np.full(len(x), 100.0 * BAR)
        bands = [Band(x, -within, within, "#8c8c8c", "2 %")]
        ticks = [(float(rate), str(rate)) for rate in ladder]
        panels.append(
            Panel(what, "Hz", "change of the RMS error, %", lines, bands, x_log=True, x_ticks=ticks)
        )
    return Sheet(
        "Which rates the errors ask for",
        "Each RMS error of Table 1 beside what it is at 200, 50 and 25 Hz; one rate at a time",
        [panels],
        [1.0] * len(panels),
        (15.0, 6.5),
    )


def text(rows: Rows, versions: str) -> str:
    """The table; the figure is drawn beside."""
    draw(figure(rows), FIGURE)
    return "\n".join(
        [
            *table(rows),
            "",
            "The largest change of the six errors (three followers, two portions). With vanishing "
            f"steps of the flight models no error would be further than {100.0 * beyond(rows):.1f} "
            "% from what it is at 200 Hz.",
            "",
            "![Errors against rates](images/convergence.png)",
            "",
            f"Flown with {versions}.",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Fly what is missing, and print or insert the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=KEPT, help="the Parquet file")
    parser.add_argument("--into", type=Path, help="a page with the two markers")
    asked = parser.parse_args(arguments)
    lines = text(*fly(STUDY, asked.out, asked.jobs))
    print(lines)
    if asked.into:
        page = insert(asked.into.read_text(encoding="utf-8"), lines, PAGE_MARK)
        asked.into.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
