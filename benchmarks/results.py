"""Write the tables of docs/results/simulations.md.

Flights are independent and fly on several processes. Nothing here depends on the clock: the same
machine and versions give the same text.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from inputs import Case, Inputs
from tables import (
    COMMAND,
    MARKS_TEXT,
    NOISE,
    SEEDS,
    Metrics,
    mark,
    row,
    versions,
    write_tables,
)

from testbed.scenario import Scenario, load_scenario

LATENCY, RECORDED, HARD, GENTLE = (
    f"simulation-3-{what}" for what in ("latency", "recorded-leader", "hard", "30deg")
)
PROFILES = ("tuned", "improved")
LAWS = {
    "the paper's": "simulation-3",
    "with integral action": "own-law-integral",
    "leader-follower": "own-law-leader-follower",
}
WIND = ("air.wind.speed_mps=8", "air.wind.from_deg=45", "controller.bounded_speed=airspeed")
COMPENSATED = "controller.extrapolate_from=timestamp"
GROUND = "controller.bounded_speed=ground_speed"
OWN_PHASES = ("rates.synchronous=false", "rates.control_hz=10", "rates.broadcast_hz=10")
HEADER = "laps: UAV 1 | 2 | 3 | mean | circle: 1 | 2 | 3 | mean |"
RULE = "--:|" * 8


def profile(name: str) -> tuple[str, ...]:
    """Return the override that selects a profile."""
    return (f"controller.profile={name}",)


# Section 9 of the paper: the same scenarios with its authors' gains and with ours, and ours with
# aircraft that act at 10 Hz, each at its own moments.
ROWS = {
    "profile `authors`": profile("authors"),
    "profile `tuned`": profile("tuned"),
    "`tuned`, own phases at 10 Hz": (*profile("tuned"), *OWN_PHASES),
    "profile `improved`": profile("improved"),
}
PAPER = {
    (f"simulation-{number}", label): Case(f"simulation-{number}", keys)
    for number in (1, 2, 3)
    for label, keys in ROWS.items()
}
CONDITIONS = {
    "unchanged": Case("simulation-3"),
    "every PID gain × 1.5": Case("simulation-3", ("controller.gain_scale=1.5",)),
    "every PID gain × 0.67": Case("simulation-3", ("controller.gain_scale=0.67",)),
    "GPS/INS noise: `simulation-3-noise`": Case("simulation-3-noise"),
    "latency 0.1 s, compensated: `simulation-3-latency`": Case(LATENCY),
    "latency 0.1 s, not compensated": Case(LATENCY, ("controller.extrapolate_from=receipt",)),
    "wind of 8 m/s, bounds of the airspeed": Case("simulation-3", WIND),
}
CHANGED = {
    (label, name): Case(case.scenario, (*case.overrides, *profile(name)))
    for label, case in CONDITIONS.items()
    for name in PROFILES
}
# Without middle loop and airframe: the error of the law itself.
IDEAL = "fleet.*.vehicle=unicycle"
WITH_OMEGA_DOT = "controller.estimators={leader_angular_acceleration: roll_rate}"
CHANGED["ideal vehicles", "tuned"] = Case("simulation-3", (IDEAL,))
CHANGED["ideal vehicles, with ω̇_g", "tuned"] = Case("simulation-3", (IDEAL, WITH_OMEGA_DOT))
HARD_PATHS = {
    (scenario, name): Case(scenario, profile(name))
    for scenario in (GENTLE, RECORDED, HARD)
    for name in PROFILES
} | {(RECORDED, "authors"): Case(RECORDED, profile("authors"))}
NOISY = {
    (law, seed): Case(scenario, (*NOISE, f"scenario.seed={seed}"))
    for law, scenario in LAWS.items()
    for seed in SEEDS
}
ESTIMATORS = "controller.estimators"
# How far the profile `improved` may be changed.
MARGINS = {
    (label, name): Case("simulation-3", (*profile(name), *keys))
    for label, name, *keys in (
        ("every PID gain × 0.5", "improved", "controller.gain_scale=0.5"),
        ("every PID gain × 2", "improved", "controller.gain_scale=2"),
        ("every PID gain × 2.5", "improved", "controller.gain_scale=2.5"),
        ("every PID gain × 2", "tuned", "controller.gain_scale=2"),
        ("latency 0.3 s, compensated", "improved", COMPENSATED, "network.delay_s=0.3"),
        ("latency 0.7 s, compensated", "improved", COMPENSATED, "network.delay_s=0.7"),
        ("latency 0.2 s, compensated", "tuned", COMPENSATED, "network.delay_s=0.2"),
        ("control and messages at 10 Hz", "improved", *OWN_PHASES[1:]),
        ("own phases at 10 Hz", "improved", *OWN_PHASES),
        ("q̈_g from accelerometers", "improved", f"{ESTIMATORS}.leader_acceleration=broadcast"),
        ("no ω̇_g", "improved", f"{ESTIMATORS}.leader_angular_acceleration=none"),
        ("no `eta_climb`", "improved", "controller.gains.feed_forwards.eta_climb=0"),
        ("wind of 8 m/s, bounds of the ground speed", "tuned", *WIND[:2], GROUND),
    )
}
CALM = {(law, None): Case(scenario) for law, scenario in LAWS.items()}


def predicted_lag_m(scenario: Scenario) -> list[float]:
    """Predict each follower's lag in steady flight with uncompensated latency, m.

    A neighbour appears behind by the distance flown in the latency, and lags itself; a follower
    settles at the mean over the received positions, weighted by the (north) gains of the graph.
    """
    path = scenario.leader.path
    assert path.kind == "mission", "the prediction needs a commanded speed"
    late = scenario.network.delay_s * path.airspeed_mps
    graph = scenario.formation
    lags: dict[str, float] = {}
    for name in (follower.name for follower in scenario.fleet):
        received = {other: gain[0] for other, gain in graph.neighbour_gains.get(name, {}).items()}
        from_leader = graph.leader_gains[name][0]
        total = from_leader * late + sum(g * (late + lags[other]) for other, g in received.items())
        lags[name] = total / (from_leader + sum(received.values()))
    return list(lags.values())


def errors(metrics: Metrics) -> list[str]:
    """Return RMS errors and their mean by window, followers in fleet order, as text."""
    return [
        f"{value:.2f}"
        for window in metrics["windows"].values()
        for value in (*window["rms_m"].values(), window["mean_rms_m"])
    ]


def separation(metrics: Metrics) -> str:
    """Return the smallest separation of the flight, its time and the outcome's mark as text."""
    least, at_s = metrics["min_separation_m"], metrics["min_separation_at_s"]
    return f"{least:.2f} m at {at_s:.0f} s{mark(metrics)}"


