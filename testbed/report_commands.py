"""The commands that make a page: report, of a flown run; study-report, of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Figures, Format, RunName


def report(
    run: RunName,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html", help="The page.  \\[default: report.html beside the log]"
        ),
    ] = None,
    figures: Figures = None,
    format: Format = None,
) -> None:
    """Make one page of a flown run: its figures, its tables, and all that repeats it.

    The page needs a browser and nothing else, on screen or on paper.
    """
    from testbed.report_console import report_and_show

    report_and_show(run, out=out, figures=figures, ending=format)


def study_report(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A file of `testbed sweep`, its directory, or a study's name for the latest.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html", help="The page.  \\[default: report.html beside the file]"
        ),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Show this number of metrics.json, as portions.circles.mean_rms_m; may be "
            "repeated.  \\[default: the metrics of the study's page]",
        ),
    ] = None,
    statistic: Annotated[
        str | None,
        typer.Option(metavar="median|mean", help="Over seeds.  \\[default: median]"),
    ] = None,
    figures: Figures = None,
    format: Format = None,
    tables: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write every table here too, as CSV."),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the tables here; - is stdout."),
    ] = None,
) -> None:
    """Make one page of a study: what came out, what matters, what was lost, what repeats it."""
    from testbed.study_report_console import report_study

    report_study(
        study,
        out=out,
        figures=figures,
        ending=format,
        tables=tables,
        json=json,
        metrics=tuple(metric or ()),
        statistic=statistic,
    )
