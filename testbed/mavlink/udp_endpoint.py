"""Non-blocking UDP sockets of MAVLink links, and their addresses.

An address is `udpout:HOST:PORT`, `udpin:HOST:PORT` or `PORT`; `PORT+STEP` stands for one port per
aircraft, the leader's first, STEP apart.

Absent peers, full buffers and network failures are normal for a link: datagrams that cannot be
sent are counted and dropped.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import re
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

from testbed.core.errors import InputError

LOOPBACK = "127.0.0.1"
_FORM = re.compile(
    r"(?:(?P<kind>udpout|udpin|udp):(?P<host>[^:]*):)?(?P<port>[0-9]+)(?:\+(?P<step>[0-9]+))?"
)
_REMEDY = (
    "write udpout:HOST:PORT to send there, udpin:HOST:PORT to listen there, or a port alone for "
    "udpout:127.0.0.1:PORT; PORT+STEP is a port for each aircraft"
)


def is_loopback(host: str) -> bool:
    """Check whether a host name or IP address is reachable from this computer only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a link.

    Attributes:
        kind: "udpout" sends to it, "udpin" listens on it.
        host: name or IPv4 address.
        port: of the leader, or of all aircraft.
        step: from one aircraft's port to the next; 0: one port for all.
    """

    kind: Literal["udpout", "udpin"]
    host: str
    port: int
    step: int = 0

    def __str__(self) -> str:
        """Format the address as on the command line."""
        step = f"+{self.step}" if self.step else ""
        return f"{self.kind}:{self.host}:{self.port}{step}"

    @property
    def loopback(self) -> bool:
        """Return whether the host is reachable from this computer only."""
        return is_loopback(self.host)

    def for_aircraft(self, row: int, name: str = "") -> Address:
        """Return the address of one aircraft.

        Args:
            row: of the aircraft; the leader's is 0.
            name: of the aircraft, for error messages.

        Raises:
            InputError: its port would be above 65535.
        """
        port = self.port + row * self.step
        if port > 65535:
            raise InputError(
                f"{self}: port {port} of {name or f'aircraft {row + 1}'}; give ports of 1 to 65535"
            )
        return replace(self, port=port, step=0)


def parse_address(text: str) -> Address:
    """Parse an address from the command line.

    Raises:
        InputError: it is not an address.
    """
    form = _FORM.fullmatch(text.strip())
    if form is None:
        raise InputError(f"{text!r} is not a MAVLink address; {_REMEDY}")
    port, step = int(form["port"]), int(form["step"] or 0)
    if not 1 <= port <= 65535:
        raise InputError(f"{text!r}: port {port}; give one of 1 to 65535")
    if form["step"] and not 1 <= step <= 65535:
        raise InputError(f"{text!r}: a step of {step}; give 1 or more, or no +STEP")
    return Address(
        "udpin" if form["kind"] in ("udp", "udpin") else "udpout",
        form["host"] or LOOPBACK,
        port,
        step,
    )


def link_addresses(
    addresses: Sequence[Address], names: Sequence[str]
) -> Iterator[tuple[Address, Sequence[int]]]:
    """Yield the address of every link and the rows of its aircraft.

    Args:
        addresses: from the command line.
        names: of N aircraft, by row.

    Raises:
        InputError: a port is above 65535, or an address occurs twice.
    """
    seen = set()
    rows = range(len(names))
    for address in addresses:
        shared: list[tuple[Address, Sequence[int]]] = [(address, rows)]
        separate = [(address.for_aircraft(row, names[row]), [row]) for row in rows]
        for link, link_rows in separate if address.step else shared:
            if link in seen:
                raise InputError(f"{link}: given twice; give each address once")
            seen.add(link)
            yield link, link_rows


Peer = tuple[str, int]

MAX_DATAGRAM_BYTES = 2048  # longer datagrams are cut; a frame has 280 bytes at most
MAX_DATAGRAMS = 200  # read at one poll, so that a flood cannot stop the flight
MAX_PEERS = 16  # of a listening socket
PEER_TIMEOUT_S = 120.0  # wall-clock s for which data is sent to a peer that sends nothing
SEND_ATTEMPTS = 2  # the first may only report that an earlier datagram was refused
BUFFER_BYTES = 1 << 20  # requested size of the system's receive and send buffers
# Of Linux: the time of receipt with each datagram, and how many the system has dropped before it.
_STAMP, _DROPPED = getattr(socket, "SO_TIMESTAMPNS", 35), getattr(socket, "SO_RXQ_OVFL", 40)
_LARGEST_DATAGRAM, _ANCILLARY_BYTES = 1 << 16, 128
_TIMESPEC, _COUNT = struct.Struct("qq"), struct.Struct("I")


class Endpoint:
    """Send datagrams to one peer, or to every peer that has sent something.

    Attributes:
        dropped: datagrams that could not be sent.
        unread: datagrams that the system has dropped before they were read, with time stamps.

    Raises:
        InputError: the address cannot be used.
    """

    def __init__(
        self,
        address: Address,
        clock: Callable[[], float],
        *,
        stamped: bool = False,
        interface: str = "",
    ) -> None:
        """Open the socket.

        Args:
            address: of one port.
            clock: wall-clock time, s.
            stamped: for `receive_stamped`.
            interface: address of this computer by which it joins the group that `address` is, and
                sends to it, to the next router at most; empty: the host is no group.
        """
        self.dropped = self.unread = 0
        self._clock = clock
        self._fixed = address.kind == "udpout"
        self._peers: dict[Peer, float] = {}  # time at which each last sent something
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        size = 4 * BUFFER_BYTES if stamped else BUFFER_BYTES
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self._socket.setsockopt(socket.SOL_SOCKET, option, size)
        self._buffer = bytearray(_LARGEST_DATAGRAM if stamped else 0)
        for option in (_STAMP, _DROPPED) if stamped else ():
            with contextlib.suppress(OSError):  # another system: stamped when read
                self._socket.setsockopt(socket.SOL_SOCKET, option, 1)
        try:
            if interface:
                self._join(address.host, interface)
            if self._fixed:
                # connected, so that the system discards datagrams from other peers
                self._socket.connect((address.host, address.port))
            else:
                self._socket.bind((address.host, address.port))
        except (OSError, UnicodeError) as error:  # UnicodeError: not a valid host name
            self._socket.close()
            raise InputError(_remedy(address, error)) from error

    def _join(self, group: str, interface: str) -> None:
        """Join a multicast group; other programs of this computer may join it, too."""
        own = socket.inet_aton(interface)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        for option, value in (
            (socket.IP_MULTICAST_TTL, b"\x01"),
            (socket.IP_MULTICAST_LOOP, b"\x01"),
            (socket.IP_MULTICAST_IF, own),
            (socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + own),
        ):
            self._socket.setsockopt(socket.IPPROTO_IP, option, value)

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

    def receive_stamped(self, most: int) -> Iterator[tuple[Peer, bytes, int]]:
        """Yield received datagrams of any size with senders and times of receipt, ns since 1970.

        Args:
            most: number of datagrams.
        """
        for _ in range(most):
            try:
                size, ancillary, _, peer = self._socket.recvmsg_into(
                    [self._buffer], _ANCILLARY_BYTES
                )
            except ConnectionRefusedError:
                continue
            except OSError:
                return
            time_ns = 0
            for _, kind, content in ancillary:
                if kind == _STAMP and len(content) == _TIMESPEC.size:
                    seconds, rest = _TIMESPEC.unpack(content)
                    time_ns = seconds * 1_000_000_000 + rest
                elif kind == _DROPPED and len(content) == _COUNT.size:
                    (self.unread,) = _COUNT.unpack(content)
            yield peer, bytes(self._buffer[:size]), time_ns or time.time_ns()

    @property
    def port(self) -> int:
        """The own port; of an address with port 0 the one that the system has chosen."""
        found: int = self._socket.getsockname()[1]
        return found

    @property
    def has_peers(self) -> bool:
        """Whether there is one to send to, active or not."""
        return self._fixed or bool(self._peers)

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
        """Send a datagram to a peer, active or not, unless peers are fixed."""
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


class HasFileno(Protocol):
    """What `select` waits for."""

    def fileno(self) -> int:
        """Return the file descriptor."""


def wait(endpoints: Sequence[HasFileno], seconds: float) -> bool:
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
