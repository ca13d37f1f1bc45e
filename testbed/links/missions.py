"""The mission protocol: https://mavlink.io/en/services/mission.html.

A fence and rally points are never there, which is said, and may be removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from testbed.links.catalogue import built
from testbed.links.cockpit import Item, Refusal
from testbed.links.craft import Craft
from testbed.links.items import HOME_LEVEL, Answer, item_fields, read_item
from testbed.links.replies import Asker, Handler, Reply, asker
from testbed.mavlink.door import Message

MOST_ITEMS = 700
REPEAT_S = 1.0  # until an item is asked for again, s of wall-clock time
REPEATS = 5
FLIGHT, FENCE, RALLY, EVERY = 0, 1, 2, 255  # MAV_MISSION_TYPE
_GUIDED, _ALTITUDE = 2, 3  # ArduPilot's MISSION_ITEM.current: fly there now, change altitude now


@dataclass(slots=True)
class _Upload:
    """A mission that is being sent to us."""

    sender: Asker
    count: int
    asked_s: float  # wall-clock time at which an item was asked for last
    repeats: int = 0
    items: list[Item] = field(default_factory=list)


class Missions:
    """Takes and gives missions; one is taken only when it has come whole."""

    def __init__(self, craft: Craft) -> None:
        """Nothing is under way."""
        self._craft = craft
        self._upload: _Upload | None = None
        self._done: tuple[Asker, int, Answer] | None = None  # the last upload
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

    def due(self, at_s: float) -> list[Reply]:
        """Ask again for what has not come; give up after a while. Wall-clock time, s."""
        upload = self._upload
        if upload is None or at_s - upload.asked_s < REPEAT_S:
            return []
        if upload.repeats >= REPEATS:
            self._upload = None
            return [_ack(upload.sender, Answer.CANCELLED)]
        upload.repeats += 1
        return [self._ask(upload, at_s)]

    def _count(self, message: Message, at_s: float) -> list[Reply]:
        """Begin an upload; its sender may begin again."""
        sender, kind = asker(message), _kind(message)
        count = int(message.number("count"))
        if kind != FLIGHT:
            nothing = count == 0 and kind in (FENCE, RALLY)
            return [_ack(sender, Answer.ACCEPTED if nothing else Answer.UNSUPPORTED, kind)]
        if self._busy(sender):
            return [_ack(sender, Answer.DENIED)]
        if count > MOST_ITEMS:
            self._upload = None
            return [_ack(sender, Answer.NO_SPACE)]
        self._upload = _Upload(sender, count, at_s)
        if count == 0:
            return self._finish(self._upload, at_s)
        return [self._ask(self._upload, at_s)]

    def _item(self, message: Message, at_s: float) -> list[Reply]:
        sender, kind = asker(message), _kind(message)
        if kind != FLIGHT:
            return [_ack(sender, Answer.UNSUPPORTED, kind)]
        current = int(message.number("current"))
        if message.name == "MISSION_ITEM" and current in (_GUIDED, _ALTITUDE):
            return self._fly_to(message, at_s, move=current == _GUIDED)
        sequence, upload = int(message.number("seq")), self._upload
        if upload is None or upload.sender != sender:
            return self._stray(sender, sequence)
        if sequence < len(upload.items):
            return []  # said twice
        if sequence > len(upload.items):
            return self._fail(upload, Answer.INVALID_SEQUENCE)
        item = read_item(message)
        if isinstance(item, Answer):
            return self._fail(upload, item)
        upload.items.append(item)
        if len(upload.items) == upload.count:
            return self._finish(upload, at_s)
        upload.repeats = 0
        return [self._ask(upload, at_s)]

    def _stray(self, sender: Asker, sequence: int) -> list[Reply]:
        """An item that nobody asked for; the last one, said twice, is answered as it was."""
        if self._done and self._done[:2] == (sender, sequence + 1):
            return [_ack(sender, self._done[2])]
        return [_ack(sender, Answer.DENIED if self._busy(sender) else Answer.ERROR)]

    def _finish(self, upload: _Upload, at_s: float) -> list[Reply]:
        """Hand the mission to the cockpit."""
        self._upload = None
        refusal = self._craft.cockpit.change_mission(tuple(upload.items))
        answer = _judged(refusal)
        self._done = (upload.sender, upload.count, answer)
        replies = [_ack(upload.sender, answer)]
        if refusal is not None:
            return replies + self._craft.texts.warn(refusal.text, at_s)
        return replies + built("MISSION_CURRENT", self._craft)

    def _fail(self, upload: _Upload, answer: Answer) -> list[Reply]:
        self._upload = None
        return [_ack(upload.sender, answer)]

    def _ask(self, upload: _Upload, at_s: float) -> Reply:
        upload.asked_s = at_s
        fields = {**upload.sender.target, "seq": len(upload.items), "mission_type": FLIGHT}
        return Reply("MISSION_REQUEST_INT", fields)

    def _busy(self, sender: Asker) -> bool:
        """Whether somebody else is sending a mission."""
        return self._upload is not None and self._upload.sender != sender

    def _ack(self, message: Message, at_s: float) -> list[Reply]:
        """The sender of an upload gives up; the end of a download needs no answer."""
        upload = self._upload
        refused = int(message.number("type")) != Answer.ACCEPTED
        if upload and refused and upload.sender == asker(message) and _kind(message) == FLIGHT:
            self._upload = None
        return []

    def _clear(self, message: Message, at_s: float) -> list[Reply]:
        sender, kind = asker(message), _kind(message)
        if kind in (FENCE, RALLY):
            return [_ack(sender, Answer.ACCEPTED, kind)]
        if kind not in (FLIGHT, EVERY):
            return [_ack(sender, Answer.UNSUPPORTED, kind)]
        if self._busy(sender):
            return [_ack(sender, Answer.DENIED, kind)]
        self._upload = None
        refusal = self._craft.cockpit.change_mission(())
        texts = self._craft.texts.warn(refusal.text, at_s) if refusal else []
        return [_ack(sender, _judged(refusal), kind), *texts]

    def _list(self, message: Message, at_s: float) -> list[Reply]:
        kind = _kind(message)
        count = len(self._craft.cockpit.mission) if kind == FLIGHT else 0
        fields = {**asker(message).target, "count": count, "mission_type": kind}
        return [Reply("MISSION_COUNT", fields)]

    def _request(self, message: Message, at_s: float) -> list[Reply]:
        """Give one item, in the form in which it was asked for."""
        sender, kind = asker(message), _kind(message)
        mission, sequence = self._craft.cockpit.mission, int(message.number("seq"))
        if kind != FLIGHT or sequence >= len(mission):
            return [_ack(sender, Answer.INVALID_SEQUENCE, kind)]
        name = "MISSION_ITEM_INT" if message.name == "MISSION_REQUEST_INT" else "MISSION_ITEM"
        fields = item_fields(
            mission[sequence],
            sequence,
            current=sequence == self._craft.cockpit.item,
            as_int=name == "MISSION_ITEM_INT",
        )
        return [Reply(name, {**sender.target, **fields, "mission_type": kind})]

    def _partial(self, message: Message, at_s: float) -> list[Reply]:
        """Missions are sent whole."""
        return [_ack(asker(message), Answer.UNSUPPORTED, _kind(message))]

    def _set_current(self, message: Message, at_s: float) -> list[Reply]:
        refusal = self._craft.cockpit.go_on_at(int(message.number("seq")))
        texts = self._craft.texts.warn(refusal.text, at_s) if refusal else []
        return built("MISSION_CURRENT", self._craft) + texts

    def _fly_to(self, message: Message, at_s: float, *, move: bool) -> list[Reply]:
        """What ArduPilot's ground stations send for "fly here"; only a MISSION_ITEM may."""
        item = read_item(message)
        if isinstance(item, Answer):
            return [_ack(asker(message), item)]
        if not move or item.frame not in HOME_LEVEL:
            return [_ack(asker(message), Answer.UNSUPPORTED)]
        refusal = self._craft.cockpit.fly_to(item.x, item.y, item.z, None)
        texts = self._craft.texts.warn(refusal.text, at_s) if refusal else []
        return [_ack(asker(message), _judged(refusal)), *texts]


def _kind(message: Message) -> int:
    return int(message.number("mission_type"))


def _ack(sender: Asker, answer: Answer, kind: int = FLIGHT) -> Reply:
    return Reply("MISSION_ACK", {**sender.target, "type": answer, "mission_type": kind})


def _judged(refusal: Refusal | None) -> Answer:
    if refusal is None:
        return Answer.ACCEPTED
    return Answer.INVALID if refusal.supported else Answer.UNSUPPORTED
