"""Ctrl-C while libraries are loaded: some of them swallow it, and the program would go on."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_came: list[int] = []


@contextmanager
def remembering() -> Iterator[None]:
    """Raise KeyboardInterrupt at Ctrl-C, as Python does, and remember meanwhile that it came."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # else somebody wants otherwise
        signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _came.clear()


def remembered() -> int:
    """How often it came."""
    return len(_came)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _came.append(number)
    raise KeyboardInterrupt
