"""The only module that imports mcap, zstandard and protobuf: MCAP files, record by record.

Chunks come and go as bytes: what is inside them is `wire`'s business. Format:
https://mcap.dev/spec.
"""

from __future__ import annotations

import functools
import io
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import zstandard
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode

from testbed.errors import InputError
from testbed.record.messages import LOG, TIMESTAMP, MessageType

MAGIC = b"\x89MCAP0\r\n"
# The fastest that still shrinks; the rest of a log is the noise of the last bits.
_COMPRESSION_LEVEL = 1
_LARGEST_CHUNK = 1 << 28
_SUMMARY = ("schema", "channel", "statistics", "chunk_index", "attachment_index", "metadata_index")


class LogError(InputError):
    """A log that cannot be read or written: which, where and why."""


class LogFile:
    """An MCAP file being written. Each call is in the file, whole or not at all, when it returns.

    Args:
        path: A file that does not exist.
        library: Who writes.

    Raises:
        LogError: The file exists, or its folder is missing, full or not writable.
    """

    def __init__(self, path: Path, *, library: str) -> None:
        """See the class."""
        self.path = path
        try:
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 - closed by close()
        except FileExistsError:
            raise LogError(f"{path}: there is a log already; name another directory") from None
        except OSError as error:
            raise LogError(f"{path}: cannot create the log: {error.strerror}") from error
        self._size = 0
        self._compressor = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL)
        self._groups: dict[str, list[bytes]] = {name: [] for name in _SUMMARY}
        self._statistics = records.Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts={},
            chunk_count=0,
            message_count=0,
            message_end_time=0,
            message_start_time=0,
            metadata_count=0,
            schema_count=0,
        )
        self._write(MAGIC + _bytes(records.Header(profile="", library=library)))

    def schema(self, kind: MessageType, dependencies: Sequence[MessageType]) -> int:
        """Add the schema of a protobuf message; its number."""
        self._statistics.schema_count += 1
        number = self._statistics.schema_count
        data = descriptor_set(dependencies)
        record = records.Schema(id=number, data=data, encoding="protobuf", name=kind.name)
        self._write(_bytes(record))
        self._groups["schema"].append(_bytes(record))
        return number

    def channel(self, topic: str, schema: int) -> int:
        """Add a channel of protobuf messages; its number."""
        self._statistics.channel_count += 1
        number = self._statistics.channel_count
        record = records.Channel(
            id=number, topic=topic, message_encoding="protobuf", metadata={}, schema_id=schema
        )
        self._write(_bytes(record))
        self._groups["channel"].append(_bytes(record))
        return number

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        data = _bytes(records.Metadata(name=name, metadata=dict(values)))
        index = records.MetadataIndex(offset=self._size, length=len(data), name=name)
        self._write(data)
        self._groups["metadata_index"].append(_bytes(index))
        self._statistics.metadata_count += 1

    def attachment(self, name: str, media_type: str, data: bytes, *, time_ns: int = 0) -> None:
        """Attach a file."""
        record = records.Attachment(
            create_time=0, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        octets = _bytes(record)
        index = records.AttachmentIndex(
            offset=self._size,
            length=len(octets),
            log_time=time_ns,
            create_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._write(octets)
        self._groups["attachment_index"].append(_bytes(index))
        self._statistics.attachment_count += 1

    def chunk(
        self, data: bytes, *, span_ns: tuple[int, int], indexes: Sequence[tuple[int, int, bytes]]
    ) -> None:
        """Add messages.

        Args:
            data: Their records, one after the other.
            span_ns: Time of the first and of the last.
            indexes: For each channel: its number, how many messages, the message index record.
        """
        compressed = self._compressor.compress(data)
        octets = _bytes(
            records.Chunk(
                compression="zstd",
                data=compressed,
                message_start_time=span_ns[0],
                message_end_time=span_ns[1],
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        start, offsets, at = self._size, {}, self._size + len(octets)
        for channel, _, record in indexes:
            offsets[channel] = at
            at += len(record)
        self._write(octets + b"".join(record for _, _, record in indexes))
        index = records.ChunkIndex(
            chunk_length=len(octets),
            chunk_start_offset=start,
            compression="zstd",
            compressed_size=len(compressed),
            message_end_time=span_ns[1],
            message_index_length=self._size - start - len(octets),
            message_index_offsets=offsets,
            message_start_time=span_ns[0],
            uncompressed_size=len(data),
        )
        self._groups["chunk_index"].append(_bytes(index))
        totals = self._statistics
        if not totals.chunk_count:
            totals.message_start_time = span_ns[0]
        totals.message_end_time = span_ns[1]
        totals.chunk_count += 1
        for channel, count, _ in indexes:
            totals.message_count += count
            counts = totals.channel_message_counts
            counts[channel] = counts.get(channel, 0) + count

    def close(self) -> None:
        """Write the summary that makes the file seekable, and close it."""
        if self._file.closed:
            return
        try:
            self._groups["statistics"] = [_bytes(self._statistics)]
            self._write(_bytes(records.DataEnd(data_section_crc=0)))
            self._write(self._summary())
        finally:
            self._file.close()

    def _summary(self) -> bytes:
        start = at = self._size
        body, offsets = [], []
        for name, group in self._groups.items():
            data = b"".join(group)
            if data:
                body.append(data)
                offset = records.SummaryOffset(
                    group_opcode=Opcode[name.upper()], group_start=at, group_length=len(data)
                )
                offsets.append(_bytes(offset))
                at += len(data)
        body += offsets
        # the checksum covers the footer too, up to the checksum
        footer = _bytes(records.Footer(summary_start=start, summary_offset_start=at, summary_crc=0))
        covered = b"".join(body) + footer[:-4]
        return covered + struct.pack("<I", zlib.crc32(covered)) + MAGIC

    def _write(self, data: bytes) -> None:
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


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


@dataclass(frozen=True, slots=True)
class Chunk:
    """Message records, uncompressed."""

    offset: int  # of the chunk in the file
    data: bytes


Channel = records.Channel
Metadata = records.Metadata
Attachment = records.Attachment
Piece: TypeAlias = Channel | Metadata | Attachment | Chunk
_PIECES: dict[int, type[records.McapRecord]] = {
    Opcode.CHANNEL: records.Channel,
    Opcode.METADATA: records.Metadata,
    Opcode.ATTACHMENT: records.Attachment,
}


@dataclass(frozen=True, slots=True)
class End:
    """The end of what could be read."""

    finished: bool  # the writer closed the file
    lost_bytes: int  # of a record that was cut


def read(path: Path) -> Iterator[Piece | End]:
    """The records of a file from its start, without seeking: what is whole of a cut file too.

    The last item is always an `End`.

    Raises:
        LogError: No MCAP file, or damaged before its end.
    """
    try:
        size = path.stat().st_size
        file = open(path, "rb")  # noqa: SIM115 - closed below
    except OSError as error:
        raise LogError(f"{path}: cannot read the log: {error.strerror}") from error
    with file:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{path}: not an MCAP file")
        at = len(MAGIC)
        while True:
            head = file.read(9)
            if len(head) < 9:
                yield End(finished=False, lost_bytes=len(head))
                return
            opcode, length = struct.unpack("<BQ", head)
            if length > size - at - 9:
                yield End(finished=False, lost_bytes=size - at)
                return
            if opcode == Opcode.DATA_END:
                tail = _tail(file, size)
                yield End(finished=tail == MAGIC, lost_bytes=0)
                return
            body = file.read(length)
            try:
                if opcode == Opcode.CHUNK:
                    yield Chunk(at, _expand(body))
                elif opcode in _PIECES:
                    kind = _PIECES[opcode]
                    yield kind.read(ReadDataStream(io.BytesIO(body)))  # type: ignore[attr-defined]
            except LogError:
                raise
            except Exception as error:
                # whatever a damaged byte sets off in the library, the place is what matters
                raise LogError(f"{path}: damaged at byte {at}: {error}") from error
            at += 9 + length


def _tail(file: io.BufferedReader, size: int) -> bytes:
    file.seek(size - len(MAGIC))
    return file.read()


def _expand(body: bytes) -> bytes:
    chunk = records.Chunk.read(ReadDataStream(io.BytesIO(body)))
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes is larger than any of ours")
    if chunk.compression == "zstd":
        # a decompressor object stops at the size; the one-shot call would trust the frame's own
        decompressor = zstandard.ZstdDecompressor().decompressobj()
        data = decompressor.decompress(chunk.data) if _declared(chunk) else b""
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}; ours is zstd")
    if len(data) != chunk.uncompressed_size:
        raise ValueError("a chunk does not have the size it states")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk fails its checksum")
    return data


def _declared(chunk: records.Chunk) -> bool:
    """Whether the compressed frame says the size that the chunk says."""
    return zstandard.frame_content_size(chunk.data) == chunk.uncompressed_size


def log_fields(payload: bytes) -> tuple[int, str, str]:
    """Level, text and source of a foxglove.Log.

    Raises:
        ValueError: It is none.
    """
    try:
        message = _log_class().FromString(payload)
    except DecodeError as error:
        raise ValueError(f"no {LOG.name}: {error}") from error
    return int(message.level), str(message.message), str(message.name)


@functools.cache
def _log_class() -> Any:  # noqa: ANN401 - made at run time
    # a pool of its own: Foxglove's package may have registered the same names
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(descriptor_set((TIMESTAMP, LOG))).file:
        pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(LOG.name))


_SCALARS = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "int32": FieldDescriptorProto.TYPE_INT32,
    "int64": FieldDescriptorProto.TYPE_INT64,
    "string": FieldDescriptorProto.TYPE_STRING,
    "fixed32": FieldDescriptorProto.TYPE_FIXED32,
    "enum": FieldDescriptorProto.TYPE_ENUM,
}


def descriptor_set(kinds: Sequence[MessageType]) -> bytes:
    """The FileDescriptorSet of some message types, one file for each package, in their order."""
    out = FileDescriptorSet()
    packages = list(dict.fromkeys(kind.name.rpartition(".")[0] for kind in kinds))
    for package in packages:
        file = out.file.add(name=f"{package}.proto", package=package, syntax="proto3")
        file.dependency.extend(f"{p}.proto" for p in packages[: packages.index(package)])
        for kind in kinds:
            if kind.name.rpartition(".")[0] == package:
                _describe(kind, file.message_type.add(name=kind.name.rpartition(".")[2]))
    return bytes(out.SerializeToString(deterministic=True))


def _describe(kind: MessageType, out: DescriptorProto) -> None:
    for field in kind.fields:
        added = out.field.add(name=field.name, number=field.number)
        repeated, single = FieldDescriptorProto.LABEL_REPEATED, FieldDescriptorProto.LABEL_OPTIONAL
        added.label = repeated if field.repeated else single
        added.type = _SCALARS.get(field.type, FieldDescriptorProto.TYPE_MESSAGE)
        if added.type == FieldDescriptorProto.TYPE_MESSAGE:
            added.type_name = f".{field.type}"
        elif field.values:
            enum = out.enum_type.add(name=field.name.title().replace("_", ""))
            added.type_name = f".{kind.name}.{enum.name}"
            for number, value in enumerate(field.values):
                enum.value.add(name=value, number=number)
