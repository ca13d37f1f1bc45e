"""Shared by the scripts that write tables: cases flown by several processes, Markdown output."""

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

COMMAND = "make results"
SEEDS = (1, 2, 3, 4, 5)
NOISE = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")

Metrics = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """A scenario with overrides."""

    scenario: str
    overrides: tuple[str, ...] = ()


def fly(case: Case) -> Metrics:
    """Fly a case without writing files, and return its metrics."""
    flown = testbed.run(case.scenario, case.overrides, write=False)
    if flown.outcome not in (
        "completed",
        "envelope_exceeded",
        "formation_lost",
        "separation_lost",
    ):  # a table may be of what upsets a formation
        raise SystemExit(f"{case}: {flown.outcome}")
    return flown.metrics


MARKS = {"formation_lost": "†", "separation_lost": "‡"}  # of flights with this outcome
MARKS_TEXT = (
    "† `formation_lost`: a follower was far from its slot. ‡ `separation_lost`: two aircraft came "
    "closer than a wingspan."
)


def mark(metrics: Metrics) -> str:
    """Return the mark of a flight's outcome; "": completed."""
    return MARKS.get(metrics["outcome"], "")


def row(*cells: str) -> str:
    """Return a line of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def versions(flown: Mapping[Case, Metrics]) -> str:
    """Return the versions it was flown with, as text."""
    versions = next(iter(flown.values()))["versions"]
    return ", ".join(f"{name} {of}" for name, of in versions.items())


def insert(page: str, text: str, command: str = COMMAND) -> str:
    """Return the page with the text between its markers, which name the command."""
    begin, end = (f"<!-- {which}: {command} -->" for which in ("begin", "end"))
    if page.count(begin) != 1 or page.count(end) != 1:
        raise SystemExit(f"expected one {begin} and one {end}")
    head, rest = page.split(begin)
    _, tail = rest.split(end)
    return f"{head}{begin}\n\n{text}\n\n{end}{tail}"


def insert_parts(files: Sequence[Path], parts: Mapping[str, str]) -> None:
    """Write texts into pages, between the markers of each that a page has."""
    for file in files:
        page = file.read_text(encoding="utf-8")
        for command, text in parts.items():
            if f"<!-- begin: {command} -->" in page:
                page = insert(page, text, command)
        file.write_text(page, encoding="utf-8")


def write_tables(
    about: str,
    cases: Sequence[Case],
    text: Callable[[Mapping[Case, Metrics]], list[str]],
    command: str = COMMAND,
) -> None:
    """Fly every case once, print the text, and insert it into a page if requested."""
    parser = argparse.ArgumentParser(description=about.split("\n")[0])
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--into", type=Path, help="a Markdown file with the two markers")
    options = parser.parse_args()
    each = list(dict.fromkeys(cases))
    flown: dict[Case, Metrics] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        for case, metrics in zip(each, pool.map(fly, each), strict=True):
            print(f"flown: {case.scenario} {' '.join(case.overrides)}", file=sys.stderr, flush=True)
            flown[case] = metrics
    lines = "\n".join(text(flown))
    print(lines)
    if options.into:
        markdown = insert(options.into.read_text(encoding="utf-8"), lines, command)
        options.into.write_text(markdown, encoding="utf-8")
