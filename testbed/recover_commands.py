"""The command that finishes runs that were cut short: recover."""

from __future__ import annotations

import typer

from testbed.options import RunName


def recover(run: RunName) -> None:
    """Finish the log of a run that was killed, and its metrics.json.

    Everything that can be read stays. What the radio did and how long the run took
    is in no log, and null.
    """
    from rich.console import Console

    from testbed.metrics.table import render_table
    from testbed.sim.recover import recover as finish

    found = finish(run)
    if not found.was_cut:
        typer.echo(f"{found.log}: is whole, there is nothing to do")
        return
    render_table(found.metrics, Console(), log=found.log.parent)
    lost = f"; {found.lost_bytes} bytes behind it were half a record" if found.lost_bytes else ""
    typer.echo(f"{found.log}: finished{lost}")
