"""One aircraft as a MAVLink vehicle: what it hears and what it says. No socket is known here."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

from testbed.links import status
from testbed.links.catalogue import HEARTBEAT, STATE, built
from testbed.links.cockpit import Cockpit, Mode
from testbed.links.commands import Commands
from testbed.links.craft import Craft
from testbed.links.missions import Missions
from testbed.links.parameters import Parameters
from testbed.links.replies import Handler, Reply, Severity
from testbed.links.scene import Scene
from testbed.links.schedule import Schedule
from testbed.links.services import Services
from testbed.links.sticks import Sticks
from testbed.mavlink.door import Message
from testbed.state import Event, RunInfo

COMPONENT = 1  # an autopilot
BEAT_S = 1.5  # of wall-clock time: a run that stands still must not seem to have ended
_EVERYBODY = 0
_SEVERITY = {"info": Severity.INFO, "warning": Severity.WARNING, "error": Severity.ERROR}


class Vehicle:
    """An aircraft that programs outside see and may command.

    Times named `at_s` are of the wall clock, by which those programs wait; telemetry is in
    simulation time.

    Attributes:
        system: its MAVLink number.
        lockstep: whether the run waits for its commands.
    """

    def __init__(
        self, cockpit: Cockpit, system: int, row: int, info: RunInfo, epoch_us: int
    ) -> None:
        """A vehicle that has said nothing yet.

        Args:
            cockpit: what may be done with the aircraft.
            system: its MAVLink number, 1 to 255.
            row: of it in every frame.
            info: of the run.
            epoch_us: what its clock calls the start, µs since 1970.
        """
        self.system, self.lockstep = system, cockpit.lockstep
        version = info.versions.get("testbed", "0")
        self._craft = Craft(cockpit, system, row, info.origin, version, epoch_us)
        self._schedule = Schedule(info.frame_rate_hz, lockstep=self.lockstep)
        self._parameters = Parameters(self._craft)
        self._missions = Missions(self._craft)
        commands = Commands(self._craft, self._schedule)
        services = Services(self._craft, self._schedule)
        parts = (self._parameters, self._missions, commands, services, Sticks(self._craft))
        self._handlers: Mapping[str, Handler] = dict(
            itertools.chain.from_iterable(part.handlers.items() for part in parts)
        )
        self._flown = self._flying()
        self._beat_s = float("-inf")

    def hear(self, message: Message, at_s: float) -> list[Reply]:
        """Do what a message says if it is meant for this vehicle, and answer."""
        handler = self._handlers.get(message.name)
        if handler is None or not self._meant(message):
            return []
        before = self._flying()
        replies = handler(message, at_s)
        if self._flying() != before:
            self._flown = self._flying()  # as told: no item has been reached
        return replies

    def look(self, scene: Scene, at_s: float) -> list[Reply]:
        """See a frame, and say what is due with it."""
        craft = self._craft
        craft.scene = scene
        names = self._schedule.due(scene.frame.time_s)
        if HEARTBEAT in names:
            self._beat_s = at_s
        replies = self._progress()
        for name in names:
            replies += built(name, craft)
        return replies

    def due(self, at_s: float) -> list[Reply]:
        """What is due between frames: lists under way, questions not answered, signs of life."""
        replies = self._parameters.due() + self._missions.due(at_s)
        if at_s - self._beat_s >= BEAT_S:
            self._beat_s = at_s
            replies.append(Reply(HEARTBEAT, status.heartbeat(self._craft)))
        return replies

    def parameters(self) -> list[Reply]:
        """All its parameters, for a log."""
        return self._parameters.every()

    def state(self) -> list[Reply]:
        """The state of the latest frame, again."""
        return [reply for name in STATE for reply in built(name, self._craft)]

    def report(self, event: Event) -> list[Reply]:
        """Say an event of this aircraft in words."""
        return self._craft.texts.say(_SEVERITY.get(event.level, Severity.WARNING), event.text)

    def _progress(self) -> list[Reply]:
        """Say which item of a mission is behind it, when it goes on to the next."""
        before, self._flown = self._flown, self._flying()
        if before == self._flown or None in (before, self._flown):
            return []
        reached = Reply("MISSION_ITEM_REACHED", {"seq": before or 0})
        return [reached, *built("MISSION_CURRENT", self._craft)]

    def _flying(self) -> int | None:
        """The item of the mission it is on; None: it flies none."""
        cockpit = self._craft.cockpit
        return cockpit.item if cockpit.mode is Mode.AUTO else None

    def _meant(self, message: Message) -> bool:
        """Whether it is for this vehicle, or for everybody."""
        fields = message.fields
        system = fields.get("target_system", fields.get("target", _EVERYBODY))
        component = fields.get("target_component", _EVERYBODY)
        return system in (_EVERYBODY, self.system) and component in (_EVERYBODY, COMPONENT)
