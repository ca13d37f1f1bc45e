"""A link in this process between two sockets of a test, which sends between turns of the loop."""

import socket
import time

from testbed.link.emulator import LinkEmulator
from testbed.link.ends import open_end, parse_end
from testbed.link.link_settings import settings_from_file
from testbed.mavlink.codec import Codec
from testbed.scenario.link_file import load_link_file

LONGEST_S = 20.0
AT_ONCE = 50  # packets in a socket's buffer


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

    def carry(self, packets, end=0, wait_s=0.0):
        """Send packets from an end, some at a time, until none is on its way.

        Return what arrives at the other end.
        """
        packets, arrived = list(packets), []
        given = sum(each.offered for each in self.emulator.progress())
        sent, stop_at = 0, time.monotonic() + LONGEST_S
        quiet_at = 0.0

        def stop():
            nonlocal sent, quiet_at
            assert time.monotonic() < stop_at, "the link has not carried everything"
            arrived.extend(self.received(1 - end))
            now = self.emulator.progress()
            if sum(each.offered for each in now) - given >= sent or self.frames_differ:
                for data in packets[sent : sent + AT_ONCE]:
                    self.send(end, data)
                    quiet_at = time.monotonic() + wait_s + 0.05
                sent = min(sent + AT_ONCE, len(packets))
            on_way = sum(each.on_way for each in now)
            return sent == len(packets) and not on_way and time.monotonic() > quiet_at

        self.emulator.run(stop)
        arrived.extend(self.received(1 - end))
        return arrived

    frames_differ = False  # a datagram is no packet of its own, so that packets cannot be counted

    def summary(self, sender="a", receiver="b"):
        return self.emulator.summary()["links"][sender][receiver]
