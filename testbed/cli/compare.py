"""The command that compares two runs: compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from testbed.cli.exit_codes import ExitCode
from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import JsonFile, RrdFile, RunName, output_option, value_option
from testbed.cli.output import (
    MISSING,
    PipeSafeConsole,
    describe_file,
    print_margin_changes,
    print_side_effects,
    result_console,
    write_json_output,
)
from testbed.cli.view import overlay_runs
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.golden.compare_runs import MetricPair, PositionDifference, RunDifference
    from testbed.logs.read import RunLog
    from testbed.studies.margin_changes import MarginChange

MAX_LINES = 12  # of differences of the scenarios, and of versions
NAMES = "first", "second"  # the runs
WORSE = "also worse in the second run", NAMES


@draws_figures("figure")
def compare_command(
    first: RunName,
    second: Annotated[str, typer.Argument(metavar="RUN", help="The run to compare it with.")],
    numbers: Annotated[
        bool,
        typer.Option(
            "--numbers",
            help="Print a table instead; exit with 0 if the runs agree, with 3 if they differ.",
        ),
    ] = False,
    within: Annotated[
        float | None,
        value_option(
            "SHARE",
            "With --numbers: relative tolerance of metrics, such as 0.01; samples and events "
            "are then not compared.  \\[default: every bit must be equal]",
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        output_option(
            metavar="FILE",
            help="Draw the distances from the slots in both runs for a column of a paper: .pdf, "
            ".svg or .png.",
            suffixes=(".pdf", ".svg", ".png"),
        ),
    ] = None,
    margins: Annotated[
        bool,
        typer.Option(
            "--margins",
            help="With --numbers: also predict the margins of both scenarios in straight flight.",
        ),
    ] = False,
    json: JsonFile = None,
    rrd: RrdFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Overlay two runs in a Rerun viewer, draw their errors, or compare all their numbers."""
    check_options(
        numbers=numbers, within=within, margins=margins, json=json, rrd=rrd, figure=figure
    )
    if figure:
        _draw(figure, (first, second), look)
        return
    if not numbers:
        overlay_runs(first, second, rrd=rrd)
        return
    from testbed.golden.compare_runs import compare_runs
    from testbed.logs.run_directory import find_run

    paths = find_run(first), find_run(second)
    logs = _read(paths[0]), _read(paths[1])
    found = compare_runs(*logs, tolerance=within)
    predicted = _predict(logs, paths) if margins else []
    write_json_output(json, _document(found, paths, predicted))
    _print_comparison(found, logs, paths, predicted, result_console(json))
    raise typer.Exit(ExitCode.OK if found.same else ExitCode.DIFFERENT)


def check_options(
    *,
    numbers: bool,
    within: float | None,
    margins: bool,
    json: Path | None,
    rrd: Path | None,
    figure: Path | None,
) -> None:
    """Refuse options that exclude each other.

    Raises:
        InputError: naming them.
    """
    if figure and (numbers or rrd):
        raise InputError(f"--figure {figure}: leave out {'--numbers' if numbers else '--rrd'}")
    if numbers and rrd:
        raise InputError(f"--rrd {rrd}: is for the overlay; leave out --numbers")
    if not numbers and (within is not None or margins or json):
        option = "--within" if within is not None else "--margins" if margins else "--json"
        raise InputError(f"{option}: is for the comparison of metrics; write --numbers too")
    if within is not None and not 0.0 <= within < 1.0:
        raise InputError(f"--within {within:g}: write a share from 0 to 1, such as 0.01 for 1 %")


def _draw(path: Path, names: Sequence[str], look: FigureLook) -> None:
    """Draw the errors of two runs, and print the file and the labels.

    Raises:
        InputError: there is no such run, the runs have nothing in common, or the file cannot be
            written.
    """
    from testbed.golden.compare_runs import run_side_effects
    from testbed.reports import compare_figure, read_run, run_labels
    from testbed.reports.figure_compare import COLUMN_IN

    first, second = (read_run(name) for name in names)
    labels = run_labels(first, second, names)
    grid = compare_figure(first, second, labels)
    replace(look, width=look.width or COLUMN_IN, no_title=True).save(grid, path, "--figure")
    console = result_console()
    for label, run, style in zip(labels, (first, second), ("solid", "dashed"), strict=True):
        console.write_line(f" {style:10}{label}: {run.path}")
    console.write_line(f" {'figure':10}{describe_file(path)}")
    print_side_effects(console, run_side_effects(first.metrics, second.metrics), *WORSE)


def _read(path: Path) -> RunLog:
    from testbed.logs.read import read_log

    log = read_log(path)
    if log.metrics is None:
        raise InputError(
            f"{path}: this run has no metrics, because it was killed before its end: finish it "
            f"with `testbed recover {path}`, or leave out --numbers to overlay the runs"
        )
    return log


