"""The command protocol: https://mavlink.io/en/services/command.html. Every command is answered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import NamedTuple

from testbed.links.catalogue import built
from testbed.links.cockpit import Mode, Refusal
from testbed.links.craft import Craft
from testbed.links.items import HOME_LEVEL, SEA_LEVEL, Place, check_place
from testbed.links.replies import Fields, Handler, Reply, asker
from testbed.links.schedule import Schedule, numbers
from testbed.mavlink.door import Message, number

_FORCED = 21196.0  # param2 of arming, that means it
_CUSTOM = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_E7 = 1e7
_MODES = frozenset(map(float, Mode))
_RTL = 11.0  # ArduPlane's mode


class Result(IntEnum):
    """Of a command: MAV_RESULT."""

    ACCEPTED = 0
    REJECTED = 1  # for the moment
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    COMMAND_INT_ONLY = 8
    UNSUPPORTED_FRAME = 9


class Asked(NamedTuple):
    """A command, from a COMMAND_LONG or a COMMAND_INT."""

    command: int
    numbers: tuple[float, float, float, float, float, float, float]  # degrees where a place is
    frame: int | None  # MAV_FRAME; None: a COMMAND_LONG does not say
    at_s: float  # wall-clock time


class Outcome(NamedTuple):
    """The answer to a command, and what is said after it."""

    result: Result
    replies: tuple[Reply, ...] = ()


class Commands:
    """Does what commands say, or says why not."""

    def __init__(self, craft: Craft, schedule: Schedule) -> None:
        """Ready for any."""
        self._craft, self._schedule = craft, schedule
        self.handlers: Mapping[str, Handler] = {
            "COMMAND_LONG": self._hear,
            "COMMAND_INT": self._hear,
            "SET_MODE": self._set_mode,
        }
        self._known: Mapping[int, Callable[[Asked], Outcome]] = {
            number(f"MAV_CMD_{name}"): obey
            for name, obey in {
                "COMPONENT_ARM_DISARM": self._arm,
                "DO_SET_MODE": self._do_set_mode,
                "DO_REPOSITION": self._reposition,
                "DO_CHANGE_SPEED": self._change_speed,
                "MISSION_START": self._start_mission,
                "DO_SET_MISSION_CURRENT": self._set_current,
                "NAV_LOITER_UNLIM": self._loiter,
                "SET_MESSAGE_INTERVAL": self._set_interval,
                "GET_MESSAGE_INTERVAL": self._get_interval,
                "REQUEST_MESSAGE": self._request,
                "REQUEST_AUTOPILOT_CAPABILITIES": self._capabilities,
                "GET_HOME_POSITION": self._home,
                "PREFLIGHT_REBOOT_SHUTDOWN": self._reboot,
                "NAV_RETURN_TO_LAUNCH": self._return,
                "NAV_TAKEOFF": self._take_off,
                "NAV_LAND": self._land,
            }.items()
        }

    def _hear(self, message: Message, at_s: float) -> list[Reply]:
        asked = _read(message, at_s)
        obey = self._known.get(asked.command)
        outcome = Outcome(Result.UNSUPPORTED) if obey is None else obey(asked)
        answer: Fields = {
            "command": asked.command,
            "result": outcome.result,
            **asker(message).target,
        }
        return [Reply("COMMAND_ACK", answer), *outcome.replies]

    def _set_mode(self, message: Message, at_s: float) -> list[Reply]:
        """SET_MODE, which ArduPilot answers as if it were a command."""
        base, custom = message.number("base_mode"), message.number("custom_mode")
        outcome = self._change_mode(base, custom, at_s)
        answer: Fields = {
            "command": number("MAVLINK_MSG_ID_SET_MODE"),
            "result": outcome.result,
            **asker(message).target,
        }
        return [Reply("COMMAND_ACK", answer), *outcome.replies]

    def _arm(self, asked: Asked) -> Outcome:
        arm, force = asked.numbers[:2]
        if arm not in (0.0, 1.0):
            return self._denied("Arming: give 1, or 0 to disarm", asked.at_s)
        done = self._craft.cockpit.arm(arm == 1.0, force=force == _FORCED)
        return self._outcome(done, asked.at_s)

    def _do_set_mode(self, asked: Asked) -> Outcome:
        return self._change_mode(asked.numbers[0], asked.numbers[1], asked.at_s)

    def _change_mode(self, base: float, custom: float, at_s: float) -> Outcome:
        had = ", ".join(f"{mode.value} {mode.name}" for mode in Mode)
        if not math.isfinite(base) or not int(base) & _CUSTOM:
            return self._denied(f"custom mode: {had}", at_s)
        if custom == _RTL:
            return self._denied(_instead("RTL").text, at_s)
        if custom not in _MODES:
            return self._denied(f"no mode {custom:.0f}: {had}", at_s)
        mode = Mode(int(custom))
        done = self._craft.cockpit.change_mode(mode)
        return self._outcome(done, at_s)

    def _reposition(self, asked: Asked) -> Outcome:
        if asked.frame is None:
            return Outcome(Result.COMMAND_INT_ONLY)  # which says what the altitude is above
        if asked.frame not in (*SEA_LEVEL, *HOME_LEVEL):
            return Outcome(Result.UNSUPPORTED_FRAME)
        _, flags, radius, anticlockwise, latitude_deg, longitude_deg, altitude = asked.numbers
        keep = math.isnan(altitude)
        place = Place(latitude_deg, longitude_deg, 0.0 if keep else altitude)
        if check_place(place) is not None or math.isinf(radius):
            return self._denied("Fly there: give latitude, longitude, altitude", asked.at_s)
        cockpit = self._craft.cockpit
        if cockpit.mode is not Mode.GUIDED:
            if not math.isfinite(flags) or not int(flags) & 1:
                return self._denied("Fly there: set the flag that changes to GUIDED", asked.at_s)
            refusal = cockpit.change_mode(Mode.GUIDED)
            if refusal is not None:
                return self._outcome(refusal, asked.at_s)
        home = self._craft.origin.elevation_m if asked.frame in SEA_LEVEL else 0.0
        sign = -1.0 if anticlockwise == 1.0 else 1.0
        done = cockpit.fly_to(
            latitude_deg,
            longitude_deg,
            None if keep else altitude - home,
            None if math.isnan(radius) or radius == 0.0 else sign * radius,
        )
        return self._outcome(done, asked.at_s)

    def _change_speed(self, asked: Asked) -> Outcome:
        kind, speed = asked.numbers[:2]
        if kind != 0.0 or not (math.isfinite(speed) and speed > 0.0):
            return self._denied("Speed: give an airspeed, type 0, in m/s", asked.at_s)
        return self._outcome(self._craft.cockpit.change_airspeed(speed), asked.at_s)

    def _start_mission(self, asked: Asked) -> Outcome:
        first, last = (each or 0.0 for each in asked.numbers[:2])
        count = len(self._craft.cockpit.mission)
        if not (0.0 <= first < max(count, 1) and last in (0.0, count - 1.0)):
            return self._denied("Mission: give a first item it has, no other last", asked.at_s)
        cockpit = self._craft.cockpit
        refusal = cockpit.change_mode(Mode.AUTO)
        if refusal is None and first > 0.0:
            refusal = cockpit.go_on_at(int(first))
        return self._outcome(refusal, asked.at_s)

    def _set_current(self, asked: Asked) -> Outcome:
        item = asked.numbers[0]
        if not 0.0 <= item <= 65535.0:
            return self._denied("Mission: give the number of an item", asked.at_s)
        done = self._outcome(self._craft.cockpit.go_on_at(int(item)), asked.at_s)
        return Outcome(done.result, (*done.replies, *built("MISSION_CURRENT", self._craft)))

    def _loiter(self, asked: Asked) -> Outcome:
        """As a command it has no place: circle here."""
        return self._outcome(self._craft.cockpit.change_mode(Mode.LOITER), asked.at_s)

    def _set_interval(self, asked: Asked) -> Outcome:
        name, interval_us = numbers().get(_id(asked.numbers[0])), asked.numbers[1]
        if name is None or not math.isfinite(interval_us):
            return Outcome(Result.DENIED)
        self._schedule.set_interval(name, interval_us)
        return Outcome(Result.ACCEPTED)

    def _get_interval(self, asked: Asked) -> Outcome:
        message = _id(asked.numbers[0])
        return Outcome(Result.ACCEPTED, (self._interval(message),))

    def _request(self, asked: Asked) -> Outcome:
        message = _id(asked.numbers[0])
        if message == number("MAVLINK_MSG_ID_MESSAGE_INTERVAL"):
            return Outcome(Result.ACCEPTED, (self._interval(_id(asked.numbers[1])),))
        name = numbers().get(message)
        if name is None:
            return Outcome(Result.UNSUPPORTED)
        replies = built(name, self._craft)
        return Outcome(Result.ACCEPTED if replies else Result.REJECTED, tuple(replies))

    def _capabilities(self, asked: Asked) -> Outcome:
        if asked.numbers[0] != 1.0:
            return Outcome(Result.DENIED)
        return Outcome(Result.ACCEPTED, tuple(built("AUTOPILOT_VERSION", self._craft)))

    def _home(self, asked: Asked) -> Outcome:
        return Outcome(Result.ACCEPTED, tuple(built("HOME_POSITION", self._craft)))

    def _reboot(self, asked: Asked) -> Outcome:
        return self._denied("Reboot: an autopilot starts with its run", asked.at_s)

    def _return(self, asked: Asked) -> Outcome:
        return self._outcome(_instead("RTL"), asked.at_s)

    def _take_off(self, asked: Asked) -> Outcome:
        return self._outcome(_instead("TAKEOFF"), asked.at_s)

    def _land(self, asked: Asked) -> Outcome:
        return self._outcome(_instead("LAND"), asked.at_s)

    def _interval(self, message: int) -> Reply:
        """MESSAGE_INTERVAL: 0 for what is never sent at all."""
        name = numbers().get(message)
        interval = 0 if name is None else self._schedule.interval_us(name)
        return Reply("MESSAGE_INTERVAL", {"message_id": max(message, 0), "interval_us": interval})

    def _outcome(self, refusal: Refusal | None, at_s: float) -> Outcome:
        if refusal is None:
            return Outcome(Result.ACCEPTED)
        result = Result.FAILED if refusal.supported else Result.UNSUPPORTED
        return Outcome(result, tuple(self._craft.texts.warn(refusal.text, at_s)))

    def _denied(self, text: str, at_s: float) -> Outcome:
        return Outcome(Result.DENIED, tuple(self._craft.texts.warn(text, at_s)))


def _read(message: Message, at_s: float) -> Asked:
    one, two, three, four = (message.number(f"param{n}") for n in range(1, 5))
    command = int(message.number("command"))
    if message.name == "COMMAND_LONG":
        five, six, seven = (message.number(f"param{n}") for n in range(5, 8))
        return Asked(command, (one, two, three, four, five, six, seven), None, at_s)
    x, y, z = (message.number(axis) for axis in "xyz")
    values = (one, two, three, four, x / _E7, y / _E7, z)
    return Asked(command, values, int(message.number("frame")), at_s)


def _instead(name: str) -> Refusal:
    return Refusal(f"no {name} here: LOITER, GUIDED or AUTO", supported=False)


def _id(value: float) -> int:
    """A message's number from a parameter; -1 for what cannot be one."""
    return int(value) if 0.0 <= value <= 65535.0 else -1
