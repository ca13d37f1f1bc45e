"""The only module that imports foxglove, mcap and protobuf: MCAP files, written and read.

Format: https://mcap.dev/spec. Foxglove's messages:
https://docs.foxglove.dev/docs/visualization/message-schemas.
"""

from __future__ import annotations

import functools
import io
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import foxglove
from foxglove import channels, messages
from foxglove.mcap import MCAPWriteOptions
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError
from mcap import records
from mcap.exceptions import EndOfFile
from mcap.stream_reader import StreamReader

from testbed.errors import InputError
from testbed.record.messages import Topic
from testbed.state import Event

_NS = 10**9
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: what it is, and the length of the rest
# Chunks end where `flush` says and nowhere else. Compressed in this thread and at the level that
# is fastest and still shrinks: the rest of a log is the noise of the last bits. Chunks carry their
# own checksums; one over the whole file would make damage in an index, which nobody needs, fatal.
_OPTIONS = MCAPWriteOptions(
    chunk_size=None,
    compression_level=1,
    compression_threads=0,
    disable_seeking=True,
    calculate_data_section_crc=False,
)

Write = Callable[[bytes, int], None]  # a message and its time in ns


class LogError(InputError):
    """A log that cannot be read or written: which, where and why."""


class LogFile:
    """An MCAP file being written.

    What is written is in the file, whole or not at all, when `flush` returns.

    Args:
        path: A file that does not exist.

    Raises:
        LogError: The file exists, or its folder is missing, full or not writable.
    """

    def __init__(self, path: Path) -> None:
        """See the class."""
        self.path = path
        try:
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 - closed by close()
        except FileExistsError:
            raise LogError(f"{path}: there is a log already; name another directory") from None
        except OSError as error:
            raise LogError(f"{path}: cannot create the log: {error.strerror}") from error
        self._context = foxglove.Context()
        self._tail = _Tail()
        self._writer = foxglove.open_mcap(
            self._tail, context=self._context, writer_options=_OPTIONS
        )

    def topic(self, name: str, kind: Topic) -> Write:
        """Open a stream of own messages, given as bytes."""
        schema = foxglove.Schema(name=kind.message, encoding="protobuf", data=_descriptor_set(kind))
        channel = foxglove.Channel(
            name, message_encoding="protobuf", schema=schema, context=self._context
        )
        return channel.base.log

    def transforms(self, name: str) -> Write:
        """Open a stream of foxglove.FrameTransforms, given as bytes."""
        channel = foxglove.Channel(
            name,
            message_encoding="protobuf",
            schema=messages.FrameTransforms.get_schema(),
            context=self._context,
        )
        return channel.base.log

    def fixes(self, name: str, frame: str) -> Callable[[Sequence[float], int], None]:
        """Open a stream of foxglove.LocationFix.

        It takes latitude and longitude in deg and the altitude in m.
        """
        channel = channels.LocationFixChannel(name, context=self._context)

        def write(place: Sequence[float], time_ns: int) -> None:
            latitude, longitude, altitude = place
            fix = messages.LocationFix(
                timestamp=_timestamp(time_ns),
                frame_id=frame,
                latitude=latitude,
                longitude=longitude,
                altitude=altitude,
            )
            channel.log(fix, log_time=time_ns)

        return write

    def events(self, name: str) -> Callable[[Event], None]:
        """Open a stream of foxglove.Log."""
        channel = channels.LogChannel(name, context=self._context)

        def write(event: Event) -> None:
            time_ns = round(event.time_s * _NS)
            line = messages.Log(
                timestamp=_timestamp(time_ns),
                level=getattr(messages.LogLevel, event.level.title(), messages.LogLevel.Unknown),
                message=event.text,
                name=event.source,
            )
            channel.log(line, log_time=time_ns)

        return write

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.write_metadata(name, dict(values))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        self._writer.attach(log_time=0, create_time=0, name=name, media_type=media_type, data=data)

    def flush(self) -> None:
        """End the chunk and put everything written so far into the file."""
        self._writer.flush()
        self._save()

    def close(self) -> None:
        """Write the summary that makes the file seekable, and close it."""
        if self._file.closed:
            return
        self._writer.close()
        self._save()
        self._file.close()

    def _save(self) -> None:
        size = self._file.tell()
        rest = memoryview(self._tail.take())
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            # half a record would hide that the rest of the file is sound
            os.ftruncate(self._file.fileno(), size)
            self._file.close()
            raise LogError(f"{self.path}: cannot write the log: {error.strerror}") from error


