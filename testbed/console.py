"""What the commands do on the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.links.addresses import parse_address
from testbed.metrics.table import render_table
from testbed.outputs import Paper, is_stdout, put_json, refuse_files
from testbed.progress import ProgressBar
from testbed.scenario import (
    Scenario,
    list_aircraft,
    list_scenarios,
    list_studies,
    list_tunings,
    load,
    shorten,
)
from testbed.scenario.pilots import ArduPlane, External
from testbed.sim.outside import Outside
from testbed.sim.run import run
from testbed.state import Observer


@dataclass(frozen=True, slots=True)
class Flight:
    """What `testbed run` was asked for; see its options."""

    scenario: str
    overrides: tuple[str, ...]
    seed: int | None
    duration_s: float | None
    out: Path | None
    json: Path | None
    view: bool
    quiet: bool
    processes: int | None
    mavlink: tuple[str, ...]
    pace: float | None
    tlog: bool
    key: Path | None
    arduplane: Path | None


def fly_and_show(asked: Flight) -> int:
    """Fly a scenario, print its table, and return the exit code of its outcome."""
    overrides = asked.overrides
    if asked.seed is not None:
        overrides = (*overrides, f"scenario.seed={asked.seed}")
    page = load(asked.scenario, overrides)
    if asked.duration_s is not None:
        if not (asked.duration_s > 0.0 and math.isfinite(asked.duration_s)):
            raise InputError(f"--duration {asked.duration_s:g}: write a number of seconds above 0")
        page = shorten(page, asked.duration_s)
    refuse_files(json=asked.json)
    speech = Console(stderr=True)
    outside = find_outside(asked, page, lambda line: speech.print(Text(line), soft_wrap=True))
    watchers: list[Observer] = [] if asked.quiet else [ProgressBar(speech)]
    if asked.view:
        from testbed.views import FAST_HZ, LiveViewer, RerunView

        viewer = LiveViewer()
        outside.tell(f"view: {viewer.address}")
        watchers.append(RerunView(viewer, most_hz=None if outside.pace else FAST_HZ))
    flown = run(page, out=asked.out, observers=watchers, outside=outside, processes=asked.processes)
    if not asked.quiet:
        paper = Paper(stderr=is_stdout(asked.json))
        render_table(flown.metrics, paper, log=flown.directory)
        for copy in sorted(flown.directory.glob("*.py")) if flown.directory else ():
            paper.print(Text(f" {'law':<20}{copy}, a copy of its code"), soft_wrap=True)
    put_json(asked.json, flown.metrics)
    return flown.exit_code


def find_outside(asked: Flight, page: Scenario, tell: Callable[[str], None]) -> Outside:
    """Who may see and command the aircraft, and the pace.

    Raises:
        InputError: an address, a key or a pace that cannot be used.
    """
    mavlink = tuple(parse_address(each) for each in asked.mavlink)
    pace = asked.pace
    if pace is None:
        by = (each.commanded_by for each in page.aircraft)
        waits = any(isinstance(each, External) and each.lockstep for each in by)
        pace = 1.0 if mavlink and not waits else 0.0
    if not 0.0 <= pace < math.inf:
        raise InputError(f"--pace {pace:g}: write a number above 0, as 1 for real time, or 0")
    if asked.key and not mavlink:
        raise InputError(
            f"--mavlink-key {asked.key}: signs a link: say where it is, as in --mavlink "
            "udpout:127.0.0.1:14550"
        )
    flown = (each.autopilot for each in page.aircraft)
    if asked.arduplane and not any(isinstance(each, ArduPlane) for each in flown):
        tell(f"warning: --arduplane {asked.arduplane}: no aircraft has autopilot: ardupilot")
    key = None
    if asked.key:
        from testbed.mavlink.signing import read_key

        key = read_key(asked.key)
    return Outside(
        tell=tell,
        mavlink=mavlink,
        pace=pace or None,
        tlog=asked.tlog,
        key=key,
        arduplane=asked.arduplane,
    )


def list_library() -> None:
    """Print the scenarios, studies and tunes with their questions, and the aircraft."""
    from testbed.study.plan import load_study
    from testbed.study.tune_page import load_tune

    questions = {
        "scenario": {name: load(name).scenario.question for name in list_scenarios()},
        "study": {name: load_study(name).page.study.question for name in list_studies()},
        "tune": {name: load_tune(name).page.study.question for name in list_tunings()},
    }
    console = Console()
    for kind, asked in questions.items():
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column(kind, no_wrap=True)
        table.add_column("question")
        for name, question in asked.items():
            table.add_row(name, question)
        console.print(table)
        console.print()
    console.print(f"[bold]aircraft[/]\n{chr(10).join(list_aircraft())}")
