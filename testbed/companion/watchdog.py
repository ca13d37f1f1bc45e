"""Notify systemd that a companion is ready, and with each pass of its loop that it runs.

One datagram to the socket of $NOTIFY_SOCKET, as of sd_notify(3); without that variable nothing is
sent, so that the companion runs by hand as it runs as a service.
"""

from __future__ import annotations

import math
import os
import socket
from collections.abc import Mapping
from contextlib import suppress

from testbed.core.numbers import parse_whole

_SHARE = 0.25  # of the watchdog's time between two messages
_LONGEST_STATUS = 200  # characters


class Watchdog:
    """The service manager's view of a companion."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """Open a socket, if a service manager listens.

        Args:
            environment: with NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID of a service.
        """
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if address.startswith(("/", "@")):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        micros = parse_whole(environment.get("WATCHDOG_USEC", "")) or 0
        asked = parse_whole(environment.get("WATCHDOG_PID", "")) in (None, os.getpid())
        watches = self._socket is not None and asked and micros > 0
        self.period_s = _SHARE * micros * 1e-6 if watches else math.inf
        """Time between two messages of `alive`, s; infinite: none are expected."""
        self._next_s = -math.inf

    def ready(self) -> None:
        """Notify that the own state is read and the loop runs."""
        self._send("READY=1")

    def alive(self, now_s: float) -> None:
        """Notify that the loop runs; call it at each pass, from the loop and from nothing else.

        Args:
            now_s: monotonic clock.
        """
        if self.period_s == math.inf or now_s < self._next_s:
            return
        self._next_s = now_s + self.period_s
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Set the text that `systemctl status` prints."""
        self._send(f"STATUS={' '.join(text.split())[:_LONGEST_STATUS]}")

    def close(self) -> None:
        """Notify that the companion ends, and close the socket."""
        self._send("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):  # a service manager that is busy or gone stops no flight
                self._socket.sendto(message.encode(), self._address)
