"""`/tf` messages as bytes, for many frames at once: foxglove.FrameTransforms from one parent.

As objects these messages would cost as much as all others together. Every length in them is made
constant by writing the two numbers of a timestamp in five bytes each, which protobuf allows
(https://protobuf.dev/programming-guides/encoding/#varints), so that numpy can fill them in.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from testbed.record.wire import varint
from testbed.state import Array

_NS = 10**9
_VARINT = 5  # bytes, enough for any uint32
_HEAD = bytes([0x08, *bytes(_VARINT), 0x10, *bytes(_VARINT)])  # Timestamp: seconds, nanos


class Transforms:
    """The layout of a run's `/tf`: where the values of each child stand in a message."""

    def __init__(self, parent: str, children: Sequence[str]) -> None:
        """Lay out the poses of these children in one parent."""
        template = b""
        self._stamps: list[int] = []  # where each child's timestamp begins
        self._values: list[list[int]] = []  # where each child's seven numbers begin
        for child in children:
            head = _field(1, _HEAD) + _field(2, parent.encode()) + _field(3, child.encode())
            body = head + _field(4, _doubles(3)) + _field(5, _doubles(4))
            whole = _field(1, body)
            start = len(template) + len(whole) - len(body)
            self._stamps.append(start + 2)
            first = start + len(head) + 2
            second = first + len(_doubles(3)) + 2
            self._values.append(
                [first + 1 + 9 * axis for axis in range(3)]
                + [second + 1 + 9 * axis for axis in range(4)]
            )
            template += whole
        self._template = np.frombuffer(template, dtype=np.uint8)

    def encode(self, poses: Array, time_ns: NDArray[np.int64]) -> list[bytes]:
        """The messages of K frames.

        Args:
            poses: (K, children, 7) x, y, z in m and the quaternion x, y, z, w.
            time_ns: (K,)
        """
        records = np.tile(self._template, (len(time_ns), 1))
        octets = np.ascontiguousarray(poses, dtype="<f8").view(np.uint8)
        octets = octets.reshape(*poses.shape, 8)
        seconds, nanos = _varints(time_ns // _NS), _varints(time_ns % _NS)
        for child, (stamp, places) in enumerate(zip(self._stamps, self._values, strict=True)):
            records[:, stamp + 1 : stamp + 1 + _VARINT] = seconds
            records[:, stamp + 2 + _VARINT : stamp + 2 + 2 * _VARINT] = nanos
            for k, place in enumerate(places):
                records[:, place : place + 8] = octets[:, child, k]
        out: list[bytes] = records.view(f"V{len(self._template)}")[:, 0].tolist()
        return out


def _varints(values: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Each value (K,) in five bytes (K, 5) of seven bits."""
    shifts = 7 * np.arange(_VARINT)
    octets = (values[:, None] >> shifts) & 0x7F
    octets[:, :-1] |= 0x80
    return octets.astype(np.uint8)


def _field(number: int, data: bytes) -> bytes:
    """A field that begins with its length."""
    return varint(number << 3 | 2) + varint(len(data)) + data


def _doubles(count: int) -> bytes:
    """Fields 1 to `count` of a message of doubles, all zero."""
    return b"".join(bytes([number << 3 | 1]) + bytes(8) for number in range(1, count + 1))
