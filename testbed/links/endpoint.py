"""One UDP socket to programs outside. Nothing here ever waits.

Nobody listening, a full buffer, a network that is away: normal in the life of a link. What could
not be sent is counted and forgotten.
"""

from __future__ import annotations

import errno
import select
import socket
from collections.abc import Callable, Iterator, Sequence

from testbed.errors import InputError
from testbed.links.addresses import Address

Peer = tuple[str, int]

LONGEST = 2048  # bytes of a datagram that are looked at; a frame has 280 at most
DATAGRAMS = 200  # read at most in one look, so that a flood cannot stop the flight
PEERS = 16  # of a socket that listens
MEMORY_S = 120.0  # for how long one who says nothing is still told, s of wall-clock time
TRIES = 2  # the first may only say that an earlier datagram was not wanted
ROOM = 1 << 20  # bytes, asked of the system for what waits to be read or sent


class Endpoint:
    """A UDP socket that sends to one peer, or to all who have spoken to it.

    Attributes:
        dropped: datagrams that could not be sent.

    Raises:
        InputError: the address cannot be used; says what to write instead.
    """

    def __init__(self, address: Address, clock: Callable[[], float]) -> None:
        """Open the socket.

        Args:
            address: of one port.
            clock: wall-clock time, s.
        """
        self.dropped = 0
        self._clock = clock
        self._fixed = address.kind == "udpout"
        self._peers: dict[Peer, float] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self._socket.setsockopt(socket.SOL_SOCKET, option, ROOM)
        try:
            if self._fixed:
                # connected: the system keeps away what anyone else sends
                self._socket.connect((address.host, address.port))
            else:
                self._socket.bind((address.host, address.port))
        except (OSError, UnicodeError) as error:  # the latter of a name that cannot be one
            self._socket.close()
            raise InputError(_remedy(address, error)) from error

    def fileno(self) -> int:
        """Of the socket, for select."""
        return self._socket.fileno()

    def receive(self) -> Iterator[tuple[Peer, bytes]]:
        """Datagrams that have come and who sent them; what is too much stays for the next look."""
        for _ in range(DATAGRAMS):
            try:
                data, peer = self._socket.recvfrom(LONGEST)
            except ConnectionRefusedError:
                continue  # of something sent before
            except OSError:
                return
            yield peer, data

    def welcome(self, peer: Peer) -> None:
        """Send to this one too, from now on, if there is room."""
        if self._fixed:
            return
        now = self._clock()
        if peer not in self._peers and len(self._peers) >= PEERS:
            oldest = min(self._peers, key=self._peers.__getitem__)
            if now - self._peers[oldest] <= MEMORY_S:
                return
            del self._peers[oldest]
        self._peers[peer] = now

    def send(self, data: bytes) -> None:
        """Send a datagram to whoever is there."""
        if self._fixed:
            self._send(lambda: self._socket.send(data))
            return
        now = self._clock()
        for peer, heard in self._peers.items():
            if now - heard <= MEMORY_S:
                self._send(lambda peer=peer: self._socket.sendto(data, peer))  # type: ignore[misc]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, attempt: Callable[[], int]) -> None:
        for _ in range(TRIES):
            try:
                attempt()
                return
            except ConnectionRefusedError:
                continue
            except OSError:
                break
        self.dropped += 1


def wait(endpoints: Sequence[Endpoint], seconds: float) -> bool:
    """Wait until one of them has something to read, for at most so long, s of wall-clock time."""
    ready, _, _ = select.select(endpoints, [], [], max(seconds, 0.0))
    return bool(ready)


def _remedy(address: Address, error: OSError | UnicodeError) -> str:
    number = error.errno if isinstance(error, OSError) else None
    if number == errno.EADDRINUSE:
        return f"{address}: another program has this port; end it, or give another port"
    if number == errno.EADDRNOTAVAIL:
        return f"{address}: this computer has no such address; give one of its own, as 127.0.0.1"
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return f"{address}: cannot be used: {reason}; give a host and a port that can be reached"
