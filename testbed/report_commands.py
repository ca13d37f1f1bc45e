"""The command that makes a page of a flown run: report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import RunName


def report(
    run: RunName,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html", help="The page.  \\[default: report.html beside the log]"
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write every figure here too, as a file of its own."),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(metavar="png|pdf|svg", help="Of these files.  \\[default: png]"),
    ] = None,
) -> None:
    """Make one page of a flown run: its figures, its tables, and all that repeats it.

    The page needs a browser and nothing else, on screen or on paper.
    """
    from testbed.report_console import report_and_show

    report_and_show(run, out=out, figures=figures, ending=format)
