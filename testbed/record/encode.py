"""Rows of frames as the bytes of a chunk: every message of K frames filled in by a few copies."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from testbed.frames import quaternion_xyzw
from testbed.record.messages import COMMAND, ESTIMATE, FORMATION, LINK_SOURCE, STATE, Topic
from testbed.record.wire import (
    HEADER,
    TIMESTAMP_SIZE,
    Bytes,
    Layout,
    Span,
    Times,
    layout,
    location_fix,
    message_header,
    packed_layout,
    stamp_headers,
    timestamps,
    transform,
)
from testbed.state import Array, Frame

PER_FRAME = (STATE, ESTIMATE, COMMAND, FORMATION)
SOURCES = (*(column.source for topic in PER_FRAME for column in topic.columns), LINK_SOURCE)
_arrays = attrgetter(*SOURCES)


class Rows:
    """Frames as rows of numbers, waiting to be written.

    Args:
        frames: How many rows there is room for.
        aircraft: Number of aircraft, the leader included.
    """

    def __init__(self, *, frames: int, aircraft: int) -> None:
        """See the class."""
        self.aircraft, self.followers = aircraft, aircraft - 1
        self._slices: dict[str, slice] = {}
        at = 0
        for topic in PER_FRAME:
            for column in topic.columns:
                width = len(column.names) * self.agents(topic)
                self._slices[column.source] = slice(at, at + width)
                at += width
        self._slices[LINK_SOURCE] = slice(at, at + self.followers * aircraft)
        self._values = np.empty((frames, self._slices[LINK_SOURCE].stop))
        self.tick = np.zeros(frames, dtype=np.int64)
        self.filled = 0

    def agents(self, topic: Topic) -> int:
        """How many messages of a topic there are in a frame."""
        return self.followers if topic.followers_only else self.aircraft

    @property
    def full(self) -> bool:
        """Whether there is no room for another frame."""
        return self.filled == len(self.tick)

    def append(self, frame: Frame) -> None:
        """Copy a frame into the next row."""
        np.concatenate(_arrays(frame), axis=None, out=self._values[self.filled])
        self.tick[self.filled] = frame.tick
        self.filled += 1

    def values(self, topic: Topic) -> Array:
        """The numbers of a topic (K, agents, fields)."""
        agents = self.agents(topic)
        columns = [self._column(column.source, agents) for column in topic.columns]
        return np.concatenate(columns, axis=-1)

    def ages(self) -> Array:
        """Age of information (K, n, N), s."""
        return self._column(LINK_SOURCE, self.followers)

    def positions(self) -> Array:
        """True positions (K, N, 3), m."""
        return self._column("truth.position_ned", self.aircraft)

    def poses(self) -> Array:
        """True position and attitude (K, N, 7): north, east, down, then quaternion x, y, z, w."""
        euler = self._column("truth.euler", self.aircraft)
        return np.concatenate([self.positions(), quaternion_xyzw(euler)], axis=-1)

    def estimates_differ(self) -> bool:
        """Whether any estimate differs from the truth in these rows."""
        pairs = ((c.source, c.source.replace("estimate", "truth")) for c in ESTIMATE.columns)
        rows = self._values[: self.filled]
        return any(
            not np.array_equal(
                rows[:, self._slices[estimate]], rows[:, self._slices[truth]], equal_nan=True
            )
            for estimate, truth in pairs
        )

    def _column(self, source: str, agents: int) -> Array:
        rows = self._values[: self.filled, self._slices[source]]
        # a run without followers has columns of no width, whose last axis cannot be inferred
        width = rows.shape[1] // agents if agents else 0
        shaped: Array = rows.reshape(self.filled, agents, width)
        return shaped


@dataclass(frozen=True, slots=True)
class Block:
    """The messages of one topic in a frame: as many records of one length side by side."""

    offset: int
    layout: Layout
    channels: tuple[int, ...]

    @property
    def record(self) -> int:
        """Length of one record, header included."""
        return HEADER + len(self.layout.template)

    @property
    def size(self) -> int:
        """Length of all."""
        return self.record * len(self.channels)

    @property
    def template(self) -> bytes:
        """The records with no number filled in."""
        size = len(self.layout.template)
        return b"".join(message_header(c, size) + self.layout.template for c in self.channels)

    def fill(self, frames: Bytes, stamps: tuple[Times, Times], values: Array) -> None:
        """Fill the records of this block in frames (K, bytes) with values (K, agents, fields)."""
        if not self.channels:
            return
        part = frames[:, self.offset : self.offset + self.size]
        # splitting an axis of stride 1 gives a view, so this writes into frames
        records = part.reshape(len(frames), len(self.channels), self.record)
        stamp_headers(records, *stamps)
        self.layout.encode_into(records[..., HEADER:], values)


class FrameLayout:
    """All messages that every frame has, one after the other: `/tf`, then topic by topic.

    Args:
        names: The aircraft.
        tf: Channel of `/tf`.
        topics: Topics with the channel of each agent; what is not there is not written.
        links: Channels of the followers' link messages.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        *,
        tf: int,
        topics: dict[Topic, tuple[int, ...]],
        links: tuple[int, ...],
    ) -> None:
        """See the class."""
        self._transforms, tf_payload = _transforms(names)
        self._template = message_header(tf, len(tf_payload)) + tf_payload
        self._tf_size = len(self._template)
        self._blocks: dict[Topic, Block] = {}
        for topic, channels in topics.items():
            block = Block(len(self._template), layout(topic.type), channels)
            self._blocks[topic] = block
            self._template += block.template
        self._link = Block(len(self._template), packed_layout(len(names)), links)
        self._template += self._link.template
        blocks = (*self._blocks.values(), self._link)
        starts = [b.offset + b.record * i for b in blocks for i in range(len(b.channels))]
        self.channels = np.array([tf, *(c for b in blocks for c in b.channels)], dtype=np.uint16)
        self.offsets = np.array([0, *starts], dtype=np.uint64)

    def encode(self, rows: Rows, *, sequence: Times, time_ns: Times) -> Bytes:
        """The records (K, bytes) of the frames in the rows, numbered and timed (K,)."""
        template = np.frombuffer(self._template, dtype=np.uint8)
        frames = np.tile(template, (rows.filled, 1))
        stamps = (sequence, time_ns)
        stamp_headers(frames[:, : self._tf_size], *stamps)
        stamp, poses = timestamps(time_ns), rows.poses()
        for i, (offset, stamp_offset, pose) in enumerate(self._transforms):
            part = frames[:, HEADER + offset : HEADER + offset + len(pose.template)]
            part[:, stamp_offset : stamp_offset + TIMESTAMP_SIZE] = stamp
            pose.encode_into(part, poses[:, i])
        for topic, block in self._blocks.items():
            block.fill(frames, stamps, rows.values(topic))
        self._link.fill(frames, stamps, rows.ages())
        return frames


