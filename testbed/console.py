"""What the commands do on the terminal."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.table import Table

from testbed.errors import InputError
from testbed.metrics.table import render_table
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.progress import ProgressBar
from testbed.scenario import list_aircraft, list_scenarios, load, shorten
from testbed.sim.run import run
from testbed.state import Observer


def fly_and_show(
    scenario: str,
    overrides: tuple[str, ...],
    *,
    seed: int | None,
    duration_s: float | None,
    out: Path | None,
    json: Path | None,
    view: bool,
    quiet: bool,
) -> int:
    """Fly a scenario, print its table, and return the exit code of its outcome."""
    if seed is not None:
        overrides = (*overrides, f"scenario.seed={seed}")
    page = load(scenario, overrides)
    if duration_s is not None:
        if not (duration_s > 0.0 and math.isfinite(duration_s)):
            raise InputError(f"--duration {duration_s:g}: write a number of seconds above 0")
        page = shorten(page, duration_s)
    refuse_files(json=json)
    watchers: list[Observer] = [] if quiet else [ProgressBar(Console(stderr=True))]
    if view:
        from testbed.views import LiveViewer, RerunView

        watchers.append(RerunView(LiveViewer()))
    flown = run(page, out=out, observers=watchers)
    if not quiet:
        render_table(flown.metrics, Console(stderr=is_stdout(json)), log=flown.directory)
    put_json(json, flown.metrics)
    return flown.exit_code


def replay_run(name: str, *, rrd: Path | None) -> int:
    """Send a flown run to a Rerun viewer, or to a file."""
    from testbed.record.read import frames, read_log
    from testbed.record.rundir import find_run
    from testbed.views import LiveViewer, RrdFile, replay

    log = read_log(find_run(name))
    try:
        replay(log.info, frames(log), RrdFile(rrd) if rrd else LiveViewer(patient=True))
    except OSError as error:
        raise InputError(f"--rrd {rrd}: {error.strerror or error}") from error
    return 0


def list_library() -> None:
    """Print the scenarios with their questions, and the aircraft."""
    console = Console()
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("scenario", no_wrap=True)
    table.add_column("question")
    for name in list_scenarios():
        table.add_row(name, load(name).scenario.question)
    console.print(table)
    console.print(f"\n[bold]aircraft[/]\n{chr(10).join(list_aircraft())}")
