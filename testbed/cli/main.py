"""The command line: its commands, and the exit code of every ending."""

from __future__ import annotations

import inspect
import math
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Annotated, Any, Final, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from testbed.cli.exit_codes import EXIT_CODES_HELP, ExitCode
from testbed.cli.output import guard_standard_streams
from testbed.core.errors import ExternalProgramLost, InputError, escape_controls, memory_shortage
from testbed.core.interrupts import count_signals
from testbed.core.numbers import parse_number
from testbed.core.version import __version__

MARKUP: Final = "rich"

# Commands by panel of `testbed --help`, each with its module in this package.
PANELS: Final[Mapping[str, Mapping[str, str]]] = {
    "Fly": {
        "demo": "demo",
        "run": "run",
        "validate": "validate",
        "list": "scenario",
        "law": "law",
        "assess": "assess",
        "margins": "margins",
        "delay": "delay",
        "frequency-response": "frequency_response",
        "network": "network",
        "link": "link",
        "companion": "companion",
        "air": "air",
        "schema": "validate",
    },
    "Look": {
        "view": "view",
        "shot": "view",
        "video": "video",
        "report": "report",
        "compare": "compare",
        "export": "export",
        "recover": "export",
        "prune": "runs",
    },
    "Study": {
        "sweep": "sweep",
        "study-report": "study_report",
        "tune": "tune",
        "benchmark": "benchmark",
    },
    "Aircraft": {
        "new": "new",
        "trim": "inspect",
        "linearize": "inspect",
        "step": "inspect",
        "respond": "respond",
        "import": "flight_logs",
        "import-formation": "flight_logs",
        "arduplane": "arduplane",
        "fmu": "fmu",
    },
    "CI": {"check": "check"},
}
# Commands that are groups of others: "new" of "new aircraft", of the same module.
_GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "new": ("new aircraft", "new law", "new study"),
    "benchmark": ("benchmark fly", "benchmark verify", "benchmark table"),
}
# Commands of groups that are meant where the first word is none of the group.
_DEFAULTS: Final = {"benchmark": "fly"}
_MODULES: Final = {
    name: f"testbed.cli.{module}"
    for panel in PANELS.values()
    for command, module in panel.items()
    for name in (command, *_GROUPS.get(command, ()))
}
# Names of a command's parameters, by command and panel of its help.
_OPTION_PANELS: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "run": {
        "Scenario": ("overrides", "seed", "duration"),
        "Output": ("out", "json", "quiet"),
        "View": ("view", "host", "follow", "rrd"),
    }
}
_WITH_EXIT_CODES: Final = (
    "demo", "run", "assess", "view", "shot", "check", "compare", "sweep", "tune", "respond",
    "arduplane", "link", "companion",
)  # fmt: skip


def _function_name(command: str) -> str:
    return f"{re.sub('[- ]', '_', command)}_command"


@cache
def _code(module: str) -> CodeType:
    """Return the code of a module, from its bytecode file, without running it."""
    spec = find_spec(module)
    assert spec is not None
    loader: Any = spec.loader  # importlib.abc has its type, and takes long to import
    code: CodeType = loader.get_code(module)
    return code


def help_text(command: str) -> str:
    """Return a command's docstring, each paragraph as one line, to be wrapped to the terminal.

    It is read from the code of the module: to run all modules would add a sixth to the time of
    `testbed --help`.
    """
    name = _function_name(command)
    functions = (each for each in _code(_MODULES[command]).co_consts if hasattr(each, "co_name"))
    docstring = next(each.co_consts[0] for each in functions if each.co_name == name)
    text = docstring if isinstance(docstring, str) else ""  # with -OO there are no docstrings
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _import_help_printer() -> None:
    """Import what typer prints help with, without rich's Markdown and tracebacks.

    These take a quarter of the time of `testbed --help`, and neither is used: the markup is rich's
    own, and `main` prints tracebacks.
    """
    unused = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}
    missing = [name for name in unused if name not in sys.modules]
    for name in missing:
        sys.modules[name] = placeholder = ModuleType(name)
        setattr(placeholder, unused[name], type(unused[name], (), {}))
    try:
        import_module("typer.rich_utils")
    finally:
        for name in missing:
            del sys.modules[name]


