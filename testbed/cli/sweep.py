"""The command that runs a study: sweep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import Jobs, JsonFile, Quiet, study_names, value_option
from testbed.cli.output import (
    MISSING,
    PipeSafeConsole,
    message_console,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from testbed.studies.precision import PointPrecision
    from testbed.studies.study_summary import RunGroup, Summary
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
            autocompletion=study_names,
        ),
    ],
    out: Annotated[
        Path | None,
        value_option(
            "DIR|FILE",
            "Directory for the study's file, or the file, ending in .parquet.  \\[default: "
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
        Backend, value_option("joblib|dask", "Processes on this machine, or a Dask cluster.")
    ] = Backend.JOBLIB,
    scheduler: Annotated[
        str | None, value_option("ADDRESS", "With --backend dask: the scheduler, tcp://HOST:8786.")
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Fly a study: many variants of a scenario, with the results in one Parquet file.

    The study's file lists what varies. A run that is lost or fails is a row of the results, and the
    exit code is 1. With a number outside the bounds of a scenario's `expect` it is 3.
    """
    from testbed.cli.progress import progress_counter
    from testbed.studies.study_summary import summarise, to_document
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
        with progress_counter("runs", rate="flights", hidden=quiet) as update:
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
    else:
        for line in _notes(result, summary):
            messages.write_line(f"warning: {line}")
        for each in summary.failures:
            messages.write_line(f"warning: run {each['run']}: {each['error']}")
        if more := _bad(result) - len(summary.failures):
            messages.write_line(f"warning: … and {more} more")
    raise typer.Exit(_exit_code(result))


def _exit_code(result: SweepResult) -> ExitCode:
    from testbed.metrics.document import BOUND_VIOLATED
    from testbed.pool.flight_task import COMPLETED

    ended = {outcome for outcome, count in result.outcomes.items() if count}
    if ended - {COMPLETED, BOUND_VIOLATED}:
        return ExitCode.AIRCRAFT_LOST
    violated = result.unexpected or BOUND_VIOLATED in ended
    return ExitCode.DIFFERENT if violated else ExitCode.OK


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
    if summary.precisions:
        _print_precisions(result, summary, console)
    for name, hint in summary.unknown_metrics.items():
        console.write_line(f" no run has a number {name!r}{hint}", "yellow")
    for each in summary.failures:
        console.write_line()
        console.write_line(f" run {each['run']}: {each['error']}", "red")
        console.write_line(f" {each['command']}", "dim")
    if more := _bad(result) - len(summary.failures):
        console.write_line()
        console.write_line(f" … and {more} more", "dim")
    console.write_line()
    console.write_line(f" file  {result.path}")


def _notes(result: SweepResult, summary: Summary) -> Iterator[str]:
    """Yield lines on the points of a study with `until` that need a second look."""
    from testbed.studies.precision import precision_notes

    return precision_notes(result.study.config, summary.precisions)


def _print_precisions(result: SweepResult, summary: Summary, console: PipeSafeConsole) -> None:
    """Print how many flights each point needed, and which are not known as well as asked."""
    from testbed.studies.study_summary import MAX_GROUPS

    found, until = summary.precisions, result.study.config.study.until
    assert until is not None
    reached = [each.flights for each in found if each.reached]
    flights = f" after {_range(reached)} flights each" if reached else ""
    console.write_line()
    console.write_line(f" mean of {until.metric}", "bold")
    console.write_line(
        f" within ± {until.half_width:g} at {100 * until.confidence:g} % at "
        f"{len(reached):,} of {len(found):,} points{flights}"
    )
    if len(found) <= MAX_GROUPS:
        console.write_line()
        console.print(precision_table(found, console.width))
    for line in _notes(result, summary):
        console.write_line(f" {line}", "yellow")


def _range(counts: Sequence[int]) -> str:
    low, high = min(counts), max(counts)
    return f"{low:,} to {high:,}" if low < high else f"{low:,}"


def precision_table(found: Sequence[PointPrecision], width: int) -> Table:
    """Return a table of settings, flights and means, where possible of at most this width."""
    columns = [
        _Column("flights", [f"{each.flights:,}" for each in found]),
        *(
            [_Column("lost", [f"{each.lost or ''}" for each in found])]
            if any(each.lost for each in found)
            else []
        ),
        _Column("mean", [_format_mean(each, each.mean) for each in found]),
        _Column("±", [_format_mean(each, each.half_width) for each in found]),
    ]
    settings = _settings(found)
    if settings and _width([*settings, *columns]) > width:
        settings = [_stack(found, max(STACK_WIDTHS[0], width - _width(columns) - GAP))]
    return _table([*settings, *columns])


def _format_mean(each: PointPrecision, value: float) -> str:
    """Format a mean or its half width with two digits of the half width."""
    if not math.isfinite(value):
        return MISSING
    if not math.isfinite(each.half_width) or each.half_width == 0.0:
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(each.half_width)))}f}"


def _bad(result: SweepResult) -> int:
    """Count the runs that were not completed, or have a number outside the scenario's bounds."""
    return sum(result.outcomes.values()) - _completed(result) + result.unexpected


def _completed(result: SweepResult) -> int:
    from testbed.pool.flight_task import COMPLETED

    return result.outcomes.get(COMPLETED, 0)


