"""The commands that read logs of real flights: import, import-formation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.cli.options import (
    Overrides,
    ScenarioName,
    finite_option,
    load_scenario,
    output_option,
    value_option,
)
from testbed.cli.output import message_console, result_console
from testbed.cli.progress import progress_counter
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.numbers import parse_number

if TYPE_CHECKING:
    from testbed.core.records import NedOrigin
    from testbed.flight_logs.flight_import import ImportedFlight
    from testbed.flight_logs.recorded_motion import Motion
    from testbed.flight_logs.tracks import Track


def import_command(
    flight: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT",
            help="A log: .bin or .tlog of ArduPlane, .ulg of PX4. With --columns a CSV file.",
        ),
    ],
    out: Annotated[Path, output_option(metavar="CSV", help="The recording to write.")],
    columns: Annotated[
        Path | None,
        value_option("MAP.yaml", "Columns and units of a CSV file from elsewhere."),
    ] = None,
    scenario: Annotated[
        str | None,
        value_option(
            "SCENARIO",
            "Positions about the origin of this scenario.  \\[default: the first position, "
            "at home's height]",
        ),
    ] = None,
    system: Annotated[
        int | None, value_option("N", "System of a .tlog to import.  \\[default: the only one]")
    ] = None,
    begin: Annotated[
        float | None,
        finite_option(
            "S",
            "Import nothing earlier: seconds since boot for a .bin or .ulg, since the first "
            "record for a .tlog, t_s of a CSV file.",
            "--from",
        ),
    ] = None,
    end: Annotated[float | None, finite_option("S", "Import nothing later.", "--to")] = None,
    mode: Annotated[
        str | None,
        value_option(
            "MODE",
            "Import flight in this mode only; any: in all.  \\[default: FBWA; of a .ulg any]",
        ),
    ] = None,
) -> None:
    """Convert a log of a real flight to a recording.

    The recording can be a leader (path: {kind: replay, file: CSV}), is replayed by `testbed
    respond`, and is an aircraft of `testbed import-formation`. It is the longest section in the
    mode without gaps, with a row per attitude message. Columns that the log does not have are left
    out.
    """
    _check_ends(begin, end)
    first = -math.inf if begin is None else begin
    last = math.inf if end is None else end
    origin = None if scenario is None else _origin_of(scenario)
    console = result_console()
    if columns is None:
        from testbed.flight_logs.flight_import import read_flight
        from testbed.flight_logs.recorded_motion import Motion

        found = read_flight(flight, system=system, begin=first, end=last, mode=mode)
        motion = Motion(found.columns, found.sources)
        home_m, rates_hz = found.home_m, found.rates_hz
    else:
        import numpy as np

        from testbed.flight_logs.column_map import read_mapped
        from testbed.flight_logs.recorded_motion import longest_section

        for option, value in (("--system", system), ("--mode", mode)):
            if value is not None:
                raise InputError(f"{option} {value}: is for a log of an autopilot; leave it out")
        motion, notes = longest_section(read_mapped(flight, columns), first, last)
        found, home_m = _mapped_flight(motion, notes), None
        time = motion.columns["t_s"]
        rates_hz = dict.fromkeys(motion.columns, 1.0 / float(np.median(np.diff(time))))
    motion = _complete(motion, origin, home_m, flight)
    from testbed.commissioning.command_files import write_sources
    from testbed.flight_logs.recorded_motion import to_csv

    text = to_csv(motion)
    with report_write_errors(f"--out {out}"):
        with write_text_file(out) as file:
            file.write(text)
        if out.is_file():  # no pipe, and no device
            write_sources(out, flight.name, motion.sources, rates_hz)
    _print_import(console, found, motion, out, scenario)


def _check_ends(begin: float | None, end: float | None) -> None:
    if begin is not None and end is not None and begin >= end:
        raise InputError(f"--from {begin:g}: not before --to {end:g}; write an earlier time")


def _origin_of(scenario: str) -> NedOrigin:
    from testbed.core.records import NedOrigin

    return NedOrigin(**load_scenario(scenario, None).scenario.origin.model_dump())


def _mapped_flight(motion: Motion, notes: tuple[str, ...]) -> ImportedFlight:
    from testbed.flight_logs.flight_import import ImportedFlight

    return ImportedFlight(
        motion.columns, motion.sources, {}, (*motion.notes, *notes), ("CSV file",)
    )


def _complete(
    motion: Motion, origin: NedOrigin | None, home_m: float | None, flight: Path
) -> Motion:
    """Add the columns of a leader about an origin, where there is a position."""
    from testbed.flight_logs.log_position import POSITION
    from testbed.flight_logs.recorded_motion import complete, default_origin

    if origin is None and motion.columns.keys() >= {*POSITION}:
        origin = default_origin(motion, home_m)
    try:
        return complete(motion, origin)
    except InputError as error:
        raise InputError(f"{flight}: {error}") from error


def _print_import(
    console: Console, flight: ImportedFlight, motion: Motion, out: Path, scenario: str | None
) -> None:
    time = motion.columns["t_s"]
    rate = (len(time) - 1) / (time[-1] - time[0])
    mode = ", ".join(flight.modes) or "mode unknown"
    console.print(
        Text.assemble(
            " ",
            (mode, "bold"),
            f" · {time[0]:.2f} to {time[-1]:.2f} s · {len(time):,} rows, {rate:.1f} per second",
        )
    )
    table = Table(box=None, pad_edge=True, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for names, source in _by_source(motion.sources):
        table.add_row(names, source)
    for name, reason in flight.missing.items():
        table.add_row(Text(name, style="dim"), Text(f"left out: {reason}", style="dim"))
    console.print()
    console.print(table)
    console.print()
    for note in flight.notes:
        console.print(Text(f" note: {note}"))
    _print_uses(console, flight, motion, out, scenario)


def _by_source(sources: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield the columns that are next to each other and have one source."""
    for source, names in groupby(sources, key=lambda name: sources[name]):
        listed = list(names)
        for k in range(0, len(listed), 2):
            yield ", ".join(listed[k : k + 2]), source


