"""Let one call at a time change an object, and refuse the others."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from testbed.core.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")


class Exclusive:
    """A lock that refuses instead of waiting.

    Args:
        what: it guards, as errors begin, such as "the flight of simulation-3".
    """

    CONSTANT = True  # no state of a flight
    __slots__ = "_call", "_lock", "_owner", "what"

    def __init__(self, what: str) -> None:
        self.what = what
        self._lock = threading.Lock()
        self._owner: tuple[int, int] | None = None  # process and thread of the call that has it
        self._call = ""  # its name

    def __reduce__(self) -> tuple[type[Exclusive], tuple[str]]:
        """Return what makes a copy, which is free."""
        return Exclusive, (self.what,)

    def acquire(self, call: str) -> None:
        """Begin a call.

        Raises:
            InputError: another one is running.
        """
        if not self._lock.acquire(blocking=False):
            raise InputError(self._refusal(call))
        self._owner, self._call = (os.getpid(), threading.get_ident()), call

    def release(self) -> None:
        """End the call."""
        self._owner = None
        self._lock.release()

    def check(self, call: str) -> None:
        """Check that no other thread is within a call: for what may be read within one.

        Raises:
            InputError: another thread is.
        """
        owner = self._owner
        if owner is not None and owner != (os.getpid(), threading.get_ident()):
            raise InputError(self._refusal(call))

    def _refusal(self, call: str) -> str:
        owner = self._owner or (os.getpid(), 0)
        if owner == (os.getpid(), threading.get_ident()):
            return (
                f"{self.what}: {call}() is called within {self._call}() of the same object, by a "
                f"stage, an observer or a law (call {call}() after {self._call}() has returned)"
            )
        if owner[0] != os.getpid():
            return (
                f"{self.what}: was within {self._call}() in the parent process when this process "
                "was forked (make another one here)"
            )
        return (
            f"{self.what}: is within {self._call}() of another thread (call {call}() after that, "
            "or make one object for each thread)"
        )


class _Guarded(Protocol):
    @property
    def _exclusive(self) -> Exclusive: ...


S = TypeVar("S", bound=_Guarded)


def exclusive(
    method: Callable[Concatenate[S, P], R],
) -> Callable[Concatenate[S, P], R]:
    """Let a method refuse to run while another such one of the same object does."""
    name = method.__name__

    @wraps(method)
    def guarded(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        lock = self._exclusive
        lock.acquire(name)
        try:
            return method(self, *args, **kwargs)
        finally:
            lock.release()

    return guarded
