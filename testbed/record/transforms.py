"""Foxglove's messages of every frame as bytes: `/tf` and the fixes.

As objects these messages would cost as much as all others together. foxglove.FrameTransforms from
one parent is of constant length, for its timestamps write their two numbers in five bytes each,
which protobuf allows (https://protobuf.dev/programming-guides/encoding/#varints), so that numpy
can fill it in; a foxglove.LocationFix is so but for its timestamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from testbed.record.chunk import Whole
from testbed.record.wire import Octets, varint
from testbed.state import Array

_NS = 10**9
_VARINT = 5  # bytes, enough for any uint32
_HEAD = bytes([0x08, *bytes(_VARINT), 0x10, *bytes(_VARINT)])  # Timestamp: seconds, nanos
_DOUBLE = np.dtype([("tag", "u1"), ("value", "<f8")])


class Transforms:
    """The layout of a run's `/tf`: a template and where the values of each child stand in it."""

    def __init__(self, parent: str, children: Sequence[str]) -> None:
        """Lay out the poses of these children in one parent."""
        self.template = b""
        # neighbours whose names are of one length: how many, where the first begins, their values
        self._groups: list[tuple[int, int, np.dtype[np.void]]] = []
        for _, neighbours in groupby(children, key=lambda child: len(child.encode())):
            poses = [_pose(parent, child) for child in neighbours]
            self._groups.append((len(poses), len(self.template), _holes(poses[0])))
            self.template += b"".join(poses)

    def fill(self, messages: Octets, positions: Array, quaternions: Array, time_ns: Whole) -> None:
        """Put K frames into messages (K, bytes) that are the template.

        Args:
            messages: one for each frame.
            positions: (K, children, 3) m.
            quaternions: (K, children, 4) x, y, z, w.
            time_ns: (K,)
        """
        seconds, nanos = _varints(time_ns // _NS), _varints(time_ns % _NS)
        first = 0
        for count, start, kind in self._groups:
            group = messages[:, start : start + count * kind.itemsize]
            records = group.reshape(len(messages), count, kind.itemsize).view(kind)[..., 0]
            records["seconds"], records["nanos"] = seconds, nanos
            records["translation"]["value"] = positions[:, first : first + count]
            records["rotation"]["value"] = quaternions[:, first : first + count]
            first += count


def _pose(parent: str, child: str) -> bytes:
    names = _field(2, parent.encode()) + _field(3, child.encode())
    return _field(1, _field(1, _HEAD) + names + _field(4, _doubles(3)) + _field(5, _doubles(4)))


def _holes(pose: bytes) -> np.dtype[np.void]:
    """Where the values are in a pose that has none yet."""
    seconds = pose.index(_HEAD) + 1
    rotation = len(pose) - len(_doubles(4))
    holes = {
        "seconds": (f"V{_VARINT}", seconds),
        "nanos": (f"V{_VARINT}", seconds + _VARINT + 1),
        "translation": ((_DOUBLE, (3,)), rotation - len(_field(5, b"")) - len(_doubles(3))),
        "rotation": ((_DOUBLE, (4,)), rotation),
    }
    formats, offsets = zip(*holes.values(), strict=True)
    return np.dtype(
        {"names": [*holes], "formats": formats, "offsets": offsets, "itemsize": len(pose)}
    )


class Fixes:
    """Where on Earth each aircraft is, as messages."""

    def __init__(self, names: Sequence[str]) -> None:
        """Of aircraft of these names."""
        self._frames = [_field(7, name.encode()) for name in names]

    def encode(self, places: Array, time_ns: Whole) -> list[list[bytes]]:
        """The messages of N aircraft in R frames.

        Args:
            places: (R, N, 3) latitude and longitude in deg, altitude in m.
            time_ns: (R,)
        """
        records = np.empty(places.shape, dtype=_DOUBLE)
        records["tag"] = [number << 3 | 1 for number in (1, 2, 3)]
        records["value"] = places
        found: list[list[bytes]] = records.view(f"V{3 * _DOUBLE.itemsize}")[..., 0].tolist()
        return [
            [place + stamp + frame for place, frame in zip(row, self._frames, strict=True)]
            for row, stamp in zip(found, map(_stamp, time_ns.tolist()), strict=True)
        ]


def _stamp(time_ns: int) -> bytes:
    """The timestamp of a fix, without the numbers that are zero."""
    return _field(6, _number(1, time_ns // _NS) + _number(2, time_ns % _NS))


@lru_cache(256)
def _number(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value) if value else b""


def _varints(values: Whole) -> NDArray[np.void]:
    """Each value (K,) in five bytes of seven bits, (K, 1)."""
    shifts = 7 * np.arange(_VARINT)
    octets = (values[:, None] >> shifts) & 0x7F
    octets[:, :-1] |= 0x80
    return octets.astype(np.uint8).view(f"V{_VARINT}")


def _field(number: int, data: bytes) -> bytes:
    """A field that begins with its length."""
    return varint(number << 3 | 2) + varint(len(data)) + data


def _doubles(count: int) -> bytes:
    """Fields 1 to `count` of a message of doubles, all zero."""
    return b"".join(bytes([number << 3 | 1]) + bytes(8) for number in range(1, count + 1))
