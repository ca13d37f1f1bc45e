"""Write table and figure of docs/speed.md: the rates that the errors of Table 1 need.

usage: make rates  (ARGS="--jobs N")

Flies the study `convergence` into a Parquet file, and resumes an interrupted call.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from study_rows import Rows, fly, write_tables
from tables import row

from testbed.core.records import Array
from testbed.views.matplotlib_backend import save_figure
from testbed.views.panels import BLACK, BLUE, DASHED, GREEN, ORANGE, Line, Panel, PanelGrid

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "convergence.png"
RESULTS = Path("logs") / "studies" / "rates"
STUDY, MARK = "convergence", "make rates"
SIMULATIONS = {  # and their colours and markers
    "simulation-3": (BLUE, "o"),
    "simulation-2": (GREEN, "^"),
    "simulation-1": (ORANGE, "s"),
}
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


def distances(rows: Rows, name: str, ladder: Mapping[int, str]) -> Array:
    """Return the largest distance of any error from that at the highest rate, by lower rate, %."""
    *lower, highest = ladder.values()
    moved = (changes(rows, name + highest, name + case) for case in lower)
    return np.array([100.0 * max(map(abs, each.values())) for each in moved])


def figure(rows: Rows) -> PanelGrid:
    """Return the figure: the largest distance of an error from that at the highest rate."""
    panels = []
    for what, ladder in LADDERS.items():
        if len(ladder) < 3:
            continue
        *lower, highest = ladder
        x = np.array(lower, dtype=float)
        lines = [
            Line(x, distances(rows, name, ladder), colour, name, 1.6, marker=marker, marks=0)
            for name, (colour, marker) in SIMULATIONS.items()
        ]
        limit = np.full(2, 100.0 * LIMIT)
        lines.append(Line(x[[0, -1]], limit, BLACK, "limit, 2 %", 1.2, dashes=DASHED))
        (own,) = (float(rate) for rate, case in ladder.items() if not case)
        panels.append(
            Panel(
                what, "Hz", f"distance from {highest} Hz, %", lines, x_log=True, y_log=True,
                y_limits=(0.01, 5.0), x_ticks=[(float(rate), str(rate)) for rate in lower],
                marks=[(own, BLACK)],
            )
        )  # fmt: skip
    return PanelGrid(
        "Errors against rates",
        "The largest distance of the six RMS errors of a simulation from their values at the "
        "highest rate; dotted: the rates of the scenarios",
        [panels],
        [1.0] * len(panels),
        (15.0, 5.0),
    )


def text(folder: Path, jobs: int) -> str:
    """Fly missing runs, return the table as text, and draw the figure."""
    rows, versions = fly(STUDY, folder / f"{STUDY}.parquet", jobs)
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


if __name__ == "__main__":
    write_tables(__doc__ or "", RESULTS, {MARK: text})
