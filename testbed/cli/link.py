"""The command that is a bad link between two real programs: link."""

from __future__ import annotations

import gc
import math
import stat
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import (
    JsonFile,
    Quiet,
    Seed,
    load_scenario,
    output_option,
    read_time,
    scenario_names,
    value_option,
)
from testbed.cli.output import (
    MISSING,
    PipeSafeConsole,
    describe_file,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.files import check_writable, report_write_errors

if TYPE_CHECKING:
    from testbed.link.emulator import LinkEmulator, Progress
    from testbed.link.ends import End, EndAddress
    from testbed.link.link_settings import LinkSettings
    from testbed.link.packet_capture import EndCapture

LISTED = 12  # kinds of messages of one direction
NEVER = "this link reaches an aircraft: never in flight"

Document = Mapping[str, Any]


class UnitChoice(StrEnum):
    """What is lost at once."""

    FRAMES = "frames"
    DATAGRAMS = "datagrams"


class RadioChoice(StrEnum):
    """The radio that answers at both ends."""

    SIK = "sik"


_END = "udpin:HOST:PORT listens, udpout:HOST:PORT sends there, serial:DEVICE:BAUD, or pty:"


def link_command(
    a: Annotated[str, typer.Argument(metavar="A", help=f"First end: {_END}.")],
    b: Annotated[str, typer.Argument(metavar="B", help="Second end, as A.")],
    network: Annotated[
        Path | None,
        value_option("FILE.yaml", "What the link does: a section `network` as in a scenario."),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="In place of a file, the network of this scenario, with --between.",
            autocompletion=scenario_names,
        ),
    ] = None,
    between: Annotated[
        tuple[str, str] | None,
        value_option("NAME NAME", "Aircraft of the scenario at A and at B."),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a key of the file or the scenario, e.g. network.loss=0.1; may be "
            "repeated.",
        ),
    ] = None,
    seed: Seed = None,
    unit: Annotated[
        UnitChoice | None,
        typer.Option(
            help="What is lost at once.  \\[default: of the file; else frames if an end is a "
            "serial line or with --radio, and datagrams if not]"
        ),
    ] = None,
    radio: Annotated[
        RadioChoice | None,
        typer.Option(help="Send RADIO_STATUS to both ends, as SiK radios do."),
    ] = None,
    duration: Annotated[
        str | None,
        value_option("TIME", "End after this time: 120, 90s or 2m.  \\[default: at Ctrl-C]"),
    ] = None,
    pcap: Annotated[
        Path | None,
        output_option(
            metavar="FILE.pcap",
            help="Record the packets at both ends: FILE.a.pcap and FILE.b.pcap, by their names.",
            suffixes=(".pcap",),
        ),
    ] = None,
    tlog: Annotated[
        Path | None,
        output_option(
            metavar="FILE.tlog",
            help="Record the MAVLink frames at both ends: FILE.a.tlog and FILE.b.tlog.",
            suffixes=(".tlog",),
        ),
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Be a bad radio, or a bad network, between two real programs.

    Carries packets between A and B, both ways, with delay, jitter, loss, rate and all else that
    `network` of a scenario has. The same seed and names lose the same packets, here and in a run.

    A ground station on its usual port, and a vehicle of this program, through a slow radio: testbed
    link udpout:127.0.0.1:14550 udpin:127.0.0.1:14555 --network examples/sik-57600.yaml, beside
    testbed run simulation-3 --mavlink 14555.

    On the bench only: packets are lost on purpose, and a program that is late or ends takes the
    link with it. Never between an aircraft in flight and its pilot.

    The file has network, and if needed ends (their names, a and b), unit, radio and positions.
    What passed is printed at the end by direction, system and message; --json writes all of it.
    """
    from testbed.link.emulator import LinkEmulator
    from testbed.link.ends import check_apart, open_end, parse_end
    from testbed.mavlink.codec import load_dialect
    from testbed.runs.stop_request import stop_on_signals

    load_dialect()
    addresses = parse_end(a), parse_end(b)
    check_apart(*addresses)
    streams = addresses[0].is_stream, addresses[1].is_stream
    duration_s = math.inf if duration is None else read_time("--duration", duration)
    if network is not None and scenario is not None:
        raise InputError(f"--scenario {scenario}: --network has the network; leave one of them out")
    if (scenario is None) != (between is None):
        raise InputError("--scenario and --between go together: write --between uav1 uav2")
    settings = _settings(network, scenario, between, overrides or (), seed, unit, radio, streams)
    messages = message_console()
    with stop_on_signals() as stop, ExitStack() as stack:
        ends: list[End] = []
        for address in addresses:
            ends.append(open_end(address))
            stack.callback(ends[-1].close)
        captures, files = _captures(settings, addresses, pcap, tlog, messages)
        for capture in captures:
            stack.callback(capture.close)
        emulator = LinkEmulator(settings, (ends[0], ends[1]), streams, captures)
        lost: ExternalProgramLost | None = None
        gc.collect()
        gc.freeze()  # what lives as long as the link is not searched again while packets wait
        try:
            with _live_line(settings, hidden=quiet) as progress:
                for line in _begin_lines(settings, addresses, ends):
                    messages.write_line(line, "yellow" if line.startswith("warning") else "")
                emulator.run(stop, duration_s=duration_s, progress=progress)
        except ExternalProgramLost as error:
            lost = error
        stopped = stop()
    _finish(emulator, settings, addresses, files, json, quiet=quiet)
    if lost is not None:
        raise lost
    raise typer.Exit(ExitCode.INTERRUPTED if stopped else ExitCode.OK)


def _settings(
    file: Path | None,
    scenario: str | None,
    between: tuple[str, str] | None,
    overrides: Sequence[str],
    seed: int | None,
    unit: UnitChoice | None,
    radio: RadioChoice | None,
    streams: tuple[bool, bool],
) -> LinkSettings:
    """Read what the link does.

    Raises:
        InputError: it cannot be used.
    """
    from testbed.link.link_file import DATAGRAMS, FRAMES, load_link_file
    from testbed.link.link_settings import settings_from_file, settings_from_scenario
    from testbed.scenario.arguments import check_argument
    from testbed.scenario.sections import Header

    default = FRAMES if any(streams) or radio is not None else DATAGRAMS
    chosen = [f"unit={unit}"] if unit is not None else []
    chosen += [f"radio={radio}"] if radio is not None else []
    if scenario is not None and between is not None:
        loaded = load_scenario(scenario, overrides, seed)
        frames = (unit or default) == FRAMES
        settings = settings_from_scenario(loaded, between, frames=frames, radio=radio is not None)
    else:
        if seed is not None:
            seed = check_argument("--seed", seed, Header, "seed")
        settings = settings_from_file(
            load_link_file(file, (*overrides, *chosen), unit=default), seed
        )
    if any(streams) and not settings.frames:
        raise InputError(
            "unit: datagrams: a serial line has none; write unit: frames, or UDP at both ends"
        )
    return settings


def _captures(
    settings: LinkSettings,
    addresses: tuple[EndAddress, EndAddress],
    pcap: Path | None,
    tlog: Path | None,
    messages: PipeSafeConsole,
) -> tuple[list[EndCapture], list[Path]]:
    """Open what records at both ends; return it with its files."""
    from testbed.link.packet_capture import EndCapture, socket_of

    if pcap is None and tlog is None:
        return [], []
    sockets = [socket_of(address, end) for end, address in enumerate(addresses)]
    captures, files = [], []
    for end, name in enumerate(settings.names):
        packets, frames = _beside(pcap, name), _beside(tlog, name)
        files += [path for path in (packets, frames) if path is not None]
        captures.append(
            EndCapture(
                (sockets[end], sockets[1 - end]),
                packets,
                frames,
                lambda text: messages.write_line(f"warning: {text}", "yellow"),
            )
        )
    return captures, files


def _beside(path: Path | None, name: str) -> Path | None:
    """Return the file of one end: FILE.NAME.pcap.

    Raises:
        InputError: it cannot be written.
    """
    if path is None:
        return None
    found = path.with_suffix(f".{name}{path.suffix}")
    with report_write_errors(found):
        check_writable(found)
    if found.exists() and not stat.S_ISREG(found.stat().st_mode):
        raise InputError(f"{found}: is no regular file; write another name")
    return found


def _begin_lines(
    settings: LinkSettings, addresses: Sequence[EndAddress], ends: Sequence[End]
) -> Iterator[str]:
    """Describe an open link."""
    named = [
        f"{name} {end.describe() or address}"
        for name, address, end in zip(settings.names, addresses, ends, strict=True)
    ]
    unit = "frames, in order" if settings.frames else "datagrams"
    radio = ", with RADIO_STATUS" if settings.radio else ""
    yield f"link: {named[0]} · {named[1]} · {unit}{radio} · seed {settings.seed}"
    for address in addresses:
        if address.may_reach_aircraft:
            yield f"warning: {address}: {NEVER}"


@contextmanager
def _live_line(
    settings: LinkSettings, *, hidden: bool
) -> Iterator[Callable[[Sequence[Progress]], None] | None]:
    """Show in a terminal what passes, second by second.

    The loop writes the line itself: a thread that draws would delay packets.
    """
    console = message_console()
    if hidden or not console.is_terminal:
        yield None
        return
    seconds, last = 0, [0, 0]

    def update(both: Sequence[Progress]) -> None:
        nonlocal seconds
        seconds += 1
        parts = [f"{seconds} s"]
        for end, now in enumerate(both):
            share = f"{100 * now.lost / now.offered:.1f} % lost, " if now.offered else ""
            parts.append(
                f"{_arrow(settings, end)} {now.offered - last[end]:,}/s, {share}"
                f"{now.on_way:,} on the way"
            )
            last[end] = now.offered
        _write_over(" · ".join(parts)[: console.width - 1])

    try:
        yield update
    finally:
        _write_over("")


def _write_over(text: str) -> None:
    """Write a line of a terminal over the one before."""
    with suppress(OSError, ValueError):  # it is closed
        sys.stderr.write(f"\r\x1b[2K{text}")
        sys.stderr.flush()


def _arrow(settings: LinkSettings, end: int) -> str:
    return f"{settings.names[end]} > {settings.names[1 - end]}"


def _finish(
    emulator: LinkEmulator,
    settings: LinkSettings,
    addresses: Sequence[EndAddress],
    files: Sequence[Path],
    json: Path | None,
    *,
    quiet: bool,
) -> None:
    """Write the JSON, and print the tables."""
    summary = emulator.summary()
    names = dict(zip(settings.names, map(str, addresses), strict=True))
    document = {"addresses": names, **summary, "files": [str(path) for path in files]}
    write_json_output(json, document)
    if quiet:
        return
    console = result_console(json)
    console.write_line()
    _print_directions(console, document)
    for sender, receivers in document["links"].items():
        for receiver, link in receivers.items():
            if link["messages"]:
                console.write_line()
                _print_messages(console, f"{sender} > {receiver}", link["messages"])
    found = document["emulator"]
    if late := found["late_s"]:
        console.write_line()
        console.write_line(
            f" delivered late by p50 {1e3 * late['p50']:.2f}, p99 {1e3 * late['p99']:.2f}, "
            f"max {1e3 * late['max']:.1f} ms; {100 * found['processor_share']:.0f} % of a core"
        )
    for key, text in (
        ("unread", "came faster than they were read"),
        ("not_sent", "had no program to take them at the other end"),
        ("overflow", "were too many on their way"),
    ):
        if found[key]:
            console.write_line(f" {found[key]:,} packets {text}", "yellow")
    for path in files:
        console.write_line(f" recorded  {describe_file(path)}")


def _print_directions(console: PipeSafeConsole, document: Document) -> None:
    table = ruled_table(
        "link", "offered", "delivered", "p50, ms", "p95", "p99", "lost", left="lost"
    )
    for sender, receivers in document["links"].items():
        for receiver, link in receivers.items():
            reasons = {**link["lost"], **({"muted": link["muted"]} if link["muted"] else {})}
            table.add_row(
                f"{sender} > {receiver}",
                f"{link['sent'] + link['muted']:,}",
                f"{link['delivered']:,}",
                *_delay_cells(link["delay_s"]),
                ", ".join(f"{name} {count:,}" for name, count in reasons.items()) or "0",
            )
    console.print_table(table)


def _print_messages(
    console: PipeSafeConsole, link: str, messages: Sequence[Mapping[str, Any]]
) -> None:
    table = ruled_table(
        link, "message", "offered", "Hz", "lost, %", "p50, ms", "p95", "p99", left=("message",)
    )
    most = sorted(messages, key=lambda each: -each["offered"])[:LISTED]
    for each in sorted(most, key=messages.index):
        lost = 100.0 * (each["offered"] - each["delivered"]) / each["offered"]
        table.add_row(
            "" if each["system"] is None else f"system {each['system']}",
            each["message"],
            f"{each['offered']:,}",
            MISSING if each["rate_hz"] is None else f"{each['rate_hz']:.1f}",
            f"{lost:.1f}",
            *_delay_cells(each["delay_s"]),
        )
    console.print_table(table)
    if (more := len(messages) - len(most)) > 0:
        console.write_line(f" and {more:,} further kinds, in the file of --json", "dim")


def _delay_cells(delay: Mapping[str, float] | None) -> list[str]:
    keys = ("p50", "p95", "p99")
    return [MISSING] * 3 if delay is None else [f"{1e3 * delay[key]:.1f}" for key in keys]
