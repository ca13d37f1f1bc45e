"""Count Ctrl-C, because some libraries suppress the KeyboardInterrupt while they are loaded."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_signals: list[int] = []


@contextmanager
def count_sigint() -> Iterator[None]:
    """Count SIGINT in the block; each still raises KeyboardInterrupt."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # keep another handler, or an ignored signal
        signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _signals.clear()


def sigint_count() -> int:
    """Return the number of SIGINT so far in the block of `count_sigint`."""
    return len(_signals)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _signals.append(number)
    raise KeyboardInterrupt
