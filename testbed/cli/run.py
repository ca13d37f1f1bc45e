"""The command that flies a scenario: run."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import (
    Follow,
    Host,
    JsonFile,
    Overrides,
    Quiet,
    ScenarioName,
    Seed,
    StartTime,
    check_follow,
    error_places,
    load_scenario,
    output_option,
    positive_option,
    read_time,
    value_option,
)
from testbed.cli.output import format_size, message_console, result_console, write_json_output
from testbed.cli.view import (
    open_viewer,
    read_shown_log,
    refuse_stdout,
    save_rrd,
    wait_for_interrupt,
)
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from rich.text import Text

    from testbed.core.records import Observer
    from testbed.runs.external_options import ExternalOptions
    from testbed.runs.flight_progress import Progress
    from testbed.scenario import Scenario

_EXTERNAL = "External programs"


class ViewChoice(StrEnum):
    """Where a flight is shown while it is flown."""

    WINDOW = "window"
    WEB = "web"


# Options that may stand without a value: their values, the first of which is meant then.
OPTIONAL_VALUES = {"--view": tuple(ViewChoice)}


def run_command(
    scenario: ScenarioName,
    overrides: Overrides = None,
    seed: Seed = None,
    duration: Annotated[
        str | None,
        value_option("TIME", "Simulated time, instead of the scenario's: 120, 90s or 2m."),
    ] = None,
    out: Annotated[
        Path | None,
        value_option("DIR", "Run directory to create.  \\[default: logs/SCENARIO/UTC-ID]"),
    ] = None,
    json: JsonFile = None,
    view: Annotated[
        ViewChoice | None,
        typer.Option(
            help="Show the flight live: in a Rerun viewer, opened if needed (window, which --view "
            "alone means), or in a browser (web), also from another machine through ssh, until "
            "Ctrl-C."
        ),
    ] = None,
    host: Host = "127.0.0.1",
    follow: Follow = None,
    rrd: Annotated[
        Path | None,
        output_option(help="Also save a Rerun recording, written when the flight is over."),
    ] = None,
    quiet: Quiet = False,
    start_time: StartTime = None,
    processes: Annotated[
        int | None,
        positive_option(
            "N",
            "Processes for the flight models; results do not depend on it.  \\[default: 1, "
            "more from 20 aircraft on]",
        ),
    ] = None,
    mavlink: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Offer every aircraft as a MAVLink vehicle: udpout:HOST:PORT, udpin:HOST:PORT, "
            "or PORT for udpout:127.0.0.1:PORT; PORT+STEP gives each aircraft its own port. May "
            "be repeated.",
            rich_help_panel=_EXTERNAL,
        ),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Simulated seconds per second; 0: as fast as possible.  \\[default: 1 with "
            "--mavlink unless the run waits for commands, else 0]",
            rich_help_panel=_EXTERNAL,
        ),
    ] = None,
    tlog: Annotated[
        bool,
        typer.Option(
            "--tlog",
            help="Also write the MAVLink telemetry to run.tlog.",
            rich_help_panel=_EXTERNAL,
        ),
    ] = False,
    mavlink_key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Sign MAVLink and accept signed commands only. The file holds a passphrase or 64 "
            "hexadecimal digits.",
            rich_help_panel=_EXTERNAL,
        ),
    ] = None,
    companions: Annotated[
        bool,
        typer.Option(
            "--companions",
            help="Fly every follower by `testbed companion` in a process of its own, in lockstep, "
            "or with --pace 1 in real time.",
            rich_help_panel=_EXTERNAL,
        ),
    ] = False,
    arduplane: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="ArduPlane binary for aircraft with autopilot: ardupilot.  \\[default: the "
            "environment variable ARDUPLANE]",
            rich_help_panel=_EXTERNAL,
        ),
    ] = None,
) -> None:
    """Fly a scenario and print a table of results.

    Writes run.mcap, scenario.resolved.yaml and metrics.json to the run directory. A number outside
    the bounds of the scenario's `expect` gives exit code 3.
    """
    from testbed.metrics.expectations import violations
    from testbed.metrics.printed_tables import render_table
    from testbed.runs.bounds import unchecked_bounds, violation_lines
    from testbed.runs.flight_progress import make_display
    from testbed.runs.run import run
    from testbed.scenario import set_duration
    from testbed.scenario.arguments import check_argument
    from testbed.scenario.sections import Header

    if start_time is not None:
        overrides = [*(overrides or ()), f"log.start_time={start_time}"]
    loaded = load_scenario(scenario, overrides, seed)
    messages = message_console()
    notes: list[tuple[str, Text]] = []
    if duration is not None:
        seconds = read_time("--duration", duration)
        duration_s = check_argument("--duration", seconds, Header, "duration_s")
        notes = _window_notes(loaded, duration_s)
        for text in unchecked_bounds(loaded, duration_s):
            messages.write_line(f"warning: {text}", "yellow")
        loaded = set_duration(loaded, duration_s)
    external = external_options(
        loaded,
        messages.write_line,
        mavlink=mavlink or (),
        pace=pace,
        tlog=tlog,
        key_file=mavlink_key,
        arduplane=arduplane,
        companions=companions,
        quiet=quiet,
    )
    check_follow(follow, loaded.aircraft_names)
    if follow is not None and view is None and rrd is None:
        messages.write_line(
            f"warning: --follow {follow}: nothing is shown; add --view or --rrd FILE", "yellow"
        )
    if rrd is not None:
        refuse_stdout(rrd)
    observers: list[Observer] = []
    progress: Progress = False
    with ExitStack() as stack:
        if not quiet:
            progress = stack.enter_context(closing(make_display(loaded.name, messages)))
        if view is not None:
            from testbed.views import FAST_HZ, RerunView

            viewer = stack.enter_context(open_viewer(host, web=view is ViewChoice.WEB))
            max_hz = None if external.pace else FAST_HZ
            observers.append(RerunView(viewer, max_hz=max_hz, follow=follow))
        with error_places(scenario, overrides):
            result = run(
                loaded,
                out=out,
                observers=observers,
                external=external,
                processes=processes,
                progress=progress,
            )
        if rrd is not None and result.directory:
            save_rrd(rrd, [read_shown_log(str(result.directory))], follow)
        write_json_output(json, result.metrics)
        if not quiet:
            console = result_console(json)
            size = format_size(*result.directory.iterdir()) if result.directory else ""
            notes += _published_notes(scenario, loaded, overrides or ())
            render_table(result.metrics, console, log=result.directory, log_size=size, notes=notes)
            code = (
                [*result.directory.glob("*.py"), *result.directory.glob("*.fmu")]
                if result.directory
                else []
            )
            for path in sorted(code):
                console.write_line(f" {'control law':<20}{path}, a copy of its code")
            if json is None and console.is_terminal:  # a program that reads a pipe needs none
                for line in next_commands(result.directory, loaded):
                    console.write_line(line, "dim")
        for line in violation_lines(violations(result.metrics), scenario, overrides or ()):
            (messages if quiet else console).write_line(line, "red")
        if view is ViewChoice.WEB and result.exit_code != ExitCode.INTERRUPTED:
            wait_for_interrupt()
    raise typer.Exit(result.exit_code)


def _window_notes(scenario: Scenario, duration_s: float) -> list[tuple[str, Text]]:
    """Describe the windows that a duration, s, cuts short or does not reach."""
    from rich.text import Text

    from testbed.scenario import cut_windows, unreached_windows

    notes = []
    if cut := cut_windows(scenario, duration_s):
        text = ", ".join(cut)
        if scenario.scenario.published is not None:
            text += ", not compared with published numbers"
        notes.append(("windows cut short", Text(text, style="yellow")))
    if unreached := unreached_windows(scenario, duration_s):
        text = ", ".join(unreached.values())
        if len(unreached) == len(scenario.scenario.windows):
            text += "; errors are those of the second half of the flight"
        notes.append(("windows not reached", Text(text, style="yellow")))
    return notes


def _published_notes(
    name: str, scenario: Scenario, overrides: Sequence[str]
) -> list[tuple[str, Text]]:
    """Say why a scenario of the user's has no column of published numbers."""
    from rich.text import Text

    from testbed.scenario import find_scenario, library
    from testbed.scenario.load import uninherited_source

    removed = any(each.startswith("scenario.published") for each in overrides)
    own = find_scenario(name).parent != library() / "scenarios"
    if scenario.scenario.published is not None or removed or not own:
        return []
    source = uninherited_source(name)
    if not source:
        return []
    text = f"not compared with {source}: another name does not inherit published numbers"
    return [("paper", Text(text, style="dim"))]


