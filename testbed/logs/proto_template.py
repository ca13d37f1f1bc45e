"""Protobuf messages as bytes, encoded by numpy for many samples at once.

A protobuf field of fixed length is a constant tag and its value
(https://protobuf.dev/programming-guides/encoding/). A message of such fields is a constant
template with values at constant offsets, which numpy fills for all samples and aircraft in one
assignment per column. For four aircraft this costs 5 µs per sample, protobuf's own classes 80 µs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.logs.messages import BOOL, DOUBLE, FIXED32, Column, Topic, aircraft_fields

Octets: TypeAlias = NDArray[np.uint8]
IntArray: TypeAlias = NDArray[np.int64]
Records: TypeAlias = np.ndarray[Any, np.dtype[np.void]]

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5  # wire types; a bool is a varint of one byte
_TYPES = {DOUBLE: ("<f8", _FIXED64), FIXED32: ("<u4", _FIXED32), BOOL: ("?", _VARINT)}
_NS = 10**9
_STAMP_BYTES = 5  # of a varint, enough for any uint32
# google.protobuf.Timestamp of constant length: seconds and nanos with five bytes each
_STAMP = bytes([0x08, *bytes(_STAMP_BYTES), 0x10, *bytes(_STAMP_BYTES)])
_APPROXIMATED = 1  # LocationFix.PositionCovarianceType
_DOUBLE = np.dtype([("tag", "u1"), ("value", "<f8")])


@dataclass(frozen=True, slots=True)
class ProtoTemplate:
    """The messages of a topic: their constant bytes and where the values stand in them."""

    topic: Topic
    data: bytes
    values: np.dtype[np.void]  # the columns by source, at their offsets in the template

    def fill(self, messages: Octets, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write values into messages.

        Args:
            messages: (..., agents, bytes), each a copy of the template.
            columns: the values (..., agents) or (..., agents, components) by source.
        """
        records = messages.view(self.values)[..., 0]
        for column in self.topic.columns:
            values = _values(records, column)
            values[...] = columns[column.source].reshape(values.shape)

    def decode(self, messages: Sequence[bytes]) -> dict[str, Array]:
        """Read the values (K, components) of K messages, by source.

        Raises:
            ValueError: A message has another length or layout than the template.
        """
        data = b"".join(messages)
        if len(data) != len(messages) * len(self.data):
            raise ValueError("a message has another length than its type")
        records = np.frombuffer(data, dtype=self.values)
        columns = {c.source: _values(records, c) for c in self.topic.columns}
        again = np.tile(np.frombuffer(self.data, dtype=np.uint8), (len(messages), 1))
        self.fill(again, columns)
        if again.tobytes() != data:
            raise ValueError("a message has other fields than its type")
        return {source: values.astype(np.float64) for source, values in columns.items()}


def topic_template(topic: Topic, names: Sequence[str]) -> ProtoTemplate:
    """Lay out the messages of a topic in a run of these aircraft."""
    data = b""
    offsets: list[int] = []
    formats: list[Any] = []
    number = 1
    for column in topic.columns:
        code, wire_type = _TYPES[column.type]
        numbers = [*range(number, number + len(column.names))]
        if column.per_aircraft:
            numbers = [*aircraft_fields(names).values()]
        tags = [varint(each << 3 | wire_type) for each in numbers]
        assert len({*map(len, tags)}) == 1, f"{column.source}: tags of two lengths"
        fields = b"".join(tag + bytes(np.dtype(code).itemsize) for tag in tags)
        if column.per_aircraft:
            data += varint(number << 3 | _LENGTH) + varint(len(fields))
        offsets.append(len(data))
        field = np.dtype([("tag", f"V{len(tags[0])}"), ("value", code)])
        formats.append((field, (len(tags),)))
        data += fields
        number += len(column.names)
    sources = [column.source for column in topic.columns]
    return ProtoTemplate(topic, data, _dtype(sources, formats, offsets, len(data)))


def _values(records: Records, column: Column) -> NDArray[Any]:
    values: NDArray[Any] = records[column.source]["value"]
    return values


