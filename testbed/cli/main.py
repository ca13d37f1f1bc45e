"""The command line: its commands, and the exit code of every ending."""

from __future__ import annotations

import gc
import inspect
import math
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, TypeVar, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from testbed import __version__
from testbed.cli.air import air_command
from testbed.cli.arduplane import arduplane_command
from testbed.cli.check import check_command
from testbed.cli.compare import compare_command
from testbed.cli.exit_codes import EXIT_CODES_HELP, ExitCode
from testbed.cli.export import export_command, import_command, recover_command
from testbed.cli.inspect import linearize_command, respond_command, step_command, trim_command
from testbed.cli.law import law_command
from testbed.cli.margins import margins_command
from testbed.cli.network import network_command
from testbed.cli.output import guard_standard_streams
from testbed.cli.report import report_command
from testbed.cli.run import ViewChoice, run_command
from testbed.cli.runs import prune_command
from testbed.cli.scenario import list_command, schema_command, validate_command
from testbed.cli.study_report import study_report_command
from testbed.cli.sweep import sweep_command
from testbed.cli.tune import tune_command
from testbed.cli.video import video_command
from testbed.cli.view import shot_command, view_command
from testbed.core.errors import ExternalProgramLost, InputError, memory_shortage
from testbed.core.interrupts import count_sigint
from testbed.core.numbers import parse_number

MARKUP: Final = "rich"
_Parameters = TypeVar("_Parameters", bound=list[Any])


def help_text(function: Callable[..., None]) -> str:
    """Read a command's docstring, each paragraph as one line, to be wrapped to the terminal."""
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _without_flag_types(parameters: _Parameters) -> _Parameters:
    """Leave out the type of flags in the help: they take no value."""
    for each in parameters:
        if isinstance(each, TyperOption) and each.is_flag:
            each.metavar = ""
    return parameters


class _Command(TyperCommand):
    # Options that may stand without a value: their values, the first of which is meant then.
    optional_values: Mapping[str, tuple[str, ...]] = {}  # noqa: RUF012
    number_options: frozenset[str] = frozenset()  # options whose value is a number

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Write the values of options that stand without one, check numbers; see typer.

        Raises:
            InputError: the value of an option that takes a number is not one.
        """
        written: list[str] = []
        for k, each in enumerate(args):
            following = args[k + 1] if k + 1 < len(args) else ""
            option, joined, text = each.partition("=")
            if (
                option in self.number_options
                and "--" not in args[:k]
                and (joined or k + 1 < len(args))
            ):
                _refuse_strange_number(option, text if joined else following)
            values = () if "--" in args[:k] else self.optional_values.get(each, ())
            implied = values[:1] if values and following not in values else ()
            if each == "--json" and (not following or following.startswith("--")):
                implied = ("-",)
            written += [each, *implied]
        return super().parse_args(ctx, written)

    def get_params(self, ctx: Any) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Return the parameters, with that of --help."""
        return _without_flag_types(super().get_params(ctx))


class CommandGroup(TyperGroup):
    """All commands by name; `testbed --help` lists them without building their options."""

    panels: ClassVar[Mapping[str, Mapping[str, Callable[..., None]]]]  # commands by panel
    epilogs: ClassVar[Mapping[str, str]]  # by command; optional
    # Names of a command's parameters, by command and panel of its help; optional.
    option_panels: ClassVar[Mapping[str, Mapping[str, tuple[str, ...]]]]
    # Options of a command that may stand without a value, and their values; optional.
    optional_values: ClassVar[Mapping[str, Mapping[str, tuple[str, ...]]]]
    functions: ClassVar[Mapping[str, Callable[..., None]]]  # all commands

    def __init_subclass__(cls) -> None:
        """Join the panels."""
        cls.functions = {n: each for panel in cls.panels.values() for n, each in panel.items()}

    def __init__(self, **options: Any) -> None:  # noqa: ANN401
        """List the commands with their help texts, without options."""
        super().__init__(**options)
        self.commands = {
            name: TyperCommand(
                name, help=help_text(function), rich_markup_mode=MARKUP, rich_help_panel=panel
            )
            for panel, functions in self.panels.items()
            for name, function in functions.items()
        }

    def get_params(self, ctx: Any) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Return the parameters of the group itself."""
        return _without_flag_types(super().get_params(ctx))

    def resolve_command(self, *args: Any) -> tuple[Any, Any, list[str]]:  # noqa: ANN401
        """Find the command that is called and build its options; see typer."""
        name, _, rest = super().resolve_command(*args)
        assert name is not None
        return name, self.full_command(name), rest

    def full_command(self, name: str) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Build a command with its options."""
        app = typer.Typer(add_completion=False, rich_markup_mode=MARKUP)
        function, epilog = self.functions[name], self.epilogs.get(name)
        app.command(name, cls=_Command, help=help_text(function), epilog=epilog)(function)
        command: Any = typer.main.get_command(app)
        command.optional_values = self.optional_values.get(name, {})
        command.number_options = _number_options(function, command.params)
        panels = self.option_panels.get(name, {})
        by_parameter = {each: panel for panel, names in panels.items() for each in names}
        for parameter in command.params:
            if parameter.name in by_parameter:
                parameter.rich_help_panel = by_parameter[parameter.name]
        return command


def _refuse_strange_number(option: str, text: str) -> None:
    """Refuse 1_0 and digits of other scripts, which typer reads; commands check the range."""
    try:
        value = float(text)
    except ValueError:
        return  # typer has a message
    if math.isfinite(value) and parse_number(text.strip(" ")) is None:
        raise InputError(f"{option} {text[:40]}: write a number such as 10 or 0.5")


def _number_options(function: Callable[..., None], parameters: list[Any]) -> frozenset[str]:
    """Return the options of a command that take a number, such as --airspeed."""
    kinds = get_type_hints(function)
    numbers = {name for name, kind in kinds.items() if {float, int} & {kind, *get_args(kind)}}
    options = (each.opts for each in parameters if each.name in numbers)
    return frozenset(option for each in options for option in each)


class _Commands(CommandGroup):
    panels = {
        "Fly": {
            "run": run_command,
            "validate": validate_command,
            "list": list_command,
            "law": law_command,
            "margins": margins_command,
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
    optional_values = {"run": {"--view": tuple(ViewChoice)}}
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
    except Exception as error:
        if shortage := memory_shortage(error):
            typer.echo(f"error: {shortage}", err=True)
            sys.exit(ExitCode.BAD_INPUT)
        traceback.print_exc()
        typer.echo("internal error: this is a defect of testbed, not of your input", err=True)
        sys.exit(ExitCode.INTERNAL_ERROR)
    finally:
        gc.set_threshold(*thresholds)
