"""A group of commands that builds the options of a command only when it is called."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

import typer
from typer.core import TyperCommand, TyperGroup

MARKUP: Final = "rich"


def help_text(function: Callable[..., None]) -> str:
    """Read a command's docstring, each paragraph as one line, to be wrapped to the terminal."""
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


class CommandGroup(TyperGroup):
    """All commands by name; `testbed --help` lists them without building their options."""

    functions: ClassVar[Mapping[str, Callable[..., None]]]
    epilogs: ClassVar[Mapping[str, str]]  # by command; optional

    def __init__(self, **options: Any) -> None:  # noqa: ANN401
        """List the commands with their help texts, without options."""
        super().__init__(**options)
        self.commands = {
            name: TyperCommand(name, help=help_text(function), rich_markup_mode=MARKUP)
            for name, function in self.functions.items()
        }

    def resolve_command(self, *args: Any) -> tuple[Any, Any, list[str]]:  # noqa: ANN401
        """Find the command that is called and build its options; see typer."""
        name, _, rest = super().resolve_command(*args)
        assert name is not None
        return name, self.full_command(name), rest

    def full_command(self, name: str) -> Any:  # noqa: ANN401 - typer's own copy of click
        """Build a command with its options."""
        app = typer.Typer(add_completion=False, rich_markup_mode=MARKUP)
        function, epilog = self.functions[name], self.epilogs.get(name)
        app.command(name, help=help_text(function), epilog=epilog)(function)
        return typer.main.get_command(app)
