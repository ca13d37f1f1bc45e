"""Output of commands: consoles, files and JSON, where `-` is standard output."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, TextIO

import typer
from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from testbed.core.errors import InputError, escape_controls
from testbed.core.files import (
    check_folder_writable,
    check_writable,
    format_bytes,
    report_write_errors,
    reserve_standard_descriptors,
    write_file,
)

if TYPE_CHECKING:
    from testbed.metrics.side_effects import SideEffects
    from testbed.studies.margin_changes import MarginChange

MISSING = "–"  # in a cell without a number


_closed: set[int] = set()  # standard descriptors that were closed when the program started


class _StandardDescriptor(io.FileIO):
    """Standard output or error; after an error its text is discarded.

    Raises:
        InputError: from `write`, of standard output whose reader has not just closed it.
    """

    def write(self, data: Any) -> int:  # noqa: ANN401 - any buffer
        try:
            return super().write(data)
        except OSError as error:
            # the buffers above are written again when the program ends
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())
            os.close(null)
            if isinstance(error, BrokenPipeError) or self.fileno() != 1:
                return len(memoryview(data).cast("B"))
            raise InputError(f"standard output: cannot be written: {error.strerror}") from error


def guard_standard_streams() -> None:
    """Make standard output and error writable: also closed, full or not Unicode.

    Errors of standard output become an InputError, those of standard error are ignored; a
    character that the encoding lacks becomes a question mark.
    """
    _closed.update(reserve_standard_descriptors())
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        stream: TextIO | None = getattr(sys, name)
        if stream is None or stream is getattr(sys, f"__{name}__"):
            raw = _StandardDescriptor(descriptor, "w", closefd=False)
            guarded = io.TextIOWrapper(
                io.BufferedWriter(raw),
                encoding=stream.encoding if stream else "utf-8",
                errors="backslashreplace" if name == "stderr" else "replace",
                line_buffering=name == "stderr" or raw.isatty(),
            )
            setattr(sys, name, guarded)


class PipeSafeConsole(Console):
    """Console of a command; `guard_standard_streams` handles a closed pipe, as that of `head`."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render, with control characters of texts escaped: they may come from a file."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(escape_controls(segment.text), segment.style)

    def write_line(self, text: str | Text = "", style: str = "") -> None:
        """Print one line as it is, without markup and without wrapping."""
        self.print(Text(text, style) if isinstance(text, str) else text, soft_wrap=True)

    def write_heading(self, name: str, rest: str) -> None:
        """Print a name in bold with what follows it, and an empty line."""
        self.write_line(Text.assemble(" ", (name, "bold"), rest))
        self.write_line()

    def print_table(self, table: Table) -> None:
        """Print a table at its own width: a narrower terminal breaks its lines, cutting nothing."""
        unlimited = self.options.update_width(10_000)
        table.width = self.measure(table, options=unlimited).maximum
        self.print(table, crop=False)


def result_console(json: Path | None = None) -> PipeSafeConsole:
    """Console for results: standard error where standard output gets JSON."""
    return PipeSafeConsole(stderr=is_stdout(json), highlight=False)


def message_console() -> PipeSafeConsole:
    """Console for messages and progress: standard error."""
    return PipeSafeConsole(stderr=True, highlight=False)


def ruled_table(*columns: str, left: Sequence[str] = ()) -> Table:
    """Make a table whose only line is below its header.

    The first column is bold on the left; the others, but for those in `left`, are on the right.
    """
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")
    for name in columns:
        first = name is columns[0]
        side: Literal["left", "right"] = "left" if first or name in left else "right"
        table.add_column(Text(name, "bold" if first else ""), justify=side, no_wrap=True)
    return table


def print_side_effects(
    console: PipeSafeConsole, found: SideEffects, title: str, names: tuple[str, str]
) -> None:
    """Print what got worse, if anything did or there are too few seeds to know.

    Args:
        console: of the results.
        found: what got worse.
        title: of the table, before what it is based on.
        names: headings of the flights before and after.
    """
    if not found:
        return
    console.write_line(f" {title}, {found.basis}", "bold yellow")
    if not found.worse:
        return
    table = Table(box=None, header_style="bold", pad_edge=False, style="yellow")
    table.add_column(" ")
    for heading in (*names, "difference"):
        table.add_column(heading, justify="right", no_wrap=True)
    for quantity, cells in ((each.quantity, each.cells) for each in found.worse):
        table.add_row(f" {quantity.label}", *cells)
    console.print_table(table)


