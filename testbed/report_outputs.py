"""What `testbed report` and `testbed study-report` share: where a page and its figures go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from testbed.errors import InputError
from testbed.outputs import refuse_files
from testbed.report.shell import FORMATS

NAME = "report.html"


def figure_ending(*, out: Path | None, figures: Path | None, ending: str | None) -> str:
    """One of `FORMATS`, as `--format` asks for it.

    Raises:
        InputError: this option, or `--out`, or `--figures` cannot be used.
    """
    refuse_files(out=out)
    if out and out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {out}: write a name that ends in .html")
    if ending and not figures:
        raise InputError(f"--format {ending}: is that of --figures DIR; write a folder for them")
    ending = (ending or FORMATS[0]).lower().removeprefix(".")
    if ending not in FORMATS:
        raise InputError(f"--format {ending}: write one of {', '.join(FORMATS)}")
    return ending


@contextmanager
def writing(page: Path) -> Iterator[None]:
    """Whatever cannot be written in the block, the page or a file that is named, is said.

    Raises:
        InputError: in place of OSError.
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{error.filename or page}: cannot be written: {error.strerror}"
        ) from error
