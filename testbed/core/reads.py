"""Which keys are read while something is built: what has read a key is its consumer.

A `Reads` is active in its block and thread. Objects of switched classes report each field that is
read to it. What is read for a part that may not be used is deferred, and counts once that is used.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

KeyPath = tuple[str | int, ...]
_FOUND = dict[KeyPath, str]  # consumers by key path: the first function that has read it

_active = threading.local()
_switching = threading.Lock()
_switched: dict[type, int] = {}  # classes that report what is read, and by how many blocks


class Deferred:
    """What was read for a part, which counts once the part is used."""

    __slots__ = ("_found",)

    def __init__(self) -> None:
        self._found: _FOUND | None = None

    def use(self) -> None:
        """Count what was read, in the block of a `Reads`; elsewhere do nothing."""
        if self._found and (reads := current()) is not None:
            reads.add(self._found)

    def forget(self) -> None:
        """Count nothing from now on."""
        self._found = None

    def __reduce__(self) -> tuple[type[Deferred], tuple[()]]:
        """Copy as one that counts nothing, so that it is no part of what holds it."""
        return Deferred, ()


class Reads:
    """Note which fields of registered objects are read.

    Args:
        ignored: the first names of modules whose own reading has the module that called them as
            consumer.

    Attributes:
        found: consumers by key path.
    """

    def __init__(self, ignored: Sequence[str] = ()) -> None:
        self.found: _FOUND = {}
        self._ignored = (__name__, *ignored)
        self._sinks: list[_FOUND | None] = [self.found]
        self._paths: dict[tuple[int, str], list[KeyPath]] = {}  # by object and field
        self._parts: dict[tuple[int, str], Deferred] = {}
        self._objects: list[object] = []  # kept, or another one could have the same id
        self._deferred: list[Deferred] = []

    def register(self, owner: object, fields: Mapping[str, Iterable[KeyPath]]) -> None:
        """Name the keys that the fields of an object stand for; those of before remain."""
        self._objects.append(owner)
        for name, paths in fields.items():
            known = self._paths.setdefault((id(owner), name), [])
            known += [each for each in paths if each not in known]

    def register_parts(self, owner: object, parts: Mapping[str, Deferred]) -> None:
        """Let fields of an object use what was read for them."""
        self._objects.append(owner)
        for name, part in parts.items():
            self._parts[id(owner), name] = part

    def paths(self, owner: object, name: str) -> list[KeyPath]:
        """Return the keys that a field stands for."""
        return self._paths.get((id(owner), name), [])

    def note(self, owner: object, name: str) -> None:
        """Note that a field is read."""
        sink = self._sinks[-1]
        key = id(owner), name
        if sink is None or not (key in self._paths or key in self._parts):
            return
        if paths := self._paths.get(key):
            consumer = self._consumer()
            for path in paths:
                sink.setdefault(path, consumer)
        if part := self._parts.get(key):
            part.use()

    def add(self, found: Mapping[KeyPath, str]) -> None:
        """Count what was read elsewhere."""
        sink = self._sinks[-1]
        if sink is not None:
            for path, consumer in found.items():
                sink.setdefault(path, consumer)

    def _consumer(self) -> str:
        frame = sys._getframe(2)
        while frame.f_back and frame.f_globals.get("__name__", "").startswith(self._ignored):
            frame = frame.f_back
        while frame.f_back and frame.f_code.co_name.startswith("<"):  # a comprehension
            frame = frame.f_back
        return f"{frame.f_globals.get('__name__', '')}.{frame.f_code.co_name}"

    @contextmanager
    def into(self, sink: _FOUND | None) -> Iterator[None]:
        """Count what is read in the block elsewhere; None: nowhere."""
        self._sinks.append(sink)
        try:
            yield
        finally:
            self._sinks.pop()

    def defer(self) -> tuple[Deferred, _FOUND]:
        """Return a part, and where what is read for it is counted."""
        part, found = Deferred(), _FOUND()
        part._found = found
        self._deferred.append(part)
        return part, found

    @contextmanager
    def active(self, classes: Sequence[type]) -> Iterator[None]:
        """Note what this thread reads of objects of these classes in the block."""
        before = current()
        with _switching:
            for each in classes:
                _switch(each, 1)
        _active.reads = self
        try:
            yield
        finally:
            _active.reads = before
            with _switching:
                for each in classes:
                    _switch(each, -1)
            for part in self._deferred:
                part.forget()


def current() -> Reads | None:
    """Return what notes the reading of this thread; None: nothing does."""
    return getattr(_active, "reads", None)


@contextmanager
def unrecorded() -> Iterator[None]:
    """Count nothing that is read in the block, as of checks and of texts."""
    reads = current()
    if reads is None:
        yield
        return
    with reads.into(None):
        yield


@contextmanager
def deferred() -> Iterator[Deferred]:
    """Count what is read in the block once the result is used."""
    reads = current()
    if reads is None:
        yield Deferred()
        return
    part, found = reads.defer()
    with reads.into(found):
        yield part


def derive(owner: object, sources: Mapping[str, Iterable[tuple[object, str]]]) -> None:
    """Let fields of a new object stand for the keys of those that they are made of."""
    if (reads := current()) is not None:
        reads.register(
            owner,
            {name: [p for one in of for p in reads.paths(*one)] for name, of in sources.items()},
        )


def _switch(switched: type, by: int) -> None:
    """Switch the report of a class on with the first block, and off with the last."""
    count = _switched.get(switched, 0) + by
    _switched[switched] = count
    if count and count == by:
        before: Any = switched.__getattribute__

        def read(self: Any, name: str) -> Any:  # noqa: ANN401 - any field
            reads = current()
            if reads is not None:
                reads.note(self, name)
            return before(self, name)

        switched.__getattribute__ = read  # type: ignore[method-assign, assignment]
    elif not count:
        del switched.__getattribute__
