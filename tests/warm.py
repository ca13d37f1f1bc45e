"""Compiles what flights need, before several processes would each do it for themselves.

usage: python tests/warm.py first|sensors|flights
"""

import sys
import time

from testbed.runs.run import run
from testbed.scenario import load_scenario, set_duration

SCENARIOS = {
    "first": ("simulation-3",),  # what `make run` flies
    "sensors": ("simulation-3-pixhawk",),  # takes as long as all the rest
    "flights": (
        *("simulation-3", "turbulence-moderate", "close-formation-wake"),
        "ideal-figure-eight",  # has a virtual leader
    ),
}
begin = time.monotonic()
first = sys.argv[1] == "first"
for name in SCENARIOS[sys.argv[1]]:
    short = set_duration(load_scenario(name, ["log.mcap=false"]), 0.5)
    run(short, write=False, progress=first)
if first:
    print(f"  ready in {time.monotonic() - begin:.0f} s", file=sys.stderr)
