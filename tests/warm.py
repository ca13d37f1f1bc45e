"""Compiles what flights need, before several processes would each do it for themselves.

usage: python tests/warm.py sensors|flights
"""

import sys

from testbed.runs.run import run
from testbed.scenario import load_scenario, set_duration

SCENARIOS = {
    "sensors": ("simulation-3-pixhawk",),  # takes as long as all the rest
    "flights": (
        *("simulation-3", "turbulence-moderate", "close-formation-wake"),
        "ideal-figure-eight",  # has a virtual leader
    ),
}
for name in SCENARIOS[sys.argv[1]]:
    run(set_duration(load_scenario(name, ["log.mcap=false"]), 0.5), write=False)
