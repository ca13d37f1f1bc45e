"""Write the tables of docs/air.md: errors in turbulence and wakes, rolling moments of a wake.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from inputs import Case, Inputs
from tables import COMMAND, Metrics, row, versions, write_tables

TESTS = Path(__file__).parents[1] / "tests"
sys.path += [str(TESTS / "shared"), str(TESTS / "atmosphere" / "truth")]
from test_wake import CASES, CORE_SPANS, OFFSETS, lattice, modelled  # noqa: E402

SEEDS = (1, 2, 3, 4)
MODELS = ("coherent", "von-karman", "dryden")
LEVELS = ("light", "moderate")
TURBULENT = {
    (model, level, seed): Case(
        "turbulence-moderate",
        (
            f"air.turbulence.model={model}",
            f"air.turbulence.intensity={level}",
            f"scenario.seed={seed}",
        ),
    )
    for level in LEVELS
    for model in MODELS
    for seed in SEEDS
}
WIND_ONLY = Case("wind-8ms")
WAKES = {"with wakes": Case("close-formation-wake")}
WAKES["without"] = Case("close-formation-wake", ("air.wake=null",))


def over_seeds(values: Sequence[float]) -> str:
    """Return the mean, and the smallest and largest value, as text."""
    mean = sum(values) / len(values)
    return f"{mean:.1f} ({min(values):.1f}–{max(values):.1f})"


def turbulence_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of errors by turbulence model and intensity."""
    yield (
        "| turbulence | | rectangles, m | circles, m | smallest separation, m | "
        "a command saturated, % |"
    )
    yield "|---|---|--:|--:|--:|--:|"
    calm = flown[WIND_ONLY]
    yield row("none", "", *_cells([calm]))
    for level in LEVELS:
        for model in MODELS:
            flights = [flown[TURBULENT[model, level, seed]] for seed in SEEDS]
            yield row(f"`{model}`", level, *_cells(flights))


def _cells(flights: Sequence[Metrics]) -> Iterator[str]:
    for window in ("rectangles", "circles"):
        yield over_seeds([flight["windows"][window]["mean_rms_m"] for flight in flights])
    yield over_seeds([flight["min_separation_m"] for flight in flights])
    shares = [
        100.0 * each["seconds"] / flight["simulated_s"]
        for flight in flights
        for each in flight["saturations"].values()
    ]
    yield over_seeds(shares)


def wake_error_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of errors and throttle with and without wakes."""
    names = list(flown[WAKES["without"]]["mean_throttle"])
    yield "| | " + " | ".join(f"{name}" for name in names) + " |"
    yield "|---|" + "--:|" * len(names)
    for label, case in WAKES.items():
        errors = flown[case]["windows"]["rectangles"]["rms_m"]
        cells = [f"{errors[name]:.2f}" if name in errors else "" for name in names]
        yield row(f"RMS error {label}, m", *cells)
    for label, case in WAKES.items():
        throttle = flown[case]["mean_throttle"]
        cells = [f"{100.0 * throttle[name]:.2f}" for name in names]
        yield row(f"mean throttle {label}, %", *cells)


def rolling_moment_table() -> Iterator[str]:
    """Return the rows of rolling-moment coefficients one span behind, beside a vortex lattice."""
    yield "| offset, spans | " + " | ".join(f"{case}: lattice | testbed" for case in CASES) + " |"
    yield "|--:|" + "--:|--:|" * len(CASES)
    columns = []
    for aircraft, planform in CASES.values():
        columns.append(lattice(aircraft, planform)[1])
        columns.append([modelled(aircraft, offset)[1] for offset in OFFSETS])
    for offset, *cells in zip(OFFSETS, *columns, strict=True):
        # no "-0.00" straight behind
        yield row(
            f"{offset:g}", *(f"{1e3 * cell + 0.0:.2f}".replace("-0.00", "0.00") for cell in cells)
        )


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """Return the tables as Markdown lines."""
    seeds = ", ".join(map(str, SEEDS))
    return [
        f"Flown with {versions(flown)}; over seeds {seeds}: mean (smallest–largest).",
        "",
        "`turbulence-moderate`, Simulation 3 in 8 m/s of wind: mean RMS errors of the followers.",
        "",
        *turbulence_table(flown),
        "",
        "`close-formation-wake`, seed 1: two followers beside the leader, one behind it.",
        "",
        *wake_error_table(flown),
        "",
        "Rolling-moment coefficient × 1000 of a follower one span behind, by its offset to the "
        f"right, cores of {CORE_SPANS:g} spans, in level flight at 22 and 18 m/s and 1.18 kg/m³.",
        "",
        *rolling_moment_table(),
    ]


INPUTS = {
    COMMAND: Inputs(
        (WIND_ONLY, *TURBULENT.values(), *WAKES.values()),
        files=("aircraft/skywalker_x8/skywalker_x8.xml",),
    )
}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {COMMAND: text})
