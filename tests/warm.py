"""Compiles what flights need, before several processes would each do it for themselves."""

from testbed.scenario import load, shorten
from testbed.sim.run import run

for name in ("simulation-3-pixhawk", "turbulence-moderate", "close-formation-wake"):
    run(shorten(load(name, ["log.mcap=false"]), 0.5), write=False)
