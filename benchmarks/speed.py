"""Measure a flight relative to bare JSBSim, by size of the fleet.

usage: make bench  (or: python benchmarks/speed.py [--repeats N] [--work AIRCRAFT_SECONDS]
[--counts N ...] [--json FILE] [--into docs/speed.md])

All scenarios are measured in one process, one after the other, several times. Each turn is the
first half of the bare loop, the flight at its own rate, at that of the bare loop with a log and
without, and the other half.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fleets import COUNTS, all_effects, vee
from full_over_bare import Turn, flight_models, full, median, turn
from inputs import Inputs
from memory import memory
from speed_tables import ALL_EFFECTS, FIGURE, MARK, SIMULATION, TARGETS, machine, picture, text
from tables import add_output_arguments, draw, publish

from testbed.scenario import Scenario, load_scenario, set_duration

WARM_UP_S = 2.0
INPUTS = {MARK: Inputs()}  # times depend on packages and machine, not on gains
LONGEST_S = 1080.0  # what Simulation 3 lasts
MEMORY_S = 60.0
# Scenarios with a target take this many shorter turns per turn of the others: the speed of a shared
# machine varies within seconds.
TURNS_WITH_TARGET = 5


def measure(scenarios: Mapping[str, Scenario], repeats: int) -> dict[str, dict[str, Any]]:
    """Measure every scenario, and return its numbers by name."""
    for scenario in scenarios.values():
        full(set_duration(scenario, WARM_UP_S))  # compiles the kernels
    turns: dict[str, list[Turn]] = {name: [] for name in scenarios}
    for number in range(repeats):
        for name, scenario in scenarios.items():
            taken = [turn(scenario) for _ in range(TURNS_WITH_TARGET if name in TARGETS else 1)]
            turns[name] += taken
            ratio = median([each.ratio for each in taken])
            _print_progress(f"turn {number + 1}: {name}: full / bare {ratio.wall_s:.2f}")
    return {name: numbers(scenario, turns[name]) for name, scenario in scenarios.items()}


def numbers(scenario: Scenario, turns: Sequence[Turn]) -> dict[str, Any]:
    """Return the numbers of the turns of a scenario, ready for JSON."""
    flown, bare = (median([getattr(each, of) for each in turns]) for of in ("full", "bare"))
    seconds, aircraft = scenario.scenario.duration_s, flight_models(scenario)
    each_us = 1e6 / (seconds * aircraft)
    result: dict[str, Any] = {"aircraft": aircraft, "simulated_s": seconds, "turns": len(turns)}
    ratios = {
        "full_over_bare": [each.full / each.bare for each in turns],
        "at_bare_hz": [each.at_bare_hz / each.bare for each in turns],
        "no_log": [each.no_log / each.bare for each in turns],
    }
    for kind, key in (("wall_s", ""), ("processor_s", "_processor")):
        for name, costs in ratios.items():
            values = [getattr(each, kind) for each in costs]
            result[name + key] = statistics.median(values)
            result[f"{name}{key}_spread"] = [min(values), max(values)]
    return result | {
        "real_time_factor": seconds / flown.wall_s,
        "bare_real_time_factor": seconds / bare.wall_s,
        "build_s": sorted(one.build_s for one in turns)[len(turns) // 2],
        "wall_us_per_aircraft_second": flown.wall_s * each_us,
        "us_per_aircraft_second": {
            "bare": bare.processor_s * each_us,
            "full": flown.processor_s * each_us,
        },
    }


def flight_s(work: float, aircraft: int) -> float:
    """Return the seconds of flight for these aircraft-seconds."""
    return min(work / aircraft, LONGEST_S)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, and write the requested files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    # many short turns: the speed of a shared machine varies within seconds
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--work", type=float, default=600.0, help="aircraft-seconds of a flight")
    parser.add_argument("--counts", type=int, nargs="*", default=COUNTS)
    parser.add_argument("--json", type=Path)
    add_output_arguments(parser)
    options = parser.parse_args(arguments)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
    scenarios = {SIMULATION: load_scenario(SIMULATION), ALL_EFFECTS: all_effects()}
    scenarios = {
        name: set_duration(each, flight_s(options.work / TURNS_WITH_TARGET, 4))
        for name, each in scenarios.items()
    }
    scenarios |= {str(count): vee(count, flight_s(options.work, count)) for count in options.counts}
    beforehand = machine()
    results = measure(scenarios, options.repeats)
    result: dict[str, Any] = {
        "machine": beforehand,
        **{name: results[name] for name in (SIMULATION, ALL_EFFECTS)},
        "by_aircraft": {str(count): results[str(count)] for count in options.counts},
    }
    if options.counts:
        result["memory"] = memory(max(options.counts), MEMORY_S)
    lines = text(result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    draw(picture(result), FIGURE)
    publish(options, {MARK: lines}, INPUTS)


def _print_progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
