"""The command that flies a study."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Jobs


class Backend(StrEnum):
    """Where a study is flown."""

    JOBLIB = "joblib"
    DASK = "dask"


def sweep(
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
            help="Go on with a study that was begun: that of --out, or the latest of this name.",
        ),
    ] = False,
    backend: Annotated[
        Backend, typer.Option(help="Processes on this machine, or a Dask cluster.")
    ] = Backend.JOBLIB,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="With --backend dask: the scheduler, tcp://HOST:8786."
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write how it ended; - is stdout."),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No progress bar and no table.")
    ] = False,
) -> None:
    """Fly a study: a scenario many times over, into one Parquet file.

    Its page says what varies. A run that is lost or fails is a row of the file, and exit code 1.
    """
    from testbed.study_console import sweep_and_show

    raise typer.Exit(
        sweep_and_show(
            study,
            out=out,
            jobs=jobs,
            resume=resume,
            backend=backend.value,
            scheduler=scheduler,
            json=json,
            quiet=quiet,
        )
    )
