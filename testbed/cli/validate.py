"""The commands that read a scenario without running it: validate, schema."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import Overrides, ScenarioName, error_places, load_scenario
from testbed.core.errors import escape_controls

if TYPE_CHECKING:
    from testbed.flight.world import World
    from testbed.scenario import Scenario


def validate_command(
    scenario: ScenarioName,
    overrides: Overrides = None,
    resolved: Annotated[
        bool, typer.Option("--resolved", help="Print the scenario with every default written out.")
    ] = False,
    stages: Annotated[
        bool, typer.Option("--stages", help="Print what a flight does at each tick, in order.")
    ] = False,
) -> None:
    """Check a scenario without running it: its keys, aircraft, formation and control law.

    Warns about each assumption of the paper that the scenario does not meet. Tests a control law of
    your own with a few calls. Names the code and the programs that a run would start.
    """
    from testbed.plan.world import build
    from testbed.scenario import dump

    loaded = load_scenario(scenario, overrides)
    with error_places(scenario, overrides):
        world = build(loaded)
    for event in world.initial_events:
        typer.echo(escape_controls(f"{event.level}: {event.source}: {event.text}"), err=True)
    for line in (*_programs(loaded), *_engines(world)):
        typer.echo(escape_controls(line), err=True)
    if stages:
        _print_stages(world)
    elif resolved:
        typer.echo(dump(loaded))
    else:
        typer.echo(f"{scenario}: valid")


def _engines(world: World) -> Iterator[str]:
    if world.fleet is not None:
        yield f"engine: {world.fleet.describe_engine()}"


def _print_stages(world: World) -> None:
    from testbed.runs.run import list_stages

    rows = [("part", "when", "stage", "runs"), *list_stages(world)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        typer.echo("  ".join(cells).rstrip())


def _programs(scenario: Scenario) -> Iterator[str]:
    """Describe the programs that a run starts; laws are among the events."""
    from testbed.ardupilot.sitl_process import VARIABLE
    from testbed.scenario.aircraft import ArduPlane

    for aircraft in scenario.aircraft:
        if isinstance(aircraft.autopilot, ArduPlane) and aircraft.autopilot.start:
            yield (
                f"info: {aircraft.name}: a run starts the program of --arduplane or {VARIABLE} "
                f"({os.environ.get(VARIABLE) or 'not set'})"
            )


def schema_command() -> None:
    """Print the JSON schema of scenario files, for editors."""
    import json

    from testbed.scenario import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
