"""Messages of one topic as bytes, for many frames at once.

In proto3 a field of fixed length is a constant tag and its value, so a message of such fields is
a template with holes (https://protobuf.dev/programming-guides/encoding/). Here the holes are the
fields of a numpy record, and numpy fills them for all frames and aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from testbed.record.messages import BOOL, DOUBLE, FIXED32, Column, Topic
from testbed.state import Array

Records: TypeAlias = np.ndarray[Any, np.dtype[np.void]]

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5  # wire types; a truth is a varint of one byte
_TYPES = {DOUBLE: ("<f8", _FIXED64), FIXED32: ("<u4", _FIXED32), BOOL: ("?", _VARINT)}


@dataclass(frozen=True, slots=True)
class Layout:
    """The messages of a topic: the bytes that never change and where the values go."""

    topic: Topic
    template: bytes
    holes: np.dtype[np.void]  # the values by field name, at their places in the template

    def encode(self, columns: Records) -> list[list[bytes]]:
        """The messages of K frames and their agents.

        Args:
            columns: (K,) whose fields are the values (agents, components) by source.
        """
        records = self._blank(columns[self.topic.columns[0].source].shape[:-1])
        for column in self.topic.columns:
            values = columns[column.source]
            for i, name in enumerate(column.names):
                records[name] = values if column.per_aircraft else values[..., i]
        # whole records without field names, which numpy hands out as bytes
        out: list[list[bytes]] = records.view(f"V{len(self.template)}").tolist()
        return out

    def decode(self, messages: Sequence[bytes]) -> dict[str, Array]:
        """Values (K, components) by source of K messages.

        Raises:
            ValueError: They are laid out in another way.
        """
        data = b"".join(messages)
        if len(data) != len(messages) * len(self.template):
            raise ValueError("a message has another length than it should")
        records = np.frombuffer(data, dtype=self.holes)
        again = self._blank(records.shape)
        for name, _ in self.topic.fields:
            again[name] = records[name]
        if again.tobytes() != data:
            raise ValueError("a message is laid out in another way than it should")
        return {column.source: _values(records, column) for column in self.topic.columns}

    def _blank(self, shape: tuple[int, ...]) -> Records:
        template = np.frombuffer(self.template, dtype=np.uint8)
        records: Records = np.tile(template, (*shape, 1)).view(self.holes)[..., 0]
        return records


def layout(topic: Topic, aircraft: int) -> Layout:
    """The layout of a topic's messages in a run of this many aircraft."""
    template = b""
    offsets: list[int] = []
    kinds: list[np.dtype[Any]] = []
    for number, (_, column) in enumerate(topic.fields, start=1):
        code, wire_type = _TYPES[column.type]
        kind = np.dtype((code, (aircraft,)) if column.per_aircraft else code)
        if column.per_aircraft:
            template += varint(number << 3 | _LENGTH) + varint(kind.itemsize)
        else:
            template += varint(number << 3 | wire_type)
        offsets.append(len(template))
        kinds.append(kind)
        template += bytes(kind.itemsize)
    holes = np.dtype(
        {
            "names": [name for name, _ in topic.fields],
            "formats": kinds,
            "offsets": offsets,
            "itemsize": len(template),
        }
    )
    return Layout(topic, template, holes)


def _values(records: Records, column: Column) -> Array:
    if column.per_aircraft:
        return np.asarray(records[column.names[0]], dtype=np.float64)
    return np.stack([records[name].astype(np.float64) for name in column.names], axis=-1)


def varint(value: int) -> bytes:
    """A whole number, not negative, seven bits to a byte."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
