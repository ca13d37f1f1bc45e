"""The commands that convert and finish logs: export, recover."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import RunName, StartTime, value_option
from testbed.cli.output import (
    check_output_path,
    describe_file,
    is_stdout,
    message_console,
    open_output,
    result_console,
)
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.logs.flight_data import FlightData


class Format(StrEnum):
    """Formats of an export."""

    CSV = "csv"
    PARQUET = "parquet"
    NPZ = "npz"
    MAT = "mat"
    FOXGLOVE = "foxglove"
    FOXGLOVE_LAYOUT = "foxglove-layout"
    PLOTJUGGLER = "plotjuggler"
    ROS2 = "ros2"


SUFFIXES = {
    Format.CSV: ".csv",
    Format.PARQUET: ".parquet",
    Format.NPZ: ".npz",
    Format.MAT: ".mat",
    Format.FOXGLOVE: ".foxglove.mcap",
    Format.FOXGLOVE_LAYOUT: ".foxglove.json",
    Format.PLOTJUGGLER: ".plotjuggler.xml",
    Format.ROS2: ".ros2",
}
LAYOUTS = (Format.FOXGLOVE_LAYOUT, Format.PLOTJUGGLER)
TIMED = (Format.FOXGLOVE, Format.ROS2)  # formats whose times can begin at another time


def _check_out(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
    """Check the path of --out; the error of an existing folder depends on the format."""
    return path if path is not None and path.is_dir() else check_output_path(parameter, path)


def export_command(
    run: RunName,
    form: Annotated[
        Format,
        value_option(
            "FORMAT",
            "csv, parquet: a table with a row per sample and aircraft. npz, mat: arrays of NumPy, "
            "of MATLAB. "
            "foxglove: the log with a 3D scene. foxglove-layout, plotjuggler: a layout for this "
            "program, which opens the log itself. ros2: a folder that `ros2 bag` reads.",
            "--format",
        ),
    ],
    out: Annotated[
        Path | None,
        value_option(
            "FILE",
            "File to write, with ros2 a new folder; - is stdout.  \\[default: run.FORMAT "
            "beside the log]",
            check=_check_out,
        ),
    ] = None,
    start_time: StartTime = None,
) -> None:
    """Write a run in another format, or write a layout for its log.

    Columns have the names of the log's topics and fields, with their units.
    """
    from testbed.core.identifiers import changed_names
    from testbed.core.start_time import start_unix_ns
    from testbed.logs.file_record import check_default_output, record_output
    from testbed.logs.flight_data import FlightData
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    log = find_run(run)
    path = out
    if path is None:
        path = log.with_suffix(SUFFIXES[form])
        if form is not Format.ROS2:  # of a folder there is a later error
            check_default_output(path, "write --out FILE")
    if path.resolve() == log.resolve():
        raise InputError(f"--out {path}: this is the log itself; write another name")
    read = read_log(log)
    if start_time is not None:
        if form not in TIMED:
            raise InputError(
                f"--start-time {start_time}: a file of format {form} has no times of day; leave "
                f"it out, or choose {', '.join(TIMED)}"
            )
        read = replace(read, info=replace(read.info, start_unix_ns=start_unix_ns(start_time)))
    flight = FlightData(read)
    content = f"{flight.time_s.size} samples of {len(flight.names)} aircraft"
    if form in LAYOUTS:
        content = f"layout for {log}"
    content += "" if flight.log.finished else " (the run was cut short)"
    messages = message_console()
    if form is Format.FOXGLOVE:
        _write_scene_log(flight, path)
    elif form is Format.ROS2:
        _write_bag(flight, path)
    else:
        write = _writer(form, flight, log, path)
        with open_output(path, "--out") as file:
            write(file)
    record_output(path, default=out is None)
    messages.write_line(describe_file(path, content))
    if form is Format.ROS2 and (changed := changed_names(flight.names)):
        listed = ", ".join(f"{name} is /{found}" for name, found in changed)
        messages.write_line(f"names that ROS 2 does not allow: {listed}")


def _write_scene_log(flight: FlightData, path: Path) -> None:
    from testbed.core.files import replacement
    from testbed.runs.flight_progress import FlightProgress, make_display
    from testbed.views.foxglove_scene import write_scene_log

    target = Path("/dev/stdout") if is_stdout(path) else path
    display = make_display(flight.info.scenario_name, message_console())
    with (
        closing(display),
        report_write_errors(f"--out {path}"),
        replacement(target) as new,
    ):
        write_scene_log(flight.log, new, [FlightProgress(display)])


def _write_bag(flight: FlightData, path: Path) -> None:
    from testbed.cli.progress import progress_counter
    from testbed.core.files import new_folder
    from testbed.views.ros2_export import write_bag

    if is_stdout(path):
        raise InputError("--out -: a bag is a folder; write the name of a new one")
    with report_write_errors(f"--out {path}"), new_folder(path) as folder:
        with progress_counter("ros2", unit="samples") as advance:
            write_bag(flight.log, folder, advance)


def _writer(
    form: Format, flight: FlightData, log: Path, path: Path
) -> Callable[[IO[bytes]], object]:
    """Choose the function that writes a flight in this format."""
    from testbed.views.foxglove_layout import foxglove_layout
    from testbed.views.plotjuggler_layout import plotjuggler_layout

    if form in (Format.CSV, Format.NPZ):
        from testbed.logs.flight_data import write_csv, write_npz

        write_arrays = write_csv if form is Format.CSV else write_npz
        return lambda file: write_arrays(flight, file)
    if form is Format.MAT:
        from testbed.logs.matlab_file import write_mat

        return lambda file: write_mat(flight, file)
    if form is Format.PARQUET:
        from testbed.logs.arrow_io import write_parquet

        return lambda file: write_parquet(flight, file)
    if form is Format.FOXGLOVE_LAYOUT:
        text = foxglove_layout(flight.info)
    else:
        folder = Path() if is_stdout(path) else path.parent
        text = plotjuggler_layout(flight, os.path.relpath(log, folder))
    return lambda file: file.write(text.encode("utf-8", "backslashreplace"))


def recover_command(run: RunName) -> None:
    """Finish the log of a run that was killed, and write its metrics.json.

    Every readable sample and event is kept. Numbers of the network and the duration of the run are
    not in the log, and are null.
    """
    from testbed.metrics.printed_tables import render_table
    from testbed.runs.recover import recover

    found = recover(run)
    console = result_console()
    if not found.was_cut:
        console.write_line(f"{found.log}: complete, nothing to recover")
        return
    render_table(found.metrics, console, log=found.log.parent)
    lost = f"; its last {found.lost_bytes} bytes were half a record" if found.lost_bytes else ""
    console.write_line(f"{found.log}: finished{lost}")
