"""The command that brings real flights in: import."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def import_flight(
    flight: Annotated[
        Path,
        typer.Argument(metavar="FLIGHT", help="ArduPlane's log: .bin from on board, or .tlog."),
    ],
    out: Annotated[Path, typer.Option(metavar="CSV", help="The recording to write.")],
    system: Annotated[
        int | None,
        typer.Option(metavar="N", help="Which vehicle of a .tlog.  \\[default: the only one]"),
    ] = None,
    begin: Annotated[
        float | None,
        typer.Option(
            "--from",
            metavar="S",
            help="Take nothing earlier, in seconds: of a .bin since boot, of a .tlog since its "
            "first record.",
        ),
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", metavar="S", help="Take nothing later.")
    ] = None,
    mode: Annotated[
        str, typer.Option(metavar="MODE", help="Take what was flown in this mode; or any.")
    ] = "FBWA",
) -> None:
    """Turn a real flight into a recording that `testbed respond` replays.

    Takes the longest stretch in the mode, with a row for each message of the
    attitude. Columns that the log cannot tell are left out.
    """
    from testbed.flight_console import import_and_show

    import_and_show(flight, out, system=system, begin=begin, end=end, mode=mode)
