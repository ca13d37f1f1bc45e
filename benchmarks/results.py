"""Every number of docs/simulations.md: the simulations' flights as Markdown tables.

Flights are independent and fly on several processes. Nothing here depends on the clock: the same
machine and versions give the same text.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tables import NOISE, SEEDS, Case, Metrics, row, versions, write_tables

from testbed.scenario import Scenario, load

LATENCY, RECORDED, HARD = (
    f"simulation-3-{what}" for what in ("latency", "recorded-leader", "hard")
)
PROFILES = ("paper", "improved")
LAWS = {
    "the paper's": "simulation-3",
    "with integral action": "own-law-integral",
    "leader-follower": "own-law-leader-follower",
}
GALE = ("air.wind.speed_mps=8", "air.wind.from_deg=45", "controller.bounds_of=airspeed")
HEADER = "laps: UAV 1 | 2 | 3 | mean | circle: 1 | 2 | 3 | mean |"
RULE = "--:|" * 8


def profile(name: str) -> tuple[str, ...]:
    """The override that chooses a profile."""
    return (f"controller.profile={name}",)


# Section 9 of the paper, and what the same pages give with its authors' and with our gains.
PAPERS = {
    (f"simulation-{number}", name): Case(f"simulation-{number}", profile(name))
    for number in (1, 2, 3)
    for name in ("authors", *PROFILES)
}
CONDITIONS = {
    "as it is": Case("simulation-3"),
    "every PID gain × 1.5": Case("simulation-3", ("controller.gain_scale=1.5",)),
    "every PID gain × 0.67": Case("simulation-3", ("controller.gain_scale=0.67",)),
    "GPS/INS noise: `simulation-3-noise`": Case("simulation-3-noise"),
    "latency 0.1 s, compensated: `simulation-3-latency`": Case(LATENCY),
    "latency 0.1 s, not compensated": Case(LATENCY, ("controller.extrapolate_from=receipt",)),
    "wind of 8 m/s, bounds of the airspeed": Case("simulation-3", GALE),
}
CHANGED = {
    (label, name): Case(case.scenario, (*case.overrides, *profile(name)))
    for label, case in CONDITIONS.items()
    for name in PROFILES
}
# The profile has no aircraft to suit here: this is the law's own error.
IDEAL = "fleet.*.vehicle=ideal"
RECKONED = "controller.estimators={turn_acceleration: roll_rate}"
CHANGED["ideal vehicles", "paper"] = Case("simulation-3", (IDEAL,))
CHANGED["ideal vehicles, ω̇_g reckoned with", "paper"] = Case("simulation-3", (IDEAL, RECKONED))
HARDER = {
    (scenario, name): Case(scenario, profile(name))
    for scenario in (RECORDED, HARD)
    for name in PROFILES
} | {(RECORDED, "authors"): Case(RECORDED, profile("authors"))}
NOISY = {
    (law, seed): Case(scenario, (*NOISE, f"scenario.seed={seed}"))
    for law, scenario in LAWS.items()
    for seed in SEEDS
}
CALM = {(law, None): Case(scenario) for law, scenario in LAWS.items()}


def predicted_lag_m(page: Scenario) -> list[float]:
    """How far each follower lags in steady flight if latency is not compensated, m.

    A neighbour seems a latency's flight behind where it is, and lags itself; a follower settles at
    the mean over those it hears, weighted by the (north) gains of the graph.
    """
    path = page.leader.path
    assert path.kind == "mission", "the prediction needs a commanded speed"
    late = page.network.delay_s * path.airspeed_mps
    graph = page.formation
    lags: dict[str, float] = {}
    for name in (follower.name for follower in page.fleet):
        heard = {other: gain[0] for other, gain in graph.neighbour_gains.get(name, {}).items()}
        from_leader = graph.leader_gains[name][0]
        total = from_leader * late + sum(g * (late + lags[other]) for other, g in heard.items())
        lags[name] = total / (from_leader + sum(heard.values()))
    return list(lags.values())


def errors(metrics: Metrics) -> list[str]:
    """RMS errors and their mean, portion after portion, followers in fleet order."""
    return [
        f"{value:.2f}"
        for portion in metrics["portions"].values()
        for value in (*portion["rms_m"].values(), portion["mean_rms_m"])
    ]


def separation(metrics: Metrics) -> str:
    """The smallest separation of the whole flight and its time."""
    return f"{metrics['min_separation_m']:.2f} m at {metrics['min_separation_at_s']:.0f} s"


def bank(metrics: Metrics) -> str:
    """The largest bank of the leader, portion by portion."""
    return ", ".join(f"{p['leader_bank_deg']:.1f}" for p in metrics["portions"].values())


def paper_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """The paper's three simulations, cell by cell."""
    yield f"| RMS error, m | numbers of | {HEADER} leader's bank, ° | closest |"
    yield f"|---|---|{RULE}---|---|"
    for number in (1, 2, 3):
        scenario = f"simulation-{number}"
        published = load(scenario).scenario.published
        assert published is not None
        cells = []
        for portion, values in published.rms_m.items():
            cells += [f"{value:g}" for value in (*values, published.mean_rms_m[portion])]
        yield row(f"Simulation {number}", "[HBH23] Table 1", *cells, "not printed", "not printed")
        for name in ("authors", *PROFILES):
            metrics = flown[scenario, name]
            label = f"profile `{name}`"
            yield row("", label, *errors(metrics), bank(metrics), separation(metrics))


