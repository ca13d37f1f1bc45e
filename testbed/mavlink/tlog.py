"""Write and read telemetry logs (.tlog): MAVLink frames with the times of their receipt.

A record is a big-endian 64-bit count of µs since 1970, UTC, and one MAVLink frame.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, read_bounded
from testbed.mavlink.codec import MavlinkError, Message, decode, frame_length

_TIME = struct.Struct(">Q")
_FLUSH_S, _BUFFER_BYTES = 0.35, 1 << 14  # wall-clock s and bytes after which records are written


class RecordWriter:
    """Write records to a new file, some at a time.

    Raises:
        MavlinkError: the file cannot be written; also from every method, once.
    """

    def __init__(self, path: Path) -> None:
        """Create or replace the file."""
        self._path, self._flushed = path, time.monotonic()
        with self._write_errors():
            # buffered here, because a file with buffered data cannot be closed on a full disk
            self._file = path.open("wb", buffering=0)
        self._buffer = bytearray()

    def add(self, record: bytes) -> None:
        """Add a record."""
        self._buffer += record
        if len(self._buffer) > _BUFFER_BYTES or time.monotonic() - self._flushed > _FLUSH_S:
            self._flush()

    def close(self) -> None:
        """Write the buffered records and close the file."""
        try:
            self._flush()
        finally:
            self._file.close()

    def _flush(self) -> None:
        buffer, self._buffer, self._flushed = self._buffer, bytearray(), time.monotonic()
        rest = memoryview(buffer)
        with self._write_errors():
            while rest:
                rest = rest[self._file.write(rest) :]

    @contextmanager
    def _write_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise MavlinkError(f"{self._path}: cannot be written: {error.strerror}") from error


class TlogWriter(RecordWriter):
    """Write a telemetry log.

    Raises:
        MavlinkError: the file cannot be written; also from every method, once.
    """

    def write(self, time_us: int, frame: bytes) -> None:
        """Add a frame.

        Args:
            time_us: of its receipt, µs since 1970.
            frame: one MAVLink frame.
        """
        self.add(_TIME.pack(time_us) + frame)


class Tlog:
    """Iterate over the (time in µs, message) of a log.

    Signatures are not verified, as the writer of the log has done so. After damage, reading
    continues at the next good record.

    Attributes:
        unread: records whose frame has a wrong checksum or is not in ArduPilot's dialect.
        damaged: bytes outside of records.
        cut: bytes of an incomplete last record.
        All are of the latest iteration.

    Raises:
        MavlinkError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._data = read_bounded(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError)
        self.unread = self.damaged = self.cut = 0

    def __iter__(self) -> Iterator[tuple[int, Message]]:
        """Yield the records in the order of the file."""
        self.unread = self.damaged = self.cut = 0
        data = self._data
        at = good = 0  # current position, and end of the last record
        while at < len(data):
            frame = at + _TIME.size
            end = frame + (frame_length(data, frame) if frame < len(data) else 0)
            message = decode(data[frame:end]) if frame < end <= len(data) else None
            if message:
                self.damaged += at - good
                yield _TIME.unpack_from(data, at)[0], message
                at = good = end
            elif at == good and frame < end <= len(data) and self._is_boundary(end):
                self.unread += 1
                at = good = end
            else:
                at += 1
        if self._is_cut(good):
            self.cut = len(data) - good
        else:
            self.damaged += len(data) - good

    def _is_boundary(self, at: int) -> bool:
        """Check whether another record starts here, or the file ends."""
        frame = at + _TIME.size
        return at == len(self._data) or (
            frame < len(self._data) and frame_length(self._data, frame) > 0
        )

    def _is_cut(self, at: int) -> bool:
        """Check whether the file ends inside a record that starts here."""
        frame = at + _TIME.size
        if frame >= len(self._data):
            return True
        length = frame_length(self._data, frame)
        return length > 0 and frame + length > len(self._data)


def has_records(head: bytes) -> bool:
    """Check whether a file with this beginning is a telemetry log.

    It is if it contains a good frame after a time; frames without times are not a log.
    """
    for at in range(len(head) - _TIME.size):
        length = frame_length(head, at + _TIME.size)
        if length and decode(head[at + _TIME.size : at + _TIME.size + length]):
            return not decode(head[: frame_length(head, 0)])
    return False