def print_margin_changes(
    console: PipeSafeConsole, changes: Iterable[MarginChange], names: tuple[str, str]
) -> None:
    """Print which predicted margins got smaller, or why they are not predicted.

    Args:
        console: of the results.
        changes: at each bank.
        names: headings of the margins before and after.
    """
    for each in changes:
        if each.problem:
            console.write_line(f" margins {each.place} are not predicted: {each.problem}", "dim")
        print_side_effects(console, each.side_effects, f"smaller margins {each.place}", names)


def is_stdout(path: Path | None) -> bool:
    """Return whether an option asks for standard output."""
    return str(path) == "-"


def check_output_path(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
    """Check that the file of an option can be written; a typer callback.

    Raises:
        InputError: it cannot, as its folder does not exist or the path is a folder.
    """
    if path is not None and is_stdout(path):
        if 1 in _closed:
            raise InputError(f"{_with_option(parameter, path)}: standard output is closed")
    elif path is not None:
        with report_write_errors(_with_option(parameter, path)):
            check_writable(path)
    return path


def check_output_folder(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
    """Check that files can be written to the folder of an option; a typer callback.

    Raises:
        InputError: they cannot, and the folder cannot be created.
    """
    if path is not None:
        with report_write_errors(_with_option(parameter, path)):
            check_folder_writable(path)
    return path


def _with_option(parameter: typer.CallbackParam, path: Path) -> str:
    name = parameter.opts[0]
    return f"{name} {path}" if name.startswith("-") else str(path)


def describe_file(path: Path, content: str = "") -> str:
    """Describe a written file: path, size and content; a pipe or device has no size."""
    size = format_size(path) if path.is_file() else ""
    return ": ".join(filter(None, [str(path), ", ".join(filter(None, [size, content]))]))


def format_size(*paths: Path) -> str:
    """Format the total size of files."""
    return format_bytes(sum(path.stat().st_size for path in paths))


@contextmanager
def open_output(path: Path, option: str) -> Iterator[BinaryIO]:
    """Open an option's file, or standard output for `-`; written when the block ends.

    Raises:
        InputError: it cannot be written.
    """
    with report_write_errors("standard output" if is_stdout(path) else f"{option} {path}"):
        if not is_stdout(path):
            with write_file(path) as file:
                yield file
            return
        content = io.BytesIO()
        yield content
        sys.stdout.flush()
        with suppress(BrokenPipeError):  # the reader, such as `head`, has enough
            sys.stdout.buffer.write(content.getbuffer())
            sys.stdout.buffer.flush()


def write_json_output(path: Path | None, document: Mapping[str, Any]) -> None:
    """Write a document to the file of --json, or to standard output for `-`.

    Raises:
        InputError: the file cannot be written.
    """
    if path is not None:
        from testbed.metrics.document import to_json

        # a surrogate, as in the name of a file that is not UTF-8, becomes JSON's own escape of it
        data = to_json(document).encode("utf-8", "backslashreplace")
        with open_output(path, "--json") as file:
            file.write(data)


def find_folder(kind: str, name: str, out: Path | None, *, resume: bool, holds: str) -> Path:
    """Return the folder of work that can be resumed: a new one, or one that has a part of it.

    Args:
        kind: what it is, such as assessment; all are in `logs/assessments`.
        name: of what is done.
        out: of --out; None: the newest of this name, or a new one.
        resume: continue in a folder.
        holds: the folder in it that work in part has.

    Raises:
        InputError: it cannot be created, or there is none to resume.
    """
    from testbed.logs.run_directory import LOGS, create_run_directory, folder_name

    folders = LOGS / f"{kind}s"
    if not resume:
        return create_run_directory(name, out=out, logs=folders)
    if out is not None:
        if not out.is_dir():
            raise InputError(f"--out {out}: there is no such folder to resume (leave --resume out)")
        return out
    known = sorted((folders / folder_name(name)).glob(f"*/{holds}"))
    if not known:
        raise InputError(f"--resume: {folders} has no {kind} of {name} (leave --resume out)")
    return known[-1].parent
