"""Tables of docs/air.md: what the air does to a formation, and how a wake rolls a follower.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tables import Case, Metrics, row, versions, write_tables

sys.path.append(str(Path(__file__).parents[1] / "tests" / "truth"))
from test_wake import CASES, CORE_SPANS, OFFSETS, felt, lattice  # noqa: E402

SEEDS = (1, 2, 3, 4)
MODELS = ("coherent", "von-karman", "dryden")
LEVELS = ("light", "moderate")
ROUGH = {
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
WINDY = Case("wind-8ms")
CLOSE = {"with wakes": Case("close-formation-wake")}
CLOSE["without"] = Case("close-formation-wake", ("air.wake=null",))


def over_seeds(values: Sequence[float]) -> str:
    """The mean, and the smallest and largest."""
    mean = sum(values) / len(values)
    return f"{mean:.1f} ({min(values):.1f}–{max(values):.1f})"


def rough_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Errors of a formation in each kind of turbulence."""
    yield (
        "| turbulence | | rectangles, m | circles, m | smallest separation, m | "
        "a command at its limit, % |"
    )
    yield "|---|---|--:|--:|--:|--:|"
    calm = flown[WINDY]
    yield row("none", "", *_cells([calm]))
    for level in LEVELS:
        for model in MODELS:
            flights = [flown[ROUGH[model, level, seed]] for seed in SEEDS]
            yield row(f"`{model}`", level, *_cells(flights))


def _cells(flights: Sequence[Metrics]) -> Iterator[str]:
    for portion in ("rectangles", "circles"):
        yield over_seeds([flight["portions"][portion]["mean_rms_m"] for flight in flights])
    yield over_seeds([flight["min_separation_m"] for flight in flights])
    shares = [
        100.0 * each["seconds"] / flight["simulated_s"]
        for flight in flights
        for each in flight["saturations"].values()
    ]
    yield over_seeds(shares)


def close_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Errors and throttle in close formation, with wakes and without."""
    names = list(flown[CLOSE["without"]]["mean_throttle"])
    yield "| | " + " | ".join(f"{name}" for name in names) + " |"
    yield "|---|" + "--:|" * len(names)
    for label, case in CLOSE.items():
        errors = flown[case]["portions"]["rectangles"]["rms_m"]
        cells = [f"{errors[name]:.2f}" if name in errors else "" for name in names]
        yield row(f"RMS error {label}, m", *cells)
    for label, case in CLOSE.items():
        throttle = flown[case]["mean_throttle"]
        cells = [f"{100.0 * throttle[name]:.2f}" for name in names]
        yield row(f"mean throttle {label}, %", *cells)


def wake_table() -> Iterator[str]:
    """Rolling-moment coefficients of a follower one span behind, beside a vortex lattice."""
    yield "| offset, spans | " + " | ".join(f"{case}: lattice | here" for case in CASES) + " |"
    yield "|--:|" + "--:|--:|" * len(CASES)
    columns = []
    for aircraft, planform in CASES.values():
        columns.append(lattice(aircraft, planform)[1])
        columns.append([felt(aircraft, offset)[1] for offset in OFFSETS])
    for offset, *cells in zip(OFFSETS, *columns, strict=True):
        # no "-0.00" straight behind
        yield row(
            f"{offset:g}", *(f"{1e3 * cell + 0.0:.2f}".replace("-0.00", "0.00") for cell in cells)
        )


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """All of it."""
    seeds = ", ".join(map(str, SEEDS))
    return [
        f"Flown with {versions(flown)}; over seeds {seeds}: mean (smallest–largest).",
        "",
        "`turbulence-moderate`, Simulation 3 in 8 m/s of wind: mean RMS errors of the followers.",
        "",
        *rough_table(flown),
        "",
        "`close-formation-wake`, seed 1: two followers beside the leader, one behind it.",
        "",
        *close_table(flown),
        "",
        "Rolling-moment coefficient × 1000 of a follower one span behind, by its offset to the "
        f"right, cores of {CORE_SPANS:g} spans, in level flight at 22 and 18 m/s and 1.18 kg/m³.",
        "",
        *wake_table(),
    ]


if __name__ == "__main__":
    write_tables(__doc__ or "", [WINDY, *ROUGH.values(), *CLOSE.values()], text)
