"""Measure the cost of scenario keys: runs with them and without, alternating.

Each run is `testbed.run` with the log on and no viewer. Two ratios are printed, each the median of
the turns with its range: of the flight alone, and with building the simulation.

usage: make bench  (or: python benchmarks/scenario_cost.py --set KEY=VALUE ... [--scenario NAME]
[--duration S] [--repeats N] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path

from full_over_bare import full

from testbed.scenario import Scenario, load_scenario, set_duration


def seconds(scenario: Scenario) -> tuple[float, float]:
    """Measure wall-clock seconds of the flight, and of building and closing."""
    cost, built = full(scenario)
    return cost.wall_s, built


def main() -> None:
    """Measure, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--set", action="append", required=True, metavar="KEY=VALUE")
    parser.add_argument("--duration", type=float, help="s of flight; default the scenario's")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    without, with_keys = (
        load_scenario(options.scenario),
        load_scenario(options.scenario, options.set),
    )
    if options.duration:
        without, with_keys = (
            set_duration(scenario, options.duration) for scenario in (without, with_keys)
        )
    for scenario in (without, with_keys):
        full(set_duration(scenario, 1.0))  # compiles the kernels
    without_times, with_times = [seconds(without)], []
    for turn in range(options.repeats):
        with_times.append(seconds(with_keys))
        without_times.append(seconds(without))
        print(
            f"turn {turn + 1}: {with_times[-1][0]:.2f} s, without {without_times[-1][0]:.2f} s",
            flush=True,
        )
    # each run relative to the mean of those before and after it, against drift
    turns = list(zip(with_times, without_times, without_times[1:], strict=False))
    flights = [2.0 * d[0] / (p[0] + q[0]) for d, p, q in turns]
    wholes = [2.0 * sum(d) / (sum(p) + sum(q)) for d, p, q in turns]
    result = {
        "scenario": without.name,
        "set": options.set,
        "simulated_s": without.scenario.duration_s,
        "flight_ratio": statistics.median(flights),
        "flight_ratio_spread": [min(flights), max(flights)],
        "with_build_ratio": statistics.median(wholes),
        "with_build_ratio_spread": [min(wholes), max(wholes)],
    }
    print(
        f"{without.name}, {without.scenario.duration_s:g} s, {' '.join(options.set)}: flight x "
        f"{result['flight_ratio']:.2f} ({min(flights):.2f}-{max(flights):.2f}), with building x "
        f"{result['with_build_ratio']:.2f} ({min(wholes):.2f}-{max(wholes):.2f})"
    )
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
