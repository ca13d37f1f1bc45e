"""The parameter protocol: https://mavlink.io/en/services/parameter.html."""

from __future__ import annotations

import math
from collections.abc import Mapping

from testbed.links.channels import PITCH, ROLL, THROTTLE, YAW
from testbed.links.craft import SERVOS, SYSTEM_NAME, Craft
from testbed.links.replies import Handler, Reply, asker
from testbed.mavlink.door import Message

BATCH = 10  # values sent at one look, so that a list does not crowd out what else is said
REAL32 = 9  # MAV_PARAM_TYPE
MISSING, READ_ONLY, REFUSED = 1, 5, 2  # MAV_PARAM_ERROR
SHORTEST_US, LONGEST_US = 800.0, 2200.0  # pulses that ArduPlane takes
_LETTERS = 16
_LARGEST = 3.4028234663852886e38  # of single precision


class Parameters:
    """Reads, lists and sets what the cockpit has, and the vehicle's own."""

    def __init__(self, craft: Craft) -> None:
        """No list is under way."""
        self._craft = craft
        self._next: int | None = None  # index of the list that is being sent
        self.handlers: Mapping[str, Handler] = {
            "PARAM_REQUEST_READ": self._read,
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_SET": self._set,
        }

    def due(self) -> list[Reply]:
        """The next values of the list that is under way."""
        if self._next is None:
            return []
        values = self._craft.parameters()
        stop = min(self._next + BATCH, len(values))
        names = list(values)[self._next : stop]
        replies = [_value(name, values, index) for index, name in enumerate(names, self._next)]
        self._next = stop if stop < len(values) else None
        return replies

    def every(self) -> list[Reply]:
        """All values at once, for a log."""
        values = self._craft.parameters()
        return [_value(name, values, index) for index, name in enumerate(values)]

    def _list(self, message: Message, at_s: float) -> list[Reply]:
        """Begin a list, or begin it again."""
        self._next = 0
        return []

    def _read(self, message: Message, at_s: float) -> list[Reply]:
        values = self._craft.parameters()
        name, index = str(message.fields["param_id"]), int(message.number("param_index"))
        if index >= 0:
            name = list(values)[index] if index < len(values) else ""
        if name not in values:
            return [self._error(message, MISSING, name, index)]
        return [_value(name, values)]

    def _set(self, message: Message, at_s: float) -> list[Reply]:
        """Set a value, and say which holds now."""
        craft, name = self._craft, str(message.fields["param_id"])
        value = message.number("param_value")
        values = craft.parameters()
        if name not in values:
            none = not craft.cockpit.parameters
            text = f"{name}: " + ("it has no parameters here" if none else "no such parameter")
            return [self._error(message, MISSING, name, -1), *craft.texts.warn(text, at_s)]
        error, why = self._change(name, value)
        replies = [_value(name, craft.parameters())]
        if why:
            replies = [self._error(message, error, name, -1), *replies]
            replies += craft.texts.warn(why, at_s)
        return replies

    def _change(self, name: str, value: float) -> tuple[int, str]:
        """Change one that is there; an error and why, or no reason."""
        craft = self._craft
        if not math.isfinite(value):
            return REFUSED, f"{name}: give a finite number"
        if name == SYSTEM_NAME:
            same = value == craft.system
            return (0, "") if same else (READ_ONLY, f"{name}: goes with the place in the fleet")
        if name in SERVOS:
            same = value == SERVOS[name]
            return (0, "") if same else (READ_ONLY, f"{name}: outputs are as they are")
        if name not in craft.own:
            refusal = craft.cockpit.change_parameter(name, value)
            return (0, "") if refusal is None else (REFUSED, refusal.text)
        if not SHORTEST_US <= value <= LONGEST_US:
            return REFUSED, f"{name}: give {SHORTEST_US:.0f} to {LONGEST_US:.0f} us"
        before = craft.own[name]
        craft.own[name] = value
        if not all(self._ordered(channel) for channel in (ROLL, PITCH, THROTTLE, YAW)):
            craft.own[name] = before
            return REFUSED, f"{name}: keep MIN below MAX, and TRIM not outside"
        return 0, ""

    def _ordered(self, channel: int) -> bool:
        own = self._craft.own
        least, trim, most = (own[f"RC{channel}_{name}"] for name in ("MIN", "TRIM", "MAX"))
        return least <= trim <= most and least < most

    def _error(self, message: Message, error: int, name: str, index: int) -> Reply:
        return Reply(
            "PARAM_ERROR",
            {
                **asker(message).target,
                "param_id": name.encode("ascii", "ignore")[:_LETTERS],
                "param_index": index,
                "error": error,
            },
        )


def _value(name: str, values: Mapping[str, float], index: int | None = None) -> Reply:
    return Reply(
        "PARAM_VALUE",
        {
            "param_id": name[:_LETTERS],
            "param_value": min(max(values[name], -_LARGEST), _LARGEST),
            "param_type": REAL32,
            "param_count": len(values),
            "param_index": list(values).index(name) if index is None else index,
        },
    )
