"""The command report, and the options and output that study-report shares with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import RunName, finite_option, output_option, value_option
from testbed.cli.output import (
    PipeSafeConsole,
    check_output_folder,
    describe_file,
    format_size,
    result_console,
)
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file

if TYPE_CHECKING:
    from testbed.reports.figure_spec import Figure
    from testbed.reports.html import Page

REPORT_NAME = "report.html"


ReportFile = Annotated[
    Path | None,
    output_option(
        metavar="FILE.html",
        help="The report.  \\[default: report.html beside the log or the study's file]",
        suffixes=(".html", ".htm"),
    ),
]
Figures = Annotated[
    Path | None,
    value_option(
        "DIR", "Also write every figure as a file to this folder.", check=check_output_folder
    ),
]
FigureFormat = Annotated[
    str | None, value_option("png|pdf|svg", "Format of these files.  \\[default: png]")
]


@draws_figures("figures")
def report_command(
    run: RunName,
    out: ReportFile = None,
    begin: Annotated[
        float | None, finite_option("S", "Draw nothing earlier in figures.", "--from")
    ] = None,
    end: Annotated[
        float | None, finite_option("S", "Draw nothing later in figures.", "--to")
    ] = None,
    figures: Figures = None,
    format: FigureFormat = None,
    latex: Annotated[
        Path | None,
        output_option(
            metavar="FILE.tex",
            help="Also write the errors over the windows, beside published ones, as a LaTeX table.",
            suffixes=(".tex",),
        ),
    ] = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Write a report of a run: figures, tables and everything needed to repeat the run.

    The report is one HTML file that needs only a browser, and can be printed.
    """
    from testbed.reports import read_run, run_figures, run_page
    from testbed.reports.latex import run_latex

    ending = figure_format(format, figures)
    if begin is not None and end is not None and begin >= end:
        raise InputError(f"--from {begin:g}: not before --to {end:g}; write an earlier time")
    data = read_run(run, begin_s=begin, end_s=end)
    report = default_report(data.path) if out is None else out
    drawn = list(run_figures(data)) if figures else []
    check_figures(drawn, figures, ending, look)
    table = run_latex(data) if latex else ""
    console = result_console()
    write_report(run_page(data), report, console, default=out is None)
    if figures:
        write_figures(drawn, figures, ending, console, look)
    if latex:
        write_latex(table, latex, console)


def default_report(path: Path) -> Path:
    """Return the path of the report beside a log or a study's file.

    Raises:
        InputError: another file is there.
    """
    from testbed.logs.file_record import check_default_output

    return check_default_output(path.with_name(REPORT_NAME), "write --out FILE.html")


def write_report(page: Page, path: Path, console: PipeSafeConsole, *, default: bool) -> None:
    """Write the page of a report, and print its file and size.

    Args:
        page: the report.
        path: of its file.
        console: for results.
        default: no option names the path.

    Raises:
        InputError: it cannot be written.
    """
    from testbed.logs.file_record import record_output
    from testbed.reports import write_page

    with report_write_errors(str(path)):
        write_page(page, path)
    record_output(path, default=default)
    console.write_line(f" report   {describe_file(path)}")


def check_figures(
    figures: Sequence[Figure], folder: Path | None, ending: str, look: FigureLook
) -> None:
    """Check that figures can be written to the folder of --figures; None: there is no such option.

    Raises:
        InputError: a file of the user has the name of one of them, or a label is of nothing in
            them.
    """
    from testbed.logs.file_record import check_folder_output
    from testbed.reports import figure_file

    if folder:
        look.style([each.grid for each in figures])
        names = (figure_file(each, ending) for each in figures)
        check_folder_output(folder, names, f"--figures {folder}")


def write_figures(
    figures: Sequence[Figure],
    folder: Path,
    ending: str,
    console: PipeSafeConsole,
    look: FigureLook,
) -> None:
    """Write figures as files, and print their folder and size; see `save_figures`.

    Raises:
        InputError: a file cannot be written.
    """
    from testbed.logs.file_record import record_folder_output
    from testbed.reports import save_figures

    style = look.style([each.grid for each in figures])
    with report_write_errors(f"--figures {folder}"):
        files = save_figures(figures, folder, ending, style)
    record_folder_output(folder, [each.name for each in files])
    console.write_line(f" figures  {len(files)} in {folder}, {format_size(*files)}")


def write_latex(table: str, path: Path, console: PipeSafeConsole) -> None:
    """Write the table of --latex, and print its file and size.

    Raises:
        InputError: it cannot be written.
    """
    with report_write_errors(f"--latex {path}"), write_text_file(path) as file:
        file.write(table)
    console.write_line(f" LaTeX    {describe_file(path)}")


def figure_format(name: str | None, figures: Path | None) -> str:
    """Check --format and return the file ending of figures.

    Raises:
        InputError: there is no such format, or --figures is missing.
    """
    from testbed.reports.html import FORMATS

    if name and not figures:
        raise InputError(f"--format {name}: is the format of --figures DIR; write a folder too")
    ending = (name or FORMATS[0]).lower().removeprefix(".")
    if ending not in FORMATS:
        raise InputError(f"--format {name}: write one of {', '.join(FORMATS)}")
    return ending
