"""Whether a run is to end: Ctrl-C and SIGTERM, heeded when it suits."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from testbed.interrupts import remembered
from testbed.sim.partners import Stopped


class Stop:
    """Whether Ctrl-C or SIGTERM came. The first is for who asks; later ones are KeyboardInterrupts.

    A process that is signalled over and over, as by a supervisor, still ends what it has started.
    """

    def __init__(self) -> None:
        """None came, but while libraries were loaded."""
        # not a threading.Event: a handler interrupted by itself would wait for its own lock
        self._signals = remembered()
        self._undisturbed = False

    def __call__(self) -> bool:
        """Whether to end."""
        return self._signals > 0

    def heed(self) -> None:
        """Go on, unless it is to end.

        Raises:
            Stopped: it is.
        """
        if self():
            raise Stopped

    def ask(self, number: int, frame: object) -> None:
        """Take a signal in; a handler."""
        self._signals += 1
        if self._signals > 1 and not self._undisturbed:
            raise KeyboardInterrupt

    def undisturbed(self, act: Callable[[], None]) -> None:
        """Do something short from which no signal is to take us away."""
        self._undisturbed = True
        try:
            act()
        finally:
            self._undisturbed = False


@contextmanager
def stopping() -> Iterator[Stop]:
    """Heed Ctrl-C and SIGTERM.

    Outside the main thread Python allows no handlers: there nothing ever stops.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, stop.ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
