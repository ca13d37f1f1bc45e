"""What `testbed tune` writes and says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.options import refuse_below_one
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.progress import counting
from testbed.record.rundir import create_run_directory
from testbed.study.places import STUDIES
from testbed.study.tune import Tuned, Tuner, tune_gains
from testbed.study.tune_files import GAINS_FILE, PAGE, RESULT, document
from testbed.study.tune_page import GAINS, Tune, load_tune

AT_BOUND = 0.02  # of the way between the bounds


def tune_and_show(name: str, *, out: Path | None, jobs: int | None, json: Path | None) -> None:
    """Seek gains, and print what they are worth.

    Raises:
        InputError: the page or an option cannot be used.
        KeyboardInterrupt: Ctrl-C; what was found so far has been written.
    """
    refuse_below_one(jobs=jobs)
    refuse_files(json=json)
    tune = load_tune(name)
    tuner = Tuner(tune)
    speech = Console(stderr=True, highlight=False)
    directory = create_run_directory(tune.study.name, out=out, logs=STUDIES)
    speech.print(f" {_announced(tune, tuner)}", soft_wrap=True)
    try:
        with counting("flights") as show:
            tuned = tune_gains(
                tuner,
                directory,
                jobs=jobs,
                progress=show,
                tell=lambda line: speech.print(f" {line}", soft_wrap=True),
            )
    except KeyboardInterrupt:
        kept = [file for file in (PAGE, GAINS_FILE) if (directory / file).is_file()]
        best = f"; best so far: {', '.join(kept)}" if kept else ""
        speech.print(f" interrupted: what was found is in {directory}{best}", soft_wrap=True)
        raise
    found = document(tuned, tuner)
    console = Console(stderr=is_stdout(json), highlight=False)
    _show(tuned, tuner, found, console)
    put_json(json, found)


def _announced(tune: Tune, tuner: Tuner) -> str:
    page = tune.page
    return (
        f"{tune.study.name}: {len(page.gains)} gains, {len(tuner.runs)} flights for each set of "
        f"them, {page.search.flights} at most, and then {len(page.held_out)} seeds held out"
    )


def _show(tuned: Tuned, tuner: Tuner, found: Mapping[str, Any], console: Console) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("gain", no_wrap=True)
    for heading in ("from", "to", "before", "after"):
        table.add_column(heading, justify="right")
    table.add_column("")
    places = tuner.space.point(tuned.best.gains)
    for place, (key, gain) in zip(places, found["gains"].items(), strict=True):
        said = "at its bound" if not AT_BOUND < place < 1.0 - AT_BOUND else ""
        numbers = (gain[name] for name in ("from", "to", "before", "after"))
        table.add_row(key.removeprefix(GAINS), *(f"{each:.4g}" for each in numbers), said)
    console.print()
    console.print(table)
    cost, judgement = found["cost"], found["judgement"]
    console.print(
        f"\n {found['robust']} of {found['metric']} over seeds {_list(found['seeds'])}: "
        f"{cost['before']:.4g} before, {cost['after']:.4g} after"
        f"\n {tuned.flights} flights: {tuned.ended}",
        soft_wrap=True,
    )
    if judgement is None:
        console.print(
            " nothing better was found: the gains are what they were, and no file was written",
            soft_wrap=True,
        )
    else:
        _show_judgement(judgement, found["held_out"], console)
        for name in (PAGE, GAINS_FILE):
            if (tuned.directory / name).is_file():
                console.print(f" {name:16} {tuned.directory / name}", soft_wrap=True)
    console.print(f" {RESULT:16} {tuned.directory / RESULT}", soft_wrap=True)


def _show_judgement(judgement: Mapping[str, Any], seeds: list[int], console: Console) -> None:
    difference = judgement["difference"]
    line = f" seeds {_list(seeds)}, not seen by the search: "
    if judgement["pairs"]:
        line += f"{judgement['before']:.4g} before, {judgement['after']:.4g} after"
        if difference["low"] is not None and math.isfinite(difference["low"]):
            line += (
                f"; difference {difference['mean']:+.4g}, 95 % interval "
                f"[{difference['low']:+.4g}, {difference['high']:+.4g}]"
            )
    lost = judgement["lost_before"], judgement["lost_after"]
    line += f"; lost or failed {lost[0]} before, {lost[1]} after" if any(lost) else ""
    console.print(line, soft_wrap=True)
    tone = "green" if judgement["better"] else "yellow"
    console.print(Text(f" {judgement['verdict']}", style=f"bold {tone}"), soft_wrap=True)


def _list(seeds: list[int]) -> str:
    """Seeds in words, those in a row as a range."""
    parts: list[list[int]] = []
    for seed in seeds:
        if parts and seed == parts[-1][-1] + 1:
            parts[-1].append(seed)
        else:
            parts.append([seed])
    return ", ".join(
        f"{part[0]}" if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in parts
    )
