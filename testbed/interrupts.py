"""Ctrl-C while libraries are loaded: some of them swallow it, and the program would go on."""

from __future__ import annotations

import signal
from types import FrameType

_came: list[int] = []


def remember() -> None:
    """Raise KeyboardInterrupt at Ctrl-C, as Python does, and remember that it came."""
    if (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):  # else somebody wants otherwise
        signal.signal(signal.SIGINT, _interrupt)


def remembered() -> int:
    """How often it came."""
    return len(_came)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _came.append(number)
    raise KeyboardInterrupt
