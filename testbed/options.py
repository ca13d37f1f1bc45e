"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.errors import InputError

ScenarioName = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Name of a scenario (`testbed list`) or a path.")
]
RunName = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        help="A run directory, a .mcap file, or a scenario's name for the latest of its runs.",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the page, e.g. network.delay_s=0.1 or 'fleet.*.sensors=gps-ins'; "
        "may be repeated.",
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", help="Flights at once.  \\[default: one per processor]"),
]
Figures = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write every figure here too, as a file of its own."),
]
Format = Annotated[
    str | None,
    typer.Option(metavar="png|pdf|svg", help="Of these files.  \\[default: png]"),
]


def refuse_below_one(**counts: int | None) -> None:
    """Refuse options, by their names, that count something and are 0 or less.

    Raises:
        InputError: one of them is.
    """
    for name, count in counts.items():
        if count is not None and count < 1:
            raise InputError(f"--{name} {count}: write a whole number above 0")
