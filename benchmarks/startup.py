"""Measure the start of `testbed --help` and of a run to its first tick, relative to Python alone.

Processes are started alternately: one that does nothing, one that prints the help, and one that
ends at the run's first sample. The first of each, which may compile, is left out. Ratios are to
Python alone before and after, so that they also hold on a busy machine.

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

# Bytecode is kept, as from the second start on.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
# The observer that reports progress gets its first sample before the second tick.
TO_FIRST_TICK = """
import os, sys
import testbed.runs.run
from testbed.cli.entry import main

class FirstTick:
    zero_copy = True
    def __init__(self, *args): pass
    def begin(self, info): pass
    def observe(self, sample): os._exit(0)
    def end(self, *args): pass

testbed.runs.run.FlightProgress = FirstTick
sys.argv = ["testbed", "run", {scenario!r}, "--out", "run"]
main()
sys.exit("the run ended without a tick")
"""


def start_time_s(arguments: list[str]) -> tuple[float, float]:
    """Measure wall-clock and processor time of a Python process, s."""
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
    """Measure, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    idle = ["-c", "pass"]
    commands = {
        "testbed --help": ["-m", "testbed", "--help"],
        f"testbed run {options.scenario}, to its first tick": [
            "-c",
            TO_FIRST_TICK.format(scenario=options.scenario),
        ],
    }
    result: dict[str, object] = {"repeats": options.repeats, "scenario": options.scenario}
    for arguments in commands.values():
        start_time_s(arguments)  # compiles the kernels
    alone = [start_time_s(idle)]
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    between: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(options.repeats):
        for name, arguments in commands.items():
            measured[name].append(start_time_s(arguments))
            alone.append(start_time_s(idle))
            between[name].append(0.5 * (alone[-2][0] + alone[-1][0]))
    print_line("python -c pass", alone, None, result)
    for name, each in measured.items():
        print_line(name, each, between[name], result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def print_line(
    name: str,
    times: list[tuple[float, float]],
    alone: list[float] | None,
    result: dict[str, object],
) -> None:
    """Print one line, and add its numbers to the result.

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
    """Return median, smallest and largest value as text."""
    median, low, high = statistics.median(values), min(values), max(values)
    return f"{median:{form}} ({low:{form}}-{high:{form}})"


if __name__ == "__main__":
    main()
