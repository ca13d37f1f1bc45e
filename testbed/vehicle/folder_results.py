"""Results of functions of an aircraft's folder, in memory and on disk until a file changes."""

from __future__ import annotations

import hashlib
import os
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import update_wrapper
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

from testbed.airframes.airframe_validation import MAX_BYTES
from testbed.core.errors import InputError
from testbed.core.input_files import open_regular
from testbed.core.kept_results import keep_result, read_result

_Rest = ParamSpec("_Rest")
_ResultT = TypeVar("_ResultT")
_Function = Callable[Concatenate[Path, _Rest], _ResultT]
_digests: ContextVar[dict[Path, str] | None] = ContextVar("digests", default=None)


def cache_by_folder(
    maxsize: int, kept: type[Any] | None = None
) -> Callable[[_Function[_Rest, _ResultT]], FolderFunction[_Rest, _ResultT]]:
    """Cache a function of a folder until one of its XML files changes.

    Args:
        maxsize: number of results in memory.
        kept: type of its results, which are kept on disk, too; None: they are not. What it depends
            on besides its arguments are the testbed's sources, the libraries and the processor.
    """
    return lambda function: FolderFunction(function, maxsize, kept)


class FolderFunction(Generic[_Rest, _ResultT]):
    """A function of a folder and of hashable arguments; see `cache_by_folder`."""

    def __init__(
        self, function: _Function[_Rest, _ResultT], maxsize: int, kept: type[_ResultT] | None
    ) -> None:
        update_wrapper(self, function)
        self._function, self._maxsize, self._kept = function, maxsize, kept
        self._name = function.__name__.strip("_").replace("_", "-")
        self._results: OrderedDict[tuple[object, ...], _ResultT] = OrderedDict()

    def __call__(self, folder: Path, /, *args: _Rest.args, **named: _Rest.kwargs) -> _ResultT:
        """Return the result for a folder, made by the function if there is none yet."""
        key = self.key(folder, *args, **named)
        if (found := self.find(key)) is None:
            found = self._function(Path(folder).resolve(), *args, **named)
            self.keep(key, found)
        return found

    def key(self, folder: Path, /, *args: _Rest.args, **named: _Rest.kwargs) -> tuple[object, ...]:
        """Return what a result depends on: the folder with its present files, and the arguments."""
        folder = Path(folder).resolve()
        return str(folder), folder_digest(folder), args, *sorted(named.items())

    def find(self, key: tuple[object, ...]) -> _ResultT | None:
        """Return a result from memory or from disk by its key; None: there is none."""
        if (found := self._results.get(key)) is not None:
            self._results.move_to_end(key)
        elif self._kept is not None:
            found = read_result(self._kept, self._name, key)
            if found is not None:
                self._remember(key, found)
        return found

    def keep(self, key: tuple[object, ...], result: _ResultT) -> None:
        """Keep a result by its key, unless a file of the folder has changed meanwhile."""
        if _read_digest(Path(str(key[0]))) != key[1]:
            return
        self._remember(key, result)
        if self._kept is not None:
            keep_result(self._name, key, result)

    def _remember(self, key: tuple[object, ...], result: _ResultT) -> None:
        self._results[key] = result
        if len(self._results) > self._maxsize:
            self._results.popitem(last=False)


@contextmanager
def unchanging_folders() -> Iterator[None]:
    """Read the files of each folder once in the block; also a decorator of functions."""
    token = _digests.set({})
    try:
        yield
    finally:
        _digests.reset(token)


def folder_digest(folder: Path) -> str:
    """Return a digest of all XML files in and below a folder.

    Times and sizes are not enough: an edit can keep both.
    """
    known = _digests.get()
    if known is None:
        return _read_digest(folder)
    if folder not in known:
        known[folder] = _read_digest(folder)
    return known[folder]


def _read_digest(folder: Path) -> str:
    content = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.rglob("*.xml")):
        data = _read_start(file)
        content.update(os.fsencode(f"{file.relative_to(folder)}\0{len(data)}\0"))
        content.update(data)
    return content.hexdigest()


def _read_start(file: Path) -> bytes:
    """Read an aircraft file up to the size limit; empty if unreadable."""
    # an error is reported when the aircraft is loaded
    with suppress(OSError, InputError), open_regular(file, sys.maxsize) as stream:
        return stream.read(MAX_BYTES + 1)
    return b""