def _predict(logs: Sequence[RunLog], paths: Sequence[Path]) -> list[MarginChange]:
    """Predict the margins of the scenarios of two runs.

    Raises:
        InputError: this version cannot read a scenario.
    """
    from testbed.logs.run_directory import SCENARIO_NAME
    from testbed.pool.flight_pool import open_flight_pool
    from testbed.scenario import load_scenario, loads
    from testbed.studies.margin_changes import predict_changes

    # the file beside the log names the copy of a law
    files = [path.parent / SCENARIO_NAME for path in paths]
    scenarios = [
        load_scenario(file)
        if file.is_file()
        else loads(log.info.scenario_yaml, source=f"--margins: {log.info.scenario_name}")
        for file, log in zip(files, logs, strict=True)
    ]
    with open_flight_pool(jobs=len(scenarios)) as pool:
        return predict_changes(scenarios, pool)


def _print_comparison(
    found: RunDifference,
    logs: Sequence[RunLog],
    paths: Sequence[Path],
    predicted: Sequence[MarginChange],
    console: PipeSafeConsole,
) -> None:
    for label, log, path in zip(("first", "second"), logs, paths, strict=True):
        console.write_line(f" {label:10}{path}: {log.info.scenario_name}, seed {log.info.seed}")
    _print_some(console, "scenario", found.scenario)
    _print_some(console, "versions", found.versions)
    console.write_line()
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column(" ")
    for heading in ("first", "second", "difference"):
        table.add_column(heading, justify="right")
    for label, pair in found.rows:
        style = "" if pair.agrees(found.tolerance or 0.0) else "yellow"
        values = (_format(pair.first), _format(pair.second), _change(pair))
        table.add_row(f" {label}", *values, style=style)
    console.print(table)
    console.write_line()
    print_side_effects(console, found.side_effects, *WORSE)
    print_margin_changes(console, predicted, NAMES)
    if found.side_effects or any(each.side_effects or each.problem for each in predicted):
        console.write_line()
    console.write_line(f" {'motion':10}{_motion(found)}")
    for each in found.positions:
        if each.first_s is not None:
            console.write_line(
                f" {each.name:10}{_distance(each)}; different from {each.first_s:g} s on"
            )
    console.write_line(f" {_verdict(found)}", "bold green" if found.same else "bold yellow")


def _motion(found: RunDifference) -> str:
    if not found.positions:
        return "not compared: no aircraft of one name has samples at the same times in both runs"
    moved = sum(each.first_s is not None for each in found.positions)
    times = found.shared_s
    samples = f"{times.size} samples in both runs, {times[0]:g} to {times[-1]:g} s"
    if not moved:
        return f"every bit is equal; {samples}"
    return f"{moved} of {len(found.positions)} aircraft differ; {samples}"


def _distance(each: PositionDifference) -> str:
    if each.largest_m is None:
        return "the distance is NaN"
    return f"up to {each.largest_m:.3g} m apart, at {each.at_s:g} s"


def _verdict(found: RunDifference) -> str:
    bound = "" if found.tolerance is None else f" by more than {100 * found.tolerance:g} %"
    parts = []
    if found.differing:
        parts.append(f"{len(found.differing)} of {found.compared} metrics differ{bound}")
    if found.tolerance is None:
        if not found.same_samples:
            first, second = found.sample_counts
            parts.append("samples differ" if first == second else f"{first} and {second} samples")
        parts += [] if found.same_events else ["events differ"]
    if parts:
        return "different: " + ", ".join(parts)
    if found.tolerance is None:
        return f"equal: {found.compared} metrics, all events and every bit of every sample"
    return f"equal: {found.compared} metrics within {100 * found.tolerance:g} %"


def _document(
    found: RunDifference, paths: Sequence[Path], predicted: Sequence[MarginChange]
) -> dict[str, Any]:
    from testbed.metrics.side_effects import to_document

    first, second = paths
    return {
        "same": found.same,
        "first": str(first),
        "second": str(second),
        "within": found.tolerance,
        "scenario": list(found.scenario),
        "versions": list(found.versions),
        "metrics_compared": found.compared,
        "metrics_changed": {pair.key: [pair.first, pair.second] for pair in found.differing},
        "samples": list(found.sample_counts),
        "same_samples": found.same_samples,
        "same_events": found.same_events,
        "shared_samples": int(found.shared_s.size),
        "worse": to_document(found.side_effects),
        "margins": [
            {"problem": each.problem, "worse": to_document(each.side_effects)} for each in predicted
        ],
        "position_differences": [asdict(each) for each in found.positions],
    }


def _format(value: float | None) -> str:
    from testbed.golden.golden_report import format_number

    return MISSING if value is None else format_number(value)


def _change(pair: MetricPair) -> str:
    if pair.first is None or pair.second is None:
        return "" if pair.first is pair.second else "in one run only"
    change = pair.second - pair.first
    if change == 0.0:
        return "none"
    percent = 100.0 * change / abs(pair.first) if pair.first else 0.0
    digits = f"{percent:+.3g}" if abs(percent) < 1000.0 else f"{percent:+,.0f}"
    share = f" ({digits} %)" if percent else ""
    return f"{'+' if change > 0.0 else '-'}{_format(abs(change))}{share}"


def _print_some(console: PipeSafeConsole, label: str, lines: Sequence[str]) -> None:
    for line in lines[:MAX_LINES]:
        console.write_line(f" {label:10}{line}")
    if len(lines) > MAX_LINES:
        console.write_line(f" {'':10}and {len(lines) - MAX_LINES} more; --json FILE has all", "dim")
