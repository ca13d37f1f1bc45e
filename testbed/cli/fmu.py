"""The command that writes an aircraft as an FMU: fmu."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import (
    MAX_SHOWN,
    AircraftName,
    JsonFile,
    ParamFile,
    Quiet,
    value_option,
)
from testbed.cli.output import (
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.cli.progress import activity
from testbed.core.errors import InputError
from testbed.core.files import (
    check_folder_writable,
    format_bytes,
    report_write_errors,
    write_file,
)
from testbed.core.numbers import parse_number
from testbed.core.ranges import MAX_SPEED_MPS

if TYPE_CHECKING:
    from rich.table import Table

    from testbed.fmi.aircraft_fmu import AircraftFmu, WrittenFmu

SPEEDS = (1.0, MAX_SPEED_MPS)  # m/s
HEIGHTS = (1.0, 15_000.0)  # m
MOST_STARTS = 200
AUTOPILOT_HZ, MOST_HZ = 50, 10_000


class TargetChoice(StrEnum):
    """A platform that the FMU has a library for."""

    HOST = "host"
    LINUX_X86_64 = "linux-x86-64"
    LINUX_ARM64 = "linux-arm64"
    MACOS = "macos"
    WINDOWS = "windows"
    ALL = "all"


def fmu_command(
    aircraft: AircraftName,
    airspeed: Annotated[
        str,
        value_option(
            "M/S",
            "True airspeeds at which it can start: 20, or 18,22, or LOW:HIGH:STEP.",
        ),
    ],
    out: Annotated[Path, value_option("DIR", "Folder for AIRCRAFT.fmu; made if there is none.")],
    height: Annotated[
        str, value_option("M", "Heights above the ground of its starts, as --airspeed.")
    ] = "100",
    tune: ParamFile = "autopilot",
    physics_hz: Annotated[
        int, value_option("HZ", "Steps of the flight model per second, a multiple of 50.")
    ] = 100,
    target: Annotated[
        list[TargetChoice] | None,
        typer.Option(
            metavar="NAME",
            help="Platform with a library in the FMU: host is this machine; by zig "
            "linux-x86-64, linux-arm64, macos, windows, or all for these four. May be repeated.  "
            "\\[default: host]",
            show_default=False,
        ),
    ] = None,
    cc: Annotated[
        Path | None,
        value_option("PATH", "C compiler of this machine, for host.  \\[default: cc on PATH]"),
    ] = None,
    zig: Annotated[
        Path | None,
        value_option(
            "PATH",
            "The compiler zig, for other platforms.  \\[default: zig or python-zig on PATH]",
        ),
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Write an aircraft with its autopilot as a native FMU, for other co-simulations (FMI 2.0).

    The FMU has the flight model, compiled from the aircraft's own files, behind fly-by-wire A. It
    needs neither Python nor JSBSim nor this program: FMPy and other importers load it. Inputs are
    pitch, roll, throttle, wind and its rotation; outputs are motion, air data, surfaces and
    battery. It flies the numbers of testbed.Aircraft.

    testbed fmu rascal110 --airspeed 15:25:1 --out fmus writes fmus/rascal110.fmu, which starts in
    trim at any of 11 airspeeds, anywhere, on any course, in the wind of its inputs.

    An aircraft that only JSBSim flies is refused. Starts cc or zig, from its option or PATH.
    """
    from testbed.fmi.aircraft_fmu import AircraftFmu, make_fmu
    from testbed.logs.file_record import check_folder_output, record_folder_output
    from testbed.scenario import find_aircraft, find_tune

    folder = find_aircraft(aircraft)
    name = f"{folder.name}.fmu"
    airspeeds = read_numbers("--airspeed", airspeed, *SPEEDS, "m/s", "20")
    heights = read_numbers("--height", height, *HEIGHTS, "m", "100")
    if len(airspeeds) * len(heights) > MOST_STARTS:
        raise InputError(
            f"--airspeed {airspeed}: makes {len(airspeeds) * len(heights)} starts with --height "
            f"{height} (write at most {MOST_STARTS} in all)"
        )
    if not AUTOPILOT_HZ <= physics_hz <= MOST_HZ or physics_hz % AUTOPILOT_HZ:
        raise InputError(
            f"--physics-hz {physics_hz}: write a multiple of {AUTOPILOT_HZ}, the rate of the "
            f"autopilot, up to {MOST_HZ:,}"
        )
    with report_write_errors(f"--out {out}"):
        check_folder_writable(out)
    check_folder_output(out, [name], f"--out {out}")
    wanted = AircraftFmu(
        folder.resolve(),
        find_tune(folder, tune).resolve(),
        airspeeds,
        heights,
        physics_hz,
        _targets(target or [TargetChoice.HOST]),
        cc,
        zig,
    )
    messages = message_console()
    with activity(name) as show:

        def report(doing: str) -> None:
            show(doing)
            if not quiet and not messages.is_terminal:
                messages.write_line(f" {doing} …")

        made = make_fmu(wanted, report)
    path = out / name
    with report_write_errors(path):
        out.mkdir(parents=True, exist_ok=True)
        with write_file(path) as file:
            file.write(made.data)
    record_folder_output(out, [name])
    write_json_output(json, _document(path, wanted, made))
    if not quiet:
        _print(path, wanted, made, json)


