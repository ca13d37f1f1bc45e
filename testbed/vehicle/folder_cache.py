"""What is found out of an aircraft's folder, kept for as long as its files say the same.

In one process, a notebook for one, an aircraft may be flown, edited and flown again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import lru_cache, wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from testbed.vehicle.airframe_files import MOST_BYTES

_Rest = ParamSpec("_Rest")
_FoundT = TypeVar("_FoundT")
_Finder = Callable[Concatenate[Path, _Rest], _FoundT]


def kept(maxsize: int) -> Callable[[_Finder[_Rest, _FoundT]], _Finder[_Rest, _FoundT]]:
    """Make a function of a folder answer the same question once, until a model file changes.

    Args:
        maxsize: answers that are kept.
    """

    def decorate(find: _Finder[_Rest, _FoundT]) -> _Finder[_Rest, _FoundT]:
        @lru_cache(maxsize=maxsize)
        def found(_: str, folder: Path, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _FoundT:
            return find(folder, *args, **kwargs)

        @wraps(find)
        def ask(folder: Path, /, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _FoundT:
            folder = Path(folder).resolve()
            return found(digest(folder), folder, *args, **kwargs)  # type: ignore[arg-type]

        return ask

    return decorate


def digest(folder: Path) -> str:
    """What all XML files of a folder and the folders in it say, names included.

    Not when they changed: an edit that is as long as what it replaces may be as old, too.
    """
    content = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.rglob("*.xml")):
        data = _start_of(file)
        content.update(os.fsencode(f"{file.relative_to(folder)}\0{len(data)}\0"))
        content.update(data)
    return content.hexdigest()


def _start_of(file: Path) -> bytes:
    """As much of a file as an aircraft can have; of what is no file or not to be read, nothing."""
    try:
        if not file.is_file():  # a pipe would be waited for
            return b""
        with file.open("rb") as stream:
            return stream.read(MOST_BYTES + 1)
    except OSError:
        return b""  # to be said by who reads the aircraft
