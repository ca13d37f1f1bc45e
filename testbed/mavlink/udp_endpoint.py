"""Non-blocking UDP sockets.

Absent peers, full buffers and network failures are normal for a link: datagrams that cannot be
sent are counted and dropped.
"""

from __future__ import annotations

import errno
import select
import socket
from collections.abc import Callable, Iterator, Sequence

from testbed.core.errors import InputError
from testbed.mavlink.addresses import Address

Peer = tuple[str, int]

MAX_DATAGRAM_BYTES = 2048  # longer datagrams are cut; a frame has 280 bytes at most
MAX_DATAGRAMS = 200  # read at one poll, so that a flood cannot stop the flight
MAX_PEERS = 16  # of a listening socket
PEER_TIMEOUT_S = 120.0  # wall-clock s for which data is sent to a peer that sends nothing
SEND_ATTEMPTS = 2  # the first may only report that an earlier datagram was refused
BUFFER_BYTES = 1 << 20  # requested size of the system's receive and send buffers


class Endpoint:
    """Send datagrams to one peer, or to every peer that has sent something.

    Attributes:
        dropped: datagrams that could not be sent.

    Raises:
        InputError: the address cannot be used.
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
        self._peers: dict[Peer, float] = {}  # time at which each last sent something
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self._socket.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
        try:
            if self._fixed:
                # connected, so that the system discards datagrams from other peers
                self._socket.connect((address.host, address.port))
            else:
                self._socket.bind((address.host, address.port))
        except (OSError, UnicodeError) as error:  # UnicodeError: not a valid host name
            self._socket.close()
            raise InputError(_remedy(address, error)) from error

    def fileno(self) -> int:
        """Return the file descriptor, for select."""
        return self._socket.fileno()

    def receive(self) -> Iterator[tuple[Peer, bytes]]:
        """Yield received datagrams and their senders, at most `MAX_DATAGRAMS`."""
        for _ in range(MAX_DATAGRAMS):
            try:
                data, peer = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
            except ConnectionRefusedError:
                continue  # reports an earlier send
            except OSError:
                return
            yield peer, data

    def add_peer(self, peer: Peer) -> None:
        """Send to this peer too from now on, unless there are `MAX_PEERS` active ones."""
        if self._fixed:
            return
        now = self._clock()
        if peer not in self._peers and len(self._peers) >= MAX_PEERS:
            oldest = min(self._peers, key=self._peers.__getitem__)
            if now - self._peers[oldest] <= PEER_TIMEOUT_S:
                return
            del self._peers[oldest]
        self._peers[peer] = now

    def send(self, data: bytes) -> None:
        """Send a datagram to every active peer."""
        if self._fixed:
            self._send(lambda: self._socket.send(data))
            return
        now = self._clock()
        for peer, latest in self._peers.items():
            if now - latest <= PEER_TIMEOUT_S:
                self._send(lambda peer=peer: self._socket.sendto(data, peer))  # type: ignore[misc]

    def reply(self, peer: Peer, data: bytes) -> None:
        """Send one datagram to a peer, active or not; a fixed peer gets all datagrams anyway."""
        if not self._fixed:
            self._send(lambda: self._socket.sendto(data, peer))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, attempt: Callable[[], int]) -> None:
        for _ in range(SEND_ATTEMPTS):
            try:
                attempt()
                return
            except ConnectionRefusedError:
                continue
            except OSError:
                break
        self.dropped += 1


def wait(endpoints: Sequence[Endpoint], seconds: float) -> bool:
    """Wait for data on any endpoint, at most this wall-clock time, s.

    Returns:
        Whether there is data.
    """
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
