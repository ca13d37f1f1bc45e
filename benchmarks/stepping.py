"""Measure what stepping a scenario from Python costs, relative to flying it at once.

Turns of `testbed.run` and of `testbed.Simulation`, stepped at 50 Hz with the state read at every
step, both without files.

usage: python benchmarks/stepping.py [--scenario NAME] [--seconds S] [--turns N]
"""

from __future__ import annotations

import argparse
import statistics
import time

import testbed
from testbed.scenario import Scenario, load_scenario, set_duration


def fly(scenario: Scenario) -> float:
    """Fly a scenario at once, and return the processor time, s."""
    begun = time.process_time()
    testbed.run(scenario, write=False)
    return time.process_time() - begun


def step(scenario: Scenario) -> float:
    """Step through a scenario, and return the processor time, s."""
    begun = time.process_time()
    with testbed.Simulation(scenario) as simulation:
        while simulation.outcome is None:
            simulation.step()
    return time.process_time() - begun


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--seconds", type=float, default=120.0, help="of flight")
    parser.add_argument("--turns", type=int, default=9)
    options = parser.parse_args()
    scenario = set_duration(load_scenario(options.scenario), options.seconds)
    fly(scenario), step(scenario)  # compile the kernels
    ratios = [step(scenario) / fly(scenario) for _ in range(options.turns)]
    print(
        f"{options.scenario}: stepped / flown at once {statistics.median(ratios):.2f} "
        f"({min(ratios):.2f} to {max(ratios):.2f}), processor time of {options.turns} turns"
    )


if __name__ == "__main__":
    main()
