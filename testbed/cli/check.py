"""The command that compares runs with golden tables: check."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import (
    Jobs,
    JsonFile,
    Overrides,
    output_option,
    positive_option,
    scenario_names,
    value_option,
)
from testbed.cli.output import (
    PipeSafeConsole,
    check_output_folder,
    message_console,
    open_output,
    result_console,
    write_json_output,
)
from testbed.cli.report import FigureFormat, figure_format
from testbed.cli.trend import show_trend
from testbed.core.errors import InputError, raise_memory_shortage
from testbed.core.files import check_folder_writable, check_writable, report_write_errors

if TYPE_CHECKING:
    from testbed.golden.golden import GoldenCase
    from testbed.golden.golden_compare import Verdict


class Annotations(StrEnum):
    """CI servers that annotate files from the output of a command."""

    GITHUB = "github"


@draws_figures("figures")
def check_command(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            autocompletion=scenario_names,
            help="Names or paths of scenarios.  \\[default: all that have a golden table]",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        positive_option(
            "N", "Flights per scenario.  \\[default: 4 seeds of the table; 16 for a new table]"
        ),
    ] = None,
    overrides: Overrides = None,
    tolerance: Annotated[
        list[str] | None,
        value_option(
            "5%|NAME=5%",
            "Numbers may be worse by this much, and better by any: all, or of one quantity, "
            "as rms_m=5% or rms_m=0.1; may be repeated.  \\[default: the scenario's expect, else "
            "1 mm for the same seed]",
        ),
    ] = None,
    jobs: Jobs = None,
    junit: Annotated[Path | None, output_option(help="Write JUnit XML for a CI server.")] = None,
    json: JsonFile = None,
    summary: Annotated[
        Path | None, output_option(help="Write a summary in Markdown, as for a job of a CI.")
    ] = None,
    reports: Annotated[
        Path | None,
        value_option(
            "DIR",
            "Fly a failing seed of each failed scenario again, with log and report.html in "
            "DIR/SCENARIO.",
            check=check_output_folder,
        ),
    ] = None,
    annotations: Annotated[
        Annotations | None,
        value_option(
            "github", "Also print each error as an annotation of a file and line, for GitHub."
        ),
    ] = None,
    golden: Annotated[
        Path | None,
        value_option("DIR", "Folder of the tables.  \\[default: golden/ beside each scenario]"),
    ] = None,
    trend: Annotated[
        Path | None,
        value_option(
            "DIR",
            "Fly nothing: show the numbers of kept results of --json over commits, one file "
            "in DIR for each, in order of their names.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        value_option(
            "DIR",
            "With --trend, draw each quantity over the commits as a file in this folder.",
            check=check_output_folder,
        ),
    ] = None,
    format: FigureFormat = None,
    update: Annotated[
        bool, typer.Option("--update", help="Write new tables instead; needs --reason.")
    ] = False,
    reason: Annotated[
        str | None, value_option("TEXT", "Why the numbers change; stored in the tables.")
    ] = None,
    ignore_bounds: Annotated[
        bool,
        typer.Option(
            "--ignore-bounds",
            help="With --update, also write tables of numbers outside the bounds of the "
            "scenario's expect.",
        ),
    ] = False,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Fly scenarios and compare their metrics with golden tables."""
    from testbed.cli.progress import progress_counter
    from testbed.golden.golden import check, find_cases, update_tables
    from testbed.golden.golden_annotations import annotations_of, input_annotations, to_github
    from testbed.golden.golden_ci import to_junit, to_markdown, write_junit
    from testbed.golden.golden_report import print_check, print_updates, to_document
    from testbed.golden.golden_tolerance import parse_tolerances

    ending = figure_format(format, figures)
    if trend is not None:
        flown = {"--seeds": seeds, "--set": overrides, "--tolerance": tolerance, "--jobs": jobs}
        files = {"--junit": junit, "--summary": summary, "--reports": reports}
        kinds = {"--annotations": annotations, "--golden": golden, "--update": update or None}
        last = {"--ignore-bounds": ignore_bounds or None, "--reason": reason}
        for option, value in {**flown, **files, **kinds, **last}.items():
            if value is not None:
                raise InputError(f"{option}: --trend flies nothing; leave {option} out")
        show_trend(trend, scenarios or (), json=json, figures=figures, ending=ending, look=look)
        return
    if figures:
        raise InputError("--figures: are of --trend DIR; write it too, or --reports for failures")
    outputs = {"--junit": junit, "--json": json, "--summary": summary, "--reports": reports}
    _check_options(outputs, update=update, reason=reason, overrides=overrides)
    if ignore_bounds and not update:
        raise InputError("--ignore-bounds: is of --update; write --update too")
    tolerances = parse_tolerances(tolerance or ())
    if tolerances and update:
        raise InputError("--tolerance: --update compares nothing; leave --tolerance out")
    console = result_console(json)
    if reports:
        import testbed.views.matplotlib_backend  # noqa: F401 - its extra is needed, before flights
    try:
        cases = find_cases(scenarios or (), folder=golden, new=update, overrides=overrides or ())
    except InputError as error:
        if junit:
            write_junit(junit, to_junit([], str(error).splitlines()))
        _write_summary(summary, to_markdown([], str(error).splitlines()))
        if annotations:
            for each in input_annotations(error):
                console.write_line(to_github(each))
        raise
    jobs = jobs or os.cpu_count() or 1
    report = message_console().write_line
    if update:
        for case in cases:
            with report_write_errors(case.path):
                check_folder_writable(case.path.parent)
                if case.path.parent.is_dir():
                    check_writable(case.path)
        with progress_counter("flights", rate="flights") as progress:
            updates = update_tables(
                cases,
                seeds=seeds,
                jobs=jobs,
                reason=(reason or "").strip(),
                ignore_bounds=ignore_bounds,
                progress=progress,
                report=report,
            )
        print_updates(updates, console)
        passed = all(each.table for each in updates)
    else:
        with progress_counter("flights", rate="flights") as progress:
            verdicts = check(
                cases,
                seeds=seeds,
                jobs=jobs,
                progress=progress,
                report=report,
                tolerances=tolerances,
            )
        if junit:
            write_junit(junit, to_junit(verdicts))
        document = to_document(verdicts)
        write_json_output(json, document)
        _write_summary(summary, to_markdown(verdicts))
        print_check(verdicts, console)
        if annotations:
            for each in annotations_of(cases, verdicts):
                console.write_line(to_github(each))
        if reports:
            _write_reports(cases, verdicts, reports, console)
        passed = document["passed"]
    raise typer.Exit(ExitCode.OK if passed else ExitCode.DIFFERENT)