class _Tail:
    """What the library has written and the file has not yet.

    The library forgets the cause of a failed write and reports some failures to stderr only, so
    it writes into memory.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._position = 0

    def write(self, data: bytes | bytearray) -> int:
        self._parts.append(bytes(data))
        self._position += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        # with disable_seeking the library only asks where it is
        return self._position

    def flush(self) -> None:
        pass

    def take(self) -> bytes:
        data = b"".join(self._parts)
        self._parts.clear()
        return data


def _timestamp(time_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=time_ns // _NS, nsec=time_ns % _NS)


@dataclass(slots=True)
class Messages:
    """The messages of a topic in the order of the file."""

    time_ns: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class Contents:
    """What a file holds, its messages by topic."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, Messages] = field(default_factory=dict)
    finished: bool = False  # the writer closed the file
    lost_bytes: int = 0  # of a record that was cut


def read(path: Path) -> Contents:
    """Read a file from its start, without its summary: what is whole of a cut one too.

    Raises:
        LogError: No MCAP file, or damaged before its end.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot read the log: {error.strerror}") from error
    if not data.startswith(_MAGIC):
        raise LogError(f"{path}: not an MCAP file")
    sound, at = _sound(data), len(_MAGIC)
    out = Contents(lost_bytes=len(data) - sound)
    topics: dict[int, Messages] = {}
    source = io.BytesIO(data[:sound])
    try:
        for record in StreamReader(source, validate_crcs=True).records:
            at = source.tell()
            if isinstance(record, records.Message):
                messages = topics[record.channel_id]
                messages.time_ns.append(record.log_time)
                messages.data.append(record.data)
            elif isinstance(record, records.Channel):
                topics[record.id] = out.messages.setdefault(record.topic, Messages())
            elif isinstance(record, records.Metadata):
                out.metadata[record.name] = record.metadata
            elif isinstance(record, records.Attachment):
                out.attachments[record.name] = record.data
        out.finished = True
    except Exception as error:
        # whatever a damaged byte sets off in the library, the place is what matters
        if not (isinstance(error, EndOfFile) and at == sound):
            raise LogError(f"{path}: damaged after byte {at}: {error!r}") from error
    return out


def _sound(data: bytes) -> int:
    """Where the last whole record ends, or the file."""
    at = len(_MAGIC)
    while len(data) - at >= _HEAD.size:
        end = at + _HEAD.size + _HEAD.unpack_from(data, at)[1]
        if end > len(data):
            break
        at = end
    return len(data) if data[at:] == _MAGIC else at


def log_fields(payload: bytes) -> tuple[str, str, str]:
    """Level, text and source of a foxglove.Log.

    Raises:
        ValueError: It is none.
    """
    try:
        line = _log_class().FromString(payload)
    except DecodeError as error:
        raise ValueError(f"no foxglove.Log: {error}") from error
    levels = line.DESCRIPTOR.fields_by_name["level"].enum_type.values_by_number
    level = levels[line.level if line.level in levels else 0].name.lower()
    return str(level), str(line.message), str(line.name)


@functools.cache
def _log_class() -> Any:  # noqa: ANN401 - made at run time
    # a pool of its own: Foxglove's package may have registered the same names
    pool = descriptor_pool.DescriptorPool()
    schema = messages.Log.get_schema()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def _descriptor_set(kind: Topic) -> bytes:
    """The schema of an own message: a FileDescriptorSet of one file."""
    package, _, name = kind.message.rpartition(".")
    out = FileDescriptorSet()
    file = out.file.add(name=f"{kind.message}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field_name, column) in enumerate(kind.fields, start=1):
        label = "LABEL_REPEATED" if column.per_aircraft else "LABEL_OPTIONAL"
        message.field.add(
            name=field_name,
            number=number,
            type=f"TYPE_{column.type.upper()}",
            label=label,
        )
    return bytes(out.SerializeToString(deterministic=True))