class _Help:
    """What the help of all commands and of their group have in common."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Print the help; see typer."""
        _import_help_printer()
        super().format_help(ctx, formatter)  # type: ignore[misc]  # typer's

    def get_params(self, ctx: Any) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Return the parameters without the types of flags, which take no value."""
        parameters = super().get_params(ctx)  # type: ignore[misc]  # typer's
        for each in parameters:
            if isinstance(each, TyperOption) and each.is_flag:
                each.metavar = ""
        return parameters


class UnexpectedEndError(Exception):
    """A defect: a file ended early, which is no Ctrl-D at a prompt, as typer takes it for."""


class _Command(_Help, TyperCommand):
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

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Run the command; see typer.

        Raises:
            UnexpectedEndError: in place of EOFError.
        """
        try:
            return super().invoke(ctx)
        except EOFError as error:
            raise UnexpectedEndError(str(error)) from error


class _Subcommands(_Help, TyperGroup):
    """The commands of a group."""

    default = ""  # command that is meant where none is named

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Write the command that is meant; see typer."""
        if self.default and args and args[0] not in (*self.commands, "--help"):
            args = [self.default, *args]
        return super().parse_args(ctx, args)


class CommandGroup(_Help, TyperGroup):
    """All commands by name; `testbed --help` lists them without importing their modules."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401
        """List the commands with their help texts, without options."""
        super().__init__(**options)
        self.commands = {
            name: TyperCommand(
                name, help=help_text(name), rich_markup_mode=MARKUP, rich_help_panel=panel
            )
            for panel, modules in PANELS.items()
            for name in modules
        }

    def resolve_command(self, *args: Any) -> tuple[Any, Any, list[str]]:  # noqa: ANN401
        """Find the command that is called and build its options; see typer."""
        name, _, rest = super().resolve_command(*args)
        assert name is not None
        return name, self.full_command(name), rest

    def full_commands(self) -> Iterator[tuple[str, Any]]:
        """Yield all commands with their whole names, those of a group in place of it."""
        for name in self.commands:
            for each in _GROUPS.get(name, (name,)):
                yield each, self.full_command(each)

    def full_command(self, name: str) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Import a command and build its options, or a group and its commands."""
        if name in _GROUPS:
            group = _Subcommands(
                name=name,
                help=help_text(name),
                no_args_is_help=True,
                rich_markup_mode=MARKUP,
            )
            group.default = _DEFAULTS.get(name, "")
            for each in _GROUPS[name]:
                member = self.full_command(each)
                member.name = each.removeprefix(f"{name} ")
                group.add_command(member)
            return group
        app = typer.Typer(add_completion=False, rich_markup_mode=MARKUP)
        module = import_module(_MODULES[name])
        function = getattr(module, _function_name(name))
        epilog = EXIT_CODES_HELP if name in _WITH_EXIT_CODES else None
        app.command(name, cls=_Command, help=help_text(name), epilog=epilog)(function)
        command: Any = typer.main.get_command(app)
        command.optional_values = getattr(module, "OPTIONAL_VALUES", {})
        command.number_options = _number_options(function, command.params)
        panels = _OPTION_PANELS.get(name, {})
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


app = typer.Typer(
    name="testbed",
    cls=CommandGroup,
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


_show_with_place = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *place: Any) -> None:  # noqa: ANN401
    """Print a warning about the input as a line, without the line of code that gave it."""
    if category is UserWarning:
        typer.echo(f"warning: {escape_controls(str(message))}", err=True)
    else:
        _show_with_place(message, category, *place)


def main() -> None:
    """Run the command line and exit with the code of its ending."""
    guard_standard_streams()
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    try:
        with count_signals():
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
