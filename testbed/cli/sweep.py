"""The command that runs a study: sweep."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import Jobs, JsonFile, Quiet
from testbed.cli.output import (
    MISSING,
    PipeSafeConsole,
    message_console,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from testbed.studies.summary import Group, Summary
    from testbed.studies.sweep import SweepResult


class Backend(StrEnum):
    """Where the flights of a study run."""

    JOBLIB = "joblib"
    DASK = "dask"


def sweep_command(
    study: Annotated[
        str,
        typer.Argument(metavar="STUDY", help="Name of a study (`testbed list`) or a path."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR|FILE",
            help="Directory for the study's file, or the file, ending in .parquet.  \\[default: "
            "logs/studies/STUDY/UTC-ID]",
        ),
    ] = None,
    jobs: Jobs = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue an interrupted study: that of --out, or the latest of this name.",
        ),
    ] = False,
    backend: Annotated[
        Backend,
        typer.Option(metavar="joblib|dask", help="Processes on this machine, or a Dask cluster."),
    ] = Backend.JOBLIB,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="With --backend dask: the scheduler, tcp://HOST:8786."
        ),
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Fly a study: many variants of a scenario, with the results in one Parquet file.

    The study's file says what varies. A run that is lost or fails is a row of the results, and the
    exit code is 1.
    """
    from testbed.cli.progress import progress_counter
    from testbed.studies.summary import summarise, to_document
    from testbed.studies.sweep import sweep

    messages = message_console()
    done_of_total = (0, 0)

    def report(text: str) -> None:
        if not quiet or text.startswith("warning"):
            messages.write_line(text)

    def progress(done: int, total: int) -> None:
        nonlocal done_of_total
        done_of_total = (done, total)
        update(done, total)

    try:
        with progress_counter("runs", hidden=quiet) as update:
            result = sweep(
                study,
                out,
                jobs=jobs,
                resume=resume,
                backend=backend.value,
                scheduler=scheduler,
                progress=progress,
                report=report,
            )
    except KeyboardInterrupt:
        done, total = done_of_total
        if total:
            report(f"interrupted; {done:,} of {total:,} runs are stored: continue with --resume")
        raise
    summary = summarise(result)
    write_json_output(json, to_document(result, summary))
    if not quiet:
        _print_summary(result, summary, result_console(json))
    raise typer.Exit(ExitCode.OK if result.completed else ExitCode.AIRCRAFT_LOST)


def _print_summary(result: SweepResult, summary: Summary, console: PipeSafeConsole) -> None:
    console.write_line()
    console.print(_headline(result))
    if summary.out_of_slot:
        line = f" {summary.out_of_slot:,} completed with a follower out of its slot at the end"
        console.write_line(line, "yellow")
    if summary.groups and summary.metrics:
        console.write_line()
        console.print(_table(summary))
    for name, hint in summary.unknown_metrics.items():
        console.write_line(f" no run has a number {name!r}{hint}", "yellow")
    for each in summary.failures:
        console.write_line()
        console.write_line(f" run {each['run']}: {each['error']}", "red")
        console.write_line(f" {each['command']}", "dim")
    bad = sum(result.outcomes.values()) - _completed(result)
    if bad > len(summary.failures):
        console.write_line()
        console.write_line(f" … and {bad - len(summary.failures)} more", "dim")
    console.write_line()
    console.write_line(f" file  {result.path}")


def _completed(result: SweepResult) -> int:
    from testbed.studies.flight_task import COMPLETED

    return result.outcomes.get(COMPLETED, 0)


def _headline(result: SweepResult) -> Text:
    from testbed.studies.flight_task import COMPLETED

    runs = sum(result.outcomes.values())
    line = Text.assemble(" ", (result.study.name, "bold"), f" · {runs:,} runs")
    if result.new_runs < runs:
        line.append(f", {result.new_runs:,} of them in this session")
    for outcome, count in result.outcomes.items():
        if count:
            style = "bold green" if outcome == COMPLETED else "bold red"
            line.append(" · ")
            line.append(f"{count:,} {outcome.replace('_', ' ')}", style=style)
    return line


def _table(summary: Summary) -> Table:
    """One row per group of runs: its settings, and median and range of each metric."""
    has_cases = any(group.case for group in summary.groups)
    keys = list(summary.groups[0].point)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 1), header_style="bold")
    if has_cases:
        table.add_column("case", no_wrap=True)
    for key in keys:
        table.add_column(_break_at_dots(key), justify="right")
    table.add_column("runs", justify="right", style="dim")
    for name in summary.metrics:
        table.add_column(_break_at_dots(name), justify="right", no_wrap=False)
    for group in summary.groups:
        table.add_row(
            *([group.case] if has_cases else []),
            *(_format(group.point[key]) for key in keys),
            _format_runs(group),
            *(_format_range(group, name) for name in summary.metrics),
        )
    table.caption = " median (smallest to largest)"
    table.caption_justify = "left"
    return table


def _break_at_dots(name: str) -> str:
    return name.replace(".", ".\n")


def _format(value: Any) -> str:  # noqa: ANN401 - a value of a scenario's key
    return f"{value:g}" if isinstance(value, float) else str(value)


def _format_runs(group: Group) -> str:
    done = group.completed == group.runs
    return str(group.runs) if done else f"{group.completed} of {group.runs}"


def _format_range(group: Group, name: str) -> str:
    values = group.metrics[name]
    if values is None:
        return MISSING
    median, low, high = values
    pattern = "{:.3g}" if max(abs(low), abs(high)) < 1000.0 else "{:.0f}"
    texts = [pattern.format(each) for each in (median, low, high)]
    return f"{texts[0]} ({texts[1]} to {texts[2]})" if low < high else texts[0]
