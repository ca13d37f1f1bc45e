"""Where programs outside are reached: `udpout:HOST:PORT` and its kin.

A port followed by `+STEP` is one for each aircraft, the leader's first, STEP apart.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from testbed.errors import InputError

LOOPBACK = "127.0.0.1"
_FORM = re.compile(
    r"(?:(?P<kind>udpout|udpin|udp):(?P<host>[^:]*):)?(?P<port>\d+)(?:\+(?P<step>\d+))?"
)
_REMEDY = (
    "write udpout:HOST:PORT to send there, udpin:HOST:PORT to wait there for who speaks first, "
    "or a port alone for udpout:127.0.0.1:PORT; PORT+STEP is a port for each aircraft"
)


def is_loopback(host: str) -> bool:
    """Whether a name or a number is of this computer alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True, slots=True)
class Address:
    """One address as it was given.

    Attributes:
        kind: "udpout" sends to it, "udpin" listens on it.
        host: a name or a number of IPv4.
        port: of the leader, or of all.
        step: from aircraft to aircraft; 0: one port for all.
    """

    kind: Literal["udpout", "udpin"]
    host: str
    port: int
    step: int = 0

    def __str__(self) -> str:
        """As it is written on the command line."""
        step = f"+{self.step}" if self.step else ""
        return f"{self.kind}:{self.host}:{self.port}{step}"

    @property
    def loopback(self) -> bool:
        """Whether only this computer is reached."""
        return is_loopback(self.host)

    def of(self, row: int, name: str = "") -> Address:
        """Where the aircraft of this row is reached.

        Args:
            row: of it, the leader's being 0.
            name: of it, for people.

        Raises:
            InputError: there is no such port.
        """
        port = self.port + row * self.step
        if port > 65535:
            raise InputError(
                f"{self}: port {port} of {name or f'aircraft {row + 1}'}; give ports of 1 to 65535"
            )
        return replace(self, port=port, step=0)


def parse_address(text: str) -> Address:
    """An address from the command line.

    Raises:
        InputError: naming what to write instead.
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


def places(
    addresses: Sequence[Address], names: Sequence[str]
) -> Iterator[tuple[Address, Sequence[int]]]:
    """Every port and the rows of the aircraft that are reached there.

    Args:
        addresses: as they were given.
        names: of N aircraft, by row.

    Raises:
        InputError: a port that cannot be, or is given twice.
    """
    taken = set()
    rows = range(len(names))
    for address in addresses:
        shared: list[tuple[Address, Sequence[int]]] = [(address, rows)]
        alone = [(address.of(row, names[row]), [row]) for row in rows]
        for place, reached in alone if address.step else shared:
            if place in taken:
                raise InputError(f"{place}: given twice; give each address once")
            taken.add(place)
            yield place, reached
