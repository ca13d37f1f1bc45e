"""The command that finishes runs that were killed: recover."""

from __future__ import annotations

from testbed.cli.options import RunName
from testbed.cli.output import result_console


def recover_command(run: RunName) -> None:
    """Finish the log of a run that was killed, and write its metrics.json.

    Every readable sample and event is kept. Numbers of the network and the duration of the run are
    not in the log, and are null.
    """
    from testbed.metrics.tables import render_table
    from testbed.sim.recover import recover

    found = recover(run)
    console = result_console()
    if not found.was_cut:
        console.write_line(f"{found.log}: complete, nothing to recover")
        return
    render_table(found.metrics, console, log=found.log.parent)
    lost = f"; its last {found.lost_bytes} bytes were half a record" if found.lost_bytes else ""
    console.write_line(f"{found.log}: finished{lost}")
