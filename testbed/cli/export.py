"""The command that writes runs in other formats: export."""

from __future__ import annotations

import os
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import RunName, output_option
from testbed.cli.output import describe_file, is_stdout, message_console, open_output
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.logs.flight_data import FlightData


class Format(StrEnum):
    """Formats of an export."""

    CSV = "csv"
    PARQUET = "parquet"
    NPZ = "npz"
    FOXGLOVE = "foxglove"
    PLOTJUGGLER = "plotjuggler"


SUFFIXES = {
    Format.CSV: ".csv",
    Format.PARQUET: ".parquet",
    Format.NPZ: ".npz",
    Format.FOXGLOVE: ".foxglove.json",
    Format.PLOTJUGGLER: ".plotjuggler.xml",
}


def export_command(
    run: RunName,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="csv, parquet: a table with a row per sample and aircraft. npz: NumPy arrays. "
            "foxglove, plotjuggler: a layout for this program, which opens the log itself.",
        ),
    ],
    out: Annotated[
        Path | None,
        output_option(
            help="File to write; - is stdout.  \\[default: run.FORMAT beside the log]",
        ),
    ] = None,
) -> None:
    """Write a run as a table or arrays, or write a layout for its log.

    Columns have the names of the log's topics and fields, with their units.
    """
    from testbed.logs.flight_data import FlightData
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    log = find_run(run)
    path = out or log.with_suffix(SUFFIXES[form])
    if path.resolve() == log.resolve():
        raise InputError(f"--out {path}: this is the log itself; write another name")
    flight = FlightData(read_log(log))
    write = _writer(form, flight, log, path)
    content = f"{flight.time_s.size} samples of {len(flight.names)} aircraft"
    if form in (Format.FOXGLOVE, Format.PLOTJUGGLER):
        content = f"layout for {log}"
    content += "" if flight.log.finished else " (the run was cut short)"
    messages = message_console()
    with open_output(path, "--out") as file:
        write(file)
    messages.write_line(describe_file(path, content))


def _writer(
    form: Format, flight: FlightData, log: Path, path: Path
) -> Callable[[IO[bytes]], object]:
    """Choose the function that writes a flight in this format."""
    from testbed.logs.arrow_io import write_csv, write_parquet
    from testbed.logs.flight_data import write_npz
    from testbed.views.foxglove_layout import foxglove_layout
    from testbed.views.plotjuggler_layout import plotjuggler_layout

    tables = {Format.CSV: write_csv, Format.PARQUET: write_parquet, Format.NPZ: write_npz}
    if form in tables:
        return lambda file: tables[form](flight, file)
    if form is Format.FOXGLOVE:
        text = foxglove_layout(flight.info)
    else:
        folder = Path() if is_stdout(path) else path.parent
        text = plotjuggler_layout(flight, os.path.relpath(log, folder))
    return lambda file: file.write(text.encode())
