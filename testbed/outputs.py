"""Where commands put what they were asked to write: files, or - for standard output."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from testbed.errors import InputError
from testbed.metrics.document import to_json, write_json


class Paper(Console):
    """A console whose reader may leave, as `head` does: nobody hears the rest, and nothing ends."""

    def on_broken_pipe(self) -> None:
        """Say the rest to nobody; rich would end the program as if an aircraft had been lost."""
        self.quiet = True
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), self.file.fileno())


def is_stdout(path: Path | None) -> bool:
    """Whether an option asks for standard output, so that all else belongs on standard error."""
    return str(path) == "-"


def refuse_files(**paths: Path | None) -> None:
    """Refuse options, by their names, whose files cannot be written; before work is done for them.

    Raises:
        InputError: there is no such folder, or the file is one.
    """
    for name, path in paths.items():
        if path is None or is_stdout(path):
            continue
        if not path.absolute().parent.is_dir():
            raise InputError(f"--{name} {path}: there is no folder {path.absolute().parent}")
        if path.is_dir():
            raise InputError(f"--{name} {path}: this is a folder; write the name of a file")


def said(path: Path, what: str = "") -> str:
    """A file that was written, in words: its name, its size, and what it is."""
    return f"{path}: {', '.join(filter(None, [size_of(path), what]))}"


def size_of(*paths: Path) -> str:
    """The size of files together, in words."""
    size = float(sum(path.stat().st_size for path in paths))
    if size < 999.5:
        return f"{size:.0f} bytes"
    unit = "kB" if size < 999_500.0 else "MB"
    size /= 1e3 if unit == "kB" else 1e6
    return f"{size:.1f} {unit}" if size < 9.95 else f"{size:,.0f} {unit}"


def put_json(path: Path | None, document: Mapping[str, Any]) -> None:
    """Write a document where it was asked for, if it was.

    Raises:
        InputError: it cannot be written there.
    """
    if is_stdout(path):
        sys.stdout.write(to_json(document))
    elif path:
        write_json(path, document)
