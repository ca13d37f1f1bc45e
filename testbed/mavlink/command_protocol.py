"""The command protocol: https://mavlink.io/en/services/command.html.

Every command is answered with one COMMAND_ACK.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import NamedTuple

from testbed.mavlink.altitude_frames import (
    ABOVE_TERRAIN,
    POSITION_FRAMES,
    TERRAIN_NOTE,
    altitude_above_home,
    frame_error,
)
from testbed.mavlink.codec import Message, constant
from testbed.mavlink.missions import check_position
from testbed.mavlink.outgoing import Fields, Handler, OutgoingMessage, sender_of
from testbed.mavlink.telemetry_messages import MessageSchedule, build_message, message_names
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import FlightMode, Rejection

_FORCE = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM
_CUSTOM = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_E7 = 1e7
_MODES = frozenset(map(float, FlightMode))
_RTL = 11.0  # ArduPlane's mode
_NO_REBOOT = "Reboot: not possible during a run"


class Result(IntEnum):
    """Result of a command: MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    COMMAND_INT_ONLY = 8
    UNSUPPORTED_FRAME = 9


class CommandRequest(NamedTuple):
    """A command from a COMMAND_LONG or a COMMAND_INT."""

    command: int
    # param1 to param7; a position is in degrees
    params: tuple[float, float, float, float, float, float, float]
    frame: int | None  # MAV_FRAME; None: of a COMMAND_LONG, which has none


class CommandReply(NamedTuple):
    """The result of a command, and the messages after its COMMAND_ACK."""

    result: Result
    messages: tuple[OutgoingMessage, ...] = ()