def _print_uses(
    console: Console, flight: ImportedFlight, motion: Motion, out: Path, scenario: str | None
) -> None:
    """Print what the recording can be used for."""
    from testbed.flight_logs.recorded_motion import COMMANDS
    from testbed.guidance.recorded_path import COLUMNS

    columns, time = motion.columns, motion.columns["t_s"]
    lacking = [name for name in COMMANDS if name not in columns]
    replay = f"lacks {', '.join(lacking)}" if lacking else f"testbed respond AIRCRAFT {out} OUT.csv"
    lines = [("recording", str(out)), ("to replay", replay)]
    if columns.keys() >= {*COLUMNS}:
        duration = math.floor(1e3 * (time[-1] - time[0]) + 1e-6) / 1e3
        lines.append(("as leader", f"path: {{kind: replay, file: {out}}}, {duration:g} s"))
        if motion.origin is not None:
            origin = motion.origin
            height = "home's height" if flight.home_m is not None else "the lowest height"
            whose = f"of {scenario}" if scenario else f"the first position, at {height}"
            place = (
                f"{{latitude_deg: {origin.latitude_deg:.7f}, longitude_deg: "
                f"{origin.longitude_deg:.7f}, elevation_m: {origin.elevation_m:.2f}}}"
            )
            lines += [("origin", place), ("", whose)]
    else:
        lines.append(("as leader", f"not possible: {flight.no_position or 'no position'}"))
    for label, text in lines:
        console.print(Text(f" {label:11}{text}"), soft_wrap=True)


def _read_start(parameter: typer.CallbackParam, text: str | None) -> str | None:
    """Check a time of ISO 8601; a typer callback."""
    from testbed.core.start_time import start_unix_ns

    if text is not None:
        try:
            start_unix_ns(text)
        except ValueError as error:
            raise InputError(f"{parameter.opts[0]} {text}: {error}") from None
    return text


