"""The command that imports real flights: import."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.cli.options import output_option, require_finite
from testbed.cli.output import result_console
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file

if TYPE_CHECKING:
    from testbed.mavlink.flight_import import ImportedFlight


def import_command(
    flight: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT", help="ArduPlane's log: a .bin of the autopilot, or a .tlog."
        ),
    ],
    out: Annotated[Path, output_option(metavar="CSV", help="The recording to write.")],
    system: Annotated[
        int | None,
        typer.Option(metavar="N", help="System of a .tlog to import.  \\[default: the only one]"),
    ] = None,
    begin: Annotated[
        float | None,
        typer.Option(
            "--from",
            metavar="S",
            help="Import nothing earlier: seconds since boot for a .bin, since the first record "
            "for a .tlog.",
            callback=require_finite,
        ),
    ] = None,
    end: Annotated[
        float | None,
        typer.Option("--to", metavar="S", help="Import nothing later.", callback=require_finite),
    ] = None,
    mode: Annotated[
        str, typer.Option(metavar="MODE", help="Import flight in this mode only; any: in all.")
    ] = "FBWA",
) -> None:
    """Convert a log of a real flight to a recording that `testbed respond` replays.

    Takes the longest continuous section in the mode, with a row per attitude message. Columns that
    the log does not have are left out.
    """
    from testbed.mavlink.flight_import import read_flight, write_flight

    if begin is not None and end is not None and begin >= end:
        raise InputError(f"--from {begin:g}: not before --to {end:g}; write an earlier time")
    found = read_flight(
        flight,
        system=system,
        begin=-math.inf if begin is None else begin,
        end=math.inf if end is None else end,
        mode=mode,
    )
    with report_write_errors(f"--out {out}"), write_text_file(out) as file:
        write_flight(found, file.write)
    console = result_console()
    _print_import(console, found)
    console.write_line(f" recording  {out}")


def _print_import(console: Console, flight: ImportedFlight) -> None:
    time = flight.columns["t_s"]
    rate = (len(time) - 1) / (time[-1] - time[0])
    console.print(
        Text.assemble(
            " ",
            (", ".join(flight.modes) or "mode unknown", "bold"),
            f" · {time[0]:.2f} to {time[-1]:.2f} s · {len(time):,} rows, {rate:.1f} per second",
        )
    )
    table = Table(box=None, pad_edge=True, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for name, source in flight.sources.items():
        table.add_row(name, source)
    for name, reason in flight.missing.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.print()
    console.print(table)
    console.print()
    for note in flight.notes:
        console.print(Text(f" note: {note}"))
