"""MCAP files: writing chunks, reading files back, also files that were cut short.

The only module that imports mcap, protobuf and zstandard. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import functools
import io
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from testbed.core.errors import InputError, raise_memory_shortage
from testbed.core.files import lock_file, unlock_file
from testbed.core.flags import flag_names
from testbed.core.input_files import MAX_LOG_BYTES, open_regular
from testbed.core.records import Event
from testbed.logs.foxglove_messages import LOG
from testbed.logs.message_batch import Chunk, LogChannel, MessageBatch, Schema, chunk
from testbed.logs.messages import Topic, aircraft_fields

_NS = 10**9
_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")  # opcode, and length of the rest
_MESSAGE_HEAD = struct.Struct("<H4xQ8x")  # channel, and time of the log
_Message = tuple[int, int, bytes]  # channel, time and data
# Of a chunk: opcode, length, first and last time, uncompressed size and checksum, length and name
# of the compression, compressed size.
_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
_ZSTD = "zstd"
_ZSTD_HEAD_BYTES = 18  # magic, descriptor, window, dictionary and content size
_MAX_RECORD_BYTES = 1 << 28  # uncompressed; a chunk holds a fraction of a second of wall time
# Of all chunks uncompressed: this, and so much more per byte of the file. Logs have 2 at most.
_MIN_TOTAL_BYTES, _MAX_EXPANSION = 1 << 28, 20
# Messages: this number, and one more per so many bytes of the file. Logs have one per 100 bytes.
_MIN_MESSAGES, _MIN_MESSAGE_BYTES = 200_000, 8
_MAX_REASON = 200  # characters of a library's error, which may quote the whole file
_LIBRARY = "testbed"  # named in the header of our files
# The fastest level: most bytes of a log are the last bits of numbers, which no level compresses.
_ZSTD_LEVEL = 1
_SUMMARY_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
# Metadata of the file beside an unfinished log: size and checksum of the log that it continues.
TAIL_NAME = "testbed.tail"
_PIECE_BYTES = 1 << 20  # read at once
NO_SAMPLES = "was cut before its first sample: nothing was recorded"


def tail_path(log: Path) -> Path:
    """Return the path of the file with the samples after the last chunk of an unfinished log."""
    return log.with_name(f".{log.name}.tail")


class LogError(InputError):
    """A log cannot be read or written; names file, place and reason."""


class McapWriter:
    """Write an MCAP file in chunks.

    A thread compresses and writes chunks, mostly without the interpreter's lock, so that the
    simulation goes on meanwhile: without it a flight of Simulation 3 takes 5 % longer on two quiet
    processors, measured in turns. A record is in the file completely or not at all. Before each
    record the file's name is checked: writing stops if the file was removed or moved. The open file
    is locked, so that nothing else rewrites it.

    Args:
        path: A file that does not exist.

    Raises:
        LogError: The file exists, or its folder is missing, full or not writable. Every method
            that writes raises it also for a chunk that an earlier call handed over; the file is
            then closed after its last complete record.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 - closed by close()
        except FileExistsError:
            raise LogError(f"{path}: there is a log already; name another directory") from None
        except OSError as error:
            raise LogError(f"{path}: cannot create the log: {error.strerror}") from error
        lock_file(self._file)
        self._size = self._crc = 0  # of the file
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="log")
        self._pending: Future[None] | None = None
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._channels: list[LogChannel] = []  # registered ones
        self._schema_ids: dict[str, int] = {}  # by name
        self._span_ns = (2**63, 0)
        self._summary: dict[Opcode, list[bytes]] = {group: [] for group in _SUMMARY_GROUPS}
        self._write(_FILE_HEAD)

    def channel(self, topic: str, schema: Schema) -> LogChannel:
        """Make a channel for messages of this file."""
        return LogChannel(topic, schema, self._register)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset, length = self._append(records.Metadata(name, dict(sorted(values.items()))))
        index = records.MetadataIndex(offset=offset, length=length, name=name)
        self._summary[Opcode.METADATA_INDEX].append(_encode(index))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        head: dict[str, Any] = {"name": name, "media_type": media_type}
        head |= {"log_time": 0, "create_time": 0}
        offset, length = self._append(records.Attachment(data=data, **head))
        index = records.AttachmentIndex(offset=offset, length=length, data_size=len(data), **head)
        self._summary[Opcode.ATTACHMENT_INDEX].append(_encode(index))

    def continues(self, log: McapWriter) -> None:
        """Mark this file as the tail of a log as it is, which `flush` has completed."""
        self.metadata(TAIL_NAME, _tail_mark(log._size, log._crc))

    def write_chunk(self, batches: Sequence[MessageBatch]) -> None:
        """Hand over a chunk; it is in the file as soon as the thread has compressed it."""
        self._wait()
        if batches:
            self._check_path()
            made = chunk(batches)
            try:
                self._pending = self._thread.submit(self._write_chunk, made)
            except RuntimeError:  # no threads any more: the interpreter is shutting down
                self._pending = None
                self._write_chunk(made)

    def flush(self) -> None:
        """Wait until all chunks are in the file."""
        self._wait()
        self._check_path()

    def close(self) -> None:
        """Write the summary, which makes the file seekable, and close it."""
        if self._file.closed:
            return
        # no checksum over the whole file: with one, damage in an unused index would be fatal
        self._append(records.DataEnd(data_section_crc=0))
        self._write(self._summary_section())
        unlock_file(self._file)
        self._file.close()
        self._thread.shutdown()

    def _register(self, channel: LogChannel) -> bytes:
        if channel.id:
            return b""
        self._channels.append(channel)
        channel.id = len(self._channels)
        name, data = channel.schema.name, channel.schema.data
        known = name in self._schema_ids
        schema_id = self._schema_ids.setdefault(name, len(self._schema_ids) + 1)
        record = _encode(records.Channel(channel.id, channel.topic, "protobuf", {}, schema_id))
        self._summary[Opcode.CHANNEL].append(record)
        if known:
            return record
        schema = _encode(records.Schema(schema_id, data, "protobuf", name))
        self._summary[Opcode.SCHEMA].append(schema)
        return schema + record

    def _write_chunk(self, made: Chunk) -> None:
        data, compressed = made.data, self._compressor.compress(made.data)
        size, span_ns = len(compressed), (made.first_ns, made.last_ns)
        length = _CHUNK_HEAD.size + size
        content = len(data), zlib.crc32(data), len(_ZSTD), _ZSTD.encode(), size
        head = _CHUNK_HEAD.pack(Opcode.CHUNK, length - _RECORD_HEAD.size, *span_ns, *content)
        ids, indices = zip(*sorted(made.index.items()), strict=True)
        start = self._size
        self._write(b"".join([head, compressed, *indices]))
        *offsets, end = accumulate(map(len, indices), initial=start + length)
        index = records.ChunkIndex(
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=dict(zip(ids, offsets, strict=True)),
            message_index_length=end - start - length,
            compression=_ZSTD,
            compressed_size=size,
            uncompressed_size=len(data),
            message_start_time=made.first_ns,
            message_end_time=made.last_ns,
        )
        self._summary[Opcode.CHUNK_INDEX].append(_encode(index))
        first_ns, last_ns = self._span_ns
        self._span_ns = min(first_ns, made.first_ns), max(last_ns, made.last_ns)

    def _append(self, record: McapRecord) -> tuple[int, int]:
        """Write a record after all chunks; return its offset and length."""
        self._wait()
        self._check_path()
        offset, data = self._size, _encode(record)
        self._write(data)
        return offset, len(data)

    def _wait(self) -> None:
        """Wait for the thread; raise what stopped it."""
        if self._pending:
            self._pending.result()

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            # remove the incomplete record, so that the rest of the file stays readable
            os.ftruncate(self._file.fileno(), self._size)
            self._file.close()
            raise LogError(f"{self.path}: cannot write the log: {error.strerror}") from error
        self._size += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _check_path(self) -> None:
        """Refuse to go on if the path names no file, or another one."""
        try:
            same = os.path.samestat(os.stat(self.path), os.fstat(self._file.fileno()))
        except OSError:
            same = False
        if not same:
            self._file.close()
            raise LogError(
                f"{self.path}: the log is not there any more: {self.path.parent} was removed or "
                "moved during the run"
            )

    def _summary_section(self) -> bytes:
        """Encode the summary section, its offsets and the footer."""
        groups = self._summary
        counts = {channel.id: channel.message_count for channel in self._channels}
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
        groups[Opcode.STATISTICS].append(_encode(statistics))
        out = offsets = b""
        for group, parts in groups.items():
            data = b"".join(parts)
            if data:
                offset = records.SummaryOffset(group, self._size + len(out), len(data))
                offsets += _encode(offset)
            out += data
        footer = records.Footer(self._size, self._size + len(out), summary_crc=0)
        out += offsets + _encode(footer)[:-4]
        return out + struct.pack("<I", zlib.crc32(out)) + _MAGIC


