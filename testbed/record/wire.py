"""Messages of one topic as bytes, for many frames at once.

In proto3 a field of fixed length is a constant tag and its value, so a message of such fields is
a template with holes (https://protobuf.dev/programming-guides/encoding/). Here the holes are the
fields of a numpy record, one for each column, and numpy fills them for all frames and aircraft.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.record.messages import BOOL, DOUBLE, FIXED32, Column, Topic
from testbed.state import Array

Octets: TypeAlias = NDArray[np.uint8]
Records: TypeAlias = np.ndarray[Any, np.dtype[np.void]]

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5  # wire types; a truth is a varint of one byte
_TYPES = {DOUBLE: ("<f8", _FIXED64), FIXED32: ("<u4", _FIXED32), BOOL: ("?", _VARINT)}


@dataclass(frozen=True, slots=True)
class Layout:
    """The messages of a topic: the bytes that never change and where the values go."""

    topic: Topic
    template: bytes
    holes: np.dtype[np.void]  # by source, at their places in the template

    def fill(self, messages: Octets, columns: Mapping[str, NDArray[Any]]) -> None:
        """Put values into messages (..., agents, bytes) that are the template.

        Args:
            messages: of any frames.
            columns: the values (..., agents) or (..., agents, components) by source.
        """
        records = messages.view(self.holes)[..., 0]
        for column in self.topic.columns:
            hole = _hole(records, column)
            hole[...] = columns[column.source].reshape(hole.shape)

    def decode(self, messages: Sequence[bytes]) -> dict[str, Array]:
        """Values (K, components) by source of K messages.

        Raises:
            ValueError: They are laid out in another way.
        """
        data = b"".join(messages)
        if len(data) != len(messages) * len(self.template):
            raise ValueError("a message has another length than it should")
        records = np.frombuffer(data, dtype=self.holes)
        columns = {c.source: _hole(records, c) for c in self.topic.columns}
        template = np.frombuffer(self.template, dtype=np.uint8)
        again = np.tile(template, (len(messages), 1))
        self.fill(again, columns)
        if again.tobytes() != data:
            raise ValueError("a message is laid out in another way than it should")
        return {source: values.astype(np.float64) for source, values in columns.items()}


def layout(topic: Topic, aircraft: int) -> Layout:
    """The layout of a topic's messages in a run of this many aircraft."""
    template = b""
    offsets: list[int] = []
    kinds: list[Any] = []
    number = 1
    for column in topic.columns:
        code, wire_type = _TYPES[column.type]
        if column.per_aircraft:
            size = aircraft * np.dtype(code).itemsize
            template += varint(number << 3 | _LENGTH) + varint(size)
            offsets.append(len(template))
            kinds.append((code, (aircraft,)))
            template += bytes(size)
        else:
            tags = [varint(n << 3 | wire_type) for n in range(number, number + len(column.names))]
            assert len({*map(len, tags)}) == 1, f"{column.source}: tags of two lengths"
            value = np.dtype([("tag", f"V{len(tags[0])}"), ("value", code)])
            offsets.append(len(template))
            kinds.append((value, (len(tags),)))
            template += b"".join(tag + bytes(np.dtype(code).itemsize) for tag in tags)
        number += len(column.names)
    holes = np.dtype(
        {
            "names": [column.source for column in topic.columns],
            "formats": kinds,
            "offsets": offsets,
            "itemsize": len(template),
        }
    )
    return Layout(topic, template, holes)


def _hole(records: Records, column: Column) -> NDArray[Any]:
    hole = records[column.source]
    return hole if column.per_aircraft else hole["value"]


@lru_cache(1024)
def varint(value: int) -> bytes:
    """A whole number, not negative, seven bits to a byte."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
