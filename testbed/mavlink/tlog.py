"""Telemetry logs, as ground stations write them: frames, each after the moment it was heard.

A record is a big-endian 64-bit count of µs since 1970, UTC, and one MAVLink frame.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from testbed.mavlink.door import MavlinkError, Message, decode, frame_length

_TIME = struct.Struct(">Q")
_FLUSH_S, _KEPT = 0.35, 1 << 14  # wall-clock s and bytes after which records are written


class TlogWriter:
    """A log being written. Used in a `with`, or closed by `close`.

    Raises:
        MavlinkError: the file cannot be written; also from all methods, once.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; one that was there is replaced."""
        self._path, self._flushed = path, time.monotonic()
        with self._refused():
            # records are kept here: a file that had them could not be closed on a full disk
            self._file = path.open("wb", buffering=0)
        self._kept = bytearray()

    def write(self, time_us: int, frame: bytes) -> None:
        """Add a frame heard at this time, µs since 1970."""
        self._kept += _TIME.pack(time_us) + frame
        if len(self._kept) > _KEPT or time.monotonic() - self._flushed > _FLUSH_S:
            self._flush()

    def close(self) -> None:
        """Write what is left."""
        try:
            self._flush()
        finally:
            self._file.close()

    def _flush(self) -> None:
        kept, self._kept, self._flushed = self._kept, bytearray(), time.monotonic()
        rest = memoryview(kept)
        with self._refused():
            while rest:
                rest = rest[self._file.write(rest) :]

    @contextmanager
    def _refused(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise MavlinkError(f"{self._path}: cannot be written: {error.strerror}") from error

    def __enter__(self) -> Self:
        """This log."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close it, whatever happened."""
        self.close()


class Tlog:
    """A log that was written: iterate over its (time in µs, message).

    Signatures are not checked: whoever kept the log did. After damage, reading goes on at the
    next good record.

    Attributes:
        unread: records whose frame has a wrong checksum or is not in ArduPilot's dialect.
        damaged: bytes in no record at all.
        cut: bytes of a last record that has no end.
        These are of the latest iteration.

    Raises:
        MavlinkError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        """Read the file."""
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise MavlinkError(f"{path}: cannot be read: {error.strerror}") from error
        self.unread = self.damaged = self.cut = 0

    def __iter__(self) -> Iterator[tuple[int, Message]]:
        """The records in the order of the file."""
        self.unread = self.damaged = self.cut = 0
        data = self._data
        at = good = 0  # where we look, and where the last record ended
        while at < len(data):
            frame = at + _TIME.size
            end = frame + (frame_length(data, frame) if frame < len(data) else 0)
            message = decode(data[frame:end]) if frame < end <= len(data) else None
            if message:
                self.damaged += at - good
                yield _TIME.unpack_from(data, at)[0], message
                at = good = end
            elif at == good and frame < end <= len(data) and self._goes_on(end):
                self.unread += 1
                at = good = end
            else:
                at += 1
        if self._cut_off(good):
            self.cut = len(data) - good
        else:
            self.damaged += len(data) - good

    def _goes_on(self, at: int) -> bool:
        """Whether another record begins here, or the file ends."""
        frame = at + _TIME.size
        return at == len(self._data) or (
            frame < len(self._data) and frame_length(self._data, frame) > 0
        )

    def _cut_off(self, at: int) -> bool:
        """Whether the file ends inside a record that begins here."""
        frame = at + _TIME.size
        if frame >= len(self._data):
            return True
        length = frame_length(self._data, frame)
        return length > 0 and frame + length > len(self._data)


def holds_records(head: bytes) -> bool:
    """Whether a file that begins so is a telemetry log: a good record is in it, after its time.

    Frames that follow one another without times are none.
    """
    for at in range(len(head) - _TIME.size):
        length = frame_length(head, at + _TIME.size)
        if length and decode(head[at + _TIME.size : at + _TIME.size + length]):
            return not decode(head[: frame_length(head, 0)])
    return False
