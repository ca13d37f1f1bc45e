"""The command line: its commands, and the exit code of every ending."""

from __future__ import annotations

import gc
import os
import sys
import traceback
from typing import Annotated

import typer

from testbed import __version__
from testbed.cli.air import air_command
from testbed.cli.arduplane import arduplane_command
from testbed.cli.check import check_command
from testbed.cli.command_group import MARKUP, CommandGroup
from testbed.cli.compare import compare_command
from testbed.cli.exit_codes import EXIT_CODES_HELP, ExitCode
from testbed.cli.export import export_command
from testbed.cli.import_flight import import_command
from testbed.cli.inspect import linearize_command, respond_command, step_command, trim_command
from testbed.cli.law import law_command
from testbed.cli.network import network_command
from testbed.cli.output import guard_standard_streams
from testbed.cli.recover import recover_command
from testbed.cli.report import report_command
from testbed.cli.run import View, run_command
from testbed.cli.runs import prune_command
from testbed.cli.scenario import list_command, schema_command, validate_command
from testbed.cli.study_report import study_report_command
from testbed.cli.sweep import sweep_command
from testbed.cli.tune import tune_command
from testbed.cli.video import video_command
from testbed.cli.view import shot_command, view_command
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.interrupts import count_sigint


class _Commands(CommandGroup):
    panels = {
        "Fly": {
            "run": run_command,
            "validate": validate_command,
            "list": list_command,
            "law": law_command,
            "network": network_command,
            "air": air_command,
            "schema": schema_command,
        },
        "Look": {
            "view": view_command,
            "shot": shot_command,
            "video": video_command,
            "report": report_command,
            "compare": compare_command,
            "export": export_command,
            "recover": recover_command,
            "prune": prune_command,
        },
        "Study": {
            "sweep": sweep_command,
            "study-report": study_report_command,
            "tune": tune_command,
        },
        "Aircraft": {
            "trim": trim_command,
            "linearize": linearize_command,
            "step": step_command,
            "respond": respond_command,
            "import": import_command,
            "arduplane": arduplane_command,
        },
        "CI": {
            "check": check_command,
        },
    }
    option_panels = {
        "run": {
            "Scenario": ("overrides", "seed", "duration"),
            "Output": ("out", "json", "quiet"),
            "View": ("view", "host", "follow", "rrd"),
        }
    }
    optional_values = {"run": {"--view": tuple(View)}}
    epilogs = dict.fromkeys(
        ("run", "view", "shot", "check", "compare", "sweep", "tune", "respond", "arduplane"),
        EXIT_CODES_HELP,
    )


app = typer.Typer(
    name="testbed",
    cls=_Commands,
    help="Simulate formations of fixed-wing aircraft: JSBSim flight models with ArduPlane "
    "autopilots, communication and wind.",
    epilog=EXIT_CODES_HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=MARKUP,
)


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"testbed {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(
            f"the current directory cannot be used: {error.strerror}; change to another"
        ) from None


def main() -> None:
    """Run the command line and exit with the code of its ending."""
    thresholds = gc.get_threshold()
    # imported modules are never garbage: collecting less often saves a tenth of a run's start
    gc.set_threshold(100_000, 20, 50)
    guard_standard_streams()
    try:
        with count_sigint():
            try:
                app()
            finally:
                sys.stdout.flush()
    except InputError as error:
        for line in (f"error: {error}", *getattr(error, "__notes__", ())):
            typer.echo(line, err=True)
        lost = isinstance(error, ExternalProgramLost)
        sys.exit(ExitCode.EXTERNAL_PROGRAM_LOST if lost else ExitCode.BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(ExitCode.INTERRUPTED)
    except Exception:
        traceback.print_exc()
        typer.echo("internal error: this is a defect of testbed, not of your input", err=True)
        sys.exit(ExitCode.INTERNAL_ERROR)
    finally:
        gc.set_threshold(*thresholds)
