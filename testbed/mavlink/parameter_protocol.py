"""The parameter protocol: https://mavlink.io/en/services/parameter.html."""

from __future__ import annotations

import math
from collections.abc import Mapping

from testbed.mavlink.codec import Message
from testbed.mavlink.outgoing import Handler, OutgoingMessage, sender_of
from testbed.mavlink.rc_channels import PITCH, ROLL, THROTTLE, YAW
from testbed.mavlink.vehicle_context import SERVO_PARAMETERS, SYSTEM_ID, VehicleContext

BATCH = 10  # values per poll, so that a list does not delay other messages
REAL32 = 9  # MAV_PARAM_TYPE
DOES_NOT_EXIST, VALUE_OUT_OF_RANGE, READ_ONLY = 1, 2, 5  # MAV_PARAM_ERROR
MIN_PULSE_US, MAX_PULSE_US = 800.0, 2200.0  # accepted by ArduPlane
_NAME_BYTES = 16
_MAX_FLOAT32 = 3.4028234663852886e38


class ParameterProtocol:
    """Read, list and set the parameters of the aircraft and of its RC channels."""

    def __init__(self, context: VehicleContext) -> None:
        self._context = context
        self._next: int | None = None  # index of the list that is being sent
        self.handlers: Mapping[str, Handler] = {
            "PARAM_REQUEST_READ": self._read,
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_SET": self._set,
        }

    def poll(self) -> list[OutgoingMessage]:
        """Return the next values of the list that is being sent."""
        if self._next is None:
            return []
        values = self._context.parameters()
        room = self._context.radio.list_room(BATCH, self._context.wall_s)
        stop = min(self._next + room, len(values))
        names = list(values)[self._next : stop]
        replies = [_value(name, values, index) for index, name in enumerate(names, self._next)]
        self._next = stop if stop < len(values) else None
        return replies

    def all_values(self) -> list[OutgoingMessage]:
        """Return all values, for a log."""
        values = self._context.parameters()
        return [_value(name, values, index) for index, name in enumerate(values)]

    def _list(self, message: Message) -> list[OutgoingMessage]:
        self._next = 0
        return []

    def _read(self, message: Message) -> list[OutgoingMessage]:
        values = self._context.parameters()
        name, index = str(message.fields["param_id"]), int(message.number("param_index"))
        if index >= 0:
            name = list(values)[index] if index < len(values) else ""
        if name not in values:
            return [self._error(message, DOES_NOT_EXIST, name, index)]
        return [_value(name, values)]

    def _set(self, message: Message) -> list[OutgoingMessage]:
        """Set a value, and answer with the value that is now valid."""
        context, name = self._context, str(message.fields["param_id"])
        value = message.number("param_value")
        values = context.parameters()
        if name not in values:
            none = not context.control.parameters
            text = f"{name}: " + (
                "this aircraft has no parameters" if none else "no such parameter"
            )
            warning = context.warn(text)
            return [self._error(message, DOES_NOT_EXIST, name, -1), *warning]
        error, reason = self._change(name, value)
        replies = [_value(name, context.parameters())]
        if reason:
            replies = [self._error(message, error, name, -1), *replies]
            replies += context.warn(reason)
        return replies

    def _change(self, name: str, value: float) -> tuple[int, str]:
        """Change an existing parameter; return the error and its reason, empty on success."""
        context = self._context
        if not math.isfinite(value):
            return VALUE_OUT_OF_RANGE, f"{name}: give a finite number"
        if name == SYSTEM_ID:
            same = value == context.system
            return (0, "") if same else (READ_ONLY, f"{name}: read-only, by order in the fleet")
        if name in SERVO_PARAMETERS:
            same = value == SERVO_PARAMETERS[name]
            return (0, "") if same else (READ_ONLY, f"{name}: read-only")
        if name not in context.own_parameters:
            rejection = context.control.set_parameter(name, value)
            return (0, "") if rejection is None else (VALUE_OUT_OF_RANGE, rejection.text)
        if not MIN_PULSE_US <= value <= MAX_PULSE_US:
            text = f"{name}: give {MIN_PULSE_US:.0f} to {MAX_PULSE_US:.0f} us"
            return VALUE_OUT_OF_RANGE, text
        before = context.own_parameters[name]
        context.own_parameters[name] = value
        if not all(self._ordered(channel) for channel in (ROLL, PITCH, THROTTLE, YAW)):
            context.own_parameters[name] = before
            return VALUE_OUT_OF_RANGE, f"{name}: keep MIN below MAX, and TRIM not outside"
        return 0, ""

    def _ordered(self, channel: int) -> bool:
        own = self._context.own_parameters
        low, trim, high = (own[f"RC{channel}_{name}"] for name in ("MIN", "TRIM", "MAX"))
        return low <= trim <= high and low < high

    def _error(self, message: Message, error: int, name: str, index: int) -> OutgoingMessage:
        return OutgoingMessage(
            "PARAM_ERROR",
            {
                **sender_of(message).target,
                "param_id": name.encode("ascii", "ignore")[:_NAME_BYTES],
                "param_index": index,
                "error": error,
            },
        )


def _value(name: str, values: Mapping[str, float], index: int | None = None) -> OutgoingMessage:
    return OutgoingMessage(
        "PARAM_VALUE",
        {
            "param_id": name[:_NAME_BYTES],
            "param_value": min(max(values[name], -_MAX_FLOAT32), _MAX_FLOAT32),
            "param_type": REAL32,
            "param_count": len(values),
            "param_index": list(values).index(name) if index is None else index,
        },
    )
