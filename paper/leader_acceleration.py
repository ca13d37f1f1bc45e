"""Write the tables of paper/leader-acceleration.md: set-ups of the simulations beside Table 1.

usage: make results  (ARGS="--jobs N")

Flies the studies `leader-acceleration`, `leader-turn-acceleration`, `table-1`, `table-1-ages`,
`table-1-causes`, `table-1-laps` and `table-1-authors`, each into a Parquet file, and resumes an
interrupted call.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from inputs import Case, Inputs
from study_rows import fly_rows, numbers, write_tables
from tables import COMMAND, row

from testbed.core.records import Array
from testbed.scenario import load_scenario

RESULTS = Path("logs") / "studies" / "leader-acceleration"
SOURCES, TURNS = "leader-acceleration", "leader-turn-acceleration"
LAPS, FIT, AUTHORS = "table-1-laps", "table-1", "table-1-authors"
CAUSES, AGES = "table-1-causes", "table-1-ages"
STUDIES = (SOURCES, TURNS, LAPS, FIT, CAUSES, AGES, AUTHORS)
SIMULATIONS = (1, 2, 3)
WINDOWS = ("rectangles", "circles")
FOLLOWERS = ("uav1", "uav2", "uav3")
ESTIMATORS = "set.controller.estimators."
NAMES = {
    "none": "zero",
    "coordinated_turn": "bank, differences",
    "broadcast": "broadcast",
    "difference": "broadcast, and ω̇_g",
}
CORNERS = {"30": "30°", "45": "45°", "recorded": "recorded"}
SET_UPS = {
    "old-messages": "messages 0.12 s old, gains × 0.5",
    "own-state-late": "own state 0.04 s old",
    "own-state-late-gains-0.6": "own state 0.04 s old, gains × 0.6",
    "own-phases": "own phases at 10 Hz, positions extrapolated from receipt",
    "both-late": "both 0.08 s old, positions extrapolated from the stamps",
    "both-late-receipt": "both 0.08 s old, positions extrapolated from receipt",
}
NEAR = 0.2  # a cell is near the paper's within this part of it
GOOD = 1.4  # factor below which points of the fit are shown
AGE, OWN_AGE = "set.network.delay_s", "set.controller.companion.state_latency_s"
SOURCE = f"{ESTIMATORS}leader_acceleration"
FITTED = {
    "network.delay_s": ("messages, s", "{:.2f}"),
    "controller.companion.state_latency_s": ("own state, s", "{:.2f}"),
    "controller.gain_scale": ("gains ×", "{:.2f}"),
    "leader.path.bank_limit_deg": ("bank, °", "{:.0f}"),
    "controller.estimators.leader_acceleration": ("q̈_g", "{}"),
}


class Cells(NamedTuple):
    """RMS errors, m, (2, 3) by window and follower, and percent errors (2,)."""

    rms: Array
    percent: Array


class SetUp(NamedTuple):
    """Middle-loop gains, corners and source of q̈_g."""

    gains: str
    corner: str
    source: str


Flights = Mapping[SetUp, Mapping[int, Cells]]  # by simulation


def published_cells() -> dict[int, Cells]:
    """Return the paper's Table 1 by simulation."""
    out = {}
    for number in SIMULATIONS:
        printed = load_scenario(f"simulation-{number}").scenario.published
        assert printed is not None
        rms = np.array([printed.rms_m[window] for window in WINDOWS], dtype=float)
        percent = np.array([printed.percent_error[window] for window in WINDOWS], dtype=float)
        out[number] = Cells(rms, percent)
    return out


def cells_of(each: Mapping[str, Any]) -> Cells:
    """Return the cells of a run of a study."""
    value = numbers(each)
    rms = [[value[f"windows.{w}.rms_m.{name}"] for name in FOLLOWERS] for w in WINDOWS]
    percent = [value[f"windows.{w}.percent_error"] for w in WINDOWS]
    return Cells(np.array(rms), np.array(percent))


def by_set_up(rows: Sequence[Mapping[str, Any]]) -> dict[SetUp, dict[int, Cells]]:
    """Return the cells of the two studies of q̈_g and ω̇_g."""
    out: dict[SetUp, dict[int, Cells]] = {}
    for each in rows:
        _, number, corner = each["case"].split("-")
        source = each.get(f"{ESTIMATORS}leader_acceleration", "difference")
        key = SetUp(each["set.controller.profile"], corner, source)
        out.setdefault(key, {})[int(number)] = cells_of(each)
    return out


def ratios(flown: Mapping[int, Cells], printed: Mapping[int, Cells]) -> Array:
    """Return testbed / paper, (simulations, 2, 3), of the simulations that were flown."""
    return np.array([each.rms / printed[number].rms for number, each in sorted(flown.items())])


def factor(ratio: Array) -> float:
    """Return the typical factor between two sets of cells: exp of the RMS of the logarithms."""
    return float(np.exp(np.sqrt(np.mean(np.log(ratio) ** 2))))


def near(ratio: Array) -> str:
    """Return how many cells are near the paper's, of how many, as text."""
    return f"{int((abs(ratio - 1.0) <= NEAR).sum())} of {ratio.size}"


