"""Write the tables of docs/results/experiments.md.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from inputs import Case, Inputs
from tables import COMMAND, NOISE, SEEDS, Metrics, row, versions, write_tables

from testbed.scenario import load_scenario

EXPERIMENTS = ("experiment-1", "experiment-2", "experiment-3")
GAINS = (1, 2, 3, 4, 6)  # k, m/s
FLEETS = {"Rascals only": "simulation-3", "with two X8s": "mixed-fleet"}
PAPER = {
    (scenario, seed): Case(scenario, (f"scenario.seed={seed}",))
    for scenario in EXPERIMENTS
    for seed in SEEDS
}
SCAN = {
    (scenario, k, noise): Case(scenario, (f"formation.k={k}", *noise))
    for scenario in EXPERIMENTS
    for k in GAINS
    for noise in ((), NOISE)
}
MIXED_FLEETS = {label: Case(name) for label, name in FLEETS.items()}


def over_seeds(values: Sequence[float], digits: int = 2) -> str:
    """Return the mean, and the smallest and largest value if they differ in print."""
    low, high = (f"{value:.{digits}f}" for value in (min(values), max(values)))
    mean = f"{sum(values) / len(values):.{digits}f}"
    return mean if low == high else f"{mean} ({low}–{high})"


def paper_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of the paper's three experiments beside ours."""
    yield (
        "| | window | follower | [HBH23], m | testbed, m | largest, m | throttle saturated, % | "
        "leader's bank, ° |"
    )
    yield "|---|---|---|--:|--:|--:|--:|--:|"
    for name in EXPERIMENTS:
        scenario = load_scenario(name)
        flights = [flown[PAPER[name, seed]] for seed in SEEDS]
        published = scenario.scenario.published
        assert published is not None
        for window, printed in published.rms_m.items():
            for follower, value in zip(scenario.fleet, printed, strict=True):
                parts = [flight["windows"][window] for flight in flights]
                limits = [flight["saturations"][follower.name] for flight in flights]
                share = 100.0 / (scenario.rates.log_hz * scenario.scenario.duration_s)
                yield row(
                    name.replace("experiment-", "Experiment "),
                    window,
                    follower.name,
                    f"{value:g}",
                    over_seeds([part["rms_m"][follower.name] for part in parts]),
                    over_seeds([part["max_error_m"][follower.name] for part in parts], 1),
                    over_seeds([share * at["by_kind"]["throttle"] for at in limits], 0),
                    over_seeds([part["leader_bank_deg"] for part in parts], 0),
                )


def scan_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of mean RMS errors by k."""
    heads = [
        (name, window) for name in EXPERIMENTS for window in load_scenario(name).scenario.windows
    ]
    titles = [f"{name[-1]}: {window}" for name, window in heads]
    yield row("RMS error, m", "k, m/s", *titles, "mean")
    yield "|---|--:|" + "--:|" * (len(heads) + 1)
    for noise, label in (((), "exact"), (NOISE, "GPS/INS noise")):
        for k in GAINS:
            values = [
                flown[SCAN[name, k, noise]]["windows"][window]["mean_rms_m"]
                for name, window in heads
            ]
            mean = sum(values) / len(values)
            yield row(label, f"{k:g}", *(f"{value:.2f}" for value in (*values, mean)))


def mixed_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of Simulation 3 with Rascals only and with X8s."""
    yield "| RMS error, m | laps: UAV 1 | 2 | 3 | circle: 1 | 2 | 3 | largest |"
    yield "|---|--:|--:|--:|--:|--:|--:|--:|"
    for label, case in MIXED_FLEETS.items():
        windows = flown[case]["windows"].values()
        cells = [f"{value:.2f}" for part in windows for value in part["rms_m"].values()]
        worst = max(max(part["max_error_m"].values()) for part in windows)
        yield row(f"{label}: `{case.scenario}`", *cells, f"{worst:.1f}")


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """Return all tables as Markdown lines."""
    text_of_versions = versions(flown)
    return [
        *paper_table(flown),
        "",
        *scan_table(flown),
        "",
        *mixed_table(flown),
        "",
        f"First table: seeds {SEEDS[0]} to {SEEDS[-1]}, mean and range. The rest: seed 1. "
        f"{text_of_versions[0].upper()}{text_of_versions[1:]}.",
    ]


INPUTS = {COMMAND: Inputs((*PAPER.values(), *MIXED_FLEETS.values(), *SCAN.values()))}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {COMMAND: text})
