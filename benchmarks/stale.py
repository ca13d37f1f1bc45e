"""Find numbers of the pages that are older than one of their inputs, and write or check them again.

usage: python benchmarks/stale.py            list them: exit 3 if there is one
       python benchmarks/stale.py --write    run the commands of those, and of no others
       python benchmarks/stale.py --check    make all but times again: exit 1 if a digit differs

A page has its numbers between two markers that name their command, with a comment that has digests
of the inputs: `inputs.py`. No list of pages stands elsewhere.
"""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parent
ROOT = SCRIPTS.parent
FOLDERS = (SCRIPTS, ROOT / "paper")
sys.path[:0] = [str(each) for each in FOLDERS if str(each) not in sys.path]

from inputs import Inputs, changed, digests, parse  # noqa: E402
from pictures import PICTURES  # noqa: E402
from tables import blocks, part_of  # noqa: E402

STALE = 3  # exit code


@dataclass(frozen=True, slots=True)
class Source:
    """A script whose `INPUTS` has what it writes, by what the markers name.

    Args:
        script: its path in the repository.
        pages: with the markers.
        minutes: that it takes on two quiet processors, all parts.
        parts: whether `--only` makes a part.
        jobs: whether it takes `--jobs`.
        exact: whether a second call gives the same digits; False: times, and pictures.
    """

    script: str
    pages: tuple[str, ...]
    minutes: float
    parts: bool = False
    jobs: bool = True
    exact: bool = True

    @property
    def inputs(self) -> Mapping[str, Inputs]:
        """Inputs of each text."""
        found: Mapping[str, Inputs] = importlib.import_module(Path(self.script).stem).INPUTS
        return found

    def command(self, marks: Sequence[str], jobs: int) -> list[str]:
        """Return the command that writes these texts."""
        words = ["python", self.script, "--into", *self.pages]
        if self.jobs:
            words += ["--jobs", str(jobs)]
        if self.parts and set(marks) != set(self.inputs):
            words += ["--only", *map(part_of, marks)]
        return words


SOURCES = (
    Source("paper/freedoms.py", ("docs/results/simulations.md",), 3),
    Source("paper/leader_acceleration.py", ("paper/leader-acceleration.md",), 5),
    Source("benchmarks/results.py", ("docs/results/simulations.md",), 2),
    Source("benchmarks/experiments.py", ("docs/results/experiments.md",), 2),
    Source("benchmarks/air.py", ("docs/air.md",), 2),
    Source("benchmarks/network.py", ("docs/network.md",), 2),
    Source("benchmarks/sensors.py", ("docs/sensors.md",), 3),
    Source("benchmarks/faults.py", ("docs/faults.md",), 3, parts=True),
    Source("benchmarks/examples.py", ("docs/own-law.md", "docs/large.md"), 1, parts=True),
    Source("benchmarks/tuned.py", ("docs/tune.md", "docs/studies.md"), 3),
    Source("benchmarks/nesc.py", ("docs/physics.md",), 1, jobs=False),
    Source("benchmarks/predictions.py", ("docs/margins.md",), 15, parts=True, jobs=False),
    Source("benchmarks/delay.py", ("docs/margins.md",), 10, parts=True),
    Source("benchmarks/convergence.py", ("docs/speed.md",), 15),
    Source("paper/gap_budget.py", ("paper/gap.md",), 15, parts=True),
    Source(
        "benchmarks/real_arduplane.py", ("docs/arduplane.md", "docs/autopilot.md"), 2, jobs=False
    ),
    Source(
        "benchmarks/recorded_arduplane.py",
        ("docs/autopilot.md", "aircraft/rascal110/SOURCE.md"),
        2,
        jobs=False,
    ),
    Source("benchmarks/new_aircraft.py", ("docs/own-aircraft.md",), 30, jobs=False),
    Source(
        "benchmarks/pictures.py",
        tuple(dict.fromkeys(each.page for each in PICTURES)),
        40,
        parts=True,
        jobs=False,
        exact=False,
    ),
    Source("benchmarks/training.py", ("docs/rl.md",), 3, jobs=False, exact=False),
    Source("benchmarks/speed.py", ("docs/speed.md",), 30, jobs=False, exact=False),
    Source("benchmarks/batch.py", ("docs/many-flights.md",), 10, jobs=False, exact=False),
)


