"""Measure how late `testbed link` delivers, what it costs, and whether it loses packets unasked.

Each case starts the link as a program on loopback, sends MAVLink frames at an even rate, and
compares the system's time stamps of their arrival with the time of sending plus the delay. It
exchanges nothing with other machines. On a machine that does other work the times are those of that
work, too: the load is printed.

usage: make bench  (or: python benchmarks/link.py [--delays MS,...] [--rates HZ,...] [--seconds S]
[--json FILE])
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.mavlink.codec import Codec

STAMP = 35  # SO_TIMESTAMPNS
TIMER_SLACK = 29  # of prctl
READY_S = 120.0  # kernels may have to be compiled first
SETTLE_S = 0.5
BUFFER_BYTES = 1 << 23
NUMBER = struct.Struct("<Q")  # in the payload of a frame: roll and pitch
AT = 14  # where it is in the frame


class Sent(NamedTuple):
    """Packets of one case."""

    sent_ns: np.ndarray  # (K,) since 1970
    number: np.ndarray  # (C,) of each arrival
    arrived_ns: np.ndarray  # (C,)


@contextmanager
def running_link(ports: tuple[int, int], json_file: Path, settings: Sequence[str]) -> Iterator[Any]:
    """Run a link from a port that listens to another, until the block ends."""
    command = [sys.executable, "-m", "testbed", "link", f"udpin:127.0.0.1:{ports[0]}"]
    command += [f"udpout:127.0.0.1:{ports[1]}", "--quiet", "--json", str(json_file)]
    process = subprocess.Popen(
        [*command, *(word for each in settings for word in ("--set", each))],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        while not (line := process.stderr.readline()).startswith("link:"):
            if not line:
                raise SystemExit("the link has not started")
        yield process
    finally:
        process.terminate()
        process.wait(10.0)


def free_ports() -> tuple[int, int]:
    """Return two unused UDP ports."""
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as two:
        for each in (one, two):
            each.bind(("127.0.0.1", 0))
        return one.getsockname()[1], two.getsockname()[1]


def send(ports: tuple[int, int], count: int, rate_hz: float, wait_s: float) -> Sent:
    """Send frames at an even rate to the first port, and receive them at the second."""
    codec = Codec(1, 1)
    rest = dict.fromkeys(("yaw", "rollspeed", "pitchspeed", "yawspeed"), 1.0)
    frames = []
    for k in range(count):
        roll, pitch = struct.unpack("<ff", NUMBER.pack(k | 1 << 62))  # no byte at the end is 0
        frames.append(codec.pack("ATTITUDE", time_boot_ms=k, roll=roll, pitch=pitch, **rest))
    sent_ns, numbers, arrived_ns = np.zeros(count, np.int64), [], []
    with (
        socket.socket(type=socket.SOCK_DGRAM) as sink,
        socket.socket(type=socket.SOCK_DGRAM) as source,
    ):
        sink.setsockopt(socket.SOL_SOCKET, STAMP, 1)
        sink.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        sink.bind(("127.0.0.1", ports[1]))
        sink.setblocking(False)
        source.connect(("127.0.0.1", ports[0]))

        def drain() -> None:
            with suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    data, ancillary, _, _ = sink.recvmsg(2048, 64)
                    seconds, ns = struct.unpack("qq", ancillary[0][2])
                    numbers.append(NUMBER.unpack_from(data, AT)[0] & ~(1 << 62))
                    arrived_ns.append(seconds * 10**9 + ns)

        begin_ns, period_ns = time.time_ns() + 50_000_000, 1e9 / rate_hz
        for k, frame in enumerate(frames):
            while (left := begin_ns + int(k * period_ns) - time.time_ns()) > 0:
                select.select([sink], [], [], left * 1e-9)
                drain()
            sent_ns[k] = time.time_ns()
            source.send(frame)
        end = time.monotonic() + wait_s
        while (left_s := end - time.monotonic()) > 0.0:
            select.select([sink], [], [], left_s)
            drain()
    return Sent(sent_ns, np.array(numbers, np.int64), np.array(arrived_ns, np.int64))


def measure(delay_s: float, rate_hz: float, seconds: float) -> dict[str, Any]:
    """Measure one delay and rate."""
    ports, count = free_ports(), round(rate_hz * seconds)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "link.json")
        with running_link(ports, file, [f"network.delay_s={delay_s}"]):
            sent = send(ports, count, rate_hz, delay_s + SETTLE_S)
        document = json.loads(file.read_text("utf-8"))
    error_ms = 1e-6 * (sent.arrived_ns - sent.sent_ns[sent.number]) - 1e3 * delay_s
    p50, p99 = np.percentile(np.abs(error_ms), (50, 99)) if len(error_ms) else (np.nan, np.nan)
    span_s = 1e-9 * (sent.sent_ns[-1] - sent.sent_ns[0])
    return {
        "delay_ms": 1e3 * delay_s,
        "rate_hz": rate_hz,
        "achieved_hz": (count - 1) / span_s,
        "error_p50_ms": float(p50),
        "error_p99_ms": float(p99),
        "error_max_ms": float(np.abs(error_ms).max(initial=0.0)),
        "lost": count - len(set(sent.number.tolist())),
        "processor_share": document["emulator"]["processor_share"],
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Measure all cases."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--delays", default="1,10,100", help="ms")
    parser.add_argument("--rates", default="50,1000,5000", help="packets per second")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with suppress(OSError, AttributeError):  # of this program, which times the sending
        ctypes.CDLL(None).prctl(TIMER_SLACK, 1, 0, 0, 0)
    rows = []
    print("delay, ms   packets/s   error p50, ms    p99     max   lost   core   load")
    for delay_ms in map(float, args.delays.split(",")):
        for rate_hz in map(float, args.rates.split(",")):
            row = measure(1e-3 * delay_ms, rate_hz, args.seconds)
            rows.append(row)
            print(
                f"{delay_ms:9g}{row['achieved_hz']:12,.0f}{row['error_p50_ms']:16.3f}"
                f"{row['error_p99_ms']:7.2f}{row['error_max_ms']:8.1f}{row['lost']:7d}"
                f"{row['processor_share']:7.2f}{row['load']:7.1f}",
                flush=True,
            )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    main()