def summary_table(flown: Flights, printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of all set-ups: cells near the paper's and typical factors."""
    yield (
        "| q̈_g | gains | corners | laps: near | testbed / paper | circle: near | testbed / paper "
        "| factor, laps | circle | all |"
    )
    yield "|---|---|---|--:|---|--:|---|--:|--:|--:|"
    for source, name in NAMES.items():
        for gains in ("tuned", "authors"):
            for corner, label in CORNERS.items():
                ratio = ratios(flown[SetUp(gains, corner, source)], printed)
                parts = [ratio[:, window] for window in range(2)]
                counted = []
                for part in parts:
                    counted += [near(part), f"{part.min():.2f}–{part.max():.2f}"]
                factors = [f"{factor(part):.2f}" for part in (*parts, ratio)]
                yield row(name, f"`{gains}`", label, *counted, *factors)


def cell_texts(cells: Cells, digits: int = 2) -> list[str]:
    """Return RMS errors and percent errors, laps first, as text."""
    out = []
    for rms, percent in zip(cells.rms, cells.percent, strict=True):
        out += [f"{value:.{digits}f}" for value in rms] + [f"{percent:.{max(digits - 1, 0)}f}"]
    return out


def cells_table(flown: Flights, printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of all cells of all set-ups."""
    yield (
        "| RMS error, m | q̈_g | gains | corners | laps: UAV 1 | 2 | 3 | error, % | circle: 1 | 2 "
        "| 3 | error, % |"
    )
    yield "|---|---|---|---|" + "--:|" * 8
    for number in SIMULATIONS:
        texts = [text.removesuffix(".0") for text in cell_texts(printed[number], 1)]
        yield row(f"Simulation {number}", "[HBH23] Table 1", "", "", *texts)
        for source, name in NAMES.items():
            for gains in ("tuned", "authors"):
                for corner, label in CORNERS.items():
                    each = flown[SetUp(gains, corner, source)].get(number)
                    if each is not None:
                        yield row("", name, f"`{gains}`", label, *cell_texts(each))


def percent_table(printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the paper's percent errors beside those that follow from its RMS errors."""
    yield "| error, % | laps: printed | from its cells | circle: printed | from its cells |"
    yield "|---|--:|--:|--:|--:|"
    for number, cells in printed.items():
        offsets = load_scenario(f"simulation-{number}").formation.offsets_m
        lengths = np.array([np.linalg.norm(offsets[name]) for name in FOLLOWERS])
        parts = []
        for rms, percent in zip(cells.rms, cells.percent, strict=True):
            parts += [f"{percent:g}", f"{100.0 * (rms / lengths).mean():.0f}"]
        yield row(f"Simulation {number}", *parts)


def laps_table(rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of corners and gains of Simulation 3 without q̈_g."""
    yield (
        "| Simulation 3, q̈_g = 0, RMS error, m | laps: UAV 1 | 2 | 3 | circle: 1 | 2 | 3 "
        "| laps / circle |"
    )
    yield "|---|" + "--:|" * 7
    cases = {each["case"]: cells_of(each).rms for each in rows}
    for name, rms in {"[HBH23] Table 1": printed[3].rms, **cases}.items():
        digits = 1 if name not in cases else 2
        means = rms.mean(axis=1)
        cells = (f"{value:.{digits}f}" for value in rms.ravel())
        yield row(name.replace("-", " "), *cells, f"{means[0] / means[1]:.1f}")


def ages_table(rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of the public code's gains by age of the messages."""
    yield "| `authors`, age, s | laps: testbed / paper | circle | factor, laps | circle | all |"
    yield "|--:|---|---|--:|--:|--:|"
    ages: dict[float, dict[int, Cells]] = {}
    for each in rows:
        flown = ages.setdefault(each["set.network.delay_s"], {})
        flown[int(each["case"].split("-")[1])] = cells_of(each)
    for age, flown in ages.items():
        ratio = ratios(flown, printed)
        parts = (ratio[:, 0], ratio[:, 1])
        spans = [f"{part.min():.2f}–{part.max():.2f}" for part in parts]
        yield row(f"{age:.2f}", *spans, *(f"{factor(part):.2f}" for part in (*parts, ratio)))


def causes_table(rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of single causes: factors over all cells, and the cells of Simulation 3."""
    yield (
        "| 30° of bank, broadcast q̈_g, gains `tuned` | factor, laps | circle | all | cells near "
        "| Simulation 3, laps: UAV 1 | 2 | 3 | circle: 1 | 2 | 3 |"
    )
    yield "|---|" + "--:|" * 10
    flown: dict[str, dict[int, Cells]] = {}
    for each in rows:
        name, _, number = each["case"].rpartition("-")
        flown.setdefault(name, {})[int(number)] = cells_of(each)
    for name, label in SET_UPS.items():
        ratio = ratios(flown[name], printed)
        factors = (f"{factor(part):.2f}" for part in (ratio[:, 0], ratio[:, 1], ratio))
        cells = (f"{value:.2f}" for value in flown[name][3].rms.ravel())
        yield row(label, *factors, near(ratio), *cells)


def by_point(
    rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]
) -> list[tuple[Mapping[str, Any], dict[int, Cells]]]:
    """Return the keys of each point of the fit and its cells by simulation, best first."""
    keys: dict[tuple[Any, ...], Mapping[str, Any]] = {}
    flown: dict[tuple[Any, ...], dict[int, Cells]] = {}
    for each in rows:
        point = tuple(each[f"set.{key}"] for key in FITTED)
        keys[point] = each
        flown.setdefault(point, {})[int(each["case"].split("-")[1])] = cells_of(each)
    ranked = sorted(flown, key=lambda point: factor(ratios(flown[point], printed)))
    return [(keys[point], flown[point]) for point in ranked]


def fit_table(rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the best points of the fit with their parameters, and the cells of the best."""
    ranked = by_point(rows, printed)
    heads = [head for head, _ in FITTED.values()]
    yield row(*heads, "factor, laps", "circle", "all", "cells near")
    yield "|" + "--:|" * (len(heads) - 1) + "---|" + "--:|" * 4
    zero = next(item for item in ranked if item[0][SOURCE] == "none")
    good = [item for item in ranked if factor(ratios(item[1], printed)) < GOOD]
    for keys, flown in (*good, zero, ranked[-1]):
        ratio = ratios(flown, printed)
        values = [
            form.format(NAMES.get(keys[f"set.{key}"], keys[f"set.{key}"]))
            for key, (_, form) in FITTED.items()
        ]
        factors = [f"{factor(part):.2f}" for part in (ratio[:, 0], ratio[:, 1], ratio)]
        yield row(*values, *factors, near(ratio))
    yield ""
    yield (
        f"The {len(good)} of {len(ranked)} points with a factor below {GOOD:g}, the best with "
        "q̈_g = 0, and the worst. The best is flown by:"
    )
    yield ""
    yield "```console"
    best, cells = ranked[0]
    yield "$ testbed run simulation-3 --set controller.extrapolate_from=timestamp \\"
    parts = [f"--set {key}={_plain(best[f'set.{key}'])}" for key in FITTED]
    yield f"    {' '.join(parts[:2])} \\"
    yield f"    {' '.join(parts[2:4])} \\"
    yield f"    {parts[4]}"
    yield "```"
    yield ""
    yield "| RMS error, m | | laps: UAV 1 | 2 | 3 | error, % | circle: 1 | 2 | 3 | error, % |"
    yield "|---|---|" + "--:|" * 8
    for number, each in sorted(cells.items()):
        texts = [text.removesuffix(".0") for text in cell_texts(printed[number], 1)]
        yield row(f"Simulation {number}", "[HBH23] Table 1", *texts)
        yield row("", "best point", *cell_texts(each))


def _plain(value: float | str) -> str:
    """Return the value of a key as it was flown."""
    return value if isinstance(value, str) else f"{value:.17g}"


def ridge_table(rows: Sequence[Mapping[str, Any]], printed: Mapping[int, Cells]) -> Iterator[str]:
    """Return the rows of factors over all cells by the ages of messages and own state."""
    flown: dict[tuple[float, float], dict[int, Cells]] = {}
    for each in rows:
        point = flown.setdefault((each[AGE], each[OWN_AGE]), {})
        point[int(each["case"].split("-")[1])] = cells_of(each)
    ages, own_ages = (sorted(set(values)) for values in zip(*flown, strict=True))
    heads = (f"own state {own:.2f} s old" for own in own_ages)
    yield row("gains × 0.5: factor, all cells (cells near)", *heads)
    yield "|---|" + "--:|" * len(own_ages)
    for age in ages:
        each_ratio = [ratios(flown[age, own], printed) for own in own_ages]
        cells = (f"{factor(ratio):.2f} ({near(ratio).split()[0]})" for ratio in each_ratio)
        yield row(f"messages {age:.2f} s old", *cells)


def text(folder: Path, jobs: int) -> str:
    """Fly missing runs and return all tables as text."""
    studies = {name: fly_rows(name, folder / f"{name}.parquet", jobs) for name in STUDIES}
    rows = {name: each for name, (each, _) in studies.items()}
    flown, printed = by_set_up([*rows[SOURCES], *rows[TURNS]]), published_cells()
    return "\n".join(
        [
            *summary_table(flown, printed),
            "",
            *laps_table(rows[LAPS], printed),
            "",
            *causes_table(rows[CAUSES], printed),
            "",
            *fit_table(rows[FIT], printed),
            "",
            *ridge_table(rows[AGES], printed),
            "",
            *ages_table(rows[AUTHORS], printed),
            "",
            *percent_table(printed),
            "",
            *cells_table(flown, printed),
            "",
            f"Seed 1; {sum(map(len, rows.values()))} flights with {studies[FIT][1]}.",
        ]
    )


INPUTS = {COMMAND: Inputs(tuple(Case(f"simulation-{number}") for number in SIMULATIONS), STUDIES)}

if __name__ == "__main__":
    write_tables(__doc__ or "", RESULTS, INPUTS, {COMMAND: text})
