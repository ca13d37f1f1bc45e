"""What `testbed report` writes and says."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from testbed.outputs import size_of
from testbed.report import read_flight, write_figures, write_page
from testbed.report_outputs import NAME, figure_ending, writing


def report_and_show(
    run: str, *, out: Path | None, figures: Path | None, ending: str | None
) -> None:
    """Read a run and write its page, and its figures where they were asked for.

    Raises:
        InputError: there is no such run, an option cannot be used, or a file not be written.
    """
    ending = figure_ending(out=out, figures=figures, ending=ending)
    flight = read_flight(run)
    page = out or flight.path.with_name(NAME)
    with writing(page):
        write_page(flight, page)
        files = write_figures(flight, figures, ending) if figures else []
    console = Console(highlight=False)
    console.print(f" page     {page}, {size_of(page)}", soft_wrap=True)
    if figures:
        console.print(f" figures  {len(files)} in {figures}, {size_of(*files)}", soft_wrap=True)
