"""One aircraft as a MAVLink vehicle: handles messages and makes telemetry, without sockets."""

from __future__ import annotations

from collections.abc import Mapping

from testbed.core.records import Event, RunInfo
from testbed.mavlink import telemetry_status as status
from testbed.mavlink.codec import Message
from testbed.mavlink.command_protocol import CommandProtocol
from testbed.mavlink.manual_control import ManualControl
from testbed.mavlink.missions import MissionProtocol
from testbed.mavlink.outgoing import Handler, OutgoingMessage, Severity
from testbed.mavlink.parameter_protocol import ParameterProtocol
from testbed.mavlink.services import Services
from testbed.mavlink.telemetry_messages import (
    COMPANION_STATE,
    HEARTBEAT,
    LOCKSTEP_STATE,
    MessageSchedule,
    build_message,
)
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import FlightMode, VehicleControl

COMPONENT = 1  # an autopilot
HEARTBEAT_S = 1.5  # wall-clock s: keeps a run that waits visible to ground stations
_BROADCAST = 0
# Words in the names of messages that command or ask for something; others report.
_COMMANDS = frozenset(
    ("CHANGE", "COMMAND", "CONFIG", "CONFIGURE", "CONTROL", "ERASE", "FETCH", "INJECT", "MAP")
    + ("MODIFY", "PLAY", "POINT", "READ", "REQUEST", "SET", "SETUP", "START", "WRITE")
)
_ANSWER = "_ACK"
_MAX_REFUSED = 1000  # kinds of messages and senders
_ATTITUDE = " (send SET_ATTITUDE_TARGET, or DO_REPOSITION in GUIDED)"
_IN_PLACE = dict.fromkeys(
    ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"), _ATTITUDE
)
_SEVERITY = {"info": Severity.INFO, "warning": Severity.WARNING, "error": Severity.ERROR}


class MavlinkVehicle:
    """Handle the messages to one aircraft and make those from it.

    Times named `wall_s` are wall-clock times, used for timeouts; telemetry is in simulation time.

    Attributes:
        system: its MAVLink system id.
        lockstep: whether the run waits for commands to it.
    """

    def __init__(
        self, control: VehicleControl, system: int, row: int, info: RunInfo, epoch_us: int
    ) -> None:
        """Start without a sample.

        Args:
            control: takes commands to the aircraft.
            system: its MAVLink system id, 1 to 255.
            row: of the aircraft in samples.
            info: of the run.
            epoch_us: Unix time of the start of the run, µs.
        """
        self.system, self.lockstep = system, control.lockstep
        version = info.versions.get("testbed", "0")
        self._context = VehicleContext(control, system, row, info.origin, version, epoch_us)
        state = LOCKSTEP_STATE if self.lockstep else ()
        self._state = COMPANION_STATE if control.companion else state
        self._schedule = MessageSchedule(info.sample_rate_hz, self._state)
        self._parameters = ParameterProtocol(self._context)
        self._missions = MissionProtocol(self._context)
        commands = CommandProtocol(self._context, self._schedule)
        services = Services(self._context, self._schedule)
        manual = ManualControl(self._context)
        parts = (self._parameters, self._missions, commands, services, manual)
        self._handlers: Mapping[str, Handler] = {
            name: handler for part in parts for name, handler in part.handlers.items()
        }
        self._item = self._active_item()
        self._sampled: list[str] = []  # messages of the latest sample
        self._heartbeat_s = float("-inf")
        self._refused: set[tuple[int, int, str]] = set()  # sender and name

    def handle(self, message: Message, wall_s: float) -> list[OutgoingMessage]:
        """Execute a message if it is addressed to this vehicle, and return the answers."""
        if not self._is_addressed(message):
            return []
        handler = self._handlers.get(message.name)
        if handler is None:
            return self._refuse(message)
        before, self._context.wall_s = self._active_item(), wall_s
        replies = handler(message)
        if self._active_item() != before:
            self._item = self._active_item()  # by command: no item has been reached
        return replies

    def _refuse(self, message: Message) -> list[OutgoingMessage]:
        """Answer a message that commands something and has no handler: once for each sender.

        Reports, as of a gimbal, answers, and what names no vehicle are not answered.
        """
        commands = not _COMMANDS.isdisjoint(message.name.split("_"))
        if not commands or message.name.endswith(_ANSWER) or "target_system" not in message.fields:
            return []
        key = message.system, message.component, message.name
        if key in self._refused or len(self._refused) >= _MAX_REFUSED:
            return []
        self._refused.add(key)
        remedy = _IN_PLACE.get(message.name, "")
        text = f"{message.name} is ignored: not supported here{remedy}"
        return self._context.texts.make_text(Severity.WARNING, text)

    def update(self, snapshot: TelemetrySnapshot, wall_s: float) -> list[OutgoingMessage]:
        """Take a sample, and return the messages that are due with it."""
        context = self._context
        context.snapshot = snapshot
        names = self._sampled = self._schedule.due(snapshot.sample.time_s)
        if HEARTBEAT in names:
            self._heartbeat_s = wall_s
        messages = self._item_reached()
        for name in names:
            messages += build_message(name, context)
        return messages

    def poll(self, wall_s: float) -> list[OutgoingMessage]:
        """Return messages due between samples: lists, repeated requests, heartbeats."""
        self._context.wall_s = wall_s
        messages = self._parameters.poll() + self._missions.poll()
        if wall_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = wall_s
            messages.append(OutgoingMessage(HEARTBEAT, status.heartbeat(self._context)))
        return messages

    def parameter_messages(self) -> list[OutgoingMessage]:
        """Return all parameters, for a log."""
        return self._parameters.all_values()

    def repeated_state(self) -> list[OutgoingMessage]:
        """Return the messages of the latest sample again, of a vehicle that a run waits for.

        All of them: a program that has missed the first sample needs the slow ones, too.
        """
        names = self._sampled if self._state else ()
        return [message for name in names for message in build_message(name, self._context)]

    def event_text(self, event: Event) -> list[OutgoingMessage]:
        """Make the STATUSTEXT of an event."""
        severity = _SEVERITY.get(event.level, Severity.WARNING)
        return self._context.texts.make_text(severity, event.text)

    def _item_reached(self) -> list[OutgoingMessage]:
        """Report the previous mission item when the aircraft goes on to the next."""
        before, self._item = self._item, self._active_item()
        if before == self._item or None in (before, self._item):
            return []
        reached = OutgoingMessage("MISSION_ITEM_REACHED", {"seq": before or 0})
        return [reached, *build_message("MISSION_CURRENT", self._context)]

    def _active_item(self) -> int | None:
        """Return the mission item that is flown; None: no mission is flown."""
        control = self._context.control
        return control.current_item if control.mode is FlightMode.AUTO else None

    def _is_addressed(self, message: Message) -> bool:
        """Check whether a message is for this vehicle, or for all."""
        fields = message.fields
        system = fields.get("target_system", fields.get("target", _BROADCAST))
        component = fields.get("target_component", _BROADCAST)
        return system in (_BROADCAST, self.system) and component in (_BROADCAST, COMPONENT)
