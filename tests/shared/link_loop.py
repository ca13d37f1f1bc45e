"""A link in this process between two sockets of a test, which sends between turns of the loop."""

import socket
import time

from testbed.link.emulator import LinkEmulator
from testbed.link.ends import open_end, parse_end
from testbed.link.link_file import load_link_file
from testbed.link.link_settings import settings_from_file
from testbed.mavlink.codec import Codec

LONGEST_S = 20.0
AT_ONCE = 40  # packets in a socket's buffer


def make_settings(*settings, seed=1, unit="datagrams"):
    return settings_from_file(load_link_file(None, settings, unit=unit), seed)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def attitude(number, codec=None):
    """A frame that nothing but its number tells from others."""
    rest = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.5)
    return (codec or Codec(1, 1)).pack("ATTITUDE", time_boot_ms=number, **rest)


class LinkLoop:
    """Program `a` sends to a port that listens; program `b` is sent to."""

    def __init__(self, settings, captures=()):
        self._here = free_port()
        self.a = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.b = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.b.bind(("127.0.0.1", 0))
        addresses = f"udpin:127.0.0.1:{self._here}", f"udpout:127.0.0.1:{self.b.getsockname()[1]}"
        self.ends = tuple(open_end(parse_end(each)) for each in addresses)
        self.a.connect(("127.0.0.1", self._here))
        for each in (self.a, self.b):
            each.setblocking(False)
        self._peer = None
        self.emulator = LinkEmulator(settings, self.ends, (False, False), captures)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for each in (self.a, self.b, *self.ends):
            each.close()

    def send(self, end, data):
        if end == 0:
            self.a.send(data)
        else:
            self.b.sendto(data, self._peer)

    def received(self, end):
        """What has come to a program until now."""
        found = []
        while True:
            try:
                data, peer = (self.a, self.b)[end].recvfrom(1 << 16)
            except (BlockingIOError, ConnectionRefusedError):
                return found
            self._peer = peer if end else self._peer
            found.append(data)

    def carry(self, packets, end=0, wait_s=0.0, lossless=False):
        """Send packets from an end, some at a time, until none is on its way.

        Args:
            packets: of bytes.
            end: that sends.
            wait_s: further time of the loop.
            lossless: every byte arrives, also where a datagram is no packet of its own.

        Returns:
            What arrives at the other end.
        """
        packets, arrived = list(packets), []
        given, stop_at = self.emulator.progress()[end].offered, time.monotonic() + LONGEST_S
        sent = carried_at = 0.0
        sent, size = 0, sum(map(len, packets))

        def is_taken(now):
            if lossless:
                return sum(map(len, arrived)) >= sum(map(len, packets[:sent]))
            return now.offered - given >= sent

        def stop():
            nonlocal sent, carried_at
            assert time.monotonic() < stop_at, "the link has not carried everything"
            arrived.extend(self.received(1 - end))
            now = self.emulator.progress()[end]
            if sent < len(packets) and is_taken(now) and now.on_way <= AT_ONCE:
                for data in packets[sent : sent + AT_ONCE]:
                    self.send(end, data)
                sent = min(sent + AT_ONCE, len(packets))
                return False
            if sent < len(packets) or not is_taken(now) or now.on_way:
                return False
            carried_at = carried_at or time.monotonic()
            return time.monotonic() >= carried_at + wait_s

        self.emulator.run(stop)
        arrived.extend(self.received(1 - end))
        assert not lossless or sum(map(len, arrived)) == size
        return arrived

    def summary(self, sender="a", receiver="b"):
        return self.emulator.summary()["links"][sender][receiver]
