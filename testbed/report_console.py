"""What `testbed report` writes and says."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from testbed.errors import InputError
from testbed.outputs import refuse_files, size_of
from testbed.report import read_flight, write_figures, write_page
from testbed.report.page import FORMATS

NAME = "report.html"


def report_and_show(
    run: str, *, out: Path | None, figures: Path | None, ending: str | None
) -> None:
    """Read a run and write its page, and its figures where they were asked for."""
    refuse_files(out=out)
    if out and out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {out}: write a name that ends in .html")
    if ending and not figures:
        raise InputError(f"--format {ending}: is that of --figures DIR; write a folder for them")
    ending = (ending or FORMATS[0]).lower().removeprefix(".")
    if ending not in FORMATS:
        raise InputError(f"--format {ending}: write one of {', '.join(FORMATS)}")
    flight = read_flight(run)
    page = out or flight.path.with_name(NAME)
    try:
        write_page(flight, page)
        files = write_figures(flight, figures, ending) if figures else []
    except OSError as error:
        raise InputError(
            f"{error.filename or page}: cannot be written: {error.strerror}"
        ) from error
    console = Console(highlight=False)
    console.print(f" page     {page}, {size_of(page)}", soft_wrap=True)
    if figures:
        console.print(f" figures  {len(files)} in {figures}, {size_of(*files)}", soft_wrap=True)
