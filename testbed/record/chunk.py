"""A chunk of an MCAP file as it is filled.

A message is a record of a head of constant length and its data
(https://mcap.dev/spec#message-op0x05). What all aircraft say at one time are records side by side,
a row of bytes; rows are made and addressed many at once, so that no message is handled alone.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.record.wire import Octets

Whole = NDArray[np.int64]

_HEAD = np.dtype(
    [
        ("kind", "u1"),
        ("length", "<u8"),  # of the rest
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("times", "<u8", (2,)),  # logged and published, ns
    ]
)
_MESSAGE, _INDEX = 5, 7  # kinds
_INDEX_HEAD = struct.Struct("<BQHI")  # kind, length, channel and the bytes of the index
_OUTSIDE = 9  # bytes of a record that its length does not count


@dataclass(frozen=True, slots=True)
class Schema:
    """A kind of message: its full name and the protobuf FileDescriptorSet that explains it."""

    name: str
    data: bytes


@dataclass(slots=True)
class Stream:
    """Messages of one kind under one name, in the order they are written.

    Args:
        announce: gives the records that make a stream known, where they are missing, and numbers
            it.
    """

    topic: str
    schema: Schema
    announce: Callable[[Stream], bytes]
    number: int = 0  # in the file; 0: nothing was written yet
    count: int = 0


@dataclass(frozen=True, slots=True)
class Strip:
    """Rows in each of which every stream has one message, its next.

    Args:
        streams: C of them.
        rows: R of them.
        starts: (R, C) where in its row each record begins; what makes a stream known is before.
        time_ns: (R,)
        turns: (R,) in whose order the rows of all strips are written.
    """

    streams: Sequence[Stream]
    rows: Sequence[Any]  # bytes or arrays of them
    starts: Whole
    time_ns: Whole
    turns: Whole


def strip(
    streams: Sequence[Stream], data: Sequence[Sequence[bytes]], time_ns: Whole, turns: Whole
) -> Strip:
    """Messages of any lengths, in R rows those of C streams."""
    news = _introduce(streams)
    sizes = np.array([list(map(len, row)) for row in data]) + _HEAD.itemsize
    heads = np.empty(sizes.shape, dtype=_HEAD)
    heads["kind"], heads["length"] = _MESSAGE, sizes - _OUTSIDE
    heads["channel"] = [stream.number for stream in streams]
    heads["sequence"], heads["times"] = _counted(streams, len(heads)), time_ns[:, None, None]
    rows = [
        b"".join(chain.from_iterable(zip(*pair, strict=True)))
        for pair in zip(heads.view(f"V{_HEAD.itemsize}").tolist(), data, strict=True)
    ]
    starts = np.cumsum(sizes, axis=1) - sizes
    return _introduced(Strip(streams, rows, starts, time_ns, turns), news)


class Sheet:
    """Rows whose messages have constant lengths.

    Args:
        kinds: what neighbours have in common, a template, and the streams that get one each; they
            have always been written together.
    """

    def __init__(self, kinds: Sequence[tuple[bytes, Sequence[Stream]]]) -> None:
        """See the class."""
        self._kinds = [(streams, _HEAD.itemsize + len(data)) for data, streams in kinds]
        self._streams = [stream for streams, _ in self._kinds for stream in streams]
        self._news = _introduce(self._streams)
        records = []
        for data, streams in kinds:
            length = _HEAD.itemsize - _OUTSIDE + len(data)
            for stream in streams:
                head = np.array((_MESSAGE, length, stream.number, 0, (0, 0)), dtype=_HEAD)
                records.append(head.tobytes() + data)
        self._template = np.frombuffer(b"".join(records), dtype=np.uint8)
        self._starts = np.array([0, *accumulate(map(len, records))][:-1], dtype=np.int64)

    def blank(self, rows: int) -> Octets:
        """Rows (rows, bytes) that wait for values."""
        return np.tile(self._template, (rows, 1))

    def messages(self, rows: Octets) -> list[Octets]:
        """Of each kind the messages in these rows, (rows, streams, bytes)."""
        return [records[..., _HEAD.itemsize :] for records in self._records(rows)]

    def strip(self, rows: Octets, time_ns: Whole) -> Strip:
        """The rows when their values are filled in."""
        times = time_ns[:, None, None]
        for records, (streams, _) in zip(self._records(rows), self._kinds, strict=True):
            heads = records[..., : _HEAD.itemsize].view(_HEAD)[..., 0]
            heads["sequence"], heads["times"] = _counted(streams, len(rows)), times
        news, self._news = self._news, []
        starts = np.broadcast_to(self._starts, (len(rows), len(self._streams)))
        made = Strip(self._streams, list(rows), starts, time_ns, turns=np.arange(len(rows)))
        return _introduced(made, news)

    def _records(self, rows: Octets) -> list[Octets]:
        out, at = [], 0
        for streams, size in self._kinds:
            end = at + len(streams) * size
            out.append(rows[:, at:end].reshape(len(rows), len(streams), size))
            at = end
        return out


def _introduce(streams: Sequence[Stream]) -> list[bytes]:
    return [stream.announce(stream) for stream in streams]


def _counted(streams: Sequence[Stream], rows: int) -> Whole:
    """Numbers (rows, 1) of the next messages of streams that were always written together."""
    first = streams[0].count + 1
    for stream in streams:
        stream.count += rows
    return np.arange(first, first + rows)[:, None]


def _introduced(made: Strip, news: Sequence[bytes]) -> Strip:
    """The strip with what makes its streams known before the first message of each."""
    if not any(news):
        return made
    row, starts = bytes(made.rows[0]), made.starts.copy()
    messages = [row[start:end] for start, end in pairwise([*starts[0].tolist(), len(row)])]
    known = b"".join(chain.from_iterable(zip(news, messages, strict=True)))
    starts[0] += list(accumulate(map(len, news)))
    return replace(made, rows=[known, *made.rows[1:]], starts=starts)


@dataclass(frozen=True, slots=True)
class Chunk:
    """What is compressed together."""

    data: bytes
    index: Mapping[int, bytes]  # the index record of each stream, by its number
    first_ns: int
    last_ns: int


def chunk(strips: Sequence[Strip]) -> Chunk:
    """A chunk of strips, no two of the same stream; rows of one turn in the order of the strips."""
    rows = [row for made in strips for row in made.rows]
    order = np.argsort(np.concatenate([made.turns for made in strips]), kind="stable")
    sizes = np.array(list(map(len, rows)))
    places = np.empty_like(sizes)
    places[order] = np.cumsum(sizes[order])
    places -= sizes
    index: dict[int, bytes] = {}
    first = 0
    for made in strips:
        last = first + len(made.rows)
        numbers = [stream.number for stream in made.streams]
        index |= zip(numbers, _index(numbers, made, places[first:last]), strict=True)
        first = last
    times = np.concatenate([made.time_ns for made in strips])
    data = b"".join([rows[i] for i in order.tolist()])
    return Chunk(data, index, first_ns=int(times.min()), last_ns=int(times.max()))


def _index(numbers: Sequence[int], made: Strip, places: Whole) -> list[bytes]:
    """The index records of a strip's streams: times of their messages and where they are."""
    size = 16 * len(places)
    entries = np.empty((len(numbers), len(places), 2), dtype="<u8")
    entries[..., 0] = made.time_ns
    entries[..., 1] = places + made.starts.T
    length = _INDEX_HEAD.size - _OUTSIDE + size
    return [
        _INDEX_HEAD.pack(_INDEX, length, number, size) + entry.tobytes()
        for number, entry in zip(numbers, entries, strict=True)
    ]
