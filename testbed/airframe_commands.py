"""The commands that look at one aircraft by itself: trim, linearize and step."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

AircraftName = Annotated[str, typer.Argument(metavar="AIRCRAFT", help="Name or folder.")]
Airspeed = Annotated[float, typer.Option(metavar="M/S", help="True airspeed, m/s.")]
Climb = Annotated[float, typer.Option(metavar="DEG", help="Climb angle, degrees; a glide is < 0.")]
Bank = Annotated[float, typer.Option(metavar="DEG", help="Bank, degrees, right wing down > 0.")]
Altitude = Annotated[float, typer.Option(metavar="M", help="Altitude above sea level, m.")]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the numbers here too; - is stdout."),
]


def trim(
    aircraft: AircraftName,
    airspeed: Airspeed,
    climb: Climb = 0.0,
    bank: Bank = 0.0,
    altitude: Altitude = 400.0,
    json: JsonFile = None,
) -> None:
    """Find the steady flight of an aircraft: attitude, controls, propeller, and what is left."""
    from testbed.airframe_tools import show_trim

    show_trim(aircraft, airspeed, climb, bank, altitude, json=json)


def linearize(
    aircraft: AircraftName,
    airspeed: Airspeed,
    climb: Climb = 0.0,
    bank: Bank = 0.0,
    altitude: Altitude = 400.0,
    json: JsonFile = None,
) -> None:
    """Linearise an aircraft about its trim and print its natural modes."""
    from testbed.airframe_tools import show_modes

    show_modes(aircraft, airspeed, climb, bank, altitude, json=json)


def step(
    aircraft: AircraftName,
    airspeed: Annotated[
        float | None,
        typer.Option(
            metavar="M/S", help="Airspeed before the step.  \\[default: the profile's trim]"
        ),
    ] = None,
    step: Annotated[float, typer.Option(metavar="M/S", help="Step of the commanded speed.")] = 2.0,
    profile: Annotated[
        str, typer.Option(metavar="NAME", help="Middle-loop gains, in middle_loop.yaml.")
    ] = "paper",
    param: Annotated[
        str, typer.Option(metavar="FILE", help="Autopilot parameters: a tune's name or a file.")
    ] = "autopilot",
    json: JsonFile = None,
) -> None:
    """Step the commanded speed of an aircraft in level flight and fit the formation law's model."""
    from testbed.airframe_tools import show_step

    show_step(aircraft, airspeed, step, profile, param, json=json)
