"""Cache of results that depend on the XML files of an aircraft folder.

An aircraft may be flown, edited and flown again in one process, for example a notebook.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import lru_cache, wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from testbed.vehicle.airframe_validation import MAX_BYTES

_Rest = ParamSpec("_Rest")
_ResultT = TypeVar("_ResultT")
_Function = Callable[Concatenate[Path, _Rest], _ResultT]


def cache_by_folder(
    maxsize: int,
) -> Callable[[_Function[_Rest, _ResultT]], _Function[_Rest, _ResultT]]:
    """Cache the results of a function of a folder until one of its XML files changes.

    Args:
        maxsize: number of results.
    """

    def decorate(function: _Function[_Rest, _ResultT]) -> _Function[_Rest, _ResultT]:
        @lru_cache(maxsize=maxsize)
        def cached(_: str, folder: Path, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _ResultT:
            return function(folder, *args, **kwargs)

        @wraps(function)
        def call(folder: Path, /, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _ResultT:
            folder = Path(folder).resolve()
            return cached(folder_digest(folder), folder, *args, **kwargs)  # type: ignore[arg-type]

        return call

    return decorate


def folder_digest(folder: Path) -> str:
    """Return a digest of the names and contents of all XML files in and below a folder.

    Times and sizes are not enough: an edit can keep both.
    """
    content = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.rglob("*.xml")):
        data = _read_start(file)
        content.update(os.fsencode(f"{file.relative_to(folder)}\0{len(data)}\0"))
        content.update(data)
    return content.hexdigest()


def _read_start(file: Path) -> bytes:
    """Read up to the size limit of an aircraft file; nothing of what is no readable file."""
    try:
        if not file.is_file():  # reading a pipe would block
            return b""
        with file.open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError:
        return b""  # reported when the aircraft is loaded
