"""The command `companion`: fly one real or simulated aircraft of a formation."""

from __future__ import annotations

import gc
from collections.abc import Mapping
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import (
    JsonFile,
    Overrides,
    Quiet,
    ScenarioName,
    Seed,
    error_places,
    load_scenario,
    value_option,
)
from testbed.cli.output import (
    PipeSafeConsole,
    message_console,
    result_console,
    write_json_output,
)
from testbed.core.errors import ExternalProgramLost

if TYPE_CHECKING:
    from testbed.companion.control_loop import CompanionLoop, FlightListener
    from testbed.companion.engagement import CompanionText
    from testbed.companion.flight_record import FlightRecord
    from testbed.companion.follower_control import FollowerControl
    from testbed.companion.start import CompanionOptions
    from testbed.scenario import Scenario

NEVER_FLOWN = (
    "never flown on an aircraft, on a Raspberry Pi or against a real ArduPlane: safety pilot and "
    "local rules first"
)


class LeaveChoice(StrEnum):
    """The mode that is asked for when it leaves."""

    LOITER = "loiter"
    RTL = "rtl"


def companion_command(
    scenario: ScenarioName,
    name: Annotated[
        str,
        typer.Option(
            "--as",
            metavar="NAME",
            help="The aircraft that carries it: a follower, which it flies, or the leader, whose "
            "state it only broadcasts.",
        ),
    ],
    autopilot: Annotated[
        str,
        value_option(
            "END",
            "Its autopilot: serial:DEVICE:BAUD, udpin:HOST:PORT listens, udpout:HOST:PORT sends "
            "there.",
        ),
    ],
    formation: Annotated[
        str,
        value_option(
            "ADDRESS",
            "The others: multicast:GROUP:PORT@IP, with the own address of the interface; "
            "peers:HOST:PORT,HOST:PORT with one address for each aircraft, the leader's first; or "
            "hub:HOST:PORT.",
        ),
    ],
    overrides: Overrides = None,
    seed: Seed = None,
    leave: Annotated[
        LeaveChoice, typer.Option(help="Mode that it asks for when it leaves the formation.")
    ] = LeaveChoice.LOITER,
    mavlink_key: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Sign messages and accept signed ones only; the same key for all. The file holds "
            "a passphrase or 64 hexadecimal digits. Serial lines are not signed.",
        ),
    ] = None,
    unsigned: Annotated[
        bool,
        typer.Option(
            "--unsigned",
            help="Use links that leave this computer without a key: anyone who reaches the port "
            "can fly the aircraft.",
        ),
    ] = False,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep",
            help="Answer each sample of a run that waits for it, from the first on. On this "
            "computer only.",
        ),
    ] = False,
    at_once: Annotated[
        bool,
        typer.Option(
            "--at-once",
            help="Command from the first sample on, without the pilot's switch: a simulated "
            "aircraft. On this computer only.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Directory of the log, to be created.  \\[default: logs/<scenario>/<UTC>-<id>]",
        ),
    ] = None,
    write_log: Annotated[
        bool, typer.Option("--log/--no-log", help="Write the log of the flight.")
    ] = True,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Fly one aircraft of a formation from the computer aboard it.

    Never flown on an aircraft, on a Raspberry Pi or against a real ArduPlane: a safety pilot and
    the rules of the place come first. Kill it on the bench before every first flight.

    It reads its aircraft's state from the autopilot by MAVLink, exchanges FOLLOW_TARGET with the
    others, runs the law of the scenario, and commands roll, pitch and throttle by
    SET_ATTITUDE_TARGET. The pilot engages it by the switch into GUIDED and ends it by any other
    mode. It never arms, and asks for one mode only: that of leaving, once, while GUIDED is on.

    On a bench, with a simulated aircraft: testbed run simulation-3 --set
    fleet.uav2.commanded_by=external --mavlink 14560+1, beside testbed companion simulation-3 --as
    uav2 --autopilot udpin:127.0.0.1:14562 --formation multicast:239.255.41.1:14600.

    A link that leaves this computer needs --mavlink-key, or --unsigned. All reasons to refuse and
    to leave are in docs/companion.md.
    """
    from testbed.companion.engagement import LeaveMode
    from testbed.companion.follower_control import FollowerControl
    from testbed.companion.formation_link import parse_formation
    from testbed.companion.start import CompanionOptions, open_companion
    from testbed.link.ends import parse_end
    from testbed.mavlink.codec import load_dialect
    from testbed.runs.stop_request import stop_on_signals

    load_dialect()
    loaded = load_scenario(scenario, overrides, seed)
    names = loaded.aircraft_names
    options = CompanionOptions(
        parse_end(autopilot),
        parse_formation(formation, names),
        _read_key(mavlink_key),
        unsigned,
        LeaveMode[leave.name],
        lockstep=lockstep,
        at_once=at_once,
    )
    options.check()
    messages = message_console()
    with stop_on_signals() as stop, ExitStack() as closing:
        with error_places(scenario, overrides):
            control = FollowerControl(loaded, name)
        for line in _begin_lines(loaded, name, options):
            messages.write_line(line, "yellow" if line.startswith("warning") else "")
        supervised = _Supervised()
        closing.callback(supervised.close)
        listeners: list[FlightListener] = [_Printer(messages), supervised]
        record = _open_record(loaded, control, out, messages) if write_log else None
        if record is not None:
            listeners.append(record)
        lost: Exception | None = None
        folder = Path(scenario).resolve().parent
        with open_companion(loaded, folder, control, options, listeners) as loop:
            gc.collect()
            gc.freeze()  # what lives as long as the flight is not searched again
            try:
                loop.run(stop)
            except ExternalProgramLost as error:
                lost = error
            statistics = loop.statistics.summary()  # of the flight, without what ends it
        if record is not None:
            record.close(statistics)
    _finish(statistics, record, json, quiet=quiet)
    if lost is not None:
        raise lost
    if loop.error is not None:
        raise loop.error
    raise typer.Exit(ExitCode.OK)


def _read_key(file: Path | None) -> bytes | None:
    from testbed.mavlink.signing import is_shared, read_key

    if file is None:
        return None
    key = read_key(file)
    if is_shared(file):
        text = f"other users may read it; write chmod 600 {file}"
        message_console().write_line(f"warning: --mavlink-key {file}: {text}", "yellow")
    return key


def _begin_lines(scenario: Scenario, name: str, options: CompanionOptions) -> list[str]:
    """Describe a companion before its flight."""
    from testbed.companion.scenario_warnings import scenario_warnings

    signed = "signed" if options.key else "unsigned"
    lines = [f"companion of {name}: {options.autopilot} · {options.formation} · {signed}"]
    if options.reaches_aircraft:
        lines.append(f"warning: {NEVER_FLOWN}")
        if options.key is None:
            lines.append("warning: --unsigned: anyone who reaches the port can fly the aircraft")
        lines += [f"warning: {each}" for each in scenario_warnings(scenario)]
    return lines


class _Printer:
    """Print the texts for the pilot."""

    def __init__(self, console: PipeSafeConsole) -> None:
        self._console = console

    def sample(self, loop: CompanionLoop) -> None:
        """Take a sample; nothing is printed."""

    def text(self, boot_s: float, text: CompanionText) -> None:
        """Print a text."""
        self._console.write_line(f"{boot_s:8.2f} s  {text.text}")

    def alive(self, now_s: float) -> None:
        """Note that the loop runs; nothing is printed."""


class _Supervised:
    """Notify a service manager, if there is one, that the companion runs."""

    def __init__(self) -> None:
        from testbed.companion.watchdog import Watchdog

        self._watchdog, self._is_ready = Watchdog(), False

    def sample(self, loop: CompanionLoop) -> None:
        """Notify at the first sample that the companion is ready."""
        if not self._is_ready:
            self._is_ready = True
            self._watchdog.ready()

    def text(self, boot_s: float, text: CompanionText) -> None:
        """Set the newest text as the state of the service."""
        self._watchdog.status(text.text)

    def alive(self, now_s: float) -> None:
        """Notify that the loop runs."""
        if self._is_ready:
            self._watchdog.alive(now_s)

    def close(self) -> None:
        """Notify that it ends."""
        self._watchdog.close()


def _open_record(
    scenario: Scenario, control: FollowerControl, out: Path | None, messages: PipeSafeConsole
) -> FlightRecord:
    from testbed.companion.flight_record import FlightRecord

    return FlightRecord(
        scenario, control, out, lambda text: messages.write_line(f"warning: {text}", "yellow")
    )


def _finish(
    document: Mapping[str, Any],
    record: FlightRecord | None,
    json: Path | None,
    *,
    quiet: bool,
) -> None:
    """Write the statistics, and print them."""
    write_json_output(json, document)
    if quiet:
        return
    console = result_console(json)
    for line in summary_lines(document):
        console.write_line(f" {line}")
    if record is not None:
        console.write_line(f" log {record.directory}")


def summary_lines(document: Mapping[str, Any]) -> list[str]:
    """Describe a flight's statistics."""
    lines = [f"{document['samples']:,} samples, {document['commands']:,} commands"]
    if latency := document["state_to_command_s"]:
        lines.append(
            f"state to command p50 {1e3 * latency['p50']:.2f}, p99 {1e3 * latency['p99']:.2f}, max "
            f"{1e3 * latency['max']:.1f} ms"
        )
    for name, age in document["age_s"].items():
        if age:
            lines.append(f"age of {name} p50 {1e3 * age['p50']:.1f}, p99 {1e3 * age['p99']:.1f} ms")
    share = document["processor_share"] or 0.0
    lines.append(f"{100 * share:.1f} % of a core, {document['peak_memory_mb']:.0f} MB at most")
    return lines
