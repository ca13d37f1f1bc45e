"""The commands as a group that looks at their options only when one is called."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, ClassVar, Final

import typer
from typer.core import TyperCommand, TyperGroup

from testbed.standing_in import standing_in

MARKUP: Final = "rich"


class Command(TyperCommand):
    """One command, with its options."""

    def format_help(self, *told: Any) -> None:  # noqa: ANN401 - typer's own
        """See typer."""
        _load_drawing()
        super().format_help(*told)


class CommandGroup(TyperGroup):
    """All commands by name: to be listed they need no options, and to be called no others'."""

    functions: ClassVar[Mapping[str, Callable[..., None]]]
    epilogs: ClassVar[Mapping[str, str]]  # of those that have one

    def __init__(self, **told: Any) -> None:  # noqa: ANN401
        """Name the commands."""
        super().__init__(**told)
        self.commands = {
            name: TyperCommand(name, help=inspect.getdoc(function), rich_markup_mode=MARKUP)
            for name, function in self.functions.items()
        }

    def resolve_command(self, *told: Any) -> tuple[Any, Any, list[str]]:  # noqa: ANN401
        """See typer."""
        name, _, rest = super().resolve_command(*told)
        assert name is not None
        return name, self.whole(name), rest

    def whole(self, name: str) -> Any:  # noqa: ANN401 - typer's own copy of click
        """A command with its options."""
        alone = typer.Typer(add_completion=False, rich_markup_mode=MARKUP)
        alone.command(name, cls=Command, epilog=self.epilogs.get(name))(self.functions[name])
        return typer.main.get_command(alone)

    def format_help(self, *told: Any) -> None:  # noqa: ANN401
        """See typer."""
        _load_drawing()
        super().format_help(*told)


def _load_drawing() -> None:
    """What typer draws help with, without what Markdown and pretty tracebacks would need."""
    with standing_in("rich.markdown", "rich.traceback"):
        import_module("typer.rich_utils")
