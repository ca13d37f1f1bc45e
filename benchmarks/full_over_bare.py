"""What everything around the flight model costs: a whole run against bare JSBSim stepping.

Both are measured in one process, in turns, on the same aircraft files at the same rate. Bare is
the same aircraft, trimmed, their controls left alone, and nothing but `run()`; it starts anew every
minute of flight so that no uncontrolled aircraft reaches the ground. Full is `testbed.run` with the
log on and no viewer, everything included but the building of the world, which is said beside it.

usage: make bench  (ARGS="--scenario NAME --duration S --repeats N --json FILE")
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

from testbed.scenario import Scenario, load, shorten
from testbed.sim.run import run
from testbed.sim.world import build

SEGMENT_S = 60.0


def bare(page: Scenario) -> float:
    """Wall-clock seconds of nothing but the flight models' steps."""
    rate, left, spent = page.rates.physics_hz, page.scenario.duration_s, 0.0
    while left > 0.0:
        steps = range(round(min(left, SEGMENT_S) * rate))
        fleet = build(page).fleet
        if fleet is None:
            raise SystemExit(f"{page.name}: no flight model in it to compare with")
        runs = fleet.bare_runs()
        began = time.perf_counter()
        for _ in steps:
            for step in runs:
                step()
        spent += time.perf_counter() - began
        left -= SEGMENT_S
    return spent


def full(page: Scenario) -> tuple[float, float]:
    """Wall-clock seconds of a run, by its own account, and of building its world."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        wall = float(run(page, out=Path(folder) / "run").metrics["wall_s"])
        return wall, time.perf_counter() - began - wall


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--duration", type=float, help="s of flight; default the scenario's")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    page = load(asked.scenario)
    if asked.duration:
        page = shorten(page, asked.duration)
    full(shorten(page, 1.0))  # compiles what is compiled once
    bares, fulls, builds = [bare(page)], [], []
    for turn in range(asked.repeats):
        wall, built = full(page)
        fulls.append(wall)
        builds.append(built)
        bares.append(bare(page))
        print(f"turn {turn + 1}: full {fulls[-1]:.2f} s, bare {bares[-1]:.2f} s", flush=True)
    # each run against the mean of what was measured before and after it: machines drift
    ratios = [2.0 * f / (b + c) for f, b, c in zip(fulls, bares, bares[1:], strict=False)]
    seconds = page.scenario.duration_s
    result = {
        "scenario": page.name,
        "aircraft": len(page.aircraft_names),
        "simulated_s": seconds,
        "full_over_bare": statistics.median(ratios),
        "full_over_bare_spread": [min(ratios), max(ratios)],
        "real_time_factor": seconds / statistics.median(fulls),
        "bare_real_time_factor": seconds / statistics.median(bares),
        "build_s": statistics.median(builds),
    }
    print(
        f"{page.name}, {result['aircraft']} aircraft, {seconds:g} s: full / bare "
        f"{result['full_over_bare']:.2f} ({min(ratios):.2f}-{max(ratios):.2f}), "
        f"{result['real_time_factor']:.0f} x real time (bare {result['bare_real_time_factor']:.0f} "
        f"x), building and closing {result['build_s']:.2f} s"
    )
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
