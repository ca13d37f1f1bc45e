"""Measure what a flight costs besides itself: its start, a first flight, and further ones.

Processes are started in turns, with bytecode and machine code kept from before; the first of
each, which may compile, is left out. The unit N is the processor time of `python -c "import
numpy"`. It is no measure alone: on a shared machine the same command takes different numbers of N
from hour to hour. With --before each command is run by an earlier version too, in the same turns.

usage: make bench  (or: python benchmarks/startup.py [--before REVISION] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FURTHER = """
import sys, time
from testbed.runs.run import run
from testbed.scenario import load_scenario
scenario, times = load_scenario("simulation-3"), []
for _ in range({flights} + 5):
    began = time.process_time()
    run(scenario, duration_s=5.0, write=False)
    times.append(time.process_time() - began)
print(sorted(times[5:])[{flights} // 2])
"""
# A law of a user's: towards the slot, with the leader's velocity.
LAW = """
import testbed
from testbed.law import command_from_velocity

@testbed.kernel
def hold(now, own, inbox, memory, config):
    if not now - inbox.received_s[0] <= config.leader_timeout_s:
        return command_from_velocity(config, own, own.velocity_ned)
    error = inbox.position_ned[0] + config.offsets[config.agents] - own.position_ned
    return command_from_velocity(config, own, inbox.velocity_ned[0] + 0.1 * error)
"""
STUDY = """
study: {schema: 1, name: start, scenario: simulation-3, duration_s: 20,
        design: factorial, seeds: [1]}
vary: {network.loss: LOSSES}
"""
SCENARIO = "extends: {scenario}\ncontroller: {{law: 'law.py:hold'}}\n"


class Used(NamedTuple):
    """What a process has used."""

    processor_s: float
    megabytes: float
    printed: str


class Version(NamedTuple):
    """A version of the testbed, with a folder for its machine code and bytecode."""

    name: str
    tree: Path
    kept: Path

    def call(self, arguments: Sequence[str], kept: str = "kept") -> Used:
        """Run a Python process of this version, and measure it.

        Args:
            arguments: of Python.
            kept: name of the folder of its machine code.
        """
        environment = {
            **{k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"},
            "PYTHONPATH": str(self.tree),
            "PYTHONPYCACHEPREFIX": str(self.kept / "bytecode"),
            "NUMBA_CACHE_DIR": str(self.kept / kept),
        }
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "law.py").write_text(LAW)
            scenario = self.tree / "scenarios" / "simulation-3.yaml"
            (Path(folder) / "law.yaml").write_text(SCENARIO.format(scenario=scenario))
            (Path(folder) / "study.yaml").write_text(
                STUDY.replace("LOSSES", str([k / 2000 for k in range(1000)]))
            )
            process = subprocess.Popen(
                [sys.executable, *arguments],
                cwd=folder,
                env=environment,
                stdout=subprocess.PIPE,
                text=True,
            )
            assert process.stdout is not None
            with process.stdout:
                printed = process.stdout.read()
            _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{self.name}: python {' '.join(arguments)[:80]} failed")
        return Used(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, printed)


@contextmanager
def versions(before: str | None) -> Iterator[list[Version]]:
    """Yield an earlier version, in a copy of the repository, and this one."""
    with tempfile.TemporaryDirectory() as folder:
        now = Version("now", ROOT, Path(folder) / "now")
        if before is None:
            yield [now]
            return
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "-q", "--detach", str(tree), before], check=True)
        try:
            yield [Version("before", tree, Path(folder) / "before"), now]
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def main() -> None:
    """Measure, and print each result in a line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--before", metavar="REVISION", help="also measure this version, in turns")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--first", type=int, default=3, help="first flights, and sweeps")
    parser.add_argument("--only", default="", metavar="TEXT", help="commands whose names have it")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    run = ["-m", "testbed", "run", "--quiet", "--out", "run"]
    commands = {
        "testbed --help": ["-m", "testbed", "--help"],
        "testbed run simulation-3 --duration 5": [*run, "simulation-3", "--duration", "5"],
        "testbed run simulation-3": [*run, "simulation-3"],
        "5 s with a kernel law": [*run, "law.yaml", "--duration", "5"],
        "sweep of 1,000 flights of 20 s that differ in a key, --jobs 1": [
            *("-m", "testbed", "sweep", "study.yaml", "--jobs", "1", "--quiet"),
            *("--out", "study.parquet"),
        ],
    }
    result: dict[str, object] = {}
    with versions(options.before) as found:
        numpy = ["-c", "import numpy"]
        units = [found[-1].call(numpy).processor_s for _ in range(options.repeats)]
        unit = statistics.median(units)
        print(f'N, python -c "import numpy": {unit:.3f} s', flush=True)
        for name, arguments in commands.items():
            if options.only in name:
                repeats = options.first if name.startswith("sweep") else options.repeats
                report(name, measure(found, repeats, arguments), unit, result)
        name = "first flight of 5 s, with nothing compiled"
        if options.only in name:
            short = commands["testbed run simulation-3 --duration 5"]
            report(name, measure(found, options.first, short, anew=True), unit, result)
        name = "each further flight of 5 s in a process"
        if options.only in name:
            further = measure(found, options.repeats, ["-c", FURTHER.format(flights=50)])
            used = {
                version: [Used(float(each.printed), 0.0, "") for each in processes]
                for version, processes in further.items()
            }
            report(name, used, unit, result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


def measure(
    found: Sequence[Version], repeats: int, arguments: Sequence[str], anew: bool = False
) -> dict[str, list[Used]]:
    """Measure a command of each version in turns; anew: each time with nothing compiled."""
    used: dict[str, list[Used]] = {each.name: [] for each in found}
    for each in found:
        each.call(arguments)  # compiles
    for number in range(repeats):
        for each in found:
            kept = f"anew-{number}" if anew else "kept"
            used[each.name].append(each.call(arguments, kept))
    return used


def report(name: str, used: dict[str, list[Used]], unit: float, result: dict[str, object]) -> None:
    """Print what a command takes, and add its numbers to the result."""
    medians = {
        version: statistics.median(each.processor_s for each in all_used)
        for version, all_used in used.items()
    }
    now = medians["now"]
    megabytes = statistics.median(each.megabytes for each in used["now"])
    numbers = {"processor_s": now, "numpy_imports": now / unit, "megabytes": megabytes}
    line = f"{name}: {now:.3f} s, {now / unit:.1f} N"
    if megabytes:
        line += f", {megabytes:.0f} MB"
    if "before" in medians:
        numbers["ratio"] = now / medians["before"]
        line += f"; {numbers['ratio']:.2f} of {medians['before']:.3f} s before"
    result[name] = numbers
    print(line, flush=True)


if __name__ == "__main__":
    main()
