"""Count Ctrl-C, because some libraries suppress the KeyboardInterrupt while they are loaded."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from testbed.core.errors import InputError

_signals: list[int] = []


class Interrupt(KeyboardInterrupt):
    """A KeyboardInterrupt of a signal, unlike one that a user's code raises."""


@contextmanager
def count_sigint() -> Iterator[None]:
    """Count SIGINT in the block; each still raises KeyboardInterrupt.

    Raises:
        Interrupt: also in place of an error that the library makes of it which is being loaded.
    """
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # keep another handler, or an ignored signal
        signal.signal(signal.SIGINT, _interrupt)
    # in a callback, as of weak references, it is lost but counted: no traceback
    hook = sys.unraisablehook
    sys.unraisablehook = lambda lost: None if lost.exc_type is Interrupt else hook(lost)
    try:
        yield
    except Exception as error:
        if _signals and not isinstance(error, InputError):
            raise Interrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook
        _signals.clear()


def sigint_count() -> int:
    """Return the number of SIGINT so far in the block of `count_sigint`."""
    return len(_signals)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _signals.append(number)
    raise Interrupt
