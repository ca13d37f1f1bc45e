"""A group of commands that builds the options of a command only when it is called."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

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

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Write the values of options that stand without one; see typer."""
        written: list[str] = []
        for k, each in enumerate(args):
            following = args[k + 1] if k + 1 < len(args) else ""
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
        panels = self.option_panels.get(name, {})
        by_parameter = {each: panel for panel, names in panels.items() for each in names}
        for parameter in command.params:
            if parameter.name in by_parameter:
                parameter.rich_help_panel = by_parameter[parameter.name]
        return command