class TransformsTemplate:
    """foxglove.FrameTransforms of one parent frame as a template.

    The message has a constant length because its timestamps are varints of five bytes, padded as
    protobuf allows.
    """

    def __init__(self, parent: str, children: Sequence[str]) -> None:
        self.data = b""
        # runs of children with names of one length: how many, their offset, the values of one
        self._runs: list[tuple[int, int, np.dtype[np.void]]] = []
        for _, run in groupby(children, key=lambda child: len(child.encode())):
            poses = [_transform(parent, child) for child in run]
            self._runs.append((len(poses), len(self.data), _transform_values(poses[0])))
            self.data += b"".join(poses)

    def fill(
        self, messages: Octets, positions: Array, quaternions: Array, time_ns: IntArray
    ) -> None:
        """Write K samples into messages.

        Args:
            messages: (K, bytes), each a copy of the template.
            positions: (K, children, 3) m.
            quaternions: (K, children, 4) x, y, z, w.
            time_ns: (K,)
        """
        seconds, nanos = _stamp_varints(time_ns // _NS), _stamp_varints(time_ns % _NS)
        first = 0
        for count, start, values in self._runs:
            run = messages[:, start : start + count * values.itemsize]
            records = run.reshape(len(messages), count, values.itemsize).view(values)[..., 0]
            records["seconds"], records["nanos"] = seconds, nanos
            records["translation"]["value"] = positions[:, first : first + count]
            records["rotation"]["value"] = quaternions[:, first : first + count]
            first += count


def _transform(parent: str, child: str) -> bytes:
    names = _field(2, parent.encode()) + _field(3, child.encode())
    return _field(1, _field(1, _STAMP) + names + _field(4, _doubles(3)) + _field(5, _doubles(4)))


def _transform_values(transform: bytes) -> np.dtype[np.void]:
    seconds = transform.index(_STAMP) + 1
    rotation = len(transform) - len(_doubles(4))
    values = {
        "seconds": (f"V{_STAMP_BYTES}", seconds),
        "nanos": (f"V{_STAMP_BYTES}", seconds + _STAMP_BYTES + 1),
        "translation": ((_DOUBLE, (3,)), rotation - len(_field(5, b"")) - len(_doubles(3))),
        "rotation": ((_DOUBLE, (4,)), rotation),
    }
    formats, offsets = zip(*values.values(), strict=True)
    return _dtype([*values], formats, offsets, len(transform))


class GnssFixes:
    """foxglove.LocationFix of each aircraft; of varying length, because of the timestamps."""

    def __init__(self, names: Sequence[str]) -> None:
        """Encode the aircraft's names as frame ids."""
        self._frame_ids = [_field(7, name.encode()) for name in names]

    def encode(self, positions: Array, covariances: Array, time_ns: IntArray) -> list[list[bytes]]:
        """Encode R samples of N aircraft, as R lists of N messages.

        Args:
            positions: (R, N, 3) latitude and longitude in deg, altitude in m.
            covariances: (R, N, 3, 3) m², of east, north and up; zero: unknown.
            time_ns: (R,)
        """
        records = np.empty(positions.shape, dtype=_DOUBLE)
        records["tag"] = [number << 3 | _FIXED64 for number in (1, 2, 3)]
        records["value"] = positions
        rows: list[list[bytes]] = records.view(f"V{3 * _DOUBLE.itemsize}")[..., 0].tolist()
        known = np.any(covariances != 0.0, axis=(2, 3))
        return [
            [
                position + (_covariance(matrix) if is_known else b"") + stamp + frame
                for position, matrix, is_known, frame in zip(*of_row, self._frame_ids, strict=True)
            ]
            for *of_row, stamp in zip(
                rows, covariances, known, map(_fix_stamp, time_ns.tolist()), strict=True
            )
        ]


def _covariance(matrix: Array) -> bytes:
    """Encode the covariance (3, 3) of a fix, with its type."""
    data = np.ascontiguousarray(matrix, dtype="<f8").tobytes()
    return _field(4, data) + _integer(5, _APPROXIMATED)


def _fix_stamp(time_ns: int) -> bytes:
    return _field(6, _integer(1, time_ns // _NS) + _integer(2, time_ns % _NS))


@lru_cache(256)
def _integer(number: int, value: int) -> bytes:
    """Encode an integer field; protobuf omits zeros."""
    return varint(number << 3 | _VARINT) + varint(value) if value else b""


def _stamp_varints(values: IntArray) -> NDArray[np.void]:
    """Encode each value (K,) as a varint of five bytes, (K, 1)."""
    shifts = 7 * np.arange(_STAMP_BYTES)
    octets = (values[:, None] >> shifts) & 0x7F
    octets[:, :-1] |= 0x80
    return octets.astype(np.uint8).view(f"V{_STAMP_BYTES}")


def _field(number: int, data: bytes) -> bytes:
    """Encode a field of bytes, text or a message."""
    return varint(number << 3 | _LENGTH) + varint(len(data)) + data


def _doubles(count: int) -> bytes:
    """Encode a message of the doubles 1 to `count`, all zero."""
    return b"".join(bytes([n << 3 | _FIXED64]) + bytes(8) for n in range(1, count + 1))


def _dtype(
    names: Sequence[str], formats: Sequence[Any], offsets: Sequence[int], size: int
) -> np.dtype[np.void]:
    return np.dtype(
        {"names": [*names], "formats": [*formats], "offsets": [*offsets], "itemsize": size}
    )


@lru_cache(1024)
def varint(value: int) -> bytes:
    """Encode a non-negative integer, seven bits to a byte, least significant first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