class CommandProtocol:
    """Execute commands, and answer with the result and the reason of a rejection."""

    def __init__(self, context: VehicleContext, schedule: MessageSchedule) -> None:
        self._context, self._schedule = context, schedule
        self.handlers: Mapping[str, Handler] = {
            "COMMAND_LONG": self._handle,
            "COMMAND_INT": self._handle,
            "SET_MODE": self._set_mode,
        }
        self._commands: Mapping[int, Callable[[CommandRequest], CommandReply]] = {
            constant(f"MAV_CMD_{name}"): execute
            for name, execute in {
                "COMPONENT_ARM_DISARM": self._arm,
                "DO_SET_MODE": lambda request: self._change_mode(*request.params[:2]),
                "DO_REPOSITION": self._reposition,
                "DO_CHANGE_SPEED": self._change_speed,
                "MISSION_START": self._start_mission,
                "DO_SET_MISSION_CURRENT": self._set_current,
                # circles the current position, as the command has none
                "NAV_LOITER_UNLIM": lambda request: self._change_mode(_CUSTOM, FlightMode.LOITER),
                "SET_MESSAGE_INTERVAL": self._set_interval,
                "GET_MESSAGE_INTERVAL": lambda request: self._interval(request.params[0]),
                "REQUEST_MESSAGE": self._request,
                "REQUEST_AUTOPILOT_CAPABILITIES": self._capabilities,
                "GET_HOME_POSITION": lambda request: self._build("HOME_POSITION"),
                "PREFLIGHT_REBOOT_SHUTDOWN": lambda request: self._denied(_NO_REBOOT),
                "NAV_RETURN_TO_LAUNCH": lambda request: self._reply(_unsupported("RTL")),
                "NAV_TAKEOFF": lambda request: self._reply(_unsupported("TAKEOFF")),
                "NAV_LAND": lambda request: self._reply(_unsupported("LAND")),
            }.items()
        }

    def _handle(self, message: Message) -> list[OutgoingMessage]:
        request = _read(message)
        execute = self._commands.get(request.command)
        reply = CommandReply(Result.UNSUPPORTED) if execute is None else execute(request)
        return _answer(message, request.command, reply)

    def _set_mode(self, message: Message) -> list[OutgoingMessage]:
        """Execute a SET_MODE, which ArduPilot answers like a command."""
        base, custom = message.number("base_mode"), message.number("custom_mode")
        return _answer(
            message, constant("MAVLINK_MSG_ID_SET_MODE"), self._change_mode(base, custom)
        )

    def _arm(self, request: CommandRequest) -> CommandReply:
        arm, force = request.params[:2]
        if arm not in (0.0, 1.0):
            return self._denied("Arming: give 1, or 0 to disarm")
        return self._reply(self._context.control.set_armed(arm == 1.0, force=force == _FORCE))

    def _change_mode(self, base: float, custom: float) -> CommandReply:
        modes = ", ".join(f"{mode.value} {mode.name}" for mode in FlightMode)
        if not math.isfinite(base) or not int(base) & _CUSTOM:
            return self._denied(f"custom mode: {modes}")
        if custom == _RTL:
            return self._denied(_unsupported("RTL").text)
        if custom not in _MODES:
            return self._denied(f"no mode {custom:.0f}: {modes}")
        return self._reply(self._context.control.set_mode(FlightMode(int(custom))))

    def _reposition(self, request: CommandRequest) -> CommandReply:
        if request.frame is None:
            return CommandReply(Result.COMMAND_INT_ONLY)  # which has the frame of the altitude
        if request.frame not in POSITION_FRAMES:
            reply = self._denied(f"Fly there: {frame_error(request.frame)}")
            return reply._replace(result=Result.UNSUPPORTED_FRAME)
        _, flags, radius, anticlockwise, latitude_deg, longitude_deg, altitude = request.params
        keep = math.isnan(altitude)
        wrong = check_position(latitude_deg, longitude_deg, 0.0 if keep else altitude)
        if wrong is not None or math.isinf(radius):
            return self._denied("Fly there: give latitude, longitude, altitude")
        control = self._context.control
        if control.mode is not FlightMode.GUIDED:
            if not math.isfinite(flags) or not int(flags) & 1:
                return self._denied("Fly there: set the flag that changes to GUIDED")
            rejection = control.set_mode(FlightMode.GUIDED)
            if rejection is not None:
                return self._reply(rejection)
        height = altitude_above_home(request.frame, altitude, self._context.origin)
        sign = -1.0 if anticlockwise == 1.0 else 1.0
        rejection = control.set_loiter_point(
            latitude_deg,
            longitude_deg,
            None if keep else height,
            None if math.isnan(radius) or radius == 0.0 else sign * radius,
        )
        reply = self._reply(rejection)
        if rejection is None and request.frame in ABOVE_TERRAIN:
            reply = reply._replace(messages=(*reply.messages, *self._context.warn(TERRAIN_NOTE)))
        return reply

    def _change_speed(self, request: CommandRequest) -> CommandReply:
        kind, speed = request.params[:2]
        if kind != 0.0 or not (math.isfinite(speed) and speed > 0.0):
            return self._denied("Speed: give an airspeed, type 0, in m/s")
        return self._reply(self._context.control.set_airspeed(speed))

    def _start_mission(self, request: CommandRequest) -> CommandReply:
        first, last = (each or 0.0 for each in request.params[:2])
        count = len(self._context.control.mission)
        if not (0.0 <= first < max(count, 1) and last in (0.0, count - 1.0)):
            return self._denied("Mission: first must be an item, last the last one")
        control = self._context.control
        rejection = control.set_mode(FlightMode.AUTO)
        if rejection is None and first > 0.0:
            rejection = control.set_current_item(int(first))
        return self._reply(rejection)

    def _set_current(self, request: CommandRequest) -> CommandReply:
        item = request.params[0]
        if not 0.0 <= item <= 65535.0:
            return self._denied("Mission: give the number of an item")
        reply = self._reply(self._context.control.set_current_item(int(item)))
        current = build_message("MISSION_CURRENT", self._context)
        return CommandReply(reply.result, (*reply.messages, *current))

    def _set_interval(self, request: CommandRequest) -> CommandReply:
        name, interval_us = message_names().get(_id(request.params[0])), request.params[1]
        if name is None or not math.isfinite(interval_us):
            return self._denied("Interval: give a telemetry message, and us")
        self._schedule.set_interval(name, interval_us)
        return CommandReply(Result.ACCEPTED)

    def _request(self, request: CommandRequest) -> CommandReply:
        message = _id(request.params[0])
        if message == constant("MAVLINK_MSG_ID_MESSAGE_INTERVAL"):
            return self._interval(request.params[1])
        name = message_names().get(message)
        if name is None:
            return CommandReply(Result.UNSUPPORTED)
        messages = build_message(name, self._context)
        result = Result.ACCEPTED if messages else Result.TEMPORARILY_REJECTED
        return CommandReply(result, tuple(messages))

    def _capabilities(self, request: CommandRequest) -> CommandReply:
        if request.params[0] != 1.0:
            return self._denied("Capabilities: give 1")
        return self._build("AUTOPILOT_VERSION")

    def _build(self, name: str) -> CommandReply:
        return CommandReply(Result.ACCEPTED, tuple(build_message(name, self._context)))

    def _interval(self, number: float) -> CommandReply:
        """Answer with a MESSAGE_INTERVAL; the interval of unknown messages is 0."""
        message = _id(number)
        name = message_names().get(message)
        interval = 0 if name is None else self._schedule.interval_us(name)
        fields: Fields = {"message_id": max(message, 0), "interval_us": interval}
        return CommandReply(Result.ACCEPTED, (OutgoingMessage("MESSAGE_INTERVAL", fields),))

    def _reply(self, rejection: Rejection | None) -> CommandReply:
        if rejection is None:
            return CommandReply(Result.ACCEPTED)
        result = Result.FAILED if rejection.supported else Result.UNSUPPORTED
        return CommandReply(result, tuple(self._context.warn(rejection.text)))

    def _denied(self, text: str) -> CommandReply:
        return CommandReply(Result.DENIED, tuple(self._context.warn(text)))


def _answer(message: Message, command: int, reply: CommandReply) -> list[OutgoingMessage]:
    fields: Fields = {"command": command, "result": reply.result, **sender_of(message).target}
    return [OutgoingMessage("COMMAND_ACK", fields), *reply.messages]


def _read(message: Message) -> CommandRequest:
    one, two, three, four = (message.number(f"param{n}") for n in range(1, 5))
    command = int(message.number("command"))
    if message.name == "COMMAND_LONG":
        five, six, seven = (message.number(f"param{n}") for n in range(5, 8))
        return CommandRequest(command, (one, two, three, four, five, six, seven), None)
    x, y, z = (message.number(axis) for axis in "xyz")
    params = (one, two, three, four, x / _E7, y / _E7, z)
    return CommandRequest(command, params, int(message.number("frame")))


def _unsupported(name: str) -> Rejection:
    return Rejection(f"no {name} here: LOITER, GUIDED or AUTO", supported=False)


def _id(value: float) -> int:
    """Convert a parameter to a message number; -1 if it is out of range."""
    return int(value) if 0.0 <= value <= 65535.0 else -1