def import_formation_command(
    scenario: ScenarioName,
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG",
            help="A log of each aircraft in the scenario's order, the leader's first: .bin, .tlog, "
            ".ulg, FILE.tlog:SYSTEM, or a recording of `testbed import`. One .tlog of all stands "
            "for its systems in order.",
        ),
    ],
    out: Annotated[
        Path | None,
        value_option("DIR", "Run directory to create.  \\[default: logs/SCENARIO/UTC-ID]"),
    ] = None,
    overrides: Overrides = None,
    start: Annotated[
        str | None,
        value_option(
            "TIME",
            "Time 0 of the run, ISO 8601 such as 2026-05-01T09:30:00Z.  \\[default: the first "
            "time that all logs have]",
            check=_read_start,
        ),
    ] = None,
    begin: Annotated[
        float | None, finite_option("S", "Take nothing earlier, s since time 0.", "--from")
    ] = None,
    end: Annotated[float | None, finite_option("S", "Take nothing later.", "--to")] = None,
    offset: Annotated[
        list[str] | None,
        value_option(
            "NAME=S",
            "Add seconds to the times of an aircraft's log; of a log that knows no time of "
            "day, its UNIX time at t_s 0. May be repeated.",
        ),
    ] = None,
    mode: Annotated[
        str, value_option("MODE", "Take flight in this mode only; any: in all.")
    ] = "any",
) -> None:
    """Make a run of the logs of several real aircraft that flew a formation.

    The run has the aircraft's recorded motion on one clock, and the slots of the scenario; metrics,
    report, view, compare and export take it like a simulated run. It is the longest section in
    which every aircraft has data, without gaps of more than a second.
    """
    _check_ends(begin, end)
    from testbed.core.records import NedOrigin
    from testbed.core.start_time import start_unix_ns
    from testbed.flight_logs.recorded_formation import write_formation
    from testbed.flight_logs.tracks import read_tracks
    from testbed.metrics.printed_tables import render_table

    shifts = dict(_parse_offset(text) for text in offset or ())
    if len(shifts) < len(offset or ()):
        raise InputError("--offset: an aircraft has two (write one for each)")
    loaded = load_scenario(scenario, overrides)
    names = loaded.aircraft_names
    console = result_console()
    message_console().write_line(f"reading {len(logs)} log{'s' * (len(logs) != 1)}")
    tracks, start_unix_s = read_tracks(
        logs,
        names,
        NedOrigin(**loaded.scenario.origin.model_dump()),
        start_unix_s=None if start is None else 1e-9 * start_unix_ns(start),
        offsets_s=shifts,
        mode=mode,
    )
    _print_tracks(console, tracks, start_unix_s)
    with progress_counter("import-formation", unit="samples") as advance:
        run = write_formation(
            loaded,
            tracks,
            start_unix_s,
            out,
            begin=-math.inf if begin is None else begin,
            end=math.inf if end is None else end,
            advance=advance,
        )
    if run.sections[1:]:
        others = ", ".join(f"{a:.1f} to {b:.1f}" for a, b in sorted(run.sections[1:]))
        console.print(
            Text(f" note: sections between gaps that are left out: {others} s; --from, --to choose")
        )
    render_table(run.metrics, console, log=run.directory)


def _parse_offset(text: str) -> tuple[str, float]:
    name, _, seconds = text.partition("=")
    value = parse_number(seconds)
    if not name or value is None:
        raise InputError(f"--offset {text}: write NAME=S, such as uav1=-0.2")
    return name, value


def _print_tracks(console: Console, tracks: Sequence[Track], start_unix_s: float) -> None:
    """Print which log each aircraft has, and how its clock was aligned."""
    from testbed.core.start_time import iso_time

    console.print(Text(f" time 0 is {iso_time(start_unix_s)}"), soft_wrap=True)
    table = Table(box=None, header_style="bold", pad_edge=True)
    for heading in ("aircraft", "log"):
        table.add_column(heading, no_wrap=True)
    for heading in ("from s", "to s", "rows/s", "UNIX time − t_s, s"):
        table.add_column(heading, justify="right")
    table.add_column("clock")
    for each in tracks:
        table.add_row(
            each.name,
            str(each.log.path.name) + ("" if each.log.system is None else f":{each.log.system}"),
            f"{each.time[0]:.2f}",
            f"{each.time[-1]:.2f}",
            f"{each.rate_hz:.1f}",
            f"{each.offset_s:.3f}",
            each.clock,
        )
    console.print(table)
    console.print()
