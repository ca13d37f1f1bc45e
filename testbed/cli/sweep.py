"""The command that runs a study: sweep."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from testbed.cli import completion
from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import Jobs, JsonFile, Quiet
from testbed.cli.output import (
    PipeSafeConsole,
    message_console,
    result_console,
    write_json_output,
)
from testbed.cli.sweep_table import CAPTION, summary_tables

if TYPE_CHECKING:
    from testbed.studies.summary import Summary
    from testbed.studies.sweep import SweepResult


class Backend(StrEnum):
    """Where the flights of a study run."""

    JOBLIB = "joblib"
    DASK = "dask"


def sweep_command(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="Name of a study (`testbed list`) or a path.",
            autocompletion=completion.study_names,
        ),
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

    The study's file lists what varies. A run that is lost or fails is a row of the results, and the
    exit code is 1. With a number outside the bounds of a scenario's `expect` it is 3.
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
    passed = ExitCode.DIFFERENT if result.unexpected else ExitCode.OK
    raise typer.Exit(passed if result.completed else ExitCode.AIRCRAFT_LOST)


def _print_summary(result: SweepResult, summary: Summary, console: PipeSafeConsole) -> None:
    console.write_line()
    for part in _headline(result, console.width):
        console.write_line(part)
    if summary.out_of_slot:
        line = f" {summary.out_of_slot:,} completed with a follower out of its slot at the end"
        console.write_line(line, "yellow")
    if result.unexpected:
        line = f" {result.unexpected:,} completed with numbers outside the bounds of the scenario"
        console.write_line(line, "red")
    if summary.groups and summary.metrics:
        for table in summary_tables(summary, console.width):
            console.write_line()
            console.print(table)
        console.write_line(CAPTION, "dim italic")
    for name, hint in summary.unknown_metrics.items():
        console.write_line(f" no run has a number {name!r}{hint}", "yellow")
    for each in summary.failures:
        console.write_line()
        console.write_line(f" run {each['run']}: {each['error']}", "red")
        console.write_line(f" {each['command']}", "dim")
    bad = sum(result.outcomes.values()) - _completed(result) + result.unexpected
    if bad > len(summary.failures):
        console.write_line()
        console.write_line(f" … and {bad - len(summary.failures)} more", "dim")
    console.write_line()
    console.write_line(f" file  {result.path}")


def _completed(result: SweepResult) -> int:
    from testbed.studies.flight_task import COMPLETED

    return result.outcomes.get(COMPLETED, 0)


def _headline(result: SweepResult, width: int) -> list[Text]:
    """Name, number of runs and their outcomes, broken between these where a line is full."""
    from testbed.metrics.tables import join_parts
    from testbed.studies.flight_task import COMPLETED

    runs = sum(result.outcomes.values())
    new = f", {result.new_runs:,} of them in this session" if result.new_runs < runs else ""
    parts = [Text(f"{runs:,} runs{new}")]
    for outcome, count in result.outcomes.items():
        if count:
            style = "bold green" if outcome == COMPLETED else "bold red"
            parts.append(Text(f"{count:,} {outcome.replace('_', ' ')}", style=style))
    return join_parts(Text(result.study.name, "bold"), parts, width)
