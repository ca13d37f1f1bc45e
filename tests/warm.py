"""Compiles what flights need, before several processes would each do it for themselves.

usage: python tests/warm.py first|sensors|flights
"""

import sys
import time

from testbed.cli.output import message_console
from testbed.cli.progress import CompilingBar
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
console = message_console()
bar = CompilingBar(console) if sys.argv[1] == "first" else None
for name in SCENARIOS[sys.argv[1]]:
    short = set_duration(load_scenario(name, ["log.mcap=false"]), 0.5)
    run(short, write=False, compiling=bar)
if bar is not None:
    console.write_line(f"  ready in {time.monotonic() - begin:.0f} s")
