"""Read files from outside: regular files only, and never more than a limit."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

from testbed.core.errors import InputError

MAX_TEXT_BYTES = 1_000_000  # scenarios, studies, gains, parameters, laws
MAX_TABLE_BYTES = 64_000_000  # CSV
MAX_FLIGHT_LOG_BYTES = 1_000_000_000  # telemetry and DataFlash logs
MAX_LOG_BYTES = 4_000_000_000  # MCAP
MAX_PARQUET_BYTES = 4_000_000_000
MAX_KEY_BYTES = 4096
MAX_DEPTH = 40  # of maps and lists in each other

_WORD = re.compile(r"[\w.+-]{1,20}")
_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


ErrorKind = Callable[[str], InputError]


class ReadError(InputError):
    """A file that cannot be read. `reason` is the text without the path."""

    def __init__(self, path: Path, reason: str) -> None:
        self.reason = reason
        super().__init__(f"{path}: {reason}")


def open_regular(path: Path, limit: int, *, error: ErrorKind | None = None) -> BinaryIO:
    """Open a regular file of at most `limit` bytes; the caller closes it.

    Opening neither waits for the other end of a pipe nor makes a terminal the controlling one.

    Args:
        path: the file.
        limit: bytes.
        error: class of the exception in place of `ReadError`.

    Raises:
        ReadError: it is missing, is a directory, a pipe or a device, or is larger.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except (OSError, ValueError) as failed:  # ValueError: NUL in the path
        raise _error(path, f"cannot be read: {_reason(failed)}", error) from failed
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
            raise _error(path, f"cannot be read: it is {kind}, not a regular file", error)
        if found.st_size > limit:
            raise _error(path, _too_large(limit), error)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bounded(
    path: Path, limit: int = MAX_TEXT_BYTES, *, error: ErrorKind | None = None
) -> bytes:
    """Read a regular file of at most `limit` bytes.

    The size is checked before reading, and reading ends behind the limit in a file that grows.

    Args:
        path: the file.
        limit: bytes.
        error: class of the exception in place of `ReadError`.

    Raises:
        ReadError: as `open_regular` does.
    """
    with open_regular(path, limit, error=error) as file:
        try:
            data = file.read(limit + 1)
        except OSError as failed:
            raise _error(path, f"cannot be read: {_reason(failed)}", error) from failed
    if len(data) > limit:
        raise _error(path, _too_large(limit), error)
    return data


def read_bounded_text(
    path: Path, limit: int = MAX_TEXT_BYTES, *, error: ErrorKind | None = None
) -> str:
    """Read a UTF-8 text file of limited size, without the byte order mark.

    Raises:
        ReadError: as `open_regular` does; also where it is not UTF-8, with the line.
    """
    data = read_bounded(path, limit, error=error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failed:
        line = failed.object.count(b"\n", 0, failed.start) + 1
        reason = f"line {line} is not UTF-8 text (save the file as UTF-8)"
        raise _error(path, reason, error) from None


def quote_word(text: str) -> str:
    """Return a short word of a file in quotes, as errors may have it, and "text" for anything else.

    A path may name a file that is not meant to be read: an error never has its lines.
    """
    return repr(text) if _WORD.fullmatch(text) else "text"


def parse_json(text: str | bytes) -> Any:  # noqa: ANN401 - any JSON value
    """Parse JSON.

    Raises:
        ValueError: it is not JSON, or nested deeper than `MAX_DEPTH`.
    """
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError(f"is nested deeper than {MAX_DEPTH} levels") from None
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        level = [child for each in level for child in _children(each)]
        if not level:
            return value
    raise ValueError(f"is nested deeper than {MAX_DEPTH} levels")


def _children(value: Any) -> Iterable[Any]:  # noqa: ANN401 - any JSON value
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def parse_json_map(text: str | bytes) -> dict[str, Any]:
    """Parse a JSON object.

    Raises:
        ValueError: it is not JSON, or another value.
    """
    value = parse_json(text)
    if not isinstance(value, dict):
        raise ValueError("is not a map")  # noqa: TRY004 - wrong input, not a wrong call
    return value


def _error(path: Path, reason: str, kind: ErrorKind | None) -> InputError:
    return ReadError(path, reason) if kind is None else kind(f"{path}: {reason}")


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _too_large(limit: int) -> str:
    return f"is larger than {limit:,} bytes (write a smaller file)"
