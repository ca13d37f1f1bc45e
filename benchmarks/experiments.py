"""Every number of docs/experiments.md: the experiments' flights as Markdown tables.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from tables import NOISE, SEEDS, Case, Metrics, row, versions, write_tables

from testbed.scenario import load

PAGES = ("experiment-1", "experiment-2", "experiment-3")
GAINS = (1, 2, 3, 4, 6)  # k, m/s
FLEETS = {"Rascals alone": "simulation-3", "with two X8s": "mixed-fleet"}
PAPER = {(page, seed): Case(page, (f"scenario.seed={seed}",)) for page in PAGES for seed in SEEDS}
SCAN = {
    (page, k, noise): Case(page, (f"formation.k={k}", *noise))
    for page in PAGES
    for k in GAINS
    for noise in ((), NOISE)
}
MIXED = {label: Case(page) for label, page in FLEETS.items()}


def over_seeds(values: Sequence[float], digits: int = 2) -> str:
    """The mean, and the smallest and largest if they differ in print."""
    low, high = (f"{value:.{digits}f}" for value in (min(values), max(values)))
    mean = f"{sum(values) / len(values):.{digits}f}"
    return mean if low == high else f"{mean} ({low}–{high})"


def paper_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """The paper's three experiments beside ours."""
    yield (
        "| | portion | follower | [HBH23], m | here, m | largest, m | throttle at a limit, % | "
        "leader's bank, ° |"
    )
    yield "|---|---|---|--:|--:|--:|--:|--:|"
    for name in PAGES:
        page = load(name)
        flights = [flown[PAPER[name, seed]] for seed in SEEDS]
        published = page.scenario.published
        assert published is not None
        for portion, printed in published.rms_m.items():
            for follower, value in zip(page.fleet, printed, strict=True):
                parts = [flight["portions"][portion] for flight in flights]
                limits = [flight["saturations"][follower.name] for flight in flights]
                share = 100.0 / (page.rates.log_hz * page.scenario.duration_s)
                yield row(
                    name.replace("experiment-", "Experiment "),
                    portion,
                    follower.name,
                    f"{value:g}",
                    over_seeds([part["rms_m"][follower.name] for part in parts]),
                    over_seeds([part["max_error_m"][follower.name] for part in parts], 1),
                    over_seeds([share * at["by_kind"]["throttle"] for at in limits], 0),
                    over_seeds([part["leader_bank_deg"] for part in parts], 0),
                )


def scan_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """What k does: RMS errors as the mean over the followers."""
    heads = [(name, portion) for name in PAGES for portion in load(name).scenario.portions]
    titles = [f"{name[-1]}: {portion}" for name, portion in heads]
    yield row("RMS error, m", "k, m/s", *titles, "mean")
    yield "|---|--:|" + "--:|" * (len(heads) + 1)
    for noise, label in (((), "exact"), (NOISE, "GPS/INS noise")):
        for k in GAINS:
            values = [
                flown[SCAN[name, k, noise]]["portions"][portion]["mean_rms_m"]
                for name, portion in heads
            ]
            mean = sum(values) / len(values)
            yield row(label, f"{k:g}", *(f"{value:.2f}" for value in (*values, mean)))


def mixed_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """The same path with Rascals, and with X8s among them."""
    yield "| RMS error, m | laps: UAV 1 | 2 | 3 | circle: 1 | 2 | 3 | largest |"
    yield "|---|--:|--:|--:|--:|--:|--:|--:|"
    for label, case in MIXED.items():
        portions = flown[case]["portions"].values()
        cells = [f"{value:.2f}" for part in portions for value in part["rms_m"].values()]
        worst = max(max(part["max_error_m"].values()) for part in portions)
        yield row(f"{label}: `{case.scenario}`", *cells, f"{worst:.1f}")


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """All tables."""
    said = versions(flown)
    return [
        *paper_table(flown),
        "",
        *scan_table(flown),
        "",
        *mixed_table(flown),
        "",
        f"First table: seeds {SEEDS[0]} to {SEEDS[-1]}, mean and range. The rest: seed 1. "
        f"{said[0].upper()}{said[1:]}.",
    ]


if __name__ == "__main__":
    write_tables(__doc__ or "", [*PAPER.values(), *MIXED.values(), *SCAN.values()], text)
