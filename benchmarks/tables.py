"""What the pages of results share: cases that fly on several processes, and where text goes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import testbed

MADE_BY = "make results"
SEEDS = (1, 2, 3, 4, 5)
NOISE = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")

Metrics = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """A flight."""

    scenario: str
    overrides: tuple[str, ...] = ()


def fly(case: Case) -> Metrics:
    """The metrics of a case, flown without writing files."""
    flown = testbed.run(case.scenario, case.overrides, write=False)
    if flown.outcome not in ("flown", "upset"):  # a table may be of what upsets a formation
        raise SystemExit(f"{case}: {flown.outcome}")
    return flown.metrics


def row(*cells: str) -> str:
    """A line of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def versions(flown: Mapping[Case, Metrics]) -> str:
    """What it was flown with."""
    said = next(iter(flown.values()))["versions"]
    return ", ".join(f"{name} {of}" for name, of in said.items())


def insert(page: str, text: str, made_by: str = MADE_BY) -> str:
    """The page with the text between its markers, which say by which command it is made."""
    begin, end = (f"<!-- {which}: {made_by} -->" for which in ("begin", "end"))
    if page.count(begin) != 1 or page.count(end) != 1:
        raise SystemExit(f"expected one {begin} and one {end}")
    head, rest = page.split(begin)
    _, tail = rest.split(end)
    return f"{head}{begin}\n\n{text}\n\n{end}{tail}"


def write_tables(
    about: str, cases: Sequence[Case], text: Callable[[Mapping[Case, Metrics]], list[str]]
) -> None:
    """Fly every case once, print the text made of them, and put it into a page if asked."""
    parser = argparse.ArgumentParser(description=about.split("\n")[0])
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--into", type=Path, help="a page with the two markers")
    asked = parser.parse_args()
    each = list(dict.fromkeys(cases))
    flown: dict[Case, Metrics] = {}
    with ProcessPoolExecutor(asked.jobs) as pool:
        for case, metrics in zip(each, pool.map(fly, each), strict=True):
            print(f"flown: {case.scenario} {' '.join(case.overrides)}", file=sys.stderr, flush=True)
            flown[case] = metrics
    lines = "\n".join(text(flown))
    print(lines)
    if asked.into:
        page = insert(asked.into.read_text(encoding="utf-8"), lines)
        asked.into.write_text(page, encoding="utf-8")
