"""Find MAVLink frames in bytes, and cut what was received into the units that a link loses.

No byte is left out, changed or reordered: what is no frame is a unit, too.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from testbed.mavlink.codec import V2, checksum, frame_length, load_dialect

_MARKER = re.compile(b"[\xfd\xfe]")
_MARKERS = b"\xfd\xfe"
_HEAD_V1, _HEAD_V2, _CHECKSUM, _SIGNED = 6, 10, 2, 0x01


class Frame(NamedTuple):
    """A frame in some bytes: its place, sender and message, and the end of its payload."""

    begin: int
    end: int
    system: int
    message: int  # id
    payload: int  # begin of the payload
    payload_end: int
    known: bool  # its message is in the dialect, and its checksum is right


class Unit(NamedTuple):
    """Bytes that arrive or are lost together, and the frames in them."""

    data: bytes
    frames: tuple[Frame, ...]


def find_frames(data: bytes, *, complete: bool = True) -> tuple[list[Frame], int]:
    """Find the frames in received bytes.

    A frame has a right checksum. That of a message that the dialect lacks cannot be computed: it
    is a frame if another one, or nothing, follows, and no frame with a right checksum is in it.

    Args:
        data: received bytes.
        complete: no more bytes follow.

    Returns:
        The frames, and where one begins that is not complete: the end of the data if there is none.
    """
    found: list[Frame] = []
    at = 0
    while (marker := _MARKER.search(data, at)) is not None:
        at = marker.start()
        end = at + frame_length(data, at)
        if end > len(data):
            if not complete:
                return found, at
            at += 1
        elif (frame := _read_frame(data, at, end)) is not None:
            found.append(frame)
            at = end
        else:
            at += 1
    return found, len(data)


def cut_frames(data: bytes, frames: Sequence[Frame]) -> list[Unit]:
    """Cut bytes into frames and what is between them, in their order."""
    units: list[Unit] = []
    at = 0
    for frame in frames:
        if frame.begin > at:
            units.append(Unit(data[at : frame.begin], ()))
        piece, begin = data[frame.begin : frame.end], frame.begin
        moved = frame._replace(
            begin=0,
            end=len(piece),
            payload=frame.payload - begin,
            payload_end=frame.payload_end - begin,
        )
        units.append(Unit(piece, (moved,)))
        at = frame.end
    if at < len(data):
        units.append(Unit(data[at:], ()))
    return units


def cut_datagram(data: bytes) -> list[Unit]:
    """Cut a datagram into its frames and what is between them."""
    frames, _ = find_frames(data)
    return cut_frames(data, frames) if data else [Unit(data, ())]


class StreamCutter:
    """Cut the bytes of a serial line into frames and what is between them.

    Bytes that may be the begin of a frame wait for the rest, until `flush`.
    """

    def __init__(self) -> None:
        self._waiting = b""

    @property
    def is_waiting(self) -> bool:
        """Whether some bytes wait."""
        return bool(self._waiting)

    def feed(self, data: bytes) -> list[Unit]:
        """Take received bytes, and return the units that are complete."""
        data = self._waiting + data
        frames, end = find_frames(data, complete=False)
        self._waiting = data[end:]
        return cut_frames(data[:end], frames)

    def flush(self) -> list[Unit]:
        """Return the waiting bytes, after which nothing came for a while."""
        data, self._waiting = self._waiting, b""
        return cut_datagram(data) if data else []


@functools.cache
def load_messages() -> Mapping[int, bytes]:
    """Return the last byte under the checksum of each message, by its id."""
    return {number: bytes([each.crc_extra]) for number, each in load_dialect().mavlink_map.items()}


@functools.cache
def message_name(number: int) -> str:
    """Return the name of a message, or its id if the dialect lacks it."""
    definition = load_dialect().mavlink_map.get(number)
    return f"message {number}" if definition is None else str(definition.msgname)


def _read_frame(data: bytes, at: int, end: int) -> Frame | None:
    """Return the frame between two places, or None if there is none."""
    if data[at] == V2 and data[at + 2] & ~_SIGNED:
        return None
    head, system, number = _read_head(data, at)
    payload_end = head + data[at + 1]
    seed = load_messages().get(number)
    if seed is None:
        followed = end == len(data) or data[end] in _MARKERS
        if not followed or _has_known_frame(data, at + 1, end):
            return None
        return Frame(at, end, system, number, head, payload_end, known=False)
    given = data[payload_end] | data[payload_end + 1] << 8
    if checksum(data[at + 1 : payload_end] + seed) != given:
        return None
    return Frame(at, end, system, number, head, payload_end, known=True)


def _read_head(data: bytes, at: int) -> tuple[int, int, int]:
    """Return where the payload of a frame begins, its system and its message."""
    if data[at] == V2:
        number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        return at + _HEAD_V2, data[at + 5], number
    return at + _HEAD_V1, data[at + 3], data[at + 5]


def _has_known_frame(data: bytes, begin: int, end: int) -> bool:
    """Return whether a frame with a right checksum lies between two places."""
    for marker in _MARKER.finditer(data, begin, end):
        at = marker.start()
        last = at + frame_length(data, at)
        if last <= end and _read_head(data, at)[2] in load_messages():
            if _read_frame(data, at, last) is not None:
                return True
    return False
