"""Stop requests by Ctrl-C and SIGTERM."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from testbed.core.interrupts import (
    GRACE_S,
    STOP_SIGNALS,
    Interrupt,
    mark_handled,
    signal_count,
    watch_compiled_code,
)

# Interrupted halfway, these would write a sample twice, or measure a part of one.
_UNINTERRUPTED_PACKAGES = ("testbed.logs.", "testbed.metrics.")


class RunStopped(Exception):
    """A stop was requested during a wait for an external program."""


class StopRequest:
    """Turn the first Ctrl-C or SIGTERM into a request, and later ones into KeyboardInterrupt.

    A signal within `GRACE_S` of one that took effect is dropped: it belongs to the same stop, as
    when a key repeats or a supervisor and a terminal both send one. A later one interrupts the
    simulation at once, but not the writing of files: there it is kept until they are complete.
    A simulation that goes on for `GRACE_S` after the first, as in a law that does not return, is
    reported to standard error, with the line of Python that it is in. Code that is compiled, where
    Python handles no signal, is reported and ended by `watch_compiled_code`.
    """

    def __init__(self) -> None:
        """Start with the signals that came while libraries were loaded."""
        # not a threading.Event: a handler interrupted by itself would wait for its own lock
        self._requested = signal_count() > 0
        self._effective_s = time.monotonic()  # of the last signal that took effect
        self._ending = False
        self._uninterrupted = False
        self._notice: threading.Timer | None = None
        self.postponed = False  # a KeyboardInterrupt, to be raised after the ending

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return self._requested

    def check(self) -> None:
        """Raise if a stop was requested.

        Raises:
            RunStopped: it was.
        """
        if self():
            raise RunStopped

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        mark_handled()
        now = time.monotonic()
        if self._requested and now - self._effective_s < GRACE_S:
            return
        first, self._requested, self._effective_s = not self._requested, True, now
        if first:
            self._notice = threading.Timer(GRACE_S, self._report_delay)
            self._notice.daemon = True
            self._notice.start()
            return
        if self._uninterrupted or _in_uninterrupted_package(frame):
            self.postponed = True
            return
        # at once, because the code that is interrupted here may not come to do it
        self._uninterrupted = self._ending
        raise Interrupt

    def begin_ending(self) -> None:
        """Postpone further signals from now on: files are completed and programs ended."""
        self._ending = self._uninterrupted = True
        self.cancel_notice()

    def cancel_notice(self) -> None:
        """Report no delay any more."""
        if self._notice is not None:
            self._notice.cancel()

    def _report_delay(self) -> None:
        """Say that the simulation goes on, where, and what ends it."""
        frame = sys._current_frames().get(threading.main_thread().ident or 0)
        if self._uninterrupted or frame is None:
            return
        where = f"{frame.f_code.co_filename}:{frame.f_lineno}"
        sys.stderr.write(
            f"\nstopping, but still in {where}: Ctrl-C (or another signal) ends it at once\n"
        )
        sys.stderr.flush()

    def interruptible(self, act: Callable[[], None]) -> None:
        """Run an action of the ending that may hang, and that a signal may interrupt."""
        try:
            self._uninterrupted = False
            act()
        finally:
            self._uninterrupted = self._ending

    def without_interruption(self, act: Callable[[], None]) -> None:
        """Run a short action that repeated signals, as a supervisor sends them, do not interrupt.

        So a process that is being stopped still ends what it has started.
        """
        before, self._uninterrupted = self._uninterrupted, True
        try:
            act()
        finally:
            self._uninterrupted = before


def _in_uninterrupted_package(frame: FrameType | None) -> bool:
    """Return whether a frame or one of its callers is of a package that must not be interrupted."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith(_UNINTERRUPTED_PACKAGES):
            return True
        frame = frame.f_back
    return False


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C and SIGTERM into a stop request.

    Outside the main thread Python allows no signal handlers: there a stop is never requested.

    Raises:
        KeyboardInterrupt: at the end of the block, if a later signal was postponed.
    """
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    for number in before:
        signal.signal(number, stop.handle)
    try:
        with watch_compiled_code():
            yield stop
    finally:
        stop.cancel_notice()
        for number, handler in before.items():
            signal.signal(number, handler)
    if stop.postponed:
        raise Interrupt