def _targets(chosen: Sequence[TargetChoice]) -> tuple[str, ...]:
    names = list[str]()
    for each in chosen:
        if each is TargetChoice.ALL:
            others = (TargetChoice.ALL, TargetChoice.HOST)
            names += [one.value for one in TargetChoice if one not in others]
        else:
            names.append(each.value)
    return tuple(dict.fromkeys(names))


def read_numbers(
    option: str, text: str, low: float, high: float, unit: str, example: str
) -> tuple[float, ...]:
    """Return the numbers of an option: one, several with commas, or LOW:HIGH:STEP, ascending.

    Raises:
        InputError: they are none, or out of range.
    """
    shown = text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"
    remedy = f"write a number such as {example}, or several with commas, or LOW:HIGH:STEP ({unit})"
    found = set[float]()
    for part in text.split(","):
        values = [parse_number(each.strip()) for each in part.split(":")]
        numbers = [each for each in values if each is not None]
        if len(numbers) != len(values) or len(numbers) not in (1, 3):
            raise InputError(f"{option} {shown}: {remedy}")
        if len(numbers) == 3:
            first, last, step = numbers
            count = math.floor((last - first) / step + 1e-9) + 1 if step > 0.0 else 0
            if count < 1:
                raise InputError(f"{option} {shown}: has no number ({remedy})")
            if count > MOST_STARTS:
                raise InputError(f"{option} {shown}: has {count} numbers (write at most 200)")
            numbers = [round(first + k * step, 9) for k in range(count)]
        found |= set(numbers)
    if wrong := [each for each in sorted(found) if not low <= each <= high]:
        raise InputError(f"{option} {shown}: has {wrong[0]:g}; write {low:g} to {high:g} ({unit})")
    return tuple(sorted(found))


def _document(path: Path, wanted: AircraftFmu, made: WrittenFmu) -> dict[str, object]:
    return {
        "file": str(path),
        "bytes": len(made.data),
        "guid": made.guid,
        "aircraft": wanted.folder.name,
        "engine": made.engine,
        "airspeeds_mps": list(wanted.airspeeds),
        "heights_m": list(wanted.heights),
        "physics_hz": wanted.physics_hz,
        "variables": made.variables,
        "libraries_bytes": dict(made.sizes),
    }


def _print(path: Path, wanted: AircraftFmu, made: WrittenFmu, json: Path | None) -> None:
    console = result_console(json)
    console.write_heading(wanted.folder.name, f" · {path} · {format_bytes(len(made.data))}")
    console.print_table(_table(wanted, made))
    console.write_line()
    console.write_line(f" {made.engine}")
    console.write_line(f" {made.variables} variables, {made.state_bytes:,} bytes of state")
    low, high = wanted.airspeeds[0], wanted.airspeeds[-1]
    starts = f"{low:g} m/s" if low == high else f"{len(wanted.airspeeds)} airspeeds from {low:g}"
    starts += "" if low == high else f" to {high:g} m/s"
    console.write_line(f" starts at {starts}")


def _table(wanted: AircraftFmu, made: WrittenFmu) -> Table:
    from testbed.fmi.targets import targets

    table = ruled_table("target", "runs on", "library", left=["target", "runs on"])
    for name in wanted.targets:
        target = targets()[name]
        (size,) = (each for path, each in made.sizes.items() if path.split("/")[1] == target.folder)
        table.add_row(name, target.words, format_bytes(size))
    return table