def _encode(record: McapRecord) -> bytes:
    out = RecordBuilder()
    record.write(out)
    return bytes(out.end())


_FILE_HEAD = _MAGIC + _encode(records.Header(profile="", library=_LIBRARY))


@dataclass(slots=True)
class TopicMessages:
    """The messages of a topic in the order of the file."""

    time_ns: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class McapContents:
    """The contents of a file, messages by topic."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, TopicMessages] = field(default_factory=dict)
    own_header: bool = False  # the header is that of `McapWriter`
    finished: bool = False  # the writer closed the file
    lost_bytes: int = 0  # of an incomplete record at the end


def read(path: Path) -> McapContents:
    """Read a file without its summary: of a cut file, all complete records, and its tail.

    Raises:
        LogError: Not an MCAP file, cut before its first record, damaged before its end, or larger
            than any log, also when it is decompressed.
    """
    with open_regular(path, MAX_LOG_BYTES, error=LogError) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(len(_FILE_HEAD))
        if size <= len(_FILE_HEAD) and _FILE_HEAD.startswith(head):
            raise LogError(f"{path}: {NO_SAMPLES}")
        if not head.startswith(_MAGIC):
            raise LogError(f"{path}: not an MCAP file")
        complete = _complete_bytes(path, file, size)
        out = McapContents(own_header=head == _FILE_HEAD, lost_bytes=size - complete)
        messages_left = _MIN_MESSAGES + size // _MIN_MESSAGE_BYTES
        topics: dict[int, TopicMessages] = {}
        source = _Start(file, complete)
        offset = len(_MAGIC)
        try:
            for record in _records(source):
                offset = source.tell()
                if isinstance(record, tuple):
                    messages_left -= 1
                    if messages_left < 0:
                        break
                    channel, time_ns, data = record
                    messages = topics[channel]
                    messages.time_ns.append(time_ns)
                    messages.data.append(data)
                elif isinstance(record, records.Channel):
                    topics[record.id] = out.messages.setdefault(record.topic, TopicMessages())
                elif isinstance(record, records.Metadata):
                    out.metadata[record.name] = record.metadata
                elif isinstance(record, records.Attachment):
                    out.attachments[record.name] = record.data
            else:
                out.finished = True
        except Exception as error:
            raise_memory_shortage(error)
            # a damaged byte can raise anything in the library; the end of a cut file is no damage
            if not (isinstance(error, EndOfFile) and offset == complete):
                reason = repr(error)[:_MAX_REASON]
                raise LogError(f"{path}: damaged after byte {offset}: {reason}") from error
    if messages_left < 0:
        raise LogError(f"{path}: more messages than any log of {size:,} bytes has")
    if out.own_header and not out.finished:
        _add_tail(out, path, complete)
    return out


def _add_tail(log: McapContents, path: Path, log_bytes: int) -> None:
    """Add the messages of a log's tail, if it continues these bytes of this log.

    It is written whole or not at all. A log of the same scenario may have the same size.
    """
    tail_file = tail_path(path)
    if not tail_file.is_file():
        return
    try:
        tail = read(tail_file)
    except LogError:  # the log without it has all complete chunks
        return
    if tail.finished and tail.metadata.get(TAIL_NAME) == _tail_mark(
        log_bytes, _checksum(path, log_bytes)
    ):
        for topic, messages in tail.messages.items():
            known = log.messages.setdefault(topic, TopicMessages())
            known.time_ns += messages.time_ns
            known.data += messages.data


def _tail_mark(log_bytes: int, log_crc: int) -> dict[str, str]:
    return {"log_bytes": str(log_bytes), "log_crc": str(log_crc)}


def _checksum(path: Path, size: int) -> int:
    """Compute the CRC-32 of the first bytes of a file."""
    crc = 0
    with open_regular(path, MAX_LOG_BYTES, error=LogError) as file:
        while size and (piece := file.read(min(size, _PIECE_BYTES))):
            crc, size = zlib.crc32(piece, crc), size - len(piece)
    return crc


def has_own_header(path: Path) -> bool:
    """Return whether a file begins as those of `McapWriter`, also if it was cut in its header.

    Raises:
        LogError: it cannot be read.
    """
    with open_regular(path, MAX_LOG_BYTES, error=LogError) as file:
        return _FILE_HEAD.startswith(file.read(len(_FILE_HEAD)))


def read_attachments(path: Path) -> dict[str, bytes]:
    """Read the attachments of a log of a run alone: its scenario, code and metrics.

    Raises:
        LogError: it cannot be read, is not of `McapWriter`, or is damaged.
    """
    with open_regular(path, MAX_LOG_BYTES, error=LogError) as file:
        if file.read(len(_FILE_HEAD)) != _FILE_HEAD:
            raise LogError(f"{path}: not a log of a run")
        size, out = os.fstat(file.fileno()).st_size, {}
        while len(head := file.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
            opcode, length = _RECORD_HEAD.unpack(head)
            end = file.tell() + length
            if end > size or opcode in (0, Opcode.DATA_END):
                break
            if opcode == Opcode.ATTACHMENT and length <= _MAX_RECORD_BYTES:
                try:
                    stream = ReadDataStream(io.BytesIO(file.read(length)))
                    found = records.Attachment.read(stream)
                except Exception as error:  # a damaged byte can raise anything in the library
                    raise_memory_shortage(error)
                    raise LogError(f"{path}: damaged: {repr(error)[:_MAX_REASON]}") from error
                out[found.name] = found.data
            file.seek(end)
        return out


class _Start:
    """The first bytes of a file, as a stream for the library."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        file.seek(0)
        self._file, self._size = file, size

    def read(self, size: int) -> bytes:
        return self._file.read(min(size, self._size - self._file.tell()))

    def tell(self) -> int:
        return self._file.tell()