def _write_summary(path: Path | None, text: str) -> None:
    if path:
        with open_output(path, "--summary") as file:
            file.write(text.encode("utf-8", "backslashreplace"))


def _write_reports(
    cases: Sequence[GoldenCase], verdicts: Sequence[Verdict], folder: Path, console: PipeSafeConsole
) -> None:
    """Fly a failing seed of each failed scenario again, and write its log and report."""
    from testbed.cli.report import write_report
    from testbed.golden.golden_report import failing_seeds
    from testbed.reports import read_run, run_page
    from testbed.runs.run import run
    from testbed.scenario import set_seed

    names: set[str] = set()
    for case, verdict in zip(cases, verdicts, strict=True):
        if verdict.passed:
            continue
        name = case.source.stem
        while name in names:
            name += "-2"
        names.add(name)
        scenario = set_seed(case.scenario, failing_seeds(verdict)[0])
        try:
            result = run(scenario, out=folder / name)
            assert result.directory
            page = run_page(read_run(result.directory))
        except Exception as error:  # the verdict has been printed; a failed flight may fail again
            raise_memory_shortage(error)
            console.write_line(f" {verdict.name}: no report: {error}", "yellow")
            continue
        write_report(page, folder / name / "report.html", console, default=False)


def _check_options(
    outputs: Mapping[str, Path | None],
    *,
    update: bool,
    reason: str | None,
    overrides: Sequence[str] | None,
) -> None:
    if overrides and update:
        raise InputError(
            "--set: a table is of a scenario as its file is; leave --set out, or change the file"
        )
    for each in overrides or ():
        if each.partition("=")[0].strip() == "scenario.seed":
            raise InputError(f"--set {each}: the table sets the seeds; write --seeds N")
    if update and not (reason or "").strip():
        raise InputError("--update: write why the new numbers are right, with --reason TEXT")
    if reason is not None and not update:
        raise InputError("--reason: is stored by --update; write --update too")
    for option, path in outputs.items():
        if path and update:
            raise InputError(f"{option}: --update compares nothing; leave {option} out")
