"""Time many flights in one process, in turns with bare JSBSim.

Rows fly Simulation 3 with law, network and metrics, each with its own seed of 20 % packet loss, on
one thread. Bare JSBSim is `run()` of four of the same aircraft at 200 Hz, with its default
integrators and constant controls.
"""

from __future__ import annotations

import argparse
import statistics
import time

from full_over_bare import bare

import testbed
from testbed.scenario import load_scenario, set_duration

TURNS, FLIGHT_S, BARE_S = 3, 60.0, 20.0


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[1, 8, 32, 128])
    parser.add_argument("--physics-hz", type=int, default=200)
    args = parser.parse_args()
    changes = [f"rates.physics_hz={args.physics_hz}", "network.loss=0.2"]
    scenario = set_duration(load_scenario("simulation-3", changes), FLIGHT_S)
    jsbsim = load_scenario("simulation-3", ["rates.physics_hz=200"])
    aircraft = len(scenario.aircraft)
    print("rows  aircraft-seconds per second  / bare JSBSim  build, ms per row")
    for rows in args.rows:
        rates, ratios, builds = [], [], []
        for _ in range(TURNS):
            spent = bare(jsbsim, BARE_S).processor_s
            begun = time.process_time()
            batch = testbed.Batch(scenario, seeds=range(1, rows + 1), threads=1)
            built = time.process_time()
            batch.run()
            flown = time.process_time() - built
            rates.append(rows * aircraft * FLIGHT_S / flown)
            ratios.append(rates[-1] / (aircraft * BARE_S / spent))
            builds.append((built - begun) / rows)
        middle = statistics.median
        numbers = f"{middle(rates):27,.0f}  {middle(ratios):14.1f}  {1e3 * middle(builds):16.1f}"
        print(f"{rows:4d}  {numbers}")


if __name__ == "__main__":
    main()
