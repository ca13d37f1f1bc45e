"""Write table and figure of docs/speed.md: the rates that the errors of Table 1 need.

usage: make rates  (ARGS="--jobs N")

Flies the study `convergence` into a Parquet file, and resumes an interrupted call.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from study_rows import Rows, fly
from tables import insert, row

from testbed.views.matplotlib_backend import save_figure
from testbed.views.panels import BLUE, GREEN, ORANGE, Band, Line, Panel, PanelGrid

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "convergence.png"
RESULTS = Path("logs") / "studies" / "rates" / "convergence.parquet"
STUDY, MARK = "convergence", "make rates"
SIMULATIONS = {"simulation-3": BLUE, "simulation-2": GREEN, "simulation-1": ORANGE}
CELLS = [(of, f"uav{k}") for of in ("rectangles", "circles") for k in (1, 2, 3)]
# Case by rate, Hz; the one without a name has the rates of the scenarios.
LADDERS: Mapping[str, Mapping[int, str]] = {
    "physics": {100: "-physics-100", 200: "", 400: "-physics-400", 800: "-physics-800"},
    "autopilot": {25: "-autopilot-25", 50: "", 100: "-autopilot-100", 200: "-autopilot-200"},
    "control and messages": {25: "", 50: "-control-50", 100: "-control-100"},
    "samples": {25: "", 50: "-frames-50"},
}
TWICE = "-twice"
LIMIT = 0.02


def errors(rows: Rows, case: str) -> dict[str, float]:
    """Return the RMS errors of Table 1 in one case, m."""
    flown = rows[case, 1]
    return {f"{name}, {of}": flown[f"windows.{of}.rms_m.{name}"] for of, name in CELLS}


def changes(rows: Rows, before: str, after: str) -> dict[str, float]:
    """Return the relative change of each error between two cases."""
    old, new = errors(rows, before), errors(rows, after)
    return {cell: new[cell] / old[cell] - 1.0 for cell in old}


def table(rows: Rows) -> Iterator[str]:
    """Return the rows of the largest change of any error when a rate is doubled."""
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
        bold = "**" if abs(each[worst]) > LIMIT else ""
        cells.append(f"{bold}{100.0 * each[worst]:+.2f} %{bold} ({worst})")
    return row(what, rates, *cells)


def distance_from_limit(rows: Rows) -> float:
    """Return the largest relative distance of an error from its limit for vanishing steps.

    The method is of first order: the remaining change equals the last doubling's.
    """
    _, own, *_, before, last = LADDERS["physics"].values()
    parts = []
    for name in SIMULATIONS:
        here, old, new = (errors(rows, name + case) for case in (own, before, last))
        parts += [abs((2.0 * new[cell] - old[cell]) / here[cell] - 1.0) for cell in here]
    return max(parts)


def figure(rows: Rows) -> PanelGrid:
    """Return the figure: every error against each rate, relative to the scenarios' rates."""
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
                label = f"{name}, {cell.split(', ')[1]}" if number in (0, 3) else ""
                marker = "s" if circle else "o"
                lines.append(Line(x, y, colour, label, 1.0, marker=marker, marks=0))
        within = np.full(len(x), 100.0 * LIMIT)
        bands = [Band(x, -within, within, "#8c8c8c", "2 %")]
        ticks = [(float(rate), str(rate)) for rate in ladder]
        panels.append(
            Panel(what, "Hz", "change of the RMS error, %", lines, bands, x_log=True, x_ticks=ticks)
        )
    return PanelGrid(
        "Errors against rates",
        "Each RMS error of Table 1 relative to its value at 200, 50 and 25 Hz; one rate at a time",
        [panels],
        [1.0] * len(panels),
        (15.0, 6.5),
    )


def text(rows: Rows, versions: str) -> str:
    """Return the table as text, and draw the figure."""
    save_figure(figure(rows), FIGURE)
    return "\n".join(
        [
            *table(rows),
            "",
            "The largest change of the six errors (three followers, two windows). With vanishing "
            "steps of the flight models no error would differ by more than "
            f"{100.0 * distance_from_limit(rows):.1f} % from its value at 200 Hz.",
            "",
            "![Errors against rates](images/convergence.png)",
            "",
            f"Flown with {versions}.",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Fly missing runs, and print or insert the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS, help="the Parquet file")
    parser.add_argument("--into", type=Path, help="a Markdown file with the two markers")
    options = parser.parse_args(arguments)
    lines = text(*fly(STUDY, options.out, options.jobs))
    print(lines)
    if options.into:
        markdown = insert(options.into.read_text(encoding="utf-8"), lines, MARK)
        options.into.write_text(markdown, encoding="utf-8")


if __name__ == "__main__":
    main()
