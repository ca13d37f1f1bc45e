"""Write the reference of the command line from the text of `--help`."""

from __future__ import annotations

import re
from typing import Any

import typer

from testbed.cli.exit_codes import EXIT_CODES_HELP
from testbed.cli.main import app


def markdown() -> str:
    """Return a section for each command, in the order of `testbed --help`."""
    group: Any = typer.main.get_command(app)
    parts = [f"{EXIT_CODES_HELP}\n"]
    for name, command in group.full_commands():
        parts += [f"## testbed {name}\n", f"```text\n{usage(name, command)}\n```\n"]
        parts += [f"{plain(command.help)}\n", table(command)]
    return "\n".join(parts)


def usage(name: str, command: Any) -> str:  # noqa: ANN401 - typer's own copy of click
    """Return the usage line of a command."""
    context = typer.Context(command, info_name=f"testbed {name}")
    return " ".join((f"testbed {name}", *command.collect_usage_pieces(context)))


def table(command: Any) -> str:  # noqa: ANN401
    """Return a table of arguments and options with default and description."""
    rows = [
        f"| {names(each)} | {cell(default(each))} | {cell(plain(each.help or ''))} |"
        for each in command.params
        if each.name != "help"
    ]
    return "\n".join(("| | default | what it is |", "|---|---|---|", *rows, "")) if rows else ""


def names(parameter: Any) -> str:  # noqa: ANN401
    """Return how a parameter is written."""
    if parameter.param_type_name == "argument":
        return f"`{parameter.metavar or parameter.name.upper()}`"
    written = "/".join((*parameter.opts, *parameter.secondary_opts))
    takes = "" if parameter.is_flag else f" {parameter.metavar or 'VALUE'}"
    return f"`{written}{takes}`"


def default(parameter: Any) -> str:  # noqa: ANN401
    """Return the default of a parameter: as in its help, or its value."""
    if stated := re.search(r"\[default: (.*?)\]", parameter.help or ""):
        return stated[1]
    value = parameter.default
    unset = value is None or value is ... or callable(value) or isinstance(value, bool)
    return "" if unset or parameter.required else f"`{value}`"


def plain(text: str) -> str:
    """Return help without terminal escapes and without the default, which has a column."""
    unescaped = text.replace("\\[", "[")
    return re.sub(r"\s*\[default: .*?\]", "", unescaped).strip()


def cell(text: str) -> str:
    """Return text escaped for a table cell."""
    return " ".join(text.split()).replace("|", "\\|")
