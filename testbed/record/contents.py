"""An MCAP file sorted by topic, each message still bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from testbed.record import door
from testbed.record.door import LogError
from testbed.record.wire import HEADER, MESSAGE_OPCODE, Bytes, Times

_RECORD = struct.Struct("<BQHIQ")  # opcode, length, channel, sequence, log time


@dataclass(slots=True)
class Messages:
    """The messages of a topic in the order of the file."""

    time_ns: Times
    chunks: tuple[tuple[bytes, list[int], list[int]], ...]  # data, starts and lengths of payloads

    def each(self) -> Iterator[bytes]:
        """Payloads one by one."""
        for data, starts, lengths in self.chunks:
            for start, length in zip(starts, lengths, strict=True):
                yield data[start : start + length]

    def payloads(self, path: Path, size: int) -> Bytes:
        """Payloads (K, size) that all have this size.

        Raises:
            LogError: One has not.
        """
        parts = []
        for data, starts, lengths in self.chunks:
            if any(length != size for length in lengths):
                raise LogError(f"{path}: a message has not the {size} bytes it should have")
            octets = np.frombuffer(data, dtype=np.uint8)
            parts.append(octets[np.array(starts)[:, None] + np.arange(size)])
        return np.concatenate(parts)


@dataclass(slots=True)
class Contents:
    """What a file holds."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, Messages] = field(default_factory=dict)
    end: door.End = field(default_factory=lambda: door.End(finished=False, lost_bytes=0))


def gather(path: Path) -> Contents:
    """Read a whole file, sorting its messages by topic.

    Raises:
        LogError: No MCAP file, or damaged before its end.
    """
    out = Contents()
    topics: dict[int, str] = {}
    chunks: dict[int, list[tuple[bytes, list[int], list[int]]]] = {}
    times: dict[int, list[int]] = {}
    for piece in door.read(path):
        if isinstance(piece, door.End):
            out.end = piece
        elif isinstance(piece, door.Chunk):
            for channel, (log_times, starts, lengths) in _split(path, piece).items():
                chunks.setdefault(channel, []).append((piece.data, starts, lengths))
                times.setdefault(channel, []).extend(log_times)
        elif isinstance(piece, door.Channel):
            topics[piece.id] = piece.topic
        elif isinstance(piece, door.Metadata):
            out.metadata[piece.name] = piece.metadata
        elif isinstance(piece, door.Attachment):
            out.attachments[piece.name] = piece.data
    for channel, parts in chunks.items():
        if channel not in topics:
            raise LogError(f"{path}: messages of channel {channel}, which the file does not name")
        stamps = np.array(times[channel], dtype=np.uint64)
        out.messages[topics[channel]] = Messages(stamps, tuple(parts))
    return out


def _split(path: Path, chunk: door.Chunk) -> dict[int, tuple[list[int], list[int], list[int]]]:
    """Times, starts and lengths of the payloads of each channel in a chunk."""
    found: dict[int, tuple[list[int], list[int], list[int]]] = {}
    data, size, at = chunk.data, len(chunk.data), 0
    unpack: Any = _RECORD.unpack_from
    while at < size:
        if size - at < HEADER:
            raise LogError(f"{path}: damaged in the chunk at byte {chunk.offset}")
        opcode, length, channel, _, stamp = unpack(data, at)
        if length > size - at - 9:
            raise LogError(f"{path}: damaged in the chunk at byte {chunk.offset}")
        if opcode == MESSAGE_OPCODE:
            lists = found.get(channel)
            if lists is None:
                lists = found[channel] = ([], [], [])
            lists[0].append(stamp)
            lists[1].append(at + HEADER)
            lists[2].append(length - HEADER + 9)
        at += 9 + length
    return found
