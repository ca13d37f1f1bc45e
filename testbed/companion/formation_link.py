"""Addresses and sockets of the formation: a multicast group, an address for each, or a hub."""

from __future__ import annotations

import ipaddress
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from testbed.core.errors import InputError
from testbed.mavlink.udp_endpoint import LOOPBACK, Address, Endpoint, Peer, is_loopback

REMEDY = (
    "write multicast:GROUP:PORT@INTERFACE_ADDRESS, peers:HOST:PORT,HOST:PORT,… with an address for "
    "each aircraft, the leader's first, or hub:HOST:PORT"
)
_PLACE = re.compile(r"([^:@,]+):([0-9]{1,5})")
MOST_AT_ONCE = 100  # datagrams of one read


@dataclass(frozen=True, slots=True)
class FormationAddress:
    """Where the messages of a formation go.

    Attributes:
        kind: how.
        places: host and port: of the group, of each aircraft, or of the hub.
        interface: address of this computer in a multicast's network.
    """

    kind: Literal["multicast", "peers", "hub"]
    places: tuple[Peer, ...]
    interface: str = ""

    @property
    def loopback(self) -> bool:
        """Whether it reaches the programs of this computer only."""
        if self.kind == "multicast":
            return is_loopback(self.interface)
        return all(is_loopback(host) for host, _ in self.places)

    def __str__(self) -> str:
        """Format it as on the command line."""
        places = ",".join(f"{host}:{port}" for host, port in self.places)
        return f"{self.kind}:{places}" + (f"@{self.interface}" if self.interface else "")


def parse_formation(text: str, names: Sequence[str]) -> FormationAddress:
    """Parse an address of the command line.

    Args:
        text: to parse.
        names: of the N aircraft, the leader first.

    Raises:
        InputError: it is none.
    """
    kind, _, rest = text.strip().partition(":")
    interface = ""
    if kind == "multicast":
        rest, _, interface = rest.partition("@")
        interface = interface or LOOPBACK
    if kind not in ("multicast", "peers", "hub"):
        raise InputError(f"--formation {text}: is no address of a formation; {REMEDY}")
    places = tuple(_place(each, text) for each in rest.split(","))
    if kind != "peers" and len(places) != 1:
        raise InputError(f"--formation {text}: has {len(places)} addresses; write one")
    if kind == "peers":
        _check_peers(places, text, names)
    if kind == "multicast":
        _check_group(places[0][0], interface, text)
        return FormationAddress("multicast", places, interface)
    return FormationAddress("peers" if kind == "peers" else "hub", places)


def _place(text: str, whole: str) -> Peer:
    found = _PLACE.fullmatch(text.strip())
    if found is None or not 1 <= int(found[2]) <= 65535:
        raise InputError(f"--formation {whole}: {text!r} is no HOST:PORT; {REMEDY}")
    return found[1], int(found[2])


def _check_peers(places: tuple[Peer, ...], text: str, names: Sequence[str]) -> None:
    if len(places) != len(names):
        raise InputError(
            f"--formation {text}: has {len(places)} addresses; write {len(names)}, of "
            f"{', '.join(names)}"
        )
    twice = next((each for k, each in enumerate(places) if each in places[:k]), None)
    if twice is not None:
        raise InputError(
            f"--formation {text}: {twice[0]}:{twice[1]} stands twice; write one for each aircraft"
        )


def _check_group(group: str, interface: str, text: str) -> None:
    try:
        known = ipaddress.IPv4Address(group).is_multicast
    except ValueError:
        known = False
    if not known:
        raise InputError(
            f"--formation {text}: {group} is no multicast group; write one of 224.0.0.0 to "
            "239.255.255.255, as 239.255.41.1"
        )
    try:
        ipaddress.IPv4Address(interface)
    except ValueError:
        raise InputError(
            f"--formation {text}: {interface} is no IPv4 address; write that of the interface, as "
            "192.168.4.2"
        ) from None


class FormationLink:
    """An open link to the other aircraft of a formation.

    Attributes:
        address: of the link.
    """

    def __init__(self, address: FormationAddress, row: int) -> None:
        """Open the socket.

        Args:
            address: of the formation.
            row: of the own aircraft, whose address of `peers` is listened at.

        Raises:
            InputError: the address cannot be used.
        """
        self.address = address
        host, port = address.places[row if address.kind == "peers" else 0]
        kind: Literal["udpout", "udpin"] = "udpout" if address.kind == "hub" else "udpin"
        self._endpoint = Endpoint(
            Address(kind, host, port), time.monotonic, stamped=True, interface=address.interface
        )
        self._others = [each for each in address.places if each != (host, port)]
        if address.kind == "multicast":
            self._others = [(host, port)]

    @property
    def dropped(self) -> int:
        """Datagrams that could not be sent."""
        return self._endpoint.dropped

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped before they were read."""
        return self._endpoint.unread

    def fileno(self) -> int:
        """Return the file descriptor, for select."""
        return self._endpoint.fileno()

    def receive(self) -> Iterator[tuple[bytes, int]]:
        """Yield received datagrams, and when they came, ns since 1970."""
        for _, data, time_ns in self._endpoint.receive_stamped(MOST_AT_ONCE):
            yield data, time_ns

    def send(self, data: bytes) -> None:
        """Send a datagram to all others, or to the hub."""
        if self.address.kind == "hub":
            self._endpoint.send(data)
        for peer in self._others if self.address.kind != "hub" else ():
            self._endpoint.reply(peer, data)

    def close(self) -> None:
        """Close the socket."""
        self._endpoint.close()
