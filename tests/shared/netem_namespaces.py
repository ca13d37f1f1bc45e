"""Linux's tc netem on one way of a veth pair between two network namespaces, and packets over it.

The sockets of both ends belong to this process: a socket stays in the namespace it was made in.
The kernel stamps arrivals, with the same clock that says when a packet was sent.
"""

import ctypes
import functools
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from waiting import TIMEOUT_S

NEW_NETWORK = 0x40000000  # CLONE_NEWNET of sched.h
FORCE_SEND_BUFFER, FORCE_RECEIVE_BUFFER, STAMP_NANOSECONDS = 32, 33, 35  # asm-generic/socket.h
BUFFER = 1 << 29  # bytes: the receiver reads when a bout is sent
BOUT = 20_000  # packets that find room in it, however long
HEADERS = 14 + 20 + 8  # bytes of Ethernet, IPv4 and UDP around a payload
NUMBER = struct.Struct("<q")
STAMP = struct.Struct("qq")
PORT = 7000
ADDRESSES = ("10.213.0.1", "10.213.0.2")
HARDWARE = ("02:00:00:00:00:01", "02:00:00:00:00:02")
DEVICES = ("out", "in")
QUEUE = 1_000_000  # packets; netem's default of 1000 would drop some
PATIENCE = 0.5  # s without a packet after which none comes
LONGEST = 300.0  # s of one measurement


class Arrivals(NamedTuple):
    """K packets sent, and M arrivals in their order."""

    sent_s: np.ndarray  # (K,)
    number: np.ndarray  # (M,) which packet it was
    at_s: np.ndarray  # (M,)

    @property
    def copies(self):
        """How often each packet came (K,)."""
        return np.bincount(self.number, minlength=len(self.sent_s))

    @property
    def delays(self):
        """From sending to the first arrival (K,) s; nan: none."""
        first = np.full(len(self.sent_s), np.nan)
        first[self.number[::-1]] = self.at_s[::-1]
        return first - self.sent_s


def command(*words):
    done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S)
    if done.returncode:
        raise OSError(f"{' '.join(words)}: {done.stderr.strip() or done.returncode}")


@functools.cache
def why_not():
    """Why this machine cannot run tc netem, or an empty text."""
    if sys.platform != "linux":
        return "tc netem is Linux's"
    missing = [name for name in ("ip", "tc") if not shutil.which(name)]
    if missing:
        return f"needs {' and '.join(missing)} of iproute2"
    if os.geteuid():
        return "needs root for network namespaces"
    try:
        with netem("delay", "1ms") as wire:
            wire.send(1)
    except OSError as error:
        return f"this kernel has no netem in network namespaces: {error}"
    return ""


@contextmanager
def netem(*options):
    """A wire that does what `tc qdisc add ... netem` makes of these options."""
    names = tuple(f"testbed-{os.getpid()}-{name}" for name in DEVICES)
    made, sockets = [], []
    try:
        for name in names:
            command("ip", "netns", "add", name)
            made.append(name)
        _join(names)
        limit = () if "limit" in options else ("limit", str(QUEUE))
        command(
            "tc", "-n", names[0], "qdisc", "add", "dev", DEVICES[0], "root", "netem",
            *limit, *options,
        )  # fmt: skip
        sockets += [_socket_in(name) for name in names]
        yield Wire(*sockets)
    finally:
        for each in sockets:
            each.close()
        for name in made:
            command("ip", "netns", "del", name)


def _join(names):
    """Two devices that know each other; nothing but our packets comes to netem."""
    command(
        "ip", "link", "add", DEVICES[0], "netns", names[0], "address", HARDWARE[0],
        "type", "veth", "peer", "name", DEVICES[1], "netns", names[1], "address", HARDWARE[1],
    )  # fmt: skip
    for end, (name, device) in enumerate(zip(names, DEVICES, strict=True)):
        ip = ("ip", "-n", name)
        command(*ip, "address", "add", f"{ADDRESSES[end]}/24", "dev", device)
        if os.path.exists("/proc/net/if_inet6"):
            command(*ip, "link", "set", device, "addrgenmode", "none")  # IPv6 would speak up
        command(*ip, "link", "set", device, "up")
        other = 1 - end
        command(
            *ip, "neigh", "replace", ADDRESSES[other], "lladdr", HARDWARE[other],
            "dev", device, "nud", "permanent",
        )  # fmt: skip


def _socket_in(namespace):
    libc = ctypes.CDLL(None, use_errno=True)

    def enter(descriptor):
        if libc.setns(descriptor, NEW_NETWORK):
            raise OSError(ctypes.get_errno(), "setns")

    home = os.open("/proc/self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    try:
        enter(there)
        try:
            return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        finally:
            enter(home)
    finally:
        os.close(there)
        os.close(home)


class Wire:
    """From one namespace to the other."""

    def __init__(self, sender, receiver):
        sender.setsockopt(socket.SOL_SOCKET, FORCE_SEND_BUFFER, BUFFER)
        receiver.setsockopt(socket.SOL_SOCKET, FORCE_RECEIVE_BUFFER, BUFFER)
        receiver.setsockopt(socket.SOL_SOCKET, STAMP_NANOSECONDS, 1)
        receiver.bind((ADDRESSES[1], PORT))
        receiver.settimeout(PATIENCE)
        sender.connect((ADDRESSES[1], PORT))
        self.sender, self.receiver = sender, receiver

    def send(self, packets, *, payload=100, period_s=0.0):
        """Send this many packets, one every period_s or as fast as it goes, and see what comes.

        After every bout it waits until the wire is empty.

        Args:
            packets: K.
            payload: bytes, at least 8.
            period_s: s.
        """
        filling = bytes(payload - NUMBER.size)
        sent = np.empty(packets, dtype=np.int64)
        begin, step = time.clock_gettime_ns(time.CLOCK_REALTIME), round(1e9 * period_s)
        number, at = [], []
        for k in range(packets):
            while (now := time.clock_gettime_ns(time.CLOCK_REALTIME)) < begin + k * step:
                pass
            sent[k] = now
            self.sender.send(NUMBER.pack(k) + filling)
            if now - begin > 1e9 * LONGEST:
                raise TimeoutError(f"{k} of {packets} packets in {LONGEST} s")
            if (k + 1) % BOUT == 0 or k + 1 == packets:
                for name, nanoseconds in self._arrivals():
                    number.append(name)
                    at.append(nanoseconds)
        return Arrivals(
            1e-9 * (sent - begin),
            np.array(number, dtype=np.int64),
            1e-9 * (np.array(at, dtype=np.int64) - begin),
        )

    def _arrivals(self):
        """Number and time in ns of every packet until none comes any more."""
        end = time.monotonic() + LONGEST
        while time.monotonic() < end:
            try:
                data, ancillary, _, _ = self.receiver.recvmsg(2048, 64)
            except TimeoutError:
                return
            seconds, nanoseconds = STAMP.unpack(ancillary[0][2])
            yield NUMBER.unpack_from(data)[0], seconds * 10**9 + nanoseconds
        raise TimeoutError(f"packets still arrive after {LONGEST} s")
