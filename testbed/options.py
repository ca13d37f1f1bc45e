"""Arguments and options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

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
