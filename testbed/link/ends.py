"""The two ends of a link: UDP sockets, serial lines and pseudo-terminals, in one `select`.

Addresses are `udpin:HOST:PORT`, `udpout:HOST:PORT`, `serial:DEVICE:BAUD`, `pty:` and `pty:PATH`.
"""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from testbed.core.errors import ExternalProgramLost, InputError
from testbed.mavlink.udp_endpoint import Address, Endpoint, parse_address

REMEDY = (
    "write udpin:HOST:PORT to listen there, udpout:HOST:PORT to send there, serial:DEVICE:BAUD, or "
    "pty: for a new serial device"
)
BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600, 1000000, 1500000)
READ_BYTES = 4096  # of a serial line at once
MAX_OUTPUT_BYTES = 1 << 14  # that wait until a serial line takes them; more are dropped
LOST_ERRORS = (errno.EIO, errno.ENXIO, errno.ENODEV)  # of a device that was unplugged


@dataclass(frozen=True, slots=True)
class EndAddress:
    """The address of an end.

    Attributes:
        kind: of the end.
        udp: its UDP address.
        path: of the device, or of the link to a new one.
        baud: rate of the device, bit/s.
    """

    kind: Literal["udp", "serial", "pty"]
    udp: Address | None = None
    path: str = ""
    baud: int = 0

    @property
    def is_stream(self) -> bool:
        """Whether it takes bytes in place of datagrams."""
        return self.kind != "udp"

    @property
    def may_reach_aircraft(self) -> bool:
        """Whether it reaches more than the programs of this computer."""
        return self.kind == "serial" or (self.udp is not None and not self.udp.loopback)

    def __str__(self) -> str:
        """Format it as on the command line."""
        if self.udp is not None:
            return str(self.udp)
        return f"{self.kind}:{self.path}" + (f":{self.baud}" if self.baud else "")


def parse_end(text: str) -> EndAddress:
    """Parse the address of an end from the command line.

    Raises:
        InputError: it is none.
    """
    kind, _, rest = text.strip().partition(":")
    if kind == "pty":
        return EndAddress("pty", path=rest)
    if kind == "serial":
        path, _, baud = rest.rpartition(":")
        if not path or not (baud.isascii() and baud.isdigit()):
            raise InputError(f"{text}: write serial:DEVICE:BAUD, as serial:/dev/ttyUSB0:57600")
        if int(baud[:9]) not in BAUDS:
            raise InputError(f"{text}: {baud} baud; write one of {', '.join(map(str, BAUDS))}")
        return EndAddress("serial", path=path, baud=int(baud))
    if kind not in ("udpin", "udpout", "udp"):
        raise InputError(f"{text!r} is no end of a link; {REMEDY}")
    address = parse_address(text)
    if address.step:
        raise InputError(f"{text}: a link has one port at each end; leave +{address.step} out")
    return EndAddress("udp", udp=address)


def check_apart(one: EndAddress, other: EndAddress) -> None:
    """Check that an end does not send to the port at which the other one listens.

    Raises:
        InputError: it does, so that packets would go round for ever.
    """
    if one.udp is None or other.udp is None or one.udp.kind == other.udp.kind:
        return
    listening = one.udp if one.udp.kind == "udpin" else other.udp
    sending = other.udp if listening is one.udp else one.udp
    same = listening.host in (sending.host, "0.0.0.0") or (listening.loopback and sending.loopback)
    if same and listening.port == sending.port:
        raise InputError(
            f"{sending}: is the port at which the other end listens, so that packets would go "
            "round for ever; write the port of a program"
        )


