"""What `testbed compare` shows of two runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.metrics.network import NOTHING
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.record.read import Log, read_log
from testbed.record.rundir import find_run
from testbed.study.golden_words import shown
from testbed.study.two_runs import Apart, Difference, Pair, compare_runs

SAME, DIFFERENT = 0, 3
LINES = 12  # of each kind that may be many


def refuse_mixed(
    *, numbers: bool, within: float | None, json: Path | None, rrd: Path | None
) -> None:
    """Refuse options that say nothing together.

    Raises:
        InputError: naming them.
    """
    if numbers and rrd:
        raise InputError(f"--rrd {rrd}: a recording of the overlay; leave --numbers out")
    if not numbers and (within is not None or json):
        option = "--json" if within is None else "--within"
        raise InputError(f"{option}: compares numbers; write --numbers too")
    if within is not None and not 0.0 <= within < 1.0:
        raise InputError(f"--within {within:g}: write a share of 0 to 1, as 0.01 for 1 %")
    refuse_files(json=json, rrd=rrd)


def compare_numbers(first: str, second: str, *, within: float | None, json: Path | None) -> int:
    """Print what differs between two runs; 0 if nothing does, else 3."""
    paths = find_run(first), find_run(second)
    logs = _read(paths[0]), _read(paths[1])
    found = compare_runs(*logs, within=within)
    console = Console(stderr=is_stdout(json), highlight=False)
    _show(found, logs, paths, console)
    put_json(json, _document(found, paths))
    return SAME if found.same else DIFFERENT


def _read(path: Path) -> Log:
    log = read_log(path)
    if log.metrics is None:
        raise InputError(
            f"{path}: this run has no metrics, for it was killed before its end: fly it again to"
            " compare numbers, or leave --numbers out to lay what there is of it over the other"
        )
    return log


def _show(found: Difference, logs: Sequence[Log], paths: Sequence[Path], console: Console) -> None:
    for word, log, path in zip(("first", "second"), logs, paths, strict=True):
        info = log.info
        _line(console, f" {word:9}{path}: {info.scenario_name}, seed {info.seed}")
    _some(console, "page", found.page)
    _some(console, "versions", found.versions)
    console.print()
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column(" ")
    for heading in ("first", "second", "difference"):
        table.add_column(heading, justify="right")
    for label, pair in found.rows:
        style = "" if pair.agrees(found.within or 0.0) else "yellow"
        table.add_row(
            f" {label}", _number(pair.first), _number(pair.second), _moved(pair), style=style
        )
    console.print(table)
    console.print()
    _line(console, f" motion   {_motion(found)}")
    for each in found.apart:
        if each.first_s is not None:
            _line(
                console,
                f" {each.name} {_distance(each)}; not the same from {each.first_s:g} s on",
            )
    _line(console, f" {_verdict(found)}", "bold green" if found.same else "bold yellow")


def _motion(found: Difference) -> str:
    """Whether anybody moved otherwise, and over which frames that was asked."""
    if not found.apart:
        return "not compared: no aircraft of one name has frames at the same times in both"
    differ = sum(each.first_s is not None for each in found.apart)
    times = (
        f"{found.shared_s.size} frames of both, {found.shared_s[0]:g} to {found.shared_s[-1]:g} s"
    )
    if not differ:
        return f"the same to the last bit in the {times}"
    return f"{differ} of {len(found.apart)} aircraft moved otherwise in the {times}"


def _distance(each: Apart) -> str:
    if each.largest_m is None:
        return "apart by what is not a number"
    return f"up to {each.largest_m:.3g} m apart, at {each.at_s:g} s"


def _verdict(found: Difference) -> str:
    count = f"{len(found.moved)} of {found.numbers} metrics"
    held = "differ" if found.within is None else f"differ by more than {100 * found.within:g} %"
    parts = [f"{count} {held}"] if found.moved else []
    if found.within is None:
        if not found.same_frames:
            first, second = found.frames
            parts.append("frames differ" if first == second else f"{first} and {second} frames")
        parts += [] if found.same_events else ["events differ"]
    if parts:
        return "different: " + ", ".join(parts)
    if found.within is None:
        return f"the same: {found.numbers} metrics, events, and every frame to the last bit"
    return f"the same: {found.numbers} metrics within {100 * found.within:g} %"


def _document(found: Difference, paths: Sequence[Path]) -> dict[str, Any]:
    first, second = paths
    return {
        "same": found.same,
        "first": str(first),
        "second": str(second),
        "within": found.within,
        "page": list(found.page),
        "versions": list(found.versions),
        "metrics_compared": found.numbers,
        "metrics_moved": {pair.key: [pair.first, pair.second] for pair in found.moved},
        "frames": list(found.frames),
        "same_frames": found.same_frames,
        "same_events": found.same_events,
        "shared_frames": int(found.shared_s.size),
        "apart": [asdict(each) for each in found.apart],
    }


def _number(value: float | None) -> str:
    return NOTHING if value is None else shown(value)


def _moved(pair: Pair) -> str:
    if pair.first is None or pair.second is None:
        return "" if pair.first is pair.second else "only one has it"
    change = pair.second - pair.first
    if change == 0.0:
        return "none"
    percent = 100.0 * change / abs(pair.first) if pair.first else 0.0
    digits = f"{percent:+.3g}" if abs(percent) < 1000.0 else f"{percent:+,.0f}"
    share = f" ({digits} %)" if percent else ""
    return f"{'+' if change > 0.0 else '-'}{shown(abs(change))}{share}"


def _some(console: Console, word: str, lines: Sequence[str]) -> None:
    for line in lines[:LINES]:
        _line(console, f" {word:9}{line}")
    if len(lines) > LINES:
        _line(console, f" {'':9}and {len(lines) - LINES} more; --json has them", "dim")


def _line(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style), soft_wrap=True)