class _WithoutIndexes(StreamReader):
    """The library's reader, with empty indexes of messages: each of their numbers takes a call."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode != Opcode.MESSAGE_INDEX:
            return super()._read_record(opcode, length)
        self._stream.read(length)
        return records.MessageIndex(0, [])


def _records(source: Any) -> Iterator[McapRecord | _Message]:  # noqa: ANN401 - a library's source
    """Read records of a file one by one: a chunk may hold millions."""
    for record in _WithoutIndexes(source, emit_chunks=True, validate_crcs=True).records:
        if isinstance(record, records.Message):
            yield record.channel_id, record.log_time, record.data
        elif not isinstance(record, records.Chunk):
            yield record
        else:
            stream, size = get_chunk_data_stream(record, validate_crc=True)
            yield from _chunk_records(stream.read(size))


def _chunk_records(data: bytes) -> Iterator[McapRecord | _Message]:
    """Read the messages and channels of a chunk; the library takes five times as long."""
    at = 0
    while at < len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        at, end = at + _RECORD_HEAD.size, at + _RECORD_HEAD.size + length
        if end > len(data):  # of a chunk without a checksum
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            channel, time_ns = _MESSAGE_HEAD.unpack_from(data, at)
            yield channel, time_ns, data[at + _MESSAGE_HEAD.size : end]
        elif opcode == Opcode.CHANNEL:
            yield records.Channel.read(ReadDataStream(io.BytesIO(data[at:end])))
        at = end


def _complete_bytes(path: Path, file: BinaryIO, file_size: int) -> int:
    """Find the end of the last complete record.

    Raises:
        LogError: A record, or the uncompressed size of a chunk or of all, is larger than that of
            any log.
    """
    offset = len(_MAGIC)
    total, limit = 0, _MIN_TOTAL_BYTES + _MAX_EXPANSION * file_size
    while file_size - offset >= _RECORD_HEAD.size:
        file.seek(offset)
        opcode, length = _RECORD_HEAD.unpack(file.read(_RECORD_HEAD.size))
        end = offset + _RECORD_HEAD.size + length
        if opcode == 0:
            raise LogError(f"{path}: damaged after byte {offset}: no record begins with 0")
        if end > file_size:
            break
        size = length
        if opcode == Opcode.CHUNK:
            file.seek(offset)
            size = max(size, _uncompressed_size(file.read(_CHUNK_HEAD.size + _ZSTD_HEAD_BYTES)))
        if size > _MAX_RECORD_BYTES:
            kind = "chunk" if opcode == Opcode.CHUNK else "record"
            raise LogError(
                f"{path}: the {kind} at byte {offset} would be {size:,} bytes uncompressed; at most"
                f" {_MAX_RECORD_BYTES:,} are allowed"
            )
        total += size
        if total > limit:
            raise LogError(
                f"{path}: the chunks up to byte {end} would be {total:,} bytes uncompressed; at"
                f" most {limit:,} are allowed in a file of {file_size:,} bytes"
            )
        offset = end
    file.seek(offset)
    return file_size if file.read(len(_MAGIC) + 1) == _MAGIC else offset


def _uncompressed_size(chunk: bytes) -> int:
    """Read the uncompressed size, from the chunk and from its zstd data, which zstd trusts.

    Args:
        chunk: its first bytes.
    """
    if len(chunk) < _CHUNK_HEAD.size:
        return 0  # damaged: the library's error has the details
    size = int(_CHUNK_HEAD.unpack_from(chunk)[4])
    try:
        return max(size, zstandard.frame_content_size(chunk[_CHUNK_HEAD.size :]))
    except zstandard.ZstdError:  # another compression, or none
        return size


def decode_event(payload: bytes, time_s: float) -> Event:
    """Decode a foxglove.Log.

    Raises:
        ValueError: The bytes are another message.
    """
    try:
        line = _log_class().FromString(payload)
    except DecodeError as error:
        raise ValueError(f"not a foxglove.Log: {error}") from error
    levels = line.DESCRIPTOR.fields_by_name["level"].enum_type.values_by_number
    level = levels[line.level if line.level in levels else 0].name.lower()
    return Event(time_s, str(level), str(line.name), str(line.message))


@functools.cache
def _log_class() -> Any:  # noqa: ANN401 - made at run time
    # a pool of its own: Foxglove's package may have registered the same names
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(LOG.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(LOG.name))


def topic_schema(topic: Topic, names: Sequence[str]) -> Schema:
    """Describe the messages of a topic in a run of these aircraft, by a FileDescriptorSet.

    A set of bits is an integer, whose sums of several bits no enumeration has; an enumeration of
    the field's name, LimiterBits of limiter_bits, names the single bits.
    """
    package, _, name = topic.message_type.rpartition(".")
    out = FileDescriptorSet()
    file = out.file.add(name=f"{topic.message_type}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field_name, column) in enumerate(topic.fields, start=1):
        kind = f"TYPE_{column.type.upper()}"
        field = message.field.add(name=field_name, number=number, label="LABEL_OPTIONAL")
        if column.bits is not None:
            named = message.enum_type.add(name=_type_name(field_name))
            # proto3 has a first value of 0; values share the message's names with its fields
            named.value.add(name=f"{field_name}_none".upper(), number=0)
            for text, bit in zip(flag_names(column.bits), column.bits, strict=True):
                named.value.add(name=f"{field_name}_{text}".upper(), number=int(bit))
        if not column.per_aircraft:
            field.type = FieldDescriptorProto.Type.Value(kind)
            continue
        by_aircraft = message.nested_type.add(name=_type_name(field_name))
        for aircraft, own_number in aircraft_fields(names).items():
            by_aircraft.field.add(
                name=aircraft, number=own_number, type=kind, label="LABEL_OPTIONAL"
            )
        field.type = FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".{topic.message_type}.{by_aircraft.name}"
    return Schema(topic.message_type, bytes(out.SerializeToString(deterministic=True)))


def _type_name(field: str) -> str:
    return field.title().replace("_", "")