class End(Protocol):
    """An open end."""

    @property
    def dropped(self) -> int:
        """Packets that could not be sent."""

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped before they were read."""

    @property
    def has_output(self) -> bool:
        """Whether bytes wait until the end takes them."""

    def fileno(self) -> int:
        """Return the file descriptor, for select."""

    def receive(self, most: int) -> Iterator[tuple[bytes, int]]:
        """Yield what was received, and when, ns since 1970; `most` pieces.

        Raises:
            ExternalProgramLost: the device is gone.
        """

    def send(self, data: bytes) -> None:
        """Send a packet, or drop it if it cannot be sent."""

    def flush(self) -> None:
        """Send what waits, as far as it is taken."""

    def close(self) -> None:
        """Close it."""

    def describe(self) -> str:
        """Return what a user connects to, if that is not the address."""


class UdpEnd:
    """A UDP socket: sends to one address, or to all that have sent something in two minutes."""

    has_output = False

    def __init__(self, address: Address) -> None:
        """Open the socket.

        Raises:
            InputError: the address cannot be used.
        """
        self._endpoint = Endpoint(address, time.monotonic, stamped=True)
        self._without_peer = 0

    @property
    def dropped(self) -> int:
        """Packets that could not be sent, also as no program has sent anything yet."""
        return self._endpoint.dropped + self._without_peer

    @property
    def unread(self) -> int:
        """Datagrams that the system has dropped before they were read."""
        return self._endpoint.unread

    def fileno(self) -> int:
        """Return the file descriptor, for select."""
        return self._endpoint.fileno()

    def receive(self, most: int) -> Iterator[tuple[bytes, int]]:
        """Yield received datagrams, and when they came, ns since 1970."""
        for peer, data, time_ns in self._endpoint.receive_stamped(most):
            self._endpoint.add_peer(peer)
            yield data, time_ns

    def send(self, data: bytes) -> None:
        """Send a datagram."""
        self._without_peer += not self._endpoint.has_peers
        self._endpoint.send(data)

    def flush(self) -> None:
        """Do nothing: datagrams do not wait."""

    def close(self) -> None:
        """Close the socket."""
        self._endpoint.close()

    def describe(self) -> str:
        """Return nothing: the address says it."""
        return ""


class SerialEnd:
    """A serial device, or the controlling side of a pseudo-terminal."""

    unread = 0

    def __init__(self, address: EndAddress) -> None:
        """Open the device, or a new pseudo-terminal.

        Raises:
            InputError: it cannot be opened.
        """
        self.dropped, self._output = 0, bytearray()
        self._address, self._other, self._link = address, -1, ""
        if address.kind == "serial":
            self._file = _open_device(address)
            self._name = ""
            return
        import pty
        import tty

        self._file, self._other = pty.openpty()
        self._name = os.ttyname(self._other)
        # the other side stays open here, so that reading waits where no program has it open
        tty.setraw(self._other)
        os.set_blocking(self._file, False)
        if address.path:
            self._link = _link_device(self._name, address)

    @property
    def has_output(self) -> bool:
        """Whether bytes wait until the line takes them."""
        return bool(self._output)

    def fileno(self) -> int:
        """Return the file descriptor, for select."""
        return self._file

    def receive(self, most: int) -> Iterator[tuple[bytes, int]]:
        """Yield received bytes, and when they were read, ns since 1970.

        Raises:
            ExternalProgramLost: the device is gone.
        """
        for _ in range(most):
            try:
                data = os.read(self._file, READ_BYTES)
            except OSError as error:
                self._check(error)
                return
            if not data:
                raise ExternalProgramLost(f"{self._address}: the device is gone; connect it again")
            yield data, time.time_ns()

    def send(self, data: bytes) -> None:
        """Send bytes; those that the line does not take now wait."""
        if len(self._output) + len(data) > MAX_OUTPUT_BYTES:
            self.dropped += 1
            return
        self._output += data
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as it is taken.

        Raises:
            ExternalProgramLost: the device is gone.
        """
        try:
            while self._output:
                del self._output[: os.write(self._file, self._output)]
        except OSError as error:
            self._check(error)

    def close(self) -> None:
        """Close the device, and remove the link to it."""
        if self._link:
            with suppress(OSError):
                if os.readlink(self._link) == self._name:
                    os.unlink(self._link)
        for file in (self._file, self._other):
            if file >= 0:
                os.close(file)
        self._file = self._other = -1

    def describe(self) -> str:
        """Return the device to open, of a pseudo-terminal."""
        return f"serial device {self._link or self._name}" if self._name else ""

    def _check(self, error: OSError) -> None:
        if error.errno in LOST_ERRORS:
            raise ExternalProgramLost(
                f"{self._address}: the device is gone: {error.strerror}; connect it again"
            ) from error


def open_end(address: EndAddress) -> End:
    """Open an end.

    Raises:
        InputError: it cannot be opened.
    """
    return SerialEnd(address) if address.udp is None else UdpEnd(address.udp)


def _open_device(address: EndAddress) -> int:
    """Open a serial device for bytes as they are, 8 bits, no parity, no flow control."""
    import fcntl
    import termios
    import tty

    try:
        if not stat.S_ISCHR(os.stat(address.path).st_mode):
            raise InputError(f"{address}: {address.path} is no device; write one as /dev/ttyUSB0")
        file = os.open(address.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, InputError):
            raise
        raise InputError(f"{address}: cannot be opened: {reason}; check the device") from error
    try:
        tty.setraw(file)
        mode = termios.tcgetattr(file)
        mode[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        mode[4] = mode[5] = getattr(termios, f"B{address.baud}")
        termios.tcsetattr(file, termios.TCSANOW, mode)
        fcntl.ioctl(file, termios.TIOCEXCL)
    except (termios.error, OSError) as error:
        os.close(file)
        raise InputError(
            f"{address}: {error.args[-1]}; write a serial device and a rate that it has"
        ) from error
    return file


def _link_device(name: str, address: EndAddress) -> str:
    """Make a symbolic link to a device, and return its path."""
    path = Path(address.path)
    try:
        path.symlink_to(name)
    except FileExistsError:
        raise InputError(
            f"{address}: {path} exists; remove it, or write another path, or pty: alone"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{address}: {path} cannot be made: {reason}; write another") from error
    return str(path.absolute())
