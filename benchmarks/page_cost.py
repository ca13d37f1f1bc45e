"""What keys of a page cost: a whole run with them against the same run without, in turns.

Each run is `testbed.run` with the log on and no viewer. Two ratios are printed, each the median of
the turns with its spread: of the flight alone by its own account, and with building the world.

usage: make bench  (or: python benchmarks/page_cost.py --set KEY=VALUE ... [--scenario NAME]
[--duration S] [--repeats N] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path

from full_over_bare import full

from testbed.scenario import Scenario, load, shorten


def seconds(page: Scenario) -> tuple[float, float]:
    """Wall-clock seconds of the flight, and of building its world and closing its log."""
    cost, built = full(page)
    return cost.wall_s, built


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--set", action="append", required=True, metavar="KEY=VALUE")
    parser.add_argument("--duration", type=float, help="s of flight; default the scenario's")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    without, with_keys = load(asked.scenario), load(asked.scenario, asked.set)
    if asked.duration:
        without, with_keys = (shorten(page, asked.duration) for page in (without, with_keys))
    for page in (without, with_keys):
        full(shorten(page, 1.0))  # compiles what is compiled once
    plain, dear = [seconds(without)], []
    for turn in range(asked.repeats):
        dear.append(seconds(with_keys))
        plain.append(seconds(without))
        print(f"turn {turn + 1}: {dear[-1][0]:.2f} s, without {plain[-1][0]:.2f} s", flush=True)
    # each run against the mean of what was measured before and after it: machines drift
    turns = list(zip(dear, plain, plain[1:], strict=False))
    flights = [2.0 * d[0] / (p[0] + q[0]) for d, p, q in turns]
    wholes = [2.0 * sum(d) / (sum(p) + sum(q)) for d, p, q in turns]
    result = {
        "scenario": without.name,
        "set": asked.set,
        "simulated_s": without.scenario.duration_s,
        "flight_ratio": statistics.median(flights),
        "flight_ratio_spread": [min(flights), max(flights)],
        "with_build_ratio": statistics.median(wholes),
        "with_build_ratio_spread": [min(wholes), max(wholes)],
    }
    print(
        f"{without.name}, {without.scenario.duration_s:g} s, {' '.join(asked.set)}: flight x "
        f"{result['flight_ratio']:.2f} ({min(flights):.2f}-{max(flights):.2f}), with building x "
        f"{result['with_build_ratio']:.2f} ({min(wholes):.2f}-{max(wholes):.2f})"
    )
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
