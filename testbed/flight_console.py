"""What `testbed import` writes and prints: a real flight as a recording."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.mavlink.flights import Flight, read_flight, write_flight
from testbed.metrics.document import replacing
from testbed.outputs import refuse_files


def import_and_show(
    path: Path,
    out: Path,
    *,
    system: int | None,
    begin: float | None,
    end: float | None,
    mode: str,
) -> None:
    """Read the flight, write its rows, and say where they came from and what to know of them."""
    refuse_files(out=out)
    for name, moment in (("from", begin), ("to", end)):
        if moment is not None and not math.isfinite(moment):
            raise InputError(f"--{name} {moment:g}: write a number of seconds")
    if begin is not None and end is not None and begin >= end:
        raise InputError(f"--from {begin:g}: not before --to {end:g}; write an earlier one")
    flight = read_flight(
        path,
        system=system,
        begin=-math.inf if begin is None else begin,
        end=math.inf if end is None else end,
        mode=mode,
    )
    try:
        with replacing(out) as file:
            write_flight(flight, file.write)
    except OSError as error:
        raise InputError(f"--out {out}: cannot write it: {error.strerror}") from error
    _show(Console(highlight=False), flight, out)


def _show(console: Console, flight: Flight, out: Path) -> None:
    time = flight.columns["t_s"]
    rate = (len(time) - 1) / (time[-1] - time[0])
    console.print(
        Text.assemble(
            " ",
            (", ".join(flight.modes) or "no mode told", "bold"),
            f" · {time[0]:.2f} to {time[-1]:.2f} s · {len(time):,} rows, {rate:.1f} a second",
        )
    )
    table = Table(box=None, pad_edge=True, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for name, source in flight.sources.items():
        table.add_row(name, source)
    for name, why in flight.missing.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {why}", style="dim"))
    console.print()
    console.print(table)
    console.print()
    for note in flight.notes:
        console.print(Text(f" note: {note}"))
    console.print(Text(f" recording  {out}"), soft_wrap=True)
