"""The command that assesses a formation before a flight: assess."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import (
    Jobs,
    JsonFile,
    Overrides,
    Quiet,
    ScenarioName,
    error_places,
    read_time,
    require_positive,
    value_option,
)
from testbed.cli.output import (
    PipeSafeConsole,
    describe_file,
    find_folder,
    message_console,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

PAGE = "assessment.html"


def assess_command(
    scenario: ScenarioName,
    overrides: Overrides = None,
    flights: Annotated[
        int | None,
        value_option(
            "N",
            "Flights of each row, with seeds from that of the scenario on: of 59 that all keep the "
            "criteria 95 % do, with 95 % confidence.  \\[default: 59]",
            check=require_positive,
        ),
    ] = None,
    duration: Annotated[
        str | None,
        value_option("TIME", "Time of each flight: 120, 120s, 2m.  \\[default: the scenario's]"),
    ] = None,
    only: Annotated[
        list[str] | None,
        value_option("ROW", "Find this row only, such as loss; may be repeated."),
    ] = None,
    param: Annotated[
        list[str] | None,
        value_option(
            "[NAME=]FILE",
            "Parameters of the real aircraft NAME, or of all, as a ground station saves them: "
            "no-go where those of these flights differ; may be repeated.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        value_option("DIR", "Folder to create.  \\[default: logs/assessments/SCENARIO/UTC-ID]"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue in the folder of --out, or the latest of this scenario: rows there are "
            "kept unless something that they depend on has changed.",
        ),
    ] = False,
    jobs: Jobs = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Find on one page what a formation bears, before a flight: go or no-go.

    Margins in straight flight, turns and climbs; the largest loss, delay, wind, turbulence and
    sensor errors with which the flights of all seeds keep the criteria; each fault and each outage
    alone; battery; the limits that are reached first; parameters and gains. Criteria are the
    bounds of `expect` of the scenario, or stated ones.

    Writes assessment.html, assessment.json, the rows and the parameters to the folder. The exit
    code is 0 for go, and 3 for no-go.
    """
    from testbed.assessment.assess import DOCUMENT, assess, row_names, write_parameters
    from testbed.assessment.assessed import FLIGHTS, Assessed
    from testbed.core.files import report_write_errors
    from testbed.logs.file_record import check_folder_output, record_files
    from testbed.reports import write_page
    from testbed.reports.assessment_page import assessment_page
    from testbed.scenario import open_scenario

    rows = row_names(only or ())
    duration_s = None if duration is None else read_time("--duration", duration)
    messages = message_console()
    with error_places(scenario, overrides):
        assessed = Assessed(
            scenario,
            open_scenario(scenario),
            tuple(overrides or ()),
            duration_s,
            FLIGHTS if flights is None else flights,
            tuple(param or ()),
        )
        name = assessed.scenario().name
        folder = find_folder("assessment", name, out, resume=resume, holds="rows")
        check_folder_output(folder, (PAGE, DOCUMENT), "assess")
        try:
            found = assess(
                assessed,
                folder,
                jobs=jobs,
                only=rows,
                report=lambda line: None if quiet else messages.write_line(f" {line}"),
            )
        except KeyboardInterrupt:
            messages.write_line(f" interrupted: the rows so far are in {folder}; write --resume")
            raise
    parameters = write_parameters(found, folder)
    write_json_output(folder / DOCUMENT, found)
    page = folder / PAGE
    with report_write_errors(page):
        write_page(assessment_page(found), page)
    record_files(folder, PAGE, DOCUMENT, "rows", "parameters")
    write_json_output(json, found)
    if not quiet:
        console = result_console(json)
        _print(found, console)
        console.write_line(f" page        {describe_file(page)}")
        for each in parameters:
            console.write_line(f" parameters  {describe_file(each)}")
    raise typer.Exit(ExitCode.DIFFERENT if found["verdict"] == "no-go" else ExitCode.OK)


def _print(found: Mapping[str, Any], console: PipeSafeConsole) -> None:
    """Print the verdict, what is short, and the rows."""
    from testbed.reports.assessment_page import row_lines

    style = {"go": "bold green", "no-go": "bold red"}.get(found["verdict"], "bold")
    console.write_heading(found["scenario"], f" · {' · '.join(found['flown'])}")
    console.write_line(f" {found['verdict']}", style)
    for each in found["short"]:
        console.write_line(f" {each['row']}: {each['text']}", "red")
    console.write_line()
    for line in row_lines(found):
        console.write_line(f" {line}")
    console.write_line()