def next_commands(directory: Path | None, scenario: Scenario) -> list[str]:
    """Return lines that name what to do with a run; none if it has no log.

    Args:
        directory: of the run.
        scenario: that was flown.
    """
    if directory is None or not scenario.log.mcap:
        return []
    run = shlex.quote(str(directory))
    commands = (
        f"testbed view {run}",
        f"testbed report {run}",
        f"testbed video {run} --out {scenario.name}.mp4",
    )
    return [f" {'' if k else 'next':<20}{each}" for k, each in enumerate(commands)]


def external_options(
    scenario: Scenario,
    announce: Callable[[str], None],
    *,
    mavlink: Sequence[str],
    pace: float | None,
    tlog: bool,
    key_file: Path | None,
    arduplane: Path | None,
    companions: bool = False,
    quiet: bool = False,
) -> ExternalOptions:
    """Read the options for external programs.

    Raises:
        InputError: an address, the key or the pace cannot be used.
    """
    from testbed.commands.tick_gate import check_pace
    from testbed.mavlink.udp_endpoint import parse_address
    from testbed.runs.external_options import ExternalOptions
    from testbed.scenario.aircraft import ArduPlane, External

    addresses = tuple(parse_address(each) for each in mavlink)
    if pace is None:
        sources = [each.commanded_by for each in scenario.aircraft]
        lockstep = any(isinstance(each, External) and each.lockstep for each in sources)
        pace = 1.0 if addresses and not (lockstep or companions) else 0.0
    if pace:
        check_pace("--pace", pace)
    if key_file and not addresses:
        raise InputError(
            f"--mavlink-key {key_file}: there is no MAVLink link to sign; add --mavlink ADDRESS, "
            "e.g. --mavlink udpout:127.0.0.1:14550"
        )
    autopilots = [each.autopilot for each in scenario.aircraft]
    if arduplane and not any(isinstance(each, ArduPlane) for each in autopilots):
        announce(f"warning: --arduplane {arduplane}: no aircraft has autopilot: ardupilot")
    key = None
    if key_file:
        from testbed.mavlink.signing import is_shared, read_key

        key = read_key(key_file)
        if is_shared(key_file):
            text = f"other users may read it; write chmod 600 {key_file}"
            announce(f"warning: --mavlink-key {key_file}: {text}")
    return ExternalOptions(
        announce=announce,
        mavlink=addresses,
        pace=pace,
        tlog=tlog,
        signing_key=key,
        arduplane=arduplane,
        companions=companions,
        quiet=quiet,
    )
