"""Messages between aircraft: FOLLOW_TARGET with GPS time and the digests of page and parameters.

https://mavlink.io/en/messages/common.html#FOLLOW_TARGET. The definition counts `timestamp` from the
sender's boot, which is no time that two aircraft share: here it is GPS time, ms since 1970, as the
sender's autopilot has it. `custom_state` has the digests of `page_digest`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from testbed.core.records import Broadcast, NedOrigin, Record
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
            digests: of page and parameters.
        """
        payload = self._payload
        self._convert.write(Broadcast(*(message[each] for each in Broadcast._fields)), payload)
        payload["timestamp"], payload["custom_state"] = timestamp_ms, digests
        return {name: payload[name][0].tolist() for name in PAYLOAD.names or ()}

    def read(self, message: Message) -> PeerMessage | None:
        """Return what a message says; None: it is of no aircraft of the formation, or absurd."""
        row = message.system - 1
        if message.name != NAME or message.frame[0] != _V2 or not 0 <= row < self._aircraft:
            return None
        length = message.frame[_LENGTH]
        raw = message.frame[_HEAD : _HEAD + length][: PAYLOAD.itemsize]
        payload = np.frombuffer(raw.ljust(PAYLOAD.itemsize, b"\0"), PAYLOAD)
        content = self._convert.read(payload)
        if not _is_plausible(content):
            return None
        fields = payload[0]
        return PeerMessage(
            row,
            int(fields["timestamp"]),
            int(fields["custom_state"]),
            float(fields["alt"]),
            content,
        )


def _is_plausible(content: Broadcast) -> bool:
    """Return whether all numbers are finite, and those of no aircraft are not among them."""
    largest = {
        "position_ned": FARTHEST,
        "velocity_ned": FASTEST,
        "acceleration_ned": STRONGEST,
        "euler_rates": STRONGEST,
        "euler": math.tau,
    }
    # a comparison with NaN is false
    return all((np.abs(getattr(content, name)) <= most).all() for name, most in largest.items())


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
