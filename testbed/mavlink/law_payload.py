"""Numbers of a law's own as TUNNEL frames, packed and unpacked in arrays.

https://mavlink.io/en/messages/common.html#TUNNEL. FOLLOW_TARGET has eight bytes of its own, too few
for a vector.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.mavlink.frame_checksum import FrameChecksum

Frames = NDArray[np.uint8]
IntArray = NDArray[np.int64]

NUMBER = 385
SEED = 147  # CRC_EXTRA of the message
MAGIC, AUTOPILOT = 0xFD, 1


class LawPayload:
    """Convert K numbers to frames, and frames to numbers.

    A frame has the numbers with single precision, and behind them one byte with K, which is not
    zero: trailing zeros of a MAVLink frame are cut off, and all frames have one length.

    Attributes:
        length: of a frame, bytes.
    """

    CONSTANT = True  # for a saved flight

    def __init__(self, count: int) -> None:
        """Use frames of this many numbers."""
        self._count = count
        payload = [
            ("payload_type", "<u2"),  # 0: unknown
            ("target", "u1", (2,)),  # system and component; 0: all
            ("payload_length", "u1"),
            ("values", "<f4", (count,)),
            ("count", "u1"),
        ]
        self._frame = np.dtype(
            [
                *(("magic", "u1"), ("length", "u1"), ("flags", "u1", (2,))),
                *(("sequence", "u1"), ("system", "u1"), ("component", "u1")),
                ("number", "u1", (3,)),
                ("payload", payload),
                ("checksum", "<u2"),
            ]
        )
        self.length = self._frame.itemsize
        self._checksum = FrameChecksum(self.length, SEED)

    def pack(self, values: Array, rows: IntArray, numbers: IntArray) -> Frames:
        """Pack numbers (S, K) to frames (S, length).

        Args:
            values: NaN where a sender has none.
            rows: (S,) of the senders; the system id is one more.
            numbers: (S,) of their messages; frames have them modulo 256.
        """
        frames = np.zeros(len(rows), self._frame)
        payload = frames["payload"]
        frames["magic"], frames["length"] = MAGIC, payload.dtype.itemsize
        frames["sequence"], frames["system"] = numbers % 256, rows + 1
        frames["component"] = AUTOPILOT
        frames["number"] = NUMBER & 0xFF, NUMBER >> 8, 0
        payload["payload_length"], payload["count"] = 4 * self._count + 1, self._count
        with np.errstate(over="ignore", invalid="ignore"):  # infinite in single precision
            payload["values"] = values
        raw: Frames = frames.view(np.uint8).reshape(len(rows), self.length)
        frames["checksum"] = self._checksum.of(raw)
        return raw

    def unpack(self, frames: Frames) -> Array:
        """Return the numbers (S, K) of frames (S, length)."""
        received = np.ascontiguousarray(frames).view(self._frame)[:, 0]
        values: Array = received["payload"]["values"].astype(np.float64)
        return values
