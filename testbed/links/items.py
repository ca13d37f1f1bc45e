"""Mission items to and from their messages."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from testbed.links.cockpit import Item
from testbed.links.replies import Fields
from testbed.links.scene import I32, whole
from testbed.mavlink.door import Message

SEA_LEVEL, HOME_LEVEL = (0, 5), (3, 6)  # MAV_FRAME: GLOBAL and GLOBAL_RELATIVE_ALT, and their _INT
NO_PLACE = 2  # MAV_FRAME_MISSION
_E7 = 1e7


class Answer(IntEnum):
    """Of a MISSION_ACK: MAV_MISSION_RESULT."""

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


class Place(NamedTuple):
    """Somewhere in the air."""

    latitude_deg: float
    longitude_deg: float
    altitude: float  # m, as the frame of the message has it


def read_item(message: Message) -> Item | Answer:
    """The item of a MISSION_ITEM_INT or a MISSION_ITEM, or why it cannot be one.

    A parameter that is no number means its default, which is zero.
    """
    frame = int(message.number("frame"))
    if frame not in (*SEA_LEVEL, *HOME_LEVEL, NO_PLACE):
        return Answer.UNSUPPORTED_FRAME
    given = [message.number(f"param{n}") for n in range(1, 5)]
    parameters = tuple(0.0 if math.isnan(each) else each for each in given)
    for number, value in enumerate(parameters):
        if math.isinf(value):
            return Answer(Answer.INVALID_PARAM1 + number)
    scale = _E7 if message.name == "MISSION_ITEM_INT" else 1.0
    x, y, z = (message.number(axis) for axis in "xyz")
    place = Place(x / scale, y / scale, z)
    wrong = check_place(place)
    if wrong is not None:
        return wrong
    one, two, three, four = parameters
    return Item(
        command=int(message.number("command")),
        frame=frame,
        parameters=(one, two, three, four),
        x=place.latitude_deg,
        y=place.longitude_deg,
        z=z,
        autocontinue=bool(message.number("autocontinue")),
    )


def check_place(place: Place) -> Answer | None:
    """What is wrong with a place; None: nothing."""
    if not abs(place.latitude_deg) <= 90.0:
        return Answer.INVALID_PARAM5_X
    if not abs(place.longitude_deg) <= 180.0:
        return Answer.INVALID_PARAM6_Y
    return None if math.isfinite(place.altitude) else Answer.INVALID_PARAM7


def item_fields(item: Item, sequence: int, *, current: bool, as_int: bool) -> Fields:
    """The fields of MISSION_ITEM_INT, or of MISSION_ITEM, without whom they are for."""
    one, two, three, four = item.parameters
    place: Fields = {"x": item.x, "y": item.y}
    if as_int:
        place = {"x": whole(item.x * _E7, I32), "y": whole(item.y * _E7, I32)}
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
        **place,
        "z": item.z,
    }
