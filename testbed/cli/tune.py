"""The command that optimises gains: tune."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from testbed.cli.options import Jobs, JsonFile, tune_names, value_option
from testbed.cli.output import (
    PipeSafeConsole,
    message_console,
    print_margin_changes,
    print_side_effects,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from testbed.tuning.tune import TuneResult
    from testbed.tuning.tuning import HeldOutTest, Tuning

NAMES = "before", "after"  # the gains
AT_BOUND = 0.02  # of the range between the bounds


def tune_command(
    tune: Annotated[
        str,
        typer.Argument(
            metavar="TUNE",
            help="Name of a tuning file (`testbed list`) or a path.",
            autocompletion=tune_names,
        ),
    ],
    out: Annotated[
        Path | None, value_option("DIR", "Folder to create.  \\[default: logs/studies/TUNE/UTC-ID]")
    ] = None,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Search gains that minimise a metric, and test them with held-out seeds.

    Prints also which other numbers got worse beyond noise. Writes the gains to middle_loop.yaml, a
    scenario that flies them to tuned.yaml, every candidate to candidates.csv, and result.json.
    """
    from testbed.cli.progress import progress_counter
    from testbed.logs.run_directory import create_run_directory
    from testbed.studies.table import STUDIES
    from testbed.tuning.tune import GAINS_FILE, SCENARIO, to_document, tune_gains
    from testbed.tuning.tuning import Tuning

    messages = message_console()

    def report(text: str) -> None:
        messages.write_line(f" {text}")

    tuning = Tuning(tune, jobs=jobs, report=report)
    directory = create_run_directory(tuning.tune.study.name, out=out, logs=STUDIES)
    messages.write_line(f" {_announcement(tuning)}")
    try:
        with progress_counter("flights", rate="flights") as progress:
            result = tune_gains(
                tuning,
                directory,
                progress=progress,
                report=report,
            )
    except KeyboardInterrupt:
        files = [name for name in (SCENARIO, GAINS_FILE) if (directory / name).is_file()]
        best = f"; the best gains are in {', '.join(files)}" if files else ""
        messages.write_line(f" interrupted: results so far are in {directory}{best}")
        raise
    found = to_document(result, tuning)
    write_json_output(json, found)
    _print_result(result, tuning, found, result_console(json))


def _announcement(tuning: Tuning) -> str:
    config = tuning.tune.config
    return (
        f"{tuning.tune.study.name}: {len(config.gains)} gains, {len(tuning.runs)} flights for "
        f"each candidate, at most {config.search.max_flights} flights, then "
        f"{len(config.held_out_seeds)} held-out seeds"
    )


def _print_result(
    result: TuneResult, tuning: Tuning, found: Mapping[str, Any], console: PipeSafeConsole
) -> None:
    from testbed.tuning.tune import GAINS_FILE, RESULT, SCENARIO
    from testbed.tuning.tune_schema import GAINS

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("gain", no_wrap=True)
    for heading in ("lower bound", "upper bound", "before", "after"):
        table.add_column(heading, justify="right")
    table.add_column("")
    positions = tuning.space.point(result.best.gains)
    for position, (key, gain) in zip(positions, found["gains"].items(), strict=True):
        note = "at its bound" if not AT_BOUND < position < 1.0 - AT_BOUND else ""
        numbers = (gain[name] for name in ("from", "to", "before", "after"))
        table.add_row(key.removeprefix(GAINS), *(f"{each:.4g}" for each in numbers), note)
    console.write_line()
    console.print_table(table)
    cost, held_out = found["cost"], result.held_out
    console.write_line()
    console.write_line(
        f" {found['aggregate']} of {found['metric']} over seeds {_seed_ranges(found['seeds'])}: "
        f"{cost['before']:.4g} before, {cost['after']:.4g} after"
    )
    for title, candidate in (("before", result.candidates[0]), ("after", result.best)):
        for each in candidate.evaluation.constraints:
            console.write_line(f" {title:6} {each.describe()}", "yellow" if each.shortfall else "")
    console.write_line(f" {result.flights} flights: {result.stop_reason}")
    if result.best.evaluation.shortfall:
        console.write_line(" no candidate meets the constraints", "bold yellow")
    if held_out is None:
        console.write_line(" no better gains were found, and no gains were written")
    else:
        _print_comparison(held_out, found["held_out_seeds"], console)
        for name in (SCENARIO, GAINS_FILE):
            if (result.directory / name).is_file():
                console.write_line(f" {name:16} {result.directory / name}")
    console.write_line(f" {RESULT:16} {result.directory / RESULT}")


def _print_comparison(held_out: HeldOutTest, seeds: list[int], console: PipeSafeConsole) -> None:
    comparison = held_out.comparison
    change = comparison.change
    line = f" held-out seeds {_seed_ranges(seeds)}: "
    if comparison.pairs:
        line += f"{change.before:.4g} before, {change.after:.4g} after"
        if math.isfinite(change.low):
            line += (
                f"; difference {change.mean:+.4g}, 95 % interval "
                f"[{change.low:+.4g}, {change.high:+.4g}]"
            )
    failed = comparison.failed_before, comparison.failed_after
    line += f"; failed {failed[0]} before, {failed[1]} after" if any(failed) else ""
    console.write_line(line)
    color = "green" if comparison.better else "yellow"
    console.write_line(f" {comparison.verdict}", f"bold {color}")
    print_side_effects(console, held_out.side_effects, "worse with the new gains", NAMES)
    print_margin_changes(console, held_out.margins, NAMES)


def _seed_ranges(seeds: list[int]) -> str:
    """Format seeds, consecutive ones as a range: `1 to 4, 9`."""
    ranges: list[list[int]] = []
    for seed in seeds:
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1].append(seed)
        else:
            ranges.append([seed])
    return ", ".join(
        f"{each[0]}" if len(each) == 1 else f"{each[0]} to {each[-1]}" for each in ranges
    )
