"""Messages between aircraft: FOLLOW_TARGET with GPS time and digests.

https://mavlink.io/en/messages/common.html#FOLLOW_TARGET. The definition counts `timestamp` from the
sender's boot, which is no time that two aircraft share: here it is GPS time, ms since 1970, as the
sender's autopilot has it. `custom_state` has the digests of scenario and parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from testbed.core.records import BoolArray, Broadcast, NedOrigin, Record
from testbed.mavlink.codec import Message
from testbed.mavlink.follow_target import MS, PAYLOAD, FollowTarget

NAME = "FOLLOW_TARGET"
_HEAD, _LENGTH = 10, 1  # of a frame of MAVLink 2: bytes, and where the length of the payload is
_V2 = 0xFD
FASTEST, FARTHEST = 150.0, 1e6  # m/s, m: no aircraft of a formation is beyond
STRONGEST = 1e3  # m/s²
_FIELDS = Broadcast._fields[1:]


class PeerMessage(NamedTuple):
    """A message of another aircraft.

    Attributes:
        row: of the aircraft, by its system id.
        timestamp_ms: GPS time of the measurement, ms since 1970.
        digests: `custom_state`.
        height_m: above mean sea level, m.
        content: of one aircraft; its stamp is not used.
    """

    row: int
    timestamp_ms: int
    digests: int
    height_m: float
    content: Broadcast


class FormationMessages:
    """Convert own states to fields of FOLLOW_TARGET, and messages of others to their content."""

    def __init__(self, origin: NedOrigin, aircraft: int) -> None:
        """See the class.

        Args:
            origin: of the NED positions.
            aircraft: N, of the formation.
        """
        self._convert, self._aircraft = FollowTarget(origin), aircraft
        self._payload = np.zeros(1, PAYLOAD)

    def fields(self, message: Record, timestamp_ms: int, digests: int) -> dict[str, Any]:
        """Return the fields of FOLLOW_TARGET for an own state.

        Args:
            message: (1,) of MESSAGE, of the own estimate.
            timestamp_ms: GPS time of the measurement, ms since 1970.
            digests: of scenario and parameters.
        """
        payload = self._payload
        self._convert.write(Broadcast(*(message[each] for each in Broadcast._fields)), payload)
        payload["timestamp"], payload["custom_state"] = timestamp_ms, digests
        return {name: payload[name][0].tolist() for name in PAYLOAD.names or ()}

    def sender(self, message: Message) -> int | None:
        """Return the row of the aircraft that sent a message; None: it is none of an aircraft."""
        row = message.system - 1
        known = message.name == NAME and message.frame[0] == _V2 and 0 <= row < self._aircraft
        return row if known else None

    def read(self, messages: Sequence[Message]) -> list[PeerMessage | None]:
        """Return the content of messages with a `sender`; None: numbers that no aircraft has."""
        payload = np.frombuffer(b"".join(map(_payload, messages)), PAYLOAD)
        content = self._convert.read(payload)
        plausible = _are_plausible(content)
        found: list[PeerMessage | None] = []
        for k, message in enumerate(messages):
            fields = payload[k]
            peer = PeerMessage(
                message.system - 1,
                int(fields["timestamp"]),
                int(fields["custom_state"]),
                float(fields["alt"]),
                Broadcast(*(each[k : k + 1] for each in content)),
            )
            found.append(peer if plausible[k] else None)
        return found


def _payload(message: Message) -> bytes:
    """Return the payload of a frame with the zeros at its end, which MAVLink 2 leaves out."""
    length = min(message.frame[_LENGTH], PAYLOAD.itemsize)
    return message.frame[_HEAD : _HEAD + length].ljust(PAYLOAD.itemsize, b"\0")


_LARGEST = {
    "position_ned": FARTHEST,
    "velocity_ned": FASTEST,
    "acceleration_ned": STRONGEST,
    "euler_rates": STRONGEST,
    "euler": math.tau,
}


def _are_plausible(content: Broadcast) -> BoolArray:
    """Return which of K messages have finite numbers that an aircraft may have."""
    found = np.ones(len(content.stamp_s), dtype=bool)
    for name, most in _LARGEST.items():  # a comparison with NaN is false
        found &= (np.abs(getattr(content, name)) <= most).all(axis=1)
    return found


def write_link(link: Record, message: PeerMessage, base_ms: int, received_s: float) -> bool:
    """Write a message into the newest one of its sender, unless that is not older.

    Args:
        link: of LINK; written.
        message: of another aircraft.
        base_ms: GPS time at the own boot, ms since 1970.
        received_s: s of the own boot time.

    Returns:
        Whether it was newer.
    """
    stamp_s = (message.timestamp_ms - base_ms) / MS
    link["sent"] += 1
    if stamp_s <= link["stamp_s"]:  # false before the first
        return False
    link["delivered"] += 1
    link["number"] += 1
    link["stamp_s"] = link["measured_s"] = stamp_s
    link["received_s"] = received_s
    for name in _FIELDS:
        link[name] = getattr(message.content, name)[0]
    return True
