"""The mission protocol: https://mavlink.io/en/services/mission.html.

Fence and rally points are not supported: their lists are empty, and clearing them succeeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from testbed.mavlink.altitude_frames import (
    ABOVE_HOME,
    ABOVE_TERRAIN,
    MISSION_FRAME,
    POSITION_FRAMES,
    TERRAIN_NOTE,
    frame_error,
)
from testbed.mavlink.codec import Message
from testbed.mavlink.outgoing import Fields, Handler, OutgoingMessage, Sender, sender_of
from testbed.mavlink.telemetry_messages import build_message
from testbed.mavlink.telemetry_snapshot import I32, to_integer
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import MissionItem, Rejection

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


class ItemRefusal(NamedTuple):
    """The reason why an item is refused."""

    result: MissionResult
    text: str


def read_item(message: Message) -> MissionItem | ItemRefusal:
    """Read the item of a MISSION_ITEM_INT or MISSION_ITEM, or the reason to reject it.

    A NaN parameter means its default, which is zero.
    """
    frame = int(message.number("frame"))
    if frame not in (*POSITION_FRAMES, MISSION_FRAME):
        return ItemRefusal(MissionResult.UNSUPPORTED_FRAME, frame_error(frame))
    values = [message.number(f"param{n}") for n in range(1, 5)]
    parameters = tuple(0.0 if math.isnan(value) else value for value in values)
    for number, value in enumerate(parameters):
        if math.isinf(value):
            result = MissionResult(MissionResult.INVALID_PARAM1 + number)
            return ItemRefusal(result, f"param{number + 1} is infinite: write a finite number")
    scale = _E7 if message.name == "MISSION_ITEM_INT" else 1.0
    latitude, longitude = message.number("x") / scale, message.number("y") / scale
    altitude = message.number("z")
    error = check_position(latitude, longitude, altitude)
    if error is not None:
        return ItemRefusal(error, _POSITION_ERRORS[error])
    one, two, three, four = parameters
    return MissionItem(
        command=int(message.number("command")),
        frame=frame,
        parameters=(one, two, three, four),
        x=latitude,
        y=longitude,
        z=altitude,
        autocontinue=bool(message.number("autocontinue")),
    )


_POSITION_ERRORS = {
    MissionResult.INVALID_PARAM5_X: "latitude: write -90 to 90 degrees",
    MissionResult.INVALID_PARAM6_Y: "longitude: write -180 to 180 degrees",
    MissionResult.INVALID_PARAM7: "altitude: write a finite number",
}


def check_position(
    latitude_deg: float, longitude_deg: float, altitude: float
) -> MissionResult | None:
    """Check the ranges of a position; None: it is valid."""
    if not abs(latitude_deg) <= 90.0:
        return MissionResult.INVALID_PARAM5_X
    if not abs(longitude_deg) <= 180.0:
        return MissionResult.INVALID_PARAM6_Y
    return None if math.isfinite(altitude) else MissionResult.INVALID_PARAM7


def item_fields(item: MissionItem, sequence: int, *, current: bool, as_int: bool) -> Fields:
    """Return the fields of a MISSION_ITEM_INT or MISSION_ITEM, without target and type."""
    position: Fields = {"x": item.x, "y": item.y}
    if as_int:
        position = {"x": to_integer(item.x * _E7, I32), "y": to_integer(item.y * _E7, I32)}
    return {
        "seq": sequence,
        "frame": item.frame,
        "command": item.command,
        "current": int(current),
        "autocontinue": int(item.autocontinue),
        **{f"param{number}": value for number, value in enumerate(item.parameters, 1)},
        **position,
        "z": item.z,
    }


MAX_ITEMS = 700
REPEAT_S = 1.0  # between two requests of one item, s of wall-clock time
REPEATS = 5
MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE
_ONLY_MISSIONS = "mission: there are no fences and rally points"
_BUSY = "mission: another program is uploading one: upload again later"
_GUIDED, _ALTITUDE = 2, 3  # ArduPilot's MISSION_ITEM.current: fly there now, change altitude now


@dataclass(slots=True)
class _Upload:
    """An upload that is not complete yet."""

    sender: Sender
    count: int
    requested_s: float  # wall-clock time of the latest request for an item
    repeats: int = 0
    items: list[MissionItem] = field(default_factory=list)


class MissionProtocol:
    """Receive and send missions; a mission is applied only when it is complete."""

    def __init__(self, context: VehicleContext) -> None:
        self._context = context
        self._upload: _Upload | None = None
        self._done: tuple[Sender, int, MissionResult] | None = None  # the last upload
        self.handlers: Mapping[str, Handler] = {
            "MISSION_COUNT": self._count,
            "MISSION_ITEM_INT": self._item,
            "MISSION_ITEM": self._item,
            "MISSION_ACK": self._ack,
            "MISSION_CLEAR_ALL": self._clear,
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST_INT": self._request,
            "MISSION_REQUEST": self._request,
            "MISSION_REQUEST_PARTIAL_LIST": self._partial,
            "MISSION_WRITE_PARTIAL_LIST": self._partial,
            "MISSION_SET_CURRENT": self._set_current,
        }

    def poll(self) -> list[OutgoingMessage]:
        """Repeat the request for a missing item; cancel the upload after `REPEATS`."""
        upload = self._upload
        if upload is None or self._context.wall_s - upload.requested_s < REPEAT_S:
            return []
        if upload.repeats >= REPEATS:
            text = f"mission: item {len(upload.items)} did not arrive: upload again"
            return self._abort(upload, MissionResult.CANCELLED, text)
        upload.repeats += 1
        return [self._request_item(upload)]

    def _count(self, message: Message) -> list[OutgoingMessage]:
        """Start an upload; its sender may restart it."""
        sender, mission_type = sender_of(message), _mission_type(message)
        count = int(message.number("count"))
        if mission_type != MISSION:
            if count == 0 and mission_type in (FENCE, RALLY):
                return [_ack(sender, MissionResult.ACCEPTED, mission_type)]
            return self._refuse(message, MissionResult.UNSUPPORTED, _ONLY_MISSIONS)
        if self._other_uploads(sender):
            return self._refuse(message, MissionResult.DENIED, _BUSY)
        if count > MAX_ITEMS:
            self._upload = None
            text = f"mission: {count} items: write {MAX_ITEMS} or fewer"
            return self._refuse(message, MissionResult.NO_SPACE, text)
        self._upload = _Upload(sender, count, self._context.wall_s)
        if count == 0:
            return self._finish(self._upload)
        return [self._request_item(self._upload)]

    def _item(self, message: Message) -> list[OutgoingMessage]:
        sender = sender_of(message)
        if _mission_type(message) != MISSION:
            return self._refuse(message, MissionResult.UNSUPPORTED, _ONLY_MISSIONS)
        current = int(message.number("current"))
        if message.name == "MISSION_ITEM" and current in (_GUIDED, _ALTITUDE):
            return self._guided_item(message, move=current == _GUIDED)
        sequence, upload = int(message.number("seq")), self._upload
        if upload is None or upload.sender != sender:
            return self._unexpected_item(message)
        if sequence < len(upload.items):
            return []  # a repetition
        if sequence > len(upload.items):
            text = f"mission: item {sequence} instead of {len(upload.items)}: upload again"
            return self._abort(upload, MissionResult.INVALID_SEQUENCE, text)
        item = read_item(message)
        if isinstance(item, ItemRefusal):
            text = f"mission item {sequence}: {item.text}"
            return self._abort(upload, item.result, text)
        upload.items.append(item)
        if len(upload.items) == upload.count:
            return self._finish(upload)
        upload.repeats = 0
        return [self._request_item(upload)]

    def _unexpected_item(self, message: Message) -> list[OutgoingMessage]:
        """Answer an item outside of an upload; a repetition of the last one as before."""
        sender, sequence = sender_of(message), int(message.number("seq"))
        if self._done and self._done[:2] == (sender, sequence + 1):
            return [_ack(sender, self._done[2])]
        if self._other_uploads(sender):
            return self._refuse(message, MissionResult.DENIED, _BUSY)
        text = f"mission: item {sequence} without an upload: send MISSION_COUNT first"
        return self._refuse(message, MissionResult.ERROR, text)

    def _finish(self, upload: _Upload) -> list[OutgoingMessage]:
        """Apply the complete mission."""
        self._upload = None
        rejection = self._context.control.set_mission(tuple(upload.items))
        result = _result(rejection)
        self._done = (upload.sender, upload.count, result)
        replies = [_ack(upload.sender, result)]
        if rejection is not None:
            return replies + self._context.warn(rejection.text)
        return replies + build_message("MISSION_CURRENT", self._context)

    def _abort(self, upload: _Upload, result: MissionResult, text: str) -> list[OutgoingMessage]:
        self._upload = None
        return [_ack(upload.sender, result), *self._context.warn(text)]

    def _refuse(self, message: Message, result: MissionResult, text: str) -> list[OutgoingMessage]:
        ack = _ack(sender_of(message), result, _mission_type(message))
        return [ack, *self._context.warn(text)]

    def _request_item(self, upload: _Upload) -> OutgoingMessage:
        upload.requested_s = self._context.wall_s
        fields = {**upload.sender.target, "seq": len(upload.items), "mission_type": MISSION}
        return OutgoingMessage("MISSION_REQUEST_INT", fields)

    def _other_uploads(self, sender: Sender) -> bool:
        """Check whether another program is uploading a mission."""
        return self._upload is not None and self._upload.sender != sender

    def _ack(self, message: Message) -> list[OutgoingMessage]:
        """Cancel the upload if its sender does; the end of a download needs no answer."""
        upload = self._upload
        cancelled = int(message.number("type")) != MissionResult.ACCEPTED
        if upload and cancelled and upload.sender == sender_of(message):
            if _mission_type(message) == MISSION:
                self._upload = None
        return []

    def _clear(self, message: Message) -> list[OutgoingMessage]:
        sender, mission_type = sender_of(message), _mission_type(message)
        if mission_type in (FENCE, RALLY):
            return [_ack(sender, MissionResult.ACCEPTED, mission_type)]
        if mission_type not in (MISSION, ALL):
            return self._refuse(message, MissionResult.UNSUPPORTED, _ONLY_MISSIONS)
        if self._other_uploads(sender):
            return self._refuse(message, MissionResult.DENIED, _BUSY)
        self._upload = None
        rejection = self._context.control.set_mission(())
        texts = self._context.warn(rejection.text) if rejection else []
        return [_ack(sender, _result(rejection), mission_type), *texts]

    def _list(self, message: Message) -> list[OutgoingMessage]:
        mission_type = _mission_type(message)
        count = len(self._context.control.mission) if mission_type == MISSION else 0
        fields = {**sender_of(message).target, "count": count, "mission_type": mission_type}
        return [OutgoingMessage("MISSION_COUNT", fields)]

    def _request(self, message: Message) -> list[OutgoingMessage]:
        """Send one item, in the form of the request."""
        sender, mission_type = sender_of(message), _mission_type(message)
        mission, sequence = self._context.control.mission, int(message.number("seq"))
        if mission_type != MISSION or sequence >= len(mission):
            text = f"mission: item {sequence} of {len(mission)} does not exist"
            return self._refuse(message, MissionResult.INVALID_SEQUENCE, text)
        name = "MISSION_ITEM_INT" if message.name == "MISSION_REQUEST_INT" else "MISSION_ITEM"
        fields = item_fields(
            mission[sequence],
            sequence,
            current=sequence == self._context.control.current_item,
            as_int=name == "MISSION_ITEM_INT",
        )
        return [OutgoingMessage(name, {**sender.target, **fields, "mission_type": mission_type})]

    def _partial(self, message: Message) -> list[OutgoingMessage]:
        """Reject partial lists."""
        text = "mission: no partial lists: send and request all items"
        return self._refuse(message, MissionResult.UNSUPPORTED, text)

    def _set_current(self, message: Message) -> list[OutgoingMessage]:
        rejection = self._context.control.set_current_item(int(message.number("seq")))
        texts = self._context.warn(rejection.text) if rejection else []
        return build_message("MISSION_CURRENT", self._context) + texts

    def _guided_item(self, message: Message, *, move: bool) -> list[OutgoingMessage]:
        """Execute ArduPilot's "fly here" request, a MISSION_ITEM with current 2."""
        item = read_item(message)
        if isinstance(item, ItemRefusal):
            return self._refuse(message, item.result, f"Fly there: {item.text}")
        if not move or item.frame not in (*ABOVE_HOME, *ABOVE_TERRAIN):
            text = "Fly there: give a position with an altitude above home"
            return self._refuse(message, MissionResult.UNSUPPORTED, text)
        rejection = self._context.control.set_loiter_point(item.x, item.y, item.z, None)
        note = TERRAIN_NOTE if item.frame in ABOVE_TERRAIN else ""
        text = rejection.text if rejection else note
        texts = self._context.warn(text) if text else []
        return [_ack(sender_of(message), _result(rejection)), *texts]


def _mission_type(message: Message) -> int:
    return int(message.number("mission_type"))


def _ack(sender: Sender, result: MissionResult, mission_type: int = MISSION) -> OutgoingMessage:
    fields = {**sender.target, "type": result, "mission_type": mission_type}
    return OutgoingMessage("MISSION_ACK", fields)


def _result(rejection: Rejection | None) -> MissionResult:
    if rejection is None:
        return MissionResult.ACCEPTED
    return MissionResult.INVALID if rejection.supported else MissionResult.UNSUPPORTED
