"""Write tables and figure of docs/speed.md: the rates that the errors of the scenarios need.

usage: make rates  (ARGS="--jobs N")

Flies the studies `convergence`, `convergence-seeds` and `convergence-others` into Parquet files,
and resumes an interrupted call.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from inputs import Inputs
from study_rows import Rows, fly, fly_rows, numbers, write_tables
from tables import draw, row

from testbed.core.records import Array
from testbed.core.stats import student_interval
from testbed.scenario.sections import Rates
from testbed.views.panels import (
    BLACK,
    BLUE,
    DASHED,
    GREEN,
    ORANGE,
    PINK,
    VIOLET,
    Line,
    Panel,
    PanelGrid,
)

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "convergence.png"
RESULTS = Path("logs") / "studies" / "rates"
STUDY, SEEDS_STUDY, OTHERS_STUDY = "convergence", "convergence-seeds", "convergence-others"
MARK = "make rates"
RATE_KEY = "set.rates.physics_hz"
RATES = (50, 100, 200, 400, 800)
HIGHEST = RATES[-1]
DEFAULT = Rates().physics_hz
RELATIVE, ABSOLUTE_M = 0.01, 0.003  # criterion: within either
SATURATED = 0.03  # share of a flight; joining takes up to that
DRAWN = {  # scenarios of the figure, their colours and markers
    "simulation-1": (BLUE, "o"),
    "simulation-3": (GREEN, "^"),
    "simulation-3-improved": (VIOLET, "v"),
    "mixed-fleet": (ORANGE, "s"),
    "close-formation-wake": (PINK, "D"),
}
OTHERS: Mapping[str, Mapping[int, str]] = {  # case by rate, Hz
    "autopilot": {25: "autopilot-25", 50: "scenario", 100: "autopilot-100", 200: "autopilot-200"},
    "control and messages": {25: "scenario", 50: "control-50", 100: "control-100"},
    "samples": {25: "scenario", 50: "samples-50"},
}
# The numbers of each flight, by scenario, rate (Hz) and seed.
Flights = Mapping[tuple[str, int, int], Mapping[str, float]]


def fly_rates(study: str, folder: Path, jobs: int) -> tuple[Flights, str]:
    """Fly the missing runs of a study that varies the rate; return numbers and versions."""
    rows, versions = fly_rows(study, folder / f"{study}.parquet", jobs)
    return {(each["case"], each[RATE_KEY], each["seed"]): numbers(each) for each in rows}, versions


def errors(flown: Mapping[str, float]) -> dict[str, float]:
    """Return the RMS errors of a flight, m, by follower and window."""
    found = {}
    for key, value in flown.items():
        head, _, follower = key.rpartition(".")
        window, _, metric = head.removeprefix("windows.").rpartition(".")
        if head.startswith("windows.") and metric == "rms_m":
            found[f"{follower}, {window}"] = value
    return found


def saturated(flown: Mapping[str, float], cell: str) -> bool:
    """Return whether commands of the follower of a cell are saturated, joining excepted."""
    follower = cell.partition(",")[0]
    seconds = flown[f"saturations.{follower}.seconds"]
    return seconds > SATURATED * flown["simulated_s"]


def differences(flights: Flights, scenario: str, *, calm: bool) -> tuple[list[str], Array, Array]:
    """Return the errors of a scenario: names, values (R, C) by rate, limits (C) of differences, m.

    Args:
        flights: of the study.
        scenario: flown.
        calm: only of followers without saturation; else only of the others.
    """
    flown = [flights[scenario, rate, 1] for rate in RATES]
    cells = [each for each in errors(flown[-1]) if saturated(flown[-1], each) != calm]
    values = np.array([[errors(each)[cell] for cell in cells] for each in flown])
    return cells, values, np.maximum(RELATIVE * values[-1], ABSOLUTE_M)


def orders(values: Array) -> list[str]:
    """Return the observed order at each three successive rates: log2 of the ratio of differences.

    Differences (R, C) are root mean squares over the errors of a scenario.
    """
    steps = np.sqrt(np.mean(np.diff(values, axis=0) ** 2, axis=1))
    return [f"{order:.1f}" for order in np.log2(steps[:-1] / steps[1:])]


def rates_table(flights: Flights, *, calm: bool) -> Iterator[str]:
    """Return the rows of the largest difference of an error from that at the highest rate."""
    heads = [f"{rate} Hz" for rate in RATES[:-1]]
    spans = [f"order {a}–{c}" for a, c in zip(RATES, RATES[2:], strict=False)]
    yield row("scenario", "errors, m", *heads, *spans)
    yield "|---|--:|" + "--:|" * (len(heads) + len(spans))
    for scenario in dict.fromkeys(name for name, _, _ in flights):
        cells, values, limits = differences(flights, scenario, calm=calm)
        if not cells:
            continue
        off = values[:-1] - values[-1]
        texts = []
        for each in off:
            worst = int(np.argmax(np.abs(each) / limits))
            bold = "**" if abs(each[worst]) > limits[worst] else ""
            percent = 100.0 * each[worst] / values[-1, worst]
            texts.append(f"{bold}{percent:+.2f} %, {1e3 * each[worst]:+.1f} mm{bold}")
        span = f"{values[-1].min():.2f} to {values[-1].max():.2f}"
        yield row(scenario, span, *texts, *orders(values))


def verdict(flights: Flights) -> str:
    """Return the lowest rate that meets the criterion, and what fails at the default, as text."""
    scenarios = list(dict.fromkeys(name for name, _, _ in flights))
    meets, failing = [], []
    for i, rate in enumerate(RATES[:-1]):
        beyond = []
        for scenario in scenarios:
            cells, values, limits = differences(flights, scenario, calm=True)
            off = np.abs(values[i] - values[-1])
            beyond += [f"{scenario} ({cells[j]})" for j in np.flatnonzero(off > limits)]
        if not beyond:
            meets.append(rate)
        elif rate == DEFAULT:
            failing = beyond
    lowest = f"{min(meets)} Hz" if meets else f"none below {HIGHEST} Hz"
    text = f"The lowest rate that meets the criterion: {lowest}. The default is {DEFAULT} Hz"
    return f"{text}; beyond it there: {', '.join(failing)}." if failing else f"{text}."


def seeds_table(flights: Flights) -> Iterator[str]:
    """Return the rows of the means over seeds of the errors at two rates, with intervals."""
    yield row("scenario", "seeds", f"{DEFAULT} Hz, m", f"{HIGHEST} Hz, m", "difference, m", "mean")
    yield "|---|--:|--:|--:|--:|---|"
    for scenario in dict.fromkeys(name for name, _, _ in flights):
        seeds = sorted({seed for name, _, seed in flights if name == scenario})
        low, high = (
            np.array([flights[scenario, rate, seed]["windows.flight.mean_rms_m"] for seed in seeds])
            for rate in (DEFAULT, HIGHEST)
        )
        (mean, *_), (_, least, most) = student_interval(low), student_interval(high)
        inside = "within" if least <= mean <= most else "**outside**"
        cells = (_interval(each) for each in (low, high, low - high))
        yield row(scenario, str(len(seeds)), *cells, inside)


def _interval(values: Array) -> str:
    mean, low, high = student_interval(values)
    return f"{mean:.4f} ({low:.4f} to {high:.4f})"


def others_table(rows: Rows) -> Iterator[str]:
    """Return the rows of the largest change of an error when another rate is doubled."""
    yield row("rate", "Hz", "largest change")
    yield "|---|---|--:|"
    for what, ladder in OTHERS.items():
        rates = list(ladder)
        for low, high in zip(rates, rates[1:], strict=False):
            old, new = (errors(rows[ladder[rate], 1]) for rate in (low, high))
            each = {cell: new[cell] / old[cell] - 1.0 for cell in old}
            worst = max(each, key=lambda cell: abs(each[cell]))
            yield row(what, f"{low} → {high}", f"{100.0 * each[worst]:+.2f} % ({worst})")


def figure(flights: Flights) -> PanelGrid:
    """Return the figure: the largest difference from the highest rate over the errors."""
    x = np.array(RATES[:-1], dtype=float)
    lines = []
    for name, (colour, marker) in DRAWN.items():
        _, values, _ = differences(flights, name, calm=True)
        off = 100.0 * np.max(np.abs(values[:-1] / values[-1] - 1.0), axis=1)
        lines.append(Line(x, off, colour, name, 1.6, marker=marker, marks=0))
    limit = np.full(2, 100.0 * RELATIVE)
    lines.append(Line(x[[0, -1]], limit, BLACK, "1 % (or 3 mm: the criterion)", 1.2, dashes=DASHED))
    panel = Panel(
        "", "Hz", f"distance from {HIGHEST} Hz, %", lines, x_log=True, y_log=True,
        y_limits=(0.005, 10.0), x_ticks=[(float(rate), str(rate)) for rate in RATES[:-1]],
        marks=[(float(DEFAULT), BLACK)],
    )  # fmt: skip
    return PanelGrid(
        "Errors against the rate of the flight models",
        "Largest over the errors of a scenario, without saturation; dotted: the default",
        [[panel]],
        [1.0],
        (9.0, 5.0),
    )


def text(folder: Path, jobs: int) -> str:
    """Fly missing runs, return the tables as text, and draw the figure."""
    flights, versions = fly_rates(STUDY, folder, jobs)
    of_seeds, _ = fly_rates(SEEDS_STUDY, folder, jobs)
    others, _ = fly(OTHERS_STUDY, folder / f"{OTHERS_STUDY}.parquet", jobs)
    draw(figure(flights), FIGURE)
    return "\n".join(_text(flights, of_seeds, others, versions))


def _text(flights: Flights, of_seeds: Flights, others: Rows, versions: str) -> Sequence[str]:
    return [
        *rates_table(flights, calm=True),
        "",
        "In calm air, followers whose commands are saturated for at most 3 % of the flight (they "
        "are, for a while, as they join): of the RMS errors of each scenario the one that is "
        f"farthest from its value at {HIGHEST} Hz, in per cent and in mm; bold: by more than 1 % "
        "and 3 mm. The order is log₂ of the ratio of successive differences, root mean squares "
        "over the errors of the scenario.",
        "",
        verdict(flights),
        "",
        "![Errors against the rate of the flight models](images/convergence.png)",
        "",
        "The other followers of these flights are saturated for longer. A limit is no smooth "
        "function of the motion, so the criterion does not apply to them:",
        "",
        *rates_table(flights, calm=False),
        "",
        "Turbulent and saturated flights, the first 300 s, mean RMS error from 95 s on: means "
        "over seeds with 95 % confidence intervals, and that of the differences of flights with "
        "the same seed, which is narrower. The last column: whether the mean at the default is "
        "within the interval at the highest rate. Estimation errors (`gps-ins`) give "
        "`simulation-3-hard` its seeds.",
        "",
        *seeds_table(of_seeds),
        "",
        "The other rates, with Simulation 3, corners at 30° of bank and flight models at 200 Hz:",
        "",
        *others_table(others),
        "",
        f"Flown with {versions}.",
    ]


INPUTS = {MARK: Inputs(studies=(STUDY, SEEDS_STUDY, OTHERS_STUDY))}

if __name__ == "__main__":
    write_tables(__doc__ or "", RESULTS, INPUTS, {MARK: text})