def _headline(result: SweepResult, width: int) -> list[Text]:
    """Name, number of runs and their outcomes, broken between these where a line is full."""
    from testbed.metrics.printed_tables import join_parts
    from testbed.pool.flight_task import COMPLETED

    runs = sum(result.outcomes.values())
    new = f", {result.new_runs:,} of them in this session" if result.new_runs < runs else ""
    parts = [Text(f"{runs:,} runs{new}")]
    for outcome, count in result.outcomes.items():
        if count:
            style = "bold green" if outcome == COMPLETED else "bold red"
            parts.append(Text(f"{count:,} {outcome.replace('_', ' ')}", style=style))
    return join_parts(Text(result.study.name, "bold"), parts, width)


CAPTION = " median (smallest to largest)"
GAP = 3  # between two columns
WORD = 14  # a longer part of a header is broken at its underscores
STACK_WIDTHS = 16, 32  # of a column of all settings, least and most


@dataclass(frozen=True, slots=True)
class _Column:
    """A column; cells may have several lines."""

    header: str
    cells: Sequence[str]
    style: str = ""
    justify: Literal["left", "right"] = "right"

    @property
    def width(self) -> int:
        lines = "\n".join((self.header, *self.cells)).splitlines()
        return max(cell_len(line) for line in lines)


def summary_tables(summary: Summary, width: int) -> Iterator[Table]:
    """Yield tables of at most this width: settings, median and range of metrics.

    Where all metrics do not fit beside the settings there are several tables. Where not even one
    does, its range goes below its median, then all settings into one column.
    """
    groups = summary.groups
    settings = _settings(groups)
    runs = _Column("runs", [_format_runs(group) for group in groups], "dim")
    metrics = [
        _Column(_break_name(name), [_format_range(group, name) for group in groups])
        for name in summary.metrics
    ]
    free_width = width - max(metric.width for metric in metrics) - GAP
    if _width([*settings, runs]) > free_width:
        metrics = [
            replace(each, cells=[cell.replace(" (", "\n(") for cell in each.cells])
            for each in metrics
        ]
        free_width = width - max(metric.width for metric in metrics) - GAP
    if settings and _width([*settings, runs]) > free_width:
        least, most = STACK_WIDTHS
        settings = [_stack(groups, min(max(free_width - runs.width - GAP, least), most))]
    lead = [*settings, runs]
    part: list[_Column] = []
    for metric in metrics:
        if part and _width([*lead, *part, metric]) > width:
            yield _table([*lead, *part])
            part = []
        part.append(metric)
    yield _table([*lead, *part])


def _settings(groups: Sequence[RunGroup | PointPrecision]) -> list[_Column]:
    """Make a column of the cases, if any, and one for each varying key."""
    cases = [group.case for group in groups]
    columns = [_Column("case", cases, justify="left")] if any(cases) else []
    for key in groups[0].point:
        columns.append(_Column(_break_name(key), [_format(group.point[key]) for group in groups]))
    return columns


def _stack(groups: Sequence[RunGroup | PointPrecision], width: int) -> _Column:
    """One column with a line for the case and lines for each key."""
    cells = []
    for group in groups:
        settings = [f"{key} = {_format(value)}" for key, value in group.point.items()]
        lines = [line for text in (group.case, *settings) if text for line in _fold(text, width)]
        cells.append("\n".join(lines))
    return _Column("setting", cells, justify="left")


def _fold(text: str, width: int) -> Iterator[str]:
    """Break a text after spaces, dots, underscores and hyphens; further lines are indented."""
    line = ""
    for word in _words(text, " ._-"):
        while cell_len(line) + cell_len(word) > width:
            if not line.strip():  # the word alone is too long
                line, word = line + word[: width - len(line)], word[width - len(line) :]
            yield line.rstrip()
            line = "  "
        line += word
    yield line.rstrip()


def _break_name(name: str) -> str:
    """Break a name after dots, and its long parts after underscores."""
    lines = []
    for part in _words(name, "."):
        line = ""
        for word in _words(part, "_") if len(part) > WORD else [part]:
            if line and len(line) + len(word) > WORD:
                lines.append(line)
                line = ""
            line += word
        lines.append(line)
    return "\n".join(lines)


def _words(text: str, ends: str) -> Iterator[str]:
    """Split a text after each of these characters."""
    start = 0
    for at, letter in enumerate(text, start=1):
        if letter in ends:
            yield text[start:at]
            start = at
    if start < len(text):
        yield text[start:]


def _width(columns: Sequence[_Column]) -> int:
    return sum(column.width + GAP for column in columns) - GAP


def _table(columns: Sequence[_Column]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 1), header_style="bold")
    for column in columns:
        table.add_column(
            Text(column.header),
            justify=column.justify,
            style=column.style,
            min_width=column.width,
        )
    for cells in zip(*(column.cells for column in columns), strict=True):
        table.add_row(*map(Text, cells))
    return table


def _format(value: Any) -> str:  # noqa: ANN401 - a value of a scenario's key
    return f"{value:g}" if isinstance(value, float) else str(value)


def _format_runs(group: RunGroup) -> str:
    done = group.completed == group.runs
    return str(group.runs) if done else f"{group.completed} of {group.runs}"


def _format_range(group: RunGroup, name: str) -> str:
    values = group.metrics[name]
    if values is None:
        return MISSING
    median, low, high = values
    pattern = "{:.3g}" if max(abs(low), abs(high)) < 1000.0 else "{:.0f}"
    texts = [pattern.format(each) for each in (median, low, high)]
    return f"{texts[0]} ({texts[1]} to {texts[2]})" if low < high else texts[0]