def bank(metrics: Metrics) -> str:
    """Return the largest bank of the leader by window as text."""
    return ", ".join(f"{p['leader_bank_deg']:.1f}" for p in metrics["windows"].values())


def paper_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Return the rows of the paper's three simulations and ours."""
    yield f"| RMS error, m | numbers of | {HEADER} leader's bank, ° | closest |"
    yield f"|---|---|{RULE}---|---|"
    for number in (1, 2, 3):
        scenario = f"simulation-{number}"
        published = load_scenario(scenario).scenario.published
        assert published is not None
        cells = []
        for window, values in published.rms_m.items():
            cells += [f"{value:g}" for value in (*values, published.mean_rms_m[window])]
        yield row(f"Simulation {number}", "[HBH23] Table 1", *cells, "not printed", "not printed")
        for label in ROWS:
            metrics = flown[scenario, label]
            yield row("", label, *errors(metrics), bank(metrics), separation(metrics))


def conditions_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Return the rows of Simulation 3 under other conditions."""
    yield f"| Simulation 3, RMS error, m | profile | {HEADER} closest |"
    yield f"|---|---|{RULE}---|"
    for (label, name), metrics in flown.items():
        first = label if name == PROFILES[0] else ""
        yield row(first, f"`{name}`", *errors(metrics), separation(metrics))
    lag = predicted_lag_m(load_scenario(LATENCY))
    cells = [f"{value:.2f}" for value in (*lag, sum(lag) / len(lag))]
    yield row("predicted lag at that latency", "", *cells, *cells, "")


def hard_paths_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Return the rows of other leaders' paths, with saturation."""
    yield (
        f"| RMS error, m | profile | {HEADER} leader's bank, ° | closest | saturated for, s | "
        "in slot for good from, s |"
    )
    yield f"|---|---|{RULE}---|---|---|---|"
    for (scenario, name), metrics in flown.items():
        inside = [value["in_slot_since_s"] for value in metrics["recovery"].values()]
        yield row(
            f"`{scenario}`",
            f"`{name}`",
            *errors(metrics),
            bank(metrics),
            separation(metrics),
            ", ".join(f"{value['seconds']:.0f}" for value in metrics["saturations"].values()),
            ", ".join("never" if value is None else f"{value:.0f}" for value in inside),
        )


def margins_table(flown: Mapping[Any, Metrics]) -> Iterator[str]:
    """Return the rows of Simulation 3 with changes that the profile `improved` may not stand."""
    yield "| changed | profile | laps: mean, m | circle: mean, m | largest, m | closest |"
    yield "|---|---|--:|--:|--:|---|"
    for (label, name), metrics in flown.items():
        means = [f"{window['mean_rms_m']:.2f}" for window in metrics["windows"].values()]
        largest = max(max(w["max_error_m"].values()) for w in metrics["windows"].values())
        yield row(label, f"`{name}`", *means, f"{largest:.1f}", separation(metrics))


def laws_table(calm: Mapping[Any, Metrics], noisy: Mapping[Any, Metrics]) -> Iterator[str]:
    """Return the rows of the paper's law and two other laws, on the same seeds."""
    yield "| law | scenario | calm: laps | circle | noise: laps | circle | closest, noise |"
    yield "|---|---|--:|--:|--:|--:|--:|"
    for law, scenario in LAWS.items():
        windows = calm[law, None]["windows"].values()
        flights = [noisy[law, seed] for seed in SEEDS]
        cells = [f"{window['mean_rms_m']:.2f}" for window in windows]
        for window in ("rectangles", "circles"):
            means = [flight["windows"][window]["mean_rms_m"] for flight in flights]
            cells.append(f"{sum(means) / len(means):.2f} ({min(means):.2f}–{max(means):.2f})")
        closest = min(flight["min_separation_m"] for flight in flights)
        yield row(law, f"`{scenario}`", *cells, f"{closest:.2f} m")


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """Return all tables as Markdown lines."""
    paper, changed, hard_paths, margins, calm, noisy = (
        {key: flown[case] for key, case in kind.items()} for kind in KINDS
    )
    return [
        *paper_table(paper),
        "",
        *conditions_table(changed),
        "",
        *hard_paths_table(hard_paths),
        "",
        *margins_table(margins),
        "",
        *laws_table(calm, noisy),
        "",
        MARKS_TEXT,
        "",
        f"Seed 1, in the last table {SEEDS[0]} to {SEEDS[-1]} for the noise; {versions(flown)}.",
    ]


KINDS: Sequence[Mapping[Any, Case]] = (PAPER, CHANGED, HARD_PATHS, MARGINS, CALM, NOISY)
INPUTS = {COMMAND: Inputs(tuple(case for kind in KINDS for case in kind.values()))}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {COMMAND: text})
