"""Messages as bytes: proto3 payloads of fixed length, encoded for many frames at once.

A field of a message of doubles is a constant tag and 8 bytes, so a payload is a template with
holes, and the holes of K frames and A aircraft are filled by one strided assignment. Seconds and
nanoseconds, which proto3 stores with a varying length, are padded to five bytes each, which every
decoder must accept (https://protobuf.dev/programming-guides/encoding/).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from testbed.record.messages import DOUBLE, FIXED32, MessageType
from testbed.state import Array

Bytes = NDArray[np.uint8]
Times = NDArray[np.uint64]

MESSAGE_OPCODE = 5
HEADER = 31  # bytes of an MCAP message record before its payload
_STAMPED = 11  # bytes of that header before the sequence number and the two times
_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5  # wire types
TIMESTAMP_SIZE = 12


@dataclass(frozen=True, slots=True)
class Span:
    """Fields next to one another whose values lie at a constant stride."""

    first: int  # index of the first field
    count: int
    offset: int  # of its value, in the payload
    stride: int
    dtype: str


@dataclass(frozen=True, slots=True)
class Layout:
    """A payload of fixed length: the bytes that never change and where the values go."""

    template: bytes
    spans: tuple[Span, ...]

    @property
    def fields(self) -> int:
        """Number of values."""
        return sum(span.count for span in self.spans)

    def encode_into(self, payloads: Bytes, values: Array) -> None:
        """Fill payloads (..., size), which may be strided, with values (..., fields)."""
        for span in self.spans:
            view = _view(payloads, span)
            view[...] = values[..., span.first : span.first + span.count]

    def decode(self, payloads: Bytes) -> Array:
        """Values (..., fields) of contiguous payloads (..., size).

        Raises:
            ValueError: The bytes between the values are not those of this layout.
        """
        template = np.frombuffer(self.template, dtype=np.uint8)
        constant = np.ones(template.size, dtype=np.bool_)
        for span in self.spans:
            width = np.dtype(span.dtype).itemsize
            for i in range(span.count):
                constant[span.offset + i * span.stride :][:width] = False
        if payloads.shape[-1] != template.size or not np.array_equal(
            payloads[..., constant], np.broadcast_to(template, payloads.shape)[..., constant]
        ):
            raise ValueError("message laid out in another way")
        values = np.empty((*payloads.shape[:-1], self.fields))
        for span in self.spans:
            values[..., span.first : span.first + span.count] = _view(payloads, span)
        return values


def _view(payloads: Bytes, span: Span) -> NDArray[np.generic]:
    """The values (..., count) of a span inside payloads (..., size), sharing their memory."""
    width = np.dtype(span.dtype).itemsize
    first = payloads[..., span.offset : span.offset + width].view(span.dtype)
    return as_strided(
        first,
        shape=(*payloads.shape[:-1], span.count),
        strides=(*payloads.strides[:-1], span.stride),
    )


def layout(kind: MessageType) -> Layout:
    """The layout of a message of numbers.

    Raises:
        ValueError: A field is neither a double nor a fixed32.
    """
    types = {DOUBLE: ("<f8", _FIXED64), FIXED32: ("<u4", _FIXED32)}
    template = b""
    spans: list[Span] = []
    for i, field in enumerate(kind.fields):
        if field.type not in types or field.repeated:
            raise ValueError(f"{kind.name}.{field.name} has no fixed length")
        dtype, wire_type = types[field.type]
        mark = tag(field.number, wire_type)
        width = np.dtype(dtype).itemsize
        offset, stride = len(template) + len(mark), len(mark) + width
        template += mark + bytes(width)
        last = spans[-1] if spans else None
        if last and (last.dtype, last.stride) == (dtype, stride):
            spans[-1] = Span(last.first, last.count + 1, last.offset, stride, dtype)
        else:
            spans.append(Span(i, 1, offset, stride, dtype))
    return Layout(template, tuple(spans))


def packed_layout(count: int) -> Layout:
    """The layout of a message whose only field, number 1, is `repeated double`."""
    head = tag(1, _LENGTH) + varint(8 * count)
    return Layout(head + bytes(8 * count), (Span(0, count, len(head), 8, "<f8"),))


def tag(number: int, wire_type: int) -> bytes:
    """What stands before a field."""
    return varint(number << 3 | wire_type)


def varint(value: int) -> bytes:
    """A whole number, not negative, seven bits to a byte."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def prefixed(number: int, data: bytes) -> bytes:
    """A field that holds a string or a message."""
    return tag(number, _LENGTH) + varint(len(data)) + data


