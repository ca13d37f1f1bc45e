"""The commands that hand a run on: export, compare."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from testbed.options import RunName


class Format(StrEnum):
    """What a run can be written as."""

    CSV = "csv"
    PARQUET = "parquet"
    NPZ = "npz"
    FOXGLOVE = "foxglove"
    PLOTJUGGLER = "plotjuggler"


def export(
    run: RunName,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            help="Tables with a row for each frame and aircraft (csv, parquet), arrays for NumPy "
            "(npz), or a layout for the program that opens the log.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Where to; - is stdout.  \\[default: run.FORMAT beside the log]"
        ),
    ] = None,
) -> None:
    """Write a flown run as a table, as arrays, or make a layout for its log.

    Columns are named after the log's topics and fields, with their units.
    """
    from testbed.export_console import export_run

    typer.echo(export_run(run, form, out), err=True)


def compare(
    first: RunName,
    second: Annotated[str, typer.Argument(metavar="RUN", help="The run to hold against it.")],
    numbers: Annotated[
        bool,
        typer.Option(
            "--numbers", help="Print a table instead; exit with 0 where they agree, else with 3."
        ),
    ] = False,
    within: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="With --numbers: metrics agree that differ by no more than this share of the "
            "larger, as 0.01; frames and events are not held to anything.  \\[default: all must "
            "be the same to the last bit]",
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="With --numbers: write all of it here; - is stdout."
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save a Rerun recording instead of opening a viewer."),
    ] = None,
) -> None:
    """Lay two runs over one another in a Rerun viewer, or compare their numbers."""
    from testbed.compare_console import compare_numbers, refuse_mixed
    from testbed.view_console import lay_over

    refuse_mixed(numbers=numbers, within=within, json=json, rrd=rrd)
    if numbers:
        raise typer.Exit(compare_numbers(first, second, within=within, json=json))
    lay_over(first, second, rrd=rrd)
