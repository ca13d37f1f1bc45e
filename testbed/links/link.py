"""One link: a socket, whose words it carries, and what waits to be sent there."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from testbed.links.endpoint import Endpoint
from testbed.mavlink.door import Codec, Message, decode, frame_length

PACKET = 1200  # bytes of frames that go in one datagram


class Link:
    """An endpoint and the aircraft that are reached there.

    Attributes:
        endpoint: the socket.
        rows: of those aircraft.
        codec: finds messages in what is heard.
        unanswered: messages of a datagram that there was no time for yet, in order.
    """

    def __init__(self, endpoint: Endpoint, rows: Sequence[int], codec: Codec) -> None:
        """Nothing waits."""
        self.endpoint, self.rows, self.codec = endpoint, frozenset(rows), codec
        self.unanswered: deque[Message] = deque()
        self._waiting = bytearray()

    def put(self, frame: bytes) -> None:
        """Have a frame sent, together with others."""
        if len(self._waiting) + len(frame) > PACKET:
            self.flush()
        self._waiting += frame

    def flush(self) -> None:
        """Send what waits."""
        if self._waiting:
            self.endpoint.send(bytes(self._waiting))
            self._waiting.clear()


def believed(data: bytes, messages: Sequence[Message]) -> Iterator[bytes]:
    """The frames of a datagram in which these messages came."""
    at, left = 0, [_label(message) for message in messages]
    while left and at < len(data):
        frame = data[at : at + frame_length(data, at)]
        message = decode(frame)
        if message is not None and _label(message) == left[0]:
            yield frame
            left.pop(0)
        at += 1 if message is None else len(frame)


def _label(message: Message) -> tuple[str, int, int, int]:
    """What tells frames of a datagram apart; fields may be no numbers, which equal nothing."""
    return message.name, message.system, message.component, message.sequence
