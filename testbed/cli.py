"""The command line."""

from __future__ import annotations

import gc
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

from testbed import __version__
from testbed.air_commands import air
from testbed.airframe_commands import linearize, step, trim
from testbed.command_group import MARKUP, CommandGroup
from testbed.errors import InputError, PartnerLost
from testbed.export_commands import compare, export
from testbed.flight_commands import import_flight
from testbed.interrupts import remembering
from testbed.network_commands import network
from testbed.options import Jobs, Overrides, ScenarioName
from testbed.recover_commands import recover
from testbed.report_commands import report, study_report
from testbed.run_commands import run
from testbed.study_commands import sweep
from testbed.tune_commands import tune
from testbed.view_commands import shot, view

LOST = 1
BAD_INPUT = 2
INTERNAL_ERROR = 4
PARTNER_LOST = 5
INTERRUPTED = 130

EXITS = (
    "Exit codes: 0 good, 1 an aircraft was lost or upset, 2 bad input, 3 regression or runs that "
    "differ, 4 internal error, 5 a program outside was lost, 130 interrupted."
)


def validate(
    scenario: ScenarioName,
    overrides: Overrides = None,
    resolved: Annotated[
        bool, typer.Option("--resolved", help="Print the page with everything it stands for.")
    ] = False,
) -> None:
    """Check a scenario without flying it: the page, the world it asks for, and its law.

    Says which of the paper's hypotheses the page breaks. A law of your own is tried out.
    """
    from testbed.scenario import dump, load
    from testbed.sim.world import build

    page = load(scenario, tuple(overrides or ()))
    for note in build(page).notes:
        typer.echo(f"{note.level}: {note.source}: {note.text}", err=True)
    typer.echo(dump(page) if resolved else f"{scenario}: good")


def check(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            help="Names or paths of scenarios.  \\[default: all that have a golden table]",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Flights of each.  \\[default: 4 of the table's; 16 for a new table]"
        ),
    ] = None,
    jobs: Jobs = None,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write JUnit XML for a CI.")
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write what was found; - is stdout."),
    ] = None,
    golden: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The tables.  \\[default: golden/ beside each page]"),
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Write the tables anew instead; needs --reason.")
    ] = False,
    reason: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Why the numbers change; kept in the tables."),
    ] = None,
) -> None:
    """Fly scenarios and compare them with their golden tables."""
    from testbed.check_console import check_and_show

    raise typer.Exit(
        check_and_show(
            tuple(scenarios or ()),
            seeds=seeds,
            jobs=jobs,
            junit=junit,
            json=json,
            update=update,
            reason=reason,
            golden=golden,
        )
    )


def list_all() -> None:
    """List the scenarios, studies, tunes and aircraft that can be named."""
    from testbed.console import list_library

    list_library()


def schema() -> None:
    """Print the JSON schema of a scenario page, for editors."""
    import json

    from testbed.scenario import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def respond(
    aircraft: Annotated[str, typer.Argument(metavar="AIRCRAFT", help="Name or folder.")],
    commands: Annotated[
        Path,
        typer.Argument(
            metavar="COMMANDS.csv",
            help="Columns t_s, theta_cmd_rad, phi_cmd_rad, throttle_cmd; more may follow.",
        ),
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.csv", help="Same columns and times.")],
    param: Annotated[
        str, typer.Option(metavar="FILE", help="Autopilot parameters: a tune's name or a file.")
    ] = "recorded",
    airspeed: Annotated[
        float | None,
        typer.Option(
            metavar="M/S", help="True airspeed at the start.  \\[default: the first row's, or 22]"
        ),
    ] = None,
    altitude: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Altitude above the origin.  \\[default: the first row's, or 100]"
        ),
    ] = None,
    origin_elevation: Annotated[
        float, typer.Option(metavar="M", help="Elevation of the origin above sea level.")
    ] = 300.0,
) -> None:
    """Replay fly-by-wire-A commands through one aircraft, to compare with a recording."""
    from testbed.scenario import find_aircraft, find_tune
    from testbed.vehicle.respond import AircraftLost
    from testbed.vehicle.respond import respond as fly

    folder = find_aircraft(aircraft)
    try:
        fly(
            folder,
            commands,
            output,
            param=find_tune(folder, param),
            airspeed=airspeed,
            altitude=altitude,
            origin_elevation=origin_elevation,
        )
    except AircraftLost as loss:
        typer.echo(f"lost: {loss}", err=True)
        raise typer.Exit(LOST) from None


class _Commands(CommandGroup):
    functions = {
        "run": run,
        "view": view,
        "shot": shot,
        "validate": validate,
        "check": check,
        "list": list_all,
        "schema": schema,
        "respond": respond,
        "compare": compare,
        "sweep": sweep,
        "tune": tune,
        "study-report": study_report,
        "import": import_flight,
        "report": report,
        "recover": recover,
        "export": export,
        "trim": trim,
        "linearize": linearize,
        "step": step,
        "air": air,
        "network": network,
    }
    epilogs = dict.fromkeys(("run", "view", "shot", "check", "compare", "sweep", "tune"), EXITS)


app = typer.Typer(
    name="testbed",
    cls=_Commands,
    help="Fly formations of fixed-wing aircraft: JSBSim behind virtual ArduPlane autopilots.",
    epilog=EXITS,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=MARKUP,
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"testbed {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_version, is_eager=True),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; every ending has its exit code."""
    thresholds = gc.get_threshold()
    # what is loaded stays: to look for garbage in it over and over is a tenth of a run's start
    gc.set_threshold(100_000, 20, 50)
    try:
        with remembering():
            app()
    except InputError as error:
        for line in (f"error: {error}", *getattr(error, "__notes__", ())):
            typer.echo(line, err=True)
        sys.exit(PARTNER_LOST if isinstance(error, PartnerLost) else BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception:
        traceback.print_exc()
        typer.echo("internal error: this is a fault of testbed, not of your input", err=True)
        sys.exit(INTERNAL_ERROR)
    finally:
        gc.set_threshold(*thresholds)
