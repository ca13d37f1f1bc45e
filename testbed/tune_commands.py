"""The command that seeks gains: tune."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Jobs


def tune(
    page: Annotated[
        str, typer.Argument(metavar="TUNE", help="Name of a tune (`testbed list`) or a path.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder to make.  \\[default: logs/studies/NAME/UTC-ID]"),
    ] = None,
    jobs: Jobs = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the result here too; - is stdout."),
    ] = None,
) -> None:
    """Seek gains that make a metric small, and hold them to seeds the search did not see.

    Leaves middle_loop.yaml, tuned.yaml that flies it, every trial, and result.json.
    """
    from testbed.tune_console import tune_and_show

    tune_and_show(page, out=out, jobs=jobs, json=json)
