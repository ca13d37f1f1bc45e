"""Shared by the scripts that write numbers into pages: flown cases, Markdown, marked parts."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from inputs import Case, Inputs, describe, digests

import testbed
from testbed.views.matplotlib_backend import save_figure
from testbed.views.panels import PanelGrid

COMMAND = "make results"
SEEDS = (1, 2, 3, 4, 5)
NOISE = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")
BEGIN = re.compile(r"^<!-- begin: (.+?) -->$", re.M)
COMMENT = re.compile(r"<!-- inputs:.*?-->", re.S)
# A table may be of what upsets a formation.
OUTCOMES = ("completed", "envelope_exceeded", "formation_lost", "separation_lost")
_VERSION = re.compile(r"\b(testbed|JSBSim|NumPy|Python) \d[\w.+]*")

Metrics = Mapping[str, Any]
Texts = Mapping[str, Callable[[Mapping[Case, Metrics]], Sequence[str]]]
"""Lines of each text, by what its markers name, from the metrics of the cases flown."""


def fly(case: Case, outcomes: Sequence[str] = OUTCOMES) -> Metrics:
    """Fly a case without writing files, and return its metrics.

    Args:
        case: scenario with overrides.
        outcomes: allowed; another one ends the program.
    """
    flown = testbed.run(case.scenario, case.overrides, write=False)
    if flown.outcome not in outcomes:
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


class Block(NamedTuple):
    """The part of a page between the markers of a command."""

    mark: str  # what the markers name
    line: int  # of the first marker
    comment: str  # with the inputs; empty: none
    text: str
    start: int  # of what is between the markers
    end: int


def blocks(page: str) -> list[Block]:
    """Return the parts between markers.

    Raises:
        ValueError: a marker has no end, or occurs twice.
    """
    found: list[Block] = []
    for begin in BEGIN.finditer(page):
        mark, end = begin[1], f"<!-- end: {begin[1]} -->"
        if page.count(begin[0]) != 1 or page.count(end) != 1:
            raise ValueError(f"expected one {begin[0]} and one {end}")
        stop = page.index(end)
        inside = page[begin.end() : stop]
        comment = COMMENT.match(inside.lstrip())
        text = inside.lstrip()[comment.end() :] if comment else inside
        line = page.count("\n", 0, begin.start()) + 1
        found.append(
            Block(mark, line, comment[0] if comment else "", text.strip(), begin.end(), stop)
        )
    return found


def insert(page: str, mark: str, text: str, inputs: Inputs) -> str:
    """Return the page with a text between its markers, and digests of its inputs."""
    (block,) = (each for each in blocks(page) if each.mark == mark)
    inside = f"\n{describe(digests(inputs))}\n\n{text}\n\n"
    return page[: block.start] + inside + page[block.end :]


def add_output_arguments(
    parser: argparse.ArgumentParser, inputs: Mapping[str, Inputs] | None = None
) -> None:
    """Add the options of scripts that write into pages.

    Args:
        parser: of the script.
        inputs: by what the markers name, of a script that can write a part of its texts.
    """
    parser.add_argument("--into", type=Path, nargs="*", default=[], help="pages with the markers")
    parser.add_argument(
        "--check",
        action="store_true",
        help="compare with the pages instead of writing: exit 1 if a printed digit differs",
    )
    if inputs is not None:
        parts = [part_of(mark) for mark in inputs]
        parser.add_argument("--only", nargs="+", choices=parts, default=parts, help="parts to make")


def part_of(mark: str) -> str:
    """Return the part of a script's texts that markers name, after its comma or colon."""
    return re.split("[,:] ", mark, maxsplit=1)[-1]


_drawn: list[tuple[PanelGrid, Path]] = []


def draw(figure: PanelGrid, file: Path) -> None:
    """Draw a figure when the text that shows it is written into a page."""
    _drawn.append((figure, file))


def publish(
    options: argparse.Namespace, parts: Mapping[str, str], inputs: Mapping[str, Inputs]
) -> bool:
    """Print texts, and write them into the pages with their markers, or compare them with these.

    Args:
        options: of `add_output_arguments`.
        parts: texts by what their markers name.
        inputs: of each text.

    Returns:
        Whether the pages have the texts now.
    """
    if not options.check:
        print(*parts.values(), sep="\n\n", flush=True)
    same, texts = True, [file.read_text(encoding="utf-8") for file in options.into]
    for mark in parts if options.into else ():
        if not any(f"<!-- begin: {mark} -->" in text for text in texts):
            names = ", ".join(map(str, options.into))
            raise SystemExit(f"<!-- begin: {mark} --> is in none of {names}")
    for file in options.into:
        page = file.read_text(encoding="utf-8")
        for block in blocks(page):
            if block.mark not in parts:
                continue
            if options.check:
                differing = list(compare(block, parts[block.mark]))
                same = same and not differing
                print(*(f"{file}:{each}" for each in differing), sep="\n", file=sys.stderr)
            else:
                page = insert(page, block.mark, parts[block.mark], inputs[block.mark])
        if not options.check:
            file.write_text(page, encoding="utf-8")
    if options.into and not options.check:
        for figure, path in _drawn:
            save_figure(figure, path)
    _drawn.clear()
    return same


def compare(block: Block, text: str) -> Iterator[str]:
    """Yield the lines of a page that differ from a text, with both; versions are not compared."""
    printed, new = (_VERSION.sub(r"\1", each).strip().split("\n") for each in (block.text, text))
    first = block.line + 2 + block.comment.count("\n") + bool(block.comment)
    for index in range(max(len(printed), len(new))):
        old, now = (each[index] if index < len(each) else "" for each in (printed, new))
        if old != now:
            yield f"{first + index}: {block.mark}\n  page {old}\n  now  {now}"


def write_tables(
    about: str,
    inputs: Mapping[str, Inputs],
    texts: Texts,
    outcomes: Sequence[str] = OUTCOMES,
) -> None:
    """Fly every case once, and print or insert the texts made of them.

    Args:
        about: docstring of the program.
        inputs: of each text, whose cases are flown.
        texts: by what their markers name.
        outcomes: that flights may have.
    """
    parser = argparse.ArgumentParser(description=about.split("\n")[0])
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    add_output_arguments(parser, inputs)
    options = parser.parse_args()
    marks = [mark for mark in inputs if part_of(mark) in options.only]
    each = list(dict.fromkeys(case for mark in marks for case in inputs[mark].cases))
    flown: dict[Case, Metrics] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        flights = pool.map(partial(fly, outcomes=outcomes), each)
        for case, metrics in zip(each, flights, strict=True):
            print(f"flown: {case.scenario} {' '.join(case.overrides)}", file=sys.stderr, flush=True)
            flown[case] = metrics
    same = publish(options, {mark: "\n".join(texts[mark](flown)) for mark in marks}, inputs)
    sys.exit(0 if same else 1)