def timestamps(time_ns: Times) -> Bytes:
    """Payloads of google.protobuf.Timestamp (..., 12) of times (...,), both numbers padded."""
    out = np.empty((*time_ns.shape, TIMESTAMP_SIZE), dtype=np.uint8)
    shifts = np.arange(0, 35, 7, dtype=np.uint64)
    more = np.array([0x80] * 4 + [0], dtype=np.uint8)
    for start, part in ((0, time_ns // 10**9), (6, time_ns % 10**9)):
        out[..., start] = tag(1 if start == 0 else 2, _VARINT)[0]
        sevens = (part[..., None] >> shifts) & np.uint64(0x7F)
        out[..., start + 1 : start + 6] = sevens.astype(np.uint8) | more
    return out


def numbers(values: Array) -> bytes:
    """Fields 1, 2, … of type double."""
    return b"".join(
        tag(i, _FIXED64) + np.float64(value).tobytes() for i, value in enumerate(values, start=1)
    )


def transform(time_ns: int, parent: str, child: str, translation: Array, xyzw: Array) -> bytes:
    """A foxglove.FrameTransform as the element of a foxglove.FrameTransforms."""
    stamp = timestamps(np.array(time_ns, dtype=np.uint64)).tobytes()
    body = prefixed(1, stamp) + prefixed(2, parent.encode()) + prefixed(3, child.encode())
    body += prefixed(4, numbers(translation)) + prefixed(5, numbers(xyzw))
    return prefixed(1, body)


def location_fix(time_ns: int, frame: str, geodetic: Array) -> bytes:
    """A foxglove.LocationFix of latitude and longitude in deg and altitude in m."""
    stamp = timestamps(np.array(time_ns, dtype=np.uint64)).tobytes()
    return numbers(geodetic) + prefixed(6, stamp) + prefixed(7, frame.encode())


def log_line(time_ns: int, level: int, text: str, source: str) -> bytes:
    """A foxglove.Log."""
    stamp = timestamps(np.array(time_ns, dtype=np.uint64)).tobytes()
    head = prefixed(1, stamp) + tag(2, _VARINT) + varint(level)
    return head + prefixed(3, text.encode()) + prefixed(4, source.encode())


def message_header(channel: int, size: int) -> bytes:
    """The MCAP record header of a message whose sequence and times are filled in later."""
    return struct.pack("<BQH", MESSAGE_OPCODE, HEADER - 9 + size, channel) + bytes(
        HEADER - _STAMPED
    )


def message(channel: int, sequence: int, time_ns: int, payload: bytes) -> bytes:
    """A whole MCAP message record."""
    head = message_header(channel, len(payload))[:_STAMPED]
    return head + struct.pack("<IQQ", sequence, time_ns, time_ns) + payload


def stamp_headers(records: Bytes, sequence: Times, time_ns: Times) -> None:
    """Write sequence numbers and times (K,) into message records (K, ..., size)."""
    stamp = np.empty(sequence.size, dtype=[("n", "<u4"), ("log", "<u8"), ("publish", "<u8")])
    stamp["n"], stamp["log"], stamp["publish"] = sequence, time_ns, time_ns
    single = (1,) * (records.ndim - 2)
    octets = stamp.view(np.uint8).reshape(sequence.size, *single, HEADER - _STAMPED)
    records[..., _STAMPED:HEADER] = octets


def message_indexes(channels: NDArray[np.uint16], time_ns: Times, offsets: Times) -> Bytes:
    """MCAP message index records (M, size) of M channels with K messages each.

    Args:
        channels: (M,) channel numbers.
        time_ns: (K,) log times.
        offsets: (M, K) where the records start in the uncompressed chunk.
    """
    count = time_ns.size
    kind = np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("size", "<u4"),
            ("entries", [("time", "<u8"), ("offset", "<u8")], (count,)),
        ]
    )
    out = np.empty(channels.size, dtype=kind)
    out["opcode"], out["length"], out["channel"] = 7, 6 + 16 * count, channels
    out["size"] = 16 * count
    out["entries"]["time"], out["entries"]["offset"] = time_ns, offsets
    return out.view(np.uint8).reshape(channels.size, kind.itemsize)
