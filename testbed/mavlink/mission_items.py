"""Conversion between mission items and their messages."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from testbed.mavlink.codec import Message
from testbed.mavlink.outgoing import Fields
from testbed.mavlink.telemetry_snapshot import I32, to_integer
from testbed.mavlink.vehicle_control import MissionItem

SEA_LEVEL, HOME_LEVEL = (0, 5), (3, 6)  # MAV_FRAME: GLOBAL and GLOBAL_RELATIVE_ALT, and their _INT
MISSION_FRAME = 2  # MAV_FRAME_MISSION, of items without a position
_E7 = 1e7


class MissionResult(IntEnum):
    """Result in a MISSION_ACK: MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    CANCELLED = 15


class Position(NamedTuple):
    """A geodetic position."""

    latitude_deg: float
    longitude_deg: float
    altitude: float  # m, in the frame of the message


def read_item(message: Message) -> MissionItem | MissionResult:
    """Read the item of a MISSION_ITEM_INT or MISSION_ITEM, or the reason to reject it.

    A NaN parameter means its default, which is zero.
    """
    frame = int(message.number("frame"))
    if frame not in (*SEA_LEVEL, *HOME_LEVEL, MISSION_FRAME):
        return MissionResult.UNSUPPORTED_FRAME
    values = [message.number(f"param{n}") for n in range(1, 5)]
    parameters = tuple(0.0 if math.isnan(value) else value for value in values)
    for number, value in enumerate(parameters):
        if math.isinf(value):
            return MissionResult(MissionResult.INVALID_PARAM1 + number)
    scale = _E7 if message.name == "MISSION_ITEM_INT" else 1.0
    x, y, z = (message.number(axis) for axis in "xyz")
    position = Position(x / scale, y / scale, z)
    error = check_position(position)
    if error is not None:
        return error
    one, two, three, four = parameters
    return MissionItem(
        command=int(message.number("command")),
        frame=frame,
        parameters=(one, two, three, four),
        x=position.latitude_deg,
        y=position.longitude_deg,
        z=z,
        autocontinue=bool(message.number("autocontinue")),
    )


def check_position(position: Position) -> MissionResult | None:
    """Check the ranges of a position; None: it is valid."""
    if not abs(position.latitude_deg) <= 90.0:
        return MissionResult.INVALID_PARAM5_X
    if not abs(position.longitude_deg) <= 180.0:
        return MissionResult.INVALID_PARAM6_Y
    return None if math.isfinite(position.altitude) else MissionResult.INVALID_PARAM7


def item_fields(item: MissionItem, sequence: int, *, current: bool, as_int: bool) -> Fields:
    """Return the fields of a MISSION_ITEM_INT or MISSION_ITEM, without target and type."""
    one, two, three, four = item.parameters
    position: Fields = {"x": item.x, "y": item.y}
    if as_int:
        position = {"x": to_integer(item.x * _E7, I32), "y": to_integer(item.y * _E7, I32)}
    return {
        "seq": sequence,
        "frame": item.frame,
        "command": item.command,
        "current": int(current),
        "autocontinue": int(item.autocontinue),
        "param1": one,
        "param2": two,
        "param3": three,
        "param4": four,
        **position,
        "z": item.z,
    }
