"""Addresses of MAVLink links: `udpout:HOST:PORT`, `udpin:HOST:PORT` or `PORT`.

`PORT+STEP` stands for one port per aircraft, the leader's first, STEP apart.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from testbed.core.errors import InputError

LOOPBACK = "127.0.0.1"
_FORM = re.compile(
    r"(?:(?P<kind>udpout|udpin|udp):(?P<host>[^:]*):)?(?P<port>\d+)(?:\+(?P<step>\d+))?"
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
        """Whether the host is reachable from this computer only."""
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