class FixLayout:
    """The `/<name>/fix` messages of all aircraft at one time, one after the other."""

    def __init__(self, names: tuple[str, ...], channels: tuple[int, ...]) -> None:
        """See the class."""
        self._parts: list[tuple[slice, int, Layout]] = []
        self._template = b""
        for name, channel in zip(names, channels, strict=True):
            payload = location_fix(0, name, np.zeros(3))
            record = message_header(channel, len(payload)) + payload
            start = len(self._template)
            fix = Layout(payload, (Span(0, 3, 1, 9, "<f8"),))
            self._parts.append((slice(start, start + len(record)), _stamp_offset(payload), fix))
            self._template += record
        self.channels = np.array(channels, dtype=np.uint16)
        self.offsets = np.array([part.start for part, _, _ in self._parts], dtype=np.uint64)

    def encode(self, geodetic: Array, *, sequence: Times, time_ns: Times) -> Bytes:
        """The records (F, bytes) of F times, from geodetic positions (F, N, 3)."""
        out = np.tile(np.frombuffer(self._template, dtype=np.uint8), (time_ns.size, 1))
        stamp = timestamps(time_ns)
        for i, (part, stamp_offset, fix) in enumerate(self._parts):
            records = out[:, part]
            stamp_headers(records, sequence, time_ns)
            payloads = records[:, HEADER:]
            payloads[:, stamp_offset : stamp_offset + TIMESTAMP_SIZE] = stamp
            fix.encode_into(payloads, geodetic[:, i])
        return out


def _stamp_offset(payload: bytes) -> int:
    """Where the timestamp lies in a payload that was made for time zero."""
    return payload.index(timestamps(np.zeros((), dtype=np.uint64)).tobytes())


def _transforms(names: tuple[str, ...]) -> tuple[list[tuple[int, int, Layout]], bytes]:
    """Where the transform of each aircraft lies in the payload of `/tf`, and that payload."""
    parts: list[tuple[int, int, Layout]] = []
    payload = b""
    for name in names:
        data = transform(0, "ned", name, np.zeros(3), np.zeros(4))
        # the last 36 bytes are the quaternion, before them its head of 2, the vector of 27
        spans = (Span(0, 3, len(data) - 64, 9, "<f8"), Span(3, 4, len(data) - 35, 9, "<f8"))
        parts.append((len(payload), _stamp_offset(data), Layout(data, spans)))
        payload += data
    return parts, payload
