"""What a run has to do with programs outside, beside its page."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from testbed.errors import InputError
from testbed.links.addresses import Address
from testbed.scenario import Scenario
from testbed.scenario.pilots import ArduPlane, External
from testbed.sim.pace import Pace
from testbed.sim.world import World
from testbed.state import Event

if TYPE_CHECKING:
    from testbed.links.station import Station


@dataclass(frozen=True, slots=True)
class Outside:
    """Who may see and command the aircraft of a run, and how fast it flies.

    Args:
        mavlink: where every aircraft is a MAVLink vehicle.
        pace: simulated seconds per second; None: as fast as it flies.
        tlog: leave run.tlog in the run directory.
        key: 32 bytes; every frame is signed with it, and nobody without it is believed.
        arduplane: the binary, where the page asks for ArduPlane and names none.
        tell: is given what people should know while it flies: what was opened, what is waited for.
    """

    mavlink: tuple[Address, ...] = ()
    pace: float | None = None
    tlog: bool = False
    key: bytes | None = None
    arduplane: Path | None = None
    tell: Callable[[str], None] = lambda text: None

    @property
    def looks_on(self) -> bool:
        """Whether the aircraft are MAVLink vehicles."""
        return bool(self.mavlink) or self.tlog


NOBODY = Outside()


def checked(outside: Outside, page: Scenario, world: World) -> World:
    """The world, with what is to be said before the flight of who is to command it.

    Raises:
        InputError: lockstep waits for a program that has no way to speak.
    """
    if outside.mavlink:
        return world
    waited = {e.name: e.commanded_by for e in page.aircraft if isinstance(e.commanded_by, External)}
    held = [name for name, external in waited.items() if external.lockstep]
    if held:
        raise InputError(
            f"{', '.join(held)}: lockstep waits for a program outside: say where it is, as in "
            "--mavlink udpout:127.0.0.1:14550"
        )
    text = (
        "is commanded from outside, and there is no link: it circles (say where programs are, as "
        "in --mavlink udpout:127.0.0.1:14550)"
    )
    unheard = (Event(0.0, "warning", name, text) for name in waited)
    return replace(world, notes=(*world.notes, *unheard))


def make_station(outside: Outside, world: World) -> Station | None:
    """The station that programs outside speak to; None: nobody does.

    Raises:
        InputError: a port cannot be had.
    """
    if world.deck is None or not outside.looks_on:
        return None
    # few runs have one
    from testbed.links.station import Station
    from testbed.mavlink.signing import Signing, signing_time

    now = time.time()
    return Station(
        outside.mavlink,
        world.deck.cockpits,
        signing=Signing(outside.key, time=signing_time(now)) if outside.key else None,
        epoch_us=round(now * 1e6),
    )


def report(world: World, station: Station | None, pace: Pace | None) -> Mapping[str, Any]:
    """What is to be said of them at the end, for the metrics."""
    said: dict[str, Any] = {"pace": pace.report()} if pace else {}
    if station:
        said["mavlink"] = station.summary()
    if world.partners:
        said["arduplane"] = {k: v for each in world.partners for k, v in each.summary().items()}
    if world.deck:
        said["commanded"] = world.deck.asked()
    return said


def announcement(outside: Outside, page: Scenario) -> Iterator[str]:
    """What has been opened, and to whom."""
    names = page.aircraft_names
    who = f"{names[0]} to {names[-1]} are systems 1 to {len(names)}"
    how = f"at {outside.pace:g} × real time" if outside.pace else "as fast as it flies"
    for address in outside.mavlink:
        ports = " and on, a port each" if address.step else ""
        signed = ", signed" if outside.key else ""
        yield f"MAVLink: {who}, {address}{ports}{signed}, {how}"
        if not address.loopback:
            who_can = "who has the key" if outside.key else "anybody who reaches it"
            yield f"warning: {address.host} is not this machine alone: {who_can} can command"
    for row, (name, asked) in enumerate((e.name, e.autopilot) for e in page.aircraft):
        if isinstance(asked, ArduPlane):
            # few pages need them
            from testbed.ardupilot.link import HOST
            from testbed.ardupilot.link import ports as ports_of

            physics, mavlink = ports_of(row if asked.instance is None else asked.instance)
            yield f"ArduPlane: {name} by {physics}/udp and {mavlink}/tcp of {HOST}"
            if asked.start:
                yield (
                    f"warning: ArduPlane itself listens on {mavlink}, {mavlink + 2} and "
                    f"{mavlink + 3}/tcp of every address of this machine: anybody who reaches it "
                    f"can command {name}"
                )
