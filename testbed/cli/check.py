"""The command that compares runs with golden tables: check."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import Jobs, JsonFile, output_option, require_positive
from testbed.cli.output import message_console, result_console, write_json_output
from testbed.core.errors import InputError
from testbed.core.files import check_folder_writable, check_writable, report_write_errors


def check_command(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            help="Names or paths of scenarios.  \\[default: all that have a golden table]",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Flights per scenario.  \\[default: 4 seeds of the table; 16 for a new table]",
            callback=require_positive,
        ),
    ] = None,
    jobs: Jobs = None,
    junit: Annotated[Path | None, output_option(help="Write JUnit XML for a CI server.")] = None,
    json: JsonFile = None,
    golden: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the tables.  \\[default: golden/ beside each scenario]"
        ),
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Write new tables instead; needs --reason.")
    ] = False,
    reason: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Why the numbers change; stored in the tables."),
    ] = None,
) -> None:
    """Fly scenarios and compare their metrics with golden tables."""
    from testbed.cli.progress import progress_counter
    from testbed.studies.golden import check, find_cases, update_tables
    from testbed.studies.golden_report import (
        print_check,
        print_updates,
        to_document,
        to_junit,
        write_junit,
    )

    _check_options(junit=junit, json=json, update=update, reason=reason)
    try:
        cases = find_cases(scenarios or (), folder=golden, new=update)
    except InputError as error:
        if junit:
            write_junit(junit, to_junit([], str(error).splitlines()))
        raise
    jobs = jobs or os.cpu_count() or 1
    report = message_console().write_line
    if update:
        for case in cases:
            with report_write_errors(case.path):
                check_folder_writable(case.path.parent)
                if case.path.parent.is_dir():
                    check_writable(case.path)
        with progress_counter("flights") as progress:
            updates = update_tables(
                cases,
                seeds=seeds,
                jobs=jobs,
                reason=(reason or "").strip(),
                progress=progress,
                report=report,
            )
        print_updates(updates, result_console())
        passed = all(each.table for each in updates)
    else:
        with progress_counter("flights") as progress:
            verdicts = check(cases, seeds=seeds, jobs=jobs, progress=progress, report=report)
        if junit:
            write_junit(junit, to_junit(verdicts))
        document = to_document(verdicts)
        write_json_output(json, document)
        print_check(verdicts, result_console(json))
        passed = document["passed"]
    raise typer.Exit(ExitCode.OK if passed else ExitCode.DIFFERENT)


def _check_options(
    *, junit: Path | None, json: Path | None, update: bool, reason: str | None
) -> None:
    if update and not (reason or "").strip():
        raise InputError("--update: write why the new numbers are right, with --reason TEXT")
    if reason is not None and not update:
        raise InputError("--reason: is stored by --update; write --update too")
    for option, path in (("--junit", junit), ("--json", json)):
        if path and update:
            raise InputError(f"{option}: --update compares nothing; leave {option} out")
