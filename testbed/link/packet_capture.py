"""Record what passes at one end of a link: packets (.pcap) and MAVLink frames (.tlog).

The .pcap has IPv4 and UDP headers in front of each packet, also of those of a serial line
(https://www.ietf.org/archive/id/draft-ietf-opsawg-pcap-04.html, with nanoseconds).
"""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from testbed.core.errors import InputError
from testbed.link.ends import EndAddress
from testbed.link.frame_cutter import find_frames
from testbed.mavlink.tlog import RecordWriter, TlogWriter

_FILE = struct.Struct("<IHHiIII")
_PACKET = struct.Struct("<IIII")
_IP, _UDP = struct.Struct(">BBHHHBBH4s4s"), struct.Struct(">HHHH")
NANOSECONDS_MAGIC, LINKTYPE_IPV4, LARGEST = 0xA1B23C4D, 228, 1 << 16
HEADERS = _IP.size + _UDP.size
SERIAL_PORTS = 14550, 14551  # of ends without a port of their own
MAX_PAYLOAD = 65_535 - HEADERS

Socket = tuple[bytes, int]  # IPv4 address and port


def socket_of(address: EndAddress, end: int) -> Socket:
    """Return the address and port that stand for an end in a .pcap."""
    host, port = "127.0.0.1", SERIAL_PORTS[end]
    if address.udp is not None:
        port = address.udp.port
        with suppress(ValueError):  # a name
            host = str(ipaddress.IPv4Address(address.udp.host))
    return ipaddress.IPv4Address(host).packed, port


class PcapWriter(RecordWriter):
    """Write a .pcap.

    Raises:
        MavlinkError: the file cannot be written; also from every method, once.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.add(_FILE.pack(NANOSECONDS_MAGIC, 2, 4, 0, 0, LARGEST, LINKTYPE_IPV4))

    def write(self, time_ns: int, source: Socket, destination: Socket, data: bytes) -> None:
        """Add a packet.

        Args:
            time_ns: ns since 1970.
            source: of the packet.
            destination: of the packet.
            data: content, of which at most 65,507 bytes are written.
        """
        data = data[:MAX_PAYLOAD]
        size = HEADERS + len(data)
        ends = source[0], destination[0]
        head = _IP.pack(0x45, 0, size, 0, 0, 64, 17, 0, *ends)
        head = _IP.pack(0x45, 0, size, 0, 0, 64, 17, _internet_checksum(head), *ends)
        udp = _UDP.pack(source[1], destination[1], _UDP.size + len(data), 0)
        stamp = _PACKET.pack(time_ns // 10**9, time_ns % 10**9, size, size)
        self.add(stamp + head + udp + data)


def _internet_checksum(data: bytes) -> int:
    """Return the checksum of an IPv4 header (RFC 1071)."""
    total: int = sum(word for (word,) in struct.iter_unpack(">H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


class EndCapture:
    """Record what passes at one end; a file that cannot be written any more is given up.

    Args:
        sockets: that stand for this end and the other one.
        pcap: file of the packets; None: none.
        tlog: file of the frames; None: none.
        warn: called with the reason when a file is given up.

    Raises:
        InputError: a file cannot be made.
    """

    def __init__(
        self,
        sockets: tuple[Socket, Socket],
        pcap: Path | None,
        tlog: Path | None,
        warn: Callable[[str], None],
    ) -> None:
        self._sockets, self._warn = sockets, warn
        self._pcap = PcapWriter(pcap) if pcap else None
        self._tlog = TlogWriter(tlog) if tlog else None

    @property
    def is_active(self) -> bool:
        """Whether anything is recorded."""
        return self._pcap is not None or self._tlog is not None

    def record(self, time_ns: int, data: bytes, *, sent_here: bool) -> None:
        """Record what an end has sent into the link, or got from it.

        Args:
            time_ns: ns since 1970.
            data: a datagram, or bytes of a line.
            sent_here: by the program at this end.
        """
        here, there = self._sockets
        if self._pcap is not None:
            ends = (here, there) if sent_here else (there, here)
            try:
                self._pcap.write(time_ns, *ends, data)
            except InputError as error:
                self._give_up(self._pcap, error)
                self._pcap = None
        if self._tlog is not None:
            try:
                for frame in find_frames(data)[0]:
                    self._tlog.write(time_ns // 1000, data[frame.begin : frame.end])
            except InputError as error:
                self._give_up(self._tlog, error)
                self._tlog = None

    def _give_up(self, file: RecordWriter, error: InputError) -> None:
        self._warn(f"{error}; this recording ends here, and the link goes on")
        file.close()  # nothing waits any more

    def close(self) -> None:
        """Complete the files."""
        for file in (self._pcap, self._tlog):
            if file is not None:
                try:
                    file.close()
                except InputError as error:
                    self._warn(str(error))
        self._pcap = self._tlog = None