@dataclass(frozen=True, slots=True)
class Stale:
    """A marked part of a page that is older than its inputs.

    Args:
        page: its path in the repository.
        line: of the marker.
        mark: what the marker names.
        source: that writes it; None: no script does.
        reasons: one for each input that changed.
    """

    page: str
    line: int
    mark: str
    source: Source | None
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        """Return a line of the list."""
        return f"{self.page}:{self.line}: {self.mark}: {'; '.join(self.reasons)}"


@cache
def _digests(inputs: Inputs) -> Mapping[str, str]:
    return digests(inputs)


@cache
def _written() -> Mapping[tuple[str, str], Source]:
    """Return the script that writes each part of a page, by page and mark."""
    return {(page, mark): each for each in SOURCES for page in each.pages for mark in each.inputs}


def pages() -> Iterator[str]:
    """Yield all pages that may have markers."""
    for folder, pattern in (("docs", "**/*.md"), ("paper", "*.md"), ("aircraft", "*/*.md")):
        for path in sorted((ROOT / folder).glob(pattern)):
            yield path.relative_to(ROOT).as_posix()


def find_stale(of: Sequence[str] | None = None) -> list[Stale]:
    """Return the parts of pages that are older than their inputs, or that no script writes.

    Args:
        of: pages; None: all.
    """
    written = _written()
    found, seen = [], set()
    for page in pages() if of is None else of:
        for block in blocks((ROOT / page).read_text(encoding="utf-8")):
            source = written.get((page, block.mark))
            seen.add((source, block.mark))
            if source is None:
                reasons = ("no script of benchmarks/stale.py writes it",)
            elif not block.comment:
                reasons = ("has no digests of its inputs",)
            else:
                now = _digests(source.inputs[block.mark])
                reasons = tuple(changed(parse(block.comment), now))
            if reasons:
                found.append(Stale(page, block.line, block.mark, source, reasons))
    for source in SOURCES if of is None else ():
        for mark in source.inputs:
            if (source, mark) not in seen:
                reasons = ("no page has markers of it",)
                found.append(Stale(source.pages[0], 1, mark, source, reasons))
    return found


def commands(stale: Sequence[Stale], jobs: int) -> Iterator[tuple[list[str], float]]:
    """Yield the commands that write stale parts, with the minutes of the whole script."""
    wanted = {(each.source, each.mark) for each in stale}
    for source in SOURCES:
        marks = [mark for mark in source.inputs if (source, mark) in wanted]
        if marks:
            yield source.command(marks, jobs), source.minutes


def run(command: Sequence[str]) -> int:
    """Run a command of `commands` in the root of the repository; return its exit code."""
    paths = [str(each) for each in FOLDERS] + os.environ.get("PYTHONPATH", "").split(os.pathsep)
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    print(" ".join(command), file=sys.stderr, flush=True)
    begun = time.monotonic()
    code = subprocess.run(
        [sys.executable, *command[1:]], cwd=ROOT, env=variables, stdout=subprocess.DEVNULL
    ).returncode
    print(f"  {(time.monotonic() - begun) / 60.0:.1f} minutes", file=sys.stderr, flush=True)
    return code


def main() -> int:
    """List, write or check; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--write", action="store_true", help="write what is stale")
    kinds.add_argument("--check", action="store_true", help="make all numbers again, and compare")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    options = parser.parse_args()
    if options.check:
        exact = [each for each in SOURCES if each.exact]
        codes = [run([*each.command([*each.inputs], options.jobs), "--check"]) for each in exact]
        return 1 if any(codes) else 0
    stale = find_stale()
    if options.write:
        for command, _ in commands(stale, options.jobs):
            if code := run(command):
                return code
        stale = find_stale()
    if not stale:
        print("No number of the pages is older than its inputs")
        return 0
    print(f"{len(stale)} tables and pictures are older than an input, or have no digests of them:")
    print(*stale, sep="\n")
    print("`make numbers` makes them again:")
    for command, minutes in commands(stale, options.jobs):
        print(f"  {' '.join(command)}    at most {minutes:g} minutes")
    return STALE


if __name__ == "__main__":
    sys.exit(main())
