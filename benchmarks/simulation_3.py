"""Every number of docs/simulation-3.md: the flights of Simulation 3 as two Markdown tables.

Flights are independent and fly on several processes. Nothing here depends on the clock: the same
machine and versions give the same text.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import testbed
from testbed.scenario import Scenario, load

BEGIN, END = "<!-- begin: make results -->", "<!-- end: make results -->"
LATENCY = "simulation-3-latency"
AUTHORS = ("controller.profile=authors",)
HEADER = "| RMS error, m | laps: UAV 1 | 2 | 3 | circle: 1 | 2 | 3 | leader's bank, ° | closest |"
RULE = "|---" + "|--:" * 6 + "|---|---|"


@dataclass(frozen=True, slots=True)
class Case:
    """A flight and what it is called in the table."""

    label: str
    scenario: str = "simulation-3"
    overrides: tuple[str, ...] = ()


ON_THE_PAPERS_PATH = (
    Case("profile `paper`"),
    Case("profile `authors`", overrides=AUTHORS),
    Case("every PID gain × 1.5", overrides=("controller.gain_scale=1.5",)),
    Case("every PID gain × 0.67", overrides=("controller.gain_scale=0.67",)),
    Case("GPS/INS noise: `simulation-3-noise`", "simulation-3-noise"),
    Case("latency 0.1 s, compensated: `simulation-3-latency`", LATENCY),
    Case("latency 0.1 s, not compensated", LATENCY, ("controller.extrapolate_from=receipt",)),
)
ON_HARDER_PATHS = (
    Case("`simulation-3-recorded-leader`", "simulation-3-recorded-leader"),
    Case("the same, profile `authors`", "simulation-3-recorded-leader", AUTHORS),
    Case("`simulation-3-hard`", "simulation-3-hard"),
)


def fly(case: Case) -> Mapping[str, Any]:
    """The metrics of a case, flown without writing files."""
    flown = testbed.run(case.scenario, case.overrides, write=False)
    if flown.outcome != "flown":
        raise SystemExit(f"{case.label}: {flown.outcome}")
    return flown.metrics


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


def row(label: str, cells: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return "| " + " | ".join((label, *cells)) + " |"


def numbers(values: Sequence[float | None]) -> list[str]:
    """Cells with two decimals."""
    return ["–" if value is None else f"{value:.2f}" for value in values]


def errors(metrics: Mapping[str, Any]) -> list[str]:
    """RMS errors, portion after portion, followers in fleet order."""
    portions = metrics["portions"].values()
    return [cell for portion in portions for cell in numbers(list(portion["rms_m"].values()))]


def separation(metrics: Mapping[str, Any]) -> str:
    """The smallest separation of the whole flight and its time."""
    return f"{metrics['min_separation_m']:.2f} m at {metrics['min_separation_at_s']:.0f} s"


def bank(metrics: Mapping[str, Any]) -> str:
    """The largest bank of the leader, portion by portion."""
    return ", ".join(f"{p['leader_bank_deg']:.1f}" for p in metrics["portions"].values())


def paper_path_table(flown: Sequence[Mapping[str, Any]]) -> list[str]:
    """The first table: one path, many conditions."""
    published = load("simulation-3").scenario.published
    assert published is not None
    lag = numbers(predicted_lag_m(load(LATENCY)))
    lines = [
        HEADER,
        RULE,
        row(
            published.source,
            [f"{x:g}" for cells in published.rms_m.values() for x in cells] + ["not printed"] * 2,
        ),
    ]
    for case, metrics in zip(ON_THE_PAPERS_PATH, flown, strict=True):
        lines.append(row(case.label, [*errors(metrics), bank(metrics), separation(metrics)]))
    return [*lines, row("the lag predicted for that", [*lag, *lag, "", ""])]


def harder_paths_table(flown: Sequence[Mapping[str, Any]]) -> list[str]:
    """The second table: other leaders' paths, with what saturated."""
    lines = [
        HEADER + " at a limit for, s | within 5 m for good from, s |",
        RULE + "---|---|",
    ]
    for case, metrics in zip(ON_HARDER_PATHS, flown, strict=True):
        limits = [f"{value['seconds']:.0f}" for value in metrics["saturations"].values()]
        inside = [value["inside_for_good_from_s"] for value in metrics["recovery"].values()]
        cells = [
            *errors(metrics),
            bank(metrics),
            separation(metrics),
            ", ".join(limits),
            ", ".join("never back" if value is None else f"{value:.0f}" for value in inside),
        ]
        lines.append(row(case.label, cells))
    return lines


def insert(page: str, text: str) -> str:
    """The page with the text between its markers."""
    if page.count(BEGIN) != 1 or page.count(END) != 1:
        raise SystemExit(f"expected one {BEGIN} and one {END}")
    head, rest = page.split(BEGIN)
    _, tail = rest.split(END)
    return f"{head}{BEGIN}\n\n{text}\n\n{END}{tail}"


def main() -> None:
    """Fly everything, print the tables, and put them into a page if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--into", type=Path, help="a page with the two markers")
    asked = parser.parse_args()
    cases = (*ON_THE_PAPERS_PATH, *ON_HARDER_PATHS)
    flown = []
    with ProcessPoolExecutor(asked.jobs) as pool:
        for case, metrics in zip(cases, pool.map(fly, cases), strict=True):
            print(f"flown: {case.label}", file=sys.stderr, flush=True)
            flown.append(metrics)
    first = len(ON_THE_PAPERS_PATH)
    versions = ", ".join(f"{name} {of}" for name, of in flown[0]["versions"].items())
    text = "\n".join(
        [
            *paper_path_table(flown[:first]),
            "",
            *harder_paths_table(flown[first:]),
            "",
            f"Seed {flown[0]['seed']}; {versions}.",
        ]
    )
    print(text)
    if asked.into:
        page = insert(asked.into.read_text(encoding="utf-8"), text)
        asked.into.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
