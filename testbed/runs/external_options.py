"""Options of a run that concern external programs: MAVLink links, pace, ArduPlane."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from testbed.commands.tick_gate import RealTimePacer, check_pace
from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.flight.world import World
from testbed.mavlink.udp_endpoint import Address, parse_address
from testbed.scenario import Scenario
from testbed.scenario.aircraft import External
from testbed.scenario.arguments import check_argument, check_calls, check_path, to_plain
from testbed.scenario.fields import Flag, Section, is_number
from testbed.scenario.validate import shown_value

if TYPE_CHECKING:
    from testbed.mavlink.server import MavlinkServer


@dataclass(frozen=True, slots=True)
class ExternalOptions:
    """Links to external programs, and the pace of a run.

    Args:
        mavlink: addresses at which every aircraft is a MAVLink vehicle.
        pace: simulated seconds per second, 0.001 to 1e6; None or 0: as fast as possible.
        tlog: write run.tlog to the run directory.
        signing_key: 32 bytes; frames are signed with it, and others are rejected.
        arduplane: the program, where the scenario asks for ArduPlane and names none.
        companions: fly every follower by a companion in a process of its own, which this run
            starts and ends; in lockstep, or with a pace in real time.
        quiet: leave out messages about the ports of ArduPlanes.
        announce: receives messages to the user during the run: open ports, long waits.

    Raises:
        InputError: an argument is wrong; the text begins with its name.
    """

    mavlink: tuple[Address, ...] = ()
    pace: float | None = None
    tlog: bool = False
    signing_key: bytes | None = None
    arduplane: Path | None = None
    companions: bool = False
    quiet: bool = False
    announce: Callable[[str], None] = field(default=lambda text: None, repr=False)

    def __post_init__(self) -> None:
        """Check all arguments."""
        from testbed.mavlink.signing import check_key  # as few runs have a server

        _check_addresses(self.mavlink)
        pace = to_plain("pace", self.pace)
        off = pace is None or (is_number(pace) and pace == 0)
        object.__setattr__(self, "pace", None if off else check_pace("pace", pace))
        for name in ("tlog", "companions", "quiet"):
            check_argument(name, getattr(self, name), _OptionArguments, name)
        if self.signing_key is not None:
            check_key("signing_key", self.signing_key)
        if self.arduplane is not None:
            object.__setattr__(self, "arduplane", check_path("arduplane", self.arduplane))
        check_calls("announce", self.announce)

    @property
    def has_server(self) -> bool:
        """Whether the run has a MAVLink server."""
        return bool(self.mavlink) or self.tlog or self.companions


class _OptionArguments(Section):
    tlog: Flag = Field(description="Whether run.tlog is written.")
    companions: Flag = Field(description="Whether companions are started.")
    quiet: Flag = Field(description="Whether messages about ports are left out.")


def _check_addresses(addresses: object) -> None:
    """Check that addresses are those that the command line reads.

    Raises:
        InputError: one is not.
    """
    example = "parse_address('udpout:127.0.0.1:14550')"
    if not isinstance(addresses, tuple | list):
        raise InputError(f"mavlink: is {shown_value(addresses)} (write ({example},))")
    for index, each in enumerate(addresses):
        name = f"mavlink[{index}]"
        if not isinstance(each, Address):
            raise InputError(f"{name}: is {shown_value(each)} (write {example})")
        try:
            read = parse_address(str(each))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        except ValueError:  # of the text of such a number
            digits = "has a number of thousands of digits"
            raise InputError(f"{name}: {digits} (write a port of 1 to 65535)") from None
        if read != each:
            raise InputError(f"{name}: is {shown_value(each)}, which reads as {read} (write that)")


NO_EXTERNAL = ExternalOptions()


def check_links(options: ExternalOptions, scenario: Scenario, world: World) -> World:
    """Return the world with a warning for each external aircraft that has no link.

    Raises:
        InputError: lockstep waits for a program that has no link.
    """
    if options.mavlink or options.companions:
        return world
    sources = {
        e.name: e.commanded_by for e in scenario.aircraft if isinstance(e.commanded_by, External)
    }
    waiting = [name for name, external in sources.items() if external.lockstep]
    if waiting:
        raise InputError(
            f"{', '.join(waiting)}: lockstep waits for an external program: write its address, as "
            "in --mavlink udpout:127.0.0.1:14550"
        )
    text = (
        "commanded_by: external, but there is no link: it circles (write the address of the "
        "program, as in --mavlink udpout:127.0.0.1:14550)"
    )
    warnings = (Event(0.0, "warning", name, text) for name in sources)
    return replace(world, initial_events=(*world.initial_events, *warnings))


def make_server(
    options: ExternalOptions, world: World, epoch_us: int | None = None
) -> MavlinkServer | None:
    """Open the MAVLink links of a run; None: it has none.

    Args:
        options: of the run.
        world: that is flown.
        epoch_us: Unix time of the start of the run, µs; None: now.

    Raises:
        InputError: a port is not available, or pymavlink is not installed.
    """
    if world.external_control is None or not options.has_server:
        return None
    # imported here, as few runs have a server
    from testbed.mavlink.codec import load_dialect
    from testbed.mavlink.server import MavlinkServer
    from testbed.mavlink.signing import Signing, signing_time

    load_dialect()

    now, key = time.time(), options.signing_key
    return MavlinkServer(
        options.mavlink,
        world.external_control.vehicles,
        signing=Signing(key, time=signing_time(now), strict=True) if key else None,
        epoch_us=round(now * 1e6) if epoch_us is None else epoch_us,
    )


def external_summary(
    world: World, server: MavlinkServer | None, pacer: RealTimePacer | None
) -> Mapping[str, Any]:
    """Summarise pace, links, ArduPlanes and external commands for the metrics."""
    summary: dict[str, Any] = {"pace": pacer.summary()} if pacer else {}
    if server:
        summary["mavlink"] = server.summary()
    if world.external_processes:
        processes = world.external_processes
        summary["arduplane"] = {k: v for each in processes for k, v in each.summary().items()}
    if commands := world.external_control or world.array_commands:
        summary["commanded"] = commands.command_counts()
    return summary


def announcements(options: ExternalOptions, scenario: Scenario) -> Iterator[str]:
    """Describe the MAVLink links, with a warning for those that other machines reach."""
    names = scenario.aircraft_names
    systems = f"{names[0]} to {names[-1]} are systems 1 to {len(names)}"
    pace = f"at {options.pace:g} × real time" if options.pace else "as fast as possible"
    for address in options.mavlink:
        ports = ", one port for each aircraft" if address.step else ""
        signed = ", signed" if options.signing_key else ""
        yield f"MAVLink: {systems}, {address}{ports}{signed}, {pace}"
        if not address.loopback:
            peers = "with the key " if options.signing_key else ""
            yield (
                f"warning: {address.host} is not only this machine: any program {peers}that "
                "reaches it can command the aircraft"
            )
