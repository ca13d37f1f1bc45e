"""Output of commands: consoles, files and JSON, where `-` is standard output."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.core.errors import InputError

MISSING = "–"  # in a cell without a number


class PipeSafeConsole(Console):
    """Console that ignores a closed pipe, such as that of `head`."""

    def on_broken_pipe(self) -> None:
        """Discard the rest; rich would exit with 1, the code of a lost aircraft."""
        self.quiet = True
        with open(os.devnull, "w") as null:
            os.dup2(null.fileno(), self.file.fileno())

    def write_line(self, text: str | Text = "", style: str = "") -> None:
        """Print one line as it is, without markup and without wrapping."""
        self.print(Text(text, style) if isinstance(text, str) else text, soft_wrap=True)


def result_console(json: Path | None = None) -> PipeSafeConsole:
    """Console for results: standard error where standard output gets JSON."""
    return PipeSafeConsole(stderr=is_stdout(json), highlight=False)


def message_console() -> PipeSafeConsole:
    """Console for messages and progress: standard error."""
    return PipeSafeConsole(stderr=True, highlight=False)


def ruled_table() -> Table:
    """Make a table whose only line is below its header."""
    return Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")


def is_stdout(path: Path | None) -> bool:
    """Whether an option asks for standard output."""
    return str(path) == "-"


def check_output_path(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
    """Check that an option names a file in an existing folder; a typer callback.

    Raises:
        InputError: the folder does not exist, or the path is a folder.
    """
    if path is None or is_stdout(path):
        return path
    name = parameter.opts[0]
    option = f"{name} {path}" if name.startswith("-") else str(path)
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{option}: there is no folder {folder}")
    if path.is_dir():
        raise InputError(f"{option}: this is a folder; write the name of a file")
    return path


@contextmanager
def report_write_errors(target: str) -> Iterator[None]:
    """Turn an OSError in the block into an InputError.

    Args:
        target: the option and its path, or the path, as the message begins.

    Raises:
        InputError: a file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error


def describe_file(path: Path, content: str = "") -> str:
    """Describe a written file: path, size and content."""
    return f"{path}: {', '.join(filter(None, [format_size(path), content]))}"


def format_size(*paths: Path) -> str:
    """Format the total size of files."""
    size = float(sum(path.stat().st_size for path in paths))
    if size < 999.5:
        return f"{size:.0f} bytes"
    unit = "kB" if size < 999_500.0 else "MB"
    size /= 1e3 if unit == "kB" else 1e6
    return f"{size:.1f} {unit}" if size < 9.95 else f"{size:,.0f} {unit}"


def write_json_output(path: Path | None, document: Mapping[str, Any]) -> None:
    """Write a document to the file of --json, or to standard output for `-`.

    Raises:
        InputError: the file cannot be written.
    """
    from testbed.metrics.document import to_json, write_json

    if is_stdout(path):
        sys.stdout.write(to_json(document))
    elif path:
        write_json(path, document)
