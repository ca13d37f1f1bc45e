"""The command that flies a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Overrides, ScenarioName

_OUTSIDE = "Programs outside"


def run(
    scenario: ScenarioName,
    overrides: Overrides = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random stream.")] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="End the flight earlier or later.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Run directory to make.  \\[default: logs/SCENARIO/UTC-ID]"
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the metrics here too; - is stdout."),
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Watch live in a Rerun viewer, started if need be.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No progress bar and no table.")
    ] = False,
    processes: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Processes that step flight models; no number depends on it.  \\[default: 1, "
            "more from 20 aircraft on]",
        ),
    ] = None,
    mavlink: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Make every aircraft a MAVLink vehicle here: udpout:HOST:PORT, udpin:HOST:PORT, "
            "or a port alone for udpout:127.0.0.1:PORT; PORT+STEP is a port for each aircraft. "
            "May be repeated.",
            rich_help_panel=_OUTSIDE,
        ),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Simulated seconds per second; 0 is as fast as it flies.  \\[default: 1 with "
            "--mavlink, unless the run waits for commands; else 0]",
            rich_help_panel=_OUTSIDE,
        ),
    ] = None,
    tlog: Annotated[
        bool,
        typer.Option(
            "--tlog",
            help="Leave run.tlog too, the MAVLink telemetry.",
            rich_help_panel=_OUTSIDE,
        ),
    ] = False,
    mavlink_key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Sign MAVLink with the key in this file, a passphrase or 64 hexadecimal digits, "
            "and believe only who has it.",
            rich_help_panel=_OUTSIDE,
        ),
    ] = None,
    arduplane: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="The ArduPlane for aircraft with autopilot: ardupilot.  \\[default: ARDUPLANE "
            "of the environment]",
            rich_help_panel=_OUTSIDE,
        ),
    ] = None,
) -> None:
    """Fly a scenario and print its table.

    Leaves run.mcap, scenario.resolved.yaml and metrics.json in the run directory.
    """
    from testbed.console import Flight, fly_and_show

    raise typer.Exit(
        fly_and_show(
            Flight(
                scenario,
                tuple(overrides or ()),
                seed=seed,
                duration_s=duration,
                out=out,
                json=json,
                view=view,
                quiet=quiet,
                processes=processes,
                mavlink=tuple(mavlink or ()),
                pace=pace,
                tlog=tlog,
                key=mavlink_key,
                arduplane=arduplane,
            )
        )
    )
