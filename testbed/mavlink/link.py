"""A MAVLink link: a UDP endpoint, the aircraft behind it, and the frames to send."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from testbed.mavlink.codec import Codec, Message, decode, frame_length
from testbed.mavlink.udp_endpoint import Endpoint

MAX_PACKET_BYTES = 1200  # of frames in one datagram


class MavlinkLink:
    """Combine frames into datagrams, and store received messages until they are handled.

    Attributes:
        endpoint: the socket.
        rows: of the aircraft that use this link.
        codec: parses received datagrams.
        unhandled: received messages, in order.
    """

    def __init__(self, endpoint: Endpoint, rows: Sequence[int], codec: Codec) -> None:
        """Start with nothing to send."""
        self.endpoint, self.rows, self.codec = endpoint, frozenset(rows), codec
        self.unhandled: deque[Message] = deque()
        self._packet = bytearray()

    def queue(self, frame: bytes) -> None:
        """Add a frame to the datagram; send the datagram before if it is full."""
        if len(self._packet) + len(frame) > MAX_PACKET_BYTES:
            self.flush()
        self._packet += frame

    def flush(self) -> None:
        """Send the queued frames."""
        if self._packet:
            self.endpoint.send(bytes(self._packet))
            self._packet.clear()


def authenticated_frames(data: bytes, messages: Sequence[Message]) -> Iterator[bytes]:
    """Yield the frames of a datagram that these accepted messages were parsed from."""
    at, remaining = 0, [_label(message) for message in messages]
    while remaining and at < len(data):
        frame = data[at : at + frame_length(data, at)]
        message = decode(frame)
        if message is not None and _label(message) == remaining[0]:
            yield frame
            remaining.pop(0)
        at += 1 if message is None else len(frame)


def _label(message: Message) -> tuple[str, int, int, int]:
    """Return what identifies a frame in a datagram; fields may be NaN, which equals nothing."""
    return message.name, message.system, message.component, message.sequence
