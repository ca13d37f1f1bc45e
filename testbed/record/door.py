"""The only module that imports foxglove, mcap, protobuf and zstandard: MCAP files.

They are written here, not by a library, as those handle messages one by one.

Format: https://mcap.dev/spec. Foxglove's messages:
https://docs.foxglove.dev/docs/visualization/message-schemas.
"""

from __future__ import annotations

import functools
import io
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

import zstandard
from foxglove import messages
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.stream_reader import StreamReader

from testbed.errors import InputError
from testbed.record.chunk import Chunk, Schema, Stream, Strip, chunk
from testbed.record.messages import Topic
from testbed.state import Event

_NS = 10**9
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: what it is, and the length of the rest
# Of a chunk: the same, its first and last time, what is packed: size, checksum, how and into what.
_CHUNK = struct.Struct("<BQQQQII4sQ")
_ZSTD = "zstd"
_LARGEST_CHUNK = 1 << 28  # bytes; one holds a fraction of a second by the clock on the wall
_LONGEST = 200  # characters of what a library has against a file, which may quote all of it
_LIBRARY = "testbed"  # what wrote a file
# The level that is fastest and still shrinks: the rest of a log is the noise of the last bits.
_LEVEL = 1
_GROUPS = (  # of the summary
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


def _known(kind: Any) -> Schema:  # noqa: ANN401 - a class of foxglove.messages
    schema = kind.get_schema()
    return Schema(schema.name, schema.data)


TRANSFORMS, FIX, LOG = map(_known, (messages.FrameTransforms, messages.LocationFix, messages.Log))


class LogError(InputError):
    """A log that cannot be read or written: which, where and why."""


NOTHING = "was cut before its first frame: nothing was recorded"


class LogFile:
    """An MCAP file being written.

    A thread of its own compresses chunks and writes them, for which it does not need the
    interpreter: wherever it does, the flight has to wait. A record is in the file whole or not at
    all. Before each the file is looked for: one that nobody finds any more is not written on.

    Args:
        path: A file that does not exist.

    Raises:
        LogError: The file exists, or its folder is missing, full or not writable. Also from every
            method that writes, of what was to be written before: the file has then closed itself
            after its last whole record.
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
        self._size = 0
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="log")
        self._writing: Future[None] | None = None
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._streams: list[Stream] = []  # those that have a number
        self._schemas: dict[str, int] = {}  # numbers by name
        self._span_ns = (2**63, 0)
        self._summary: dict[Opcode, list[bytes]] = {group: [] for group in _GROUPS}
        self._put(_BEGINNING)

    def stream(self, topic: str, schema: Schema) -> Stream:
        """A stream of messages for the chunks of this file."""
        return Stream(topic, schema, self._announce)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        at, length = self._append(records.Metadata(name, dict(sorted(values.items()))))
        index = records.MetadataIndex(offset=at, length=length, name=name)
        self._summary[Opcode.METADATA_INDEX].append(_bytes(index))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        what: dict[str, Any] = {"name": name, "media_type": media_type}
        what |= {"log_time": 0, "create_time": 0}
        at, length = self._append(records.Attachment(data=data, **what))
        index = records.AttachmentIndex(offset=at, length=length, data_size=len(data), **what)
        self._summary[Opcode.ATTACHMENT_INDEX].append(_bytes(index))

    def write(self, strips: Sequence[Strip]) -> None:
        """Write a chunk, which will be in the file as soon as it is compressed."""
        self._wait()
        if strips:
            self._look()
            self._writing = self._thread.submit(self._save, chunk(strips))

    def close(self) -> None:
        """Write the summary that makes the file seekable, and close it."""
        if self._file.closed:
            return
        # a checksum over the whole file would make damage in an index, which nobody needs, fatal
        self._append(records.DataEnd(data_section_crc=0))
        self._put(self._end())
        self._file.close()
        self._thread.shutdown()

    def _announce(self, stream: Stream) -> bytes:
        if stream.number:
            return b""
        self._streams.append(stream)
        stream.number = len(self._streams)
        name, data = stream.schema.name, stream.schema.data
        known = name in self._schemas
        number = self._schemas.setdefault(name, len(self._schemas) + 1)
        channel = _bytes(records.Channel(stream.number, stream.topic, "protobuf", {}, number))
        self._summary[Opcode.CHANNEL].append(channel)
        if known:
            return channel
        schema = _bytes(records.Schema(number, data, "protobuf", name))
        self._summary[Opcode.SCHEMA].append(schema)
        return schema + channel

    def _save(self, made: Chunk) -> None:
        data, packed = made.data, self._compressor.compress(made.data)
        size, span_ns = len(packed), (made.first_ns, made.last_ns)
        length = _CHUNK.size + size
        about = len(data), zlib.crc32(data), len(_ZSTD), _ZSTD.encode(), size
        head = _CHUNK.pack(Opcode.CHUNK, length - _HEAD.size, *span_ns, *about)
        numbers, indices = zip(*sorted(made.index.items()), strict=True)
        at = self._size
        self._put(b"".join([head, packed, *indices]))
        *places, end = accumulate(map(len, indices), initial=at + length)
        index = records.ChunkIndex(
            chunk_start_offset=at,
            chunk_length=length,
            message_index_offsets=dict(zip(numbers, places, strict=True)),
            message_index_length=end - at - length,
            compression=_ZSTD,
            compressed_size=size,
            uncompressed_size=len(data),
            message_start_time=made.first_ns,
            message_end_time=made.last_ns,
        )
        self._summary[Opcode.CHUNK_INDEX].append(_bytes(index))
        first_ns, last_ns = self._span_ns
        self._span_ns = min(first_ns, made.first_ns), max(last_ns, made.last_ns)

    def _append(self, record: McapRecord) -> tuple[int, int]:
        """Put a record behind all chunks and say where it is and how long."""
        self._wait()
        self._look()
        at, data = self._size, _bytes(record)
        self._put(data)
        return at, len(data)

    def _wait(self) -> None:
        """Until the thread is done; what has kept it from that is raised here."""
        if self._writing:
            self._writing.result()

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            # half a record would hide that the rest of the file is sound
            os.ftruncate(self._file.fileno(), self._size)
            self._file.close()
            raise LogError(f"{self.path}: cannot write the log: {error.strerror}") from error
        self._size += len(data)

    def _look(self) -> None:
        """Whether the open file has its name still: a folder that is removed takes it along."""
        try:
            there = os.path.samestat(os.stat(self.path), os.fstat(self._file.fileno()))
        except OSError:
            there = False
        if not there:
            self._file.close()
            raise LogError(
                f"{self.path}: the log is not there any more: {self.path.parent} was removed or "
                "moved during the run"
            )

    def _end(self) -> bytes:
        """Everything after the data: what is in the file and where, by groups of records."""
        groups, counts = self._summary, {each.number: each.count for each in self._streams}
        first, last = self._span_ns if counts else (0, 0)
        statistics = records.Statistics(
            attachment_count=len(groups[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(counts),
            channel_message_counts=counts,
            chunk_count=len(groups[Opcode.CHUNK_INDEX]),
            message_count=sum(counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(groups[Opcode.METADATA_INDEX]),
            schema_count=len(groups[Opcode.SCHEMA]),
        )
        groups[Opcode.STATISTICS].append(_bytes(statistics))
        out = offsets = b""
        for group, parts in groups.items():
            data = b"".join(parts)
            if data:
                offset = records.SummaryOffset(group, self._size + len(out), len(data))
                offsets += _bytes(offset)
            out += data
        footer = records.Footer(self._size, self._size + len(out), summary_crc=0)
        out += offsets + _bytes(footer)[:-4]
        return out + struct.pack("<I", zlib.crc32(out)) + _MAGIC


def log_line(event: Event) -> bytes:
    """A foxglove.Log."""
    time_ns = round(event.time_s * _NS)
    line = messages.Log(
        timestamp=messages.Timestamp(sec=time_ns // _NS, nsec=time_ns % _NS),
        level=getattr(messages.LogLevel, event.level.title(), messages.LogLevel.Unknown),
        message=event.text,
        name=event.source,
    )
    return line.encode()


def _bytes(record: McapRecord) -> bytes:
    out = RecordBuilder()
    record.write(out)
    return bytes(out.end())


_BEGINNING = _MAGIC + _bytes(records.Header(profile="", library=_LIBRARY))


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
    begun: bool = False  # it begins as we begin one
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
    if _BEGINNING.startswith(data):
        raise LogError(f"{path}: {NOTHING}")
    if not data.startswith(_MAGIC):
        raise LogError(f"{path}: not an MCAP file")
    sound, at = _sound(path, data), len(_MAGIC)
    out = Contents(begun=data.startswith(_BEGINNING), lost_bytes=len(data) - sound)
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
            raise LogError(f"{path}: damaged after byte {at}: {repr(error)[:_LONGEST]}") from error
    return out


def _sound(path: Path, data: bytes) -> int:
    """Where the last whole record ends, or the file.

    Raises:
        LogError: A chunk would be unpacked to more than any log has.
    """
    at, view = len(_MAGIC), memoryview(data)
    while len(data) - at >= _HEAD.size:
        kind, length = _HEAD.unpack_from(data, at)
        end = at + _HEAD.size + length
        if end > len(data):
            break
        if kind == Opcode.CHUNK and (size := _unpacked(view[at:end])) > _LARGEST_CHUNK:
            raise LogError(f"{path}: a chunk of {size:,} bytes at byte {at}: no run has such a one")
        at = end
    return len(data) if data[at:] == _MAGIC else at


def _unpacked(chunk: memoryview) -> int:
    """What a chunk says of its size, or its compressed data do: zstd believes these."""
    if len(chunk) < _CHUNK.size:
        return 0  # damaged: the library says how
    size = int(_CHUNK.unpack_from(chunk)[4])
    try:
        return max(size, zstandard.frame_content_size(chunk[_CHUNK.size :]))
    except zstandard.ZstdError:  # packed in another way, or not at all
        return size


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
    for file in FileDescriptorSet.FromString(LOG.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(LOG.name))


def schema(kind: Topic) -> Schema:
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
    return Schema(kind.message, bytes(out.SerializeToString(deterministic=True)))
