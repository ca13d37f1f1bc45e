"""What `testbed export` writes."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO

from testbed.errors import InputError
from testbed.export_commands import Format
from testbed.metrics.document import replacing
from testbed.outputs import is_stdout, refuse_files, said
from testbed.record.arrow_door import write_csv, write_parquet
from testbed.record.export import write_npz
from testbed.record.flight import Flight
from testbed.record.read import read_log
from testbed.record.rundir import find_run
from testbed.views.foxglove_layout import foxglove_layout
from testbed.views.plotjuggler_layout import plotjuggler_layout

SUFFIXES = {
    Format.CSV: ".csv",
    Format.PARQUET: ".parquet",
    Format.NPZ: ".npz",
    Format.FOXGLOVE: ".foxglove.json",
    Format.PLOTJUGGLER: ".plotjuggler.xml",
}


def export_run(run: str, form: Format, out: Path | None) -> str:
    """Write a run in another form; what was written, in words.

    Raises:
        InputError: there is no such run, or the file cannot be written.
    """
    refuse_files(out=out)
    log = find_run(run)
    path = out or log.with_suffix(SUFFIXES[form])
    if path.resolve() == log.resolve():
        raise InputError(f"--out {path}: this is the log itself; write another name")
    flight = Flight(read_log(log))
    write = _writer(form, flight, log, path)
    if is_stdout(out):
        paper = io.BytesIO()
        write(paper)
        sys.stdout.buffer.write(paper.getvalue())
    else:
        try:
            with replacing(path) as file:
                write(file.buffer)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written: {error.strerror}; name another with --out FILE"
            ) from error
    size = f"{flight.time_s.size} frames of {len(flight.names)} aircraft"
    if form in (Format.FOXGLOVE, Format.PLOTJUGGLER):
        size = f"layout for {log}"
    whole = "" if flight.log.finished else " (the run was cut short)"
    return f"{path}: {size}{whole}" if is_stdout(out) else said(path, f"{size}{whole}")


def _writer(form: Format, flight: Flight, log: Path, path: Path) -> Callable[[IO[bytes]], object]:
    """What writes a flight in this form."""
    tables = {Format.CSV: write_csv, Format.PARQUET: write_parquet, Format.NPZ: write_npz}
    if form in tables:
        return lambda file: tables[form](flight, file)
    if form is Format.FOXGLOVE:
        text = foxglove_layout(flight.info)
    else:
        folder = Path() if is_stdout(path) else path.parent
        text = plotjuggler_layout(flight, os.path.relpath(log, folder))
    return lambda file: file.write(text.encode())
