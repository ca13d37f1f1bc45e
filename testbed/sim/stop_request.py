"""Stop requests by Ctrl-C and SIGTERM."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from testbed.core.interrupts import sigint_count


class RunStopped(Exception):
    """A stop was requested during a wait for an external program."""


class StopRequest:
    """Count Ctrl-C and SIGTERM: the first requests a stop, later ones raise KeyboardInterrupt."""

    def __init__(self) -> None:
        """Start with the signals that came while libraries were loaded."""
        # not a threading.Event: a handler interrupted by itself would wait for its own lock
        self._signals = sigint_count()
        self._uninterrupted = False

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return self._signals > 0

    def check(self) -> None:
        """Raise if a stop was requested.

        Raises:
            RunStopped: it was.
        """
        if self():
            raise RunStopped

    def handle(self, number: int, frame: object) -> None:
        """Handle a signal."""
        self._signals += 1
        if self._signals > 1 and not self._uninterrupted:
            raise KeyboardInterrupt

    def without_interruption(self, act: Callable[[], None]) -> None:
        """Run a short action that repeated signals, as a supervisor sends them, do not interrupt.

        So a process that is being stopped still ends what it has started.
        """
        self._uninterrupted = True
        try:
            act()
        finally:
            self._uninterrupted = False


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C and SIGTERM into a stop request.

    Outside the main thread Python allows no signal handlers: there a stop is never requested.
    """
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, stop.handle)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
