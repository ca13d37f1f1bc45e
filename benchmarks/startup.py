"""How long it takes to begin: `testbed --help`, and a run to its first tick, beside Python alone.

Processes are started in turns: one that does nothing, one that prints the help, and one that ends
itself when the run's first frame is there. The first of each, which may have to compile, does not
count. Ratios are to what Python alone took before and after, so that they say something on a
machine that has other things to do.

usage: make bench  (or: python benchmarks/startup.py [--scenario NAME] [--repeats N] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# Bytecode is kept, as it is for whoever uses the testbed twice.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
# The progress bar is made before the flight and sees its first frame before the second tick.
TO_FIRST_TICK = """
import os, sys
from testbed import cli, console

class FirstTick:
    borrows = True
    def __init__(self, *told): pass
    def begin(self, info): pass
    def observe(self, frame): os._exit(0)
    def end(self, *told): pass

console.ProgressBar = FirstTick
sys.argv = ["testbed", "run", {scenario!r}, "--out", "run"]
cli.main()
sys.exit("the run ended without a tick")
"""


def took(arguments: list[str]) -> tuple[float, float]:
    """Wall clock and processor time of a process of Python, s."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, *arguments], cwd=folder, env=ENVIRONMENT, stdout=subprocess.DEVNULL
        )
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"python {arguments[0]} … ended with {process.returncode}")
    return wall, used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    nothing = ["-c", "pass"]
    begun = {
        "testbed --help": ["-m", "testbed", "--help"],
        f"testbed run {asked.scenario}, to its first tick": [
            "-c",
            TO_FIRST_TICK.format(scenario=asked.scenario),
        ],
    }
    result: dict[str, object] = {"repeats": asked.repeats, "scenario": asked.scenario}
    for arguments in begun.values():
        took(arguments)  # compiles what is compiled once
    alone = [took(nothing)]
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in begun}
    between: dict[str, list[float]] = {name: [] for name in begun}
    for _ in range(asked.repeats):
        for name, arguments in begun.items():
            measured[name].append(took(arguments))
            alone.append(took(nothing))
            between[name].append(0.5 * (alone[-2][0] + alone[-1][0]))
    show("python -c pass", alone, None, result)
    for name, each in measured.items():
        show(name, each, between[name], result)
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


def show(
    name: str,
    times: list[tuple[float, float]],
    alone: list[float] | None,
    result: dict[str, object],
) -> None:
    """Print one line, and keep its numbers.

    Args:
        name: what was started.
        times: wall clocks and processor times, s.
        alone: for each, the wall clock of Python alone, s.
        result: gains them.
    """
    walls = [wall for wall, _ in times]
    processor = statistics.median(used for _, used in times)
    line = f"{name}: {spread(walls, '.3f')} s, processor {processor:.3f} s"
    numbers: dict[str, object] = {
        "wall_s": statistics.median(walls),
        "wall_s_spread": [min(walls), max(walls)],
        "processor_s": processor,
    }
    if alone:
        ratios = [wall / empty for wall, empty in zip(walls, alone, strict=True)]
        numbers |= {"ratio": statistics.median(ratios), "spread": [min(ratios), max(ratios)]}
        line += f"; x {spread(ratios, '.1f')} Python alone"
    result[name] = numbers
    print(line, flush=True)


def spread(values: list[float], form: str) -> str:
    """The median, the smallest and the largest."""
    median, low, high = statistics.median(values), min(values), max(values)
    return f"{median:{form}} ({low:{form}}-{high:{form}})"


if __name__ == "__main__":
    main()