def changed_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Simulation 3 under other conditions."""
    yield f"| Simulation 3, RMS error, m | profile | {HEADER} closest |"
    yield f"|---|---|{RULE}---|"
    for (label, name), metrics in flown.items():
        first = label if name == PROFILES[0] else ""
        yield row(first, f"`{name}`", *errors(metrics), separation(metrics))
    lag = predicted_lag_m(load(LATENCY))
    cells = [f"{value:.2f}" for value in (*lag, sum(lag) / len(lag))]
    yield row("the lag predicted for that latency", "", *cells, *cells, "")


def harder_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Other leaders' paths, with what saturated."""
    yield (
        f"| RMS error, m | profile | {HEADER} leader's bank, ° | closest | at a limit for, s | "
        "within 5 m for good from, s |"
    )
    yield f"|---|---|{RULE}---|---|---|---|"
    for (scenario, name), metrics in flown.items():
        inside = [value["inside_for_good_from_s"] for value in metrics["recovery"].values()]
        yield row(
            f"`{scenario}`",
            f"`{name}`",
            *errors(metrics),
            bank(metrics),
            separation(metrics),
            ", ".join(f"{value['seconds']:.0f}" for value in metrics["saturations"].values()),
            ", ".join("never back" if value is None else f"{value:.0f}" for value in inside),
        )


def laws_table(calm: Mapping[Any, Metrics], noisy: Mapping[Any, Metrics]) -> Iterator[str]:
    """The paper's law and the two examples of a law of one's own, on the same seeds."""
    yield "| law | page | calm: laps | circle | noise: laps | circle | closest, noise |"
    yield "|---|---|--:|--:|--:|--:|--:|"
    for law, scenario in LAWS.items():
        portions = calm[law, None]["portions"].values()
        flights = [noisy[law, seed] for seed in SEEDS]
        cells = [f"{portion['mean_rms_m']:.2f}" for portion in portions]
        for portion in ("rectangles", "circles"):
            means = [flight["portions"][portion]["mean_rms_m"] for flight in flights]
            cells.append(f"{sum(means) / len(means):.2f} ({min(means):.2f}–{max(means):.2f})")
        closest = min(flight["min_separation_m"] for flight in flights)
        yield row(law, f"`{scenario}`", *cells, f"{closest:.2f} m")


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """All tables."""
    papers, changed, harder, calm, noisy = (
        {key: flown[case] for key, case in kind.items()} for kind in KINDS
    )
    return [
        *paper_table(papers),
        "",
        *changed_table(changed),
        "",
        *harder_table(harder),
        "",
        *laws_table(calm, noisy),
        "",
        f"Seed 1, in the last table {SEEDS[0]} to {SEEDS[-1]} for the noise; {versions(flown)}.",
    ]


KINDS: Sequence[Mapping[Any, Case]] = (PAPERS, CHANGED, HARDER, CALM, NOISY)

if __name__ == "__main__":
    write_tables(__doc__ or "", [case for kind in KINDS for case in kind.values()], text)
