"""Compiles what flights need, before several processes would each do it for themselves.

usage: python tests/warm.py sensors|flights
"""

import sys

from testbed.scenario import load_scenario, set_duration
from testbed.sim.build import build
from testbed.sim.run import run

if sys.argv[1] == "sensors":  # takes as long as all the rest
    build(load_scenario("simulation-3-pixhawk"))
else:
    for name in ("simulation-3", "turbulence-moderate", "close-formation-wake"):
        run(set_duration(load_scenario(name, ["log.mcap=false"]), 0.5), write=False)
