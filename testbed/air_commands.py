"""The command that looks at the air of a scenario by itself: air."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Overrides, ScenarioName


def air(
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.npz", help="Write what the probes felt, as NumPy arrays."),
    ] = None,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples per second.")] = 50.0,
    duration: Annotated[
        float, typer.Option(metavar="SECONDS", help="Length of the flight.")
    ] = 600.0,
    airspeed: Annotated[
        float | None,
        typer.Option(
            metavar="M/S", help="True airspeed.  \\[default: that of the leader's mission, or 20]"
        ),
    ] = None,
    course: Annotated[
        float,
        typer.Option(
            metavar="DEG",
            help="Direction of flight through the air, degrees clockwise from north; the mean wind "
            "carries the probes besides.",
        ),
    ] = 0.0,
    height: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Height above the ground.  \\[default: that of the leader's start]"
        ),
    ] = None,
    separation: Annotated[
        float | None,
        typer.Option(metavar="M", help="Fly a second probe this far to the right of the first."),
    ] = None,
    overrides: Overrides = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random stream.")] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Draw it beside the closed forms, as .png, .pdf or .svg."
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the table here too; - is stdout."),
    ] = None,
) -> None:
    """Fly probes straight through a scenario's air and show what they feel.

    Probes hold their height and airspeed, wings level, in the leader's airframe.
    The mean wind carries them besides: over the ground they go as both together.
    The first begins at the leader's start and has the leader's turbulence; the
    second has that of the first follower. Gusts are felt. Wakes are not: probes
    shed none, and nobody else flies.
    """
    from testbed.air_console import Asked, probe_and_show

    probe_and_show(
        scenario,
        tuple(overrides or ()),
        Asked(rate, duration, airspeed, course, height, separation),
        seed=seed,
        out=out,
        plot=plot,
        json=json,
    )
