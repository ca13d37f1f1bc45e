"""Checksums of many frames of one length at once, of MAVLink 2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class FrameChecksum:
    """The CRC-16/MCRF4XX of frames of a message.

    The checksum is linear: that of a frame is the exclusive or of the contributions of its bytes.
    """

    CONSTANT = True  # for a saved flight

    def __init__(self, length: int, seed: int) -> None:
        """Compute the checksum of a frame of zeros, and the contribution of every byte value.

        Args:
            length: of a frame, bytes.
            seed: CRC_EXTRA of the message.
        """
        zeros, polynomial = 0xFFFF, 0x8408  # initial value; x^16 + x^12 + x^5 + 1, reflected
        table: NDArray[np.uint16] = np.arange(256, dtype=np.uint16)
        for _ in range(8):
            table = np.where(table & 1, (table >> 1) ^ polynomial, table >> 1).astype(np.uint16)
        summed = length - 3  # all but the first byte and the checksum itself
        self._tables = np.empty((summed, 256), np.uint16)
        added = (table >> 8) ^ table[table & 0xFF]  # by the last byte, which the seed follows
        for place in reversed(range(summed)):
            self._tables[place] = added
            added = (added >> 8) ^ table[added & 0xFF]
        for byte in (*bytes(summed), seed):
            zeros = (zeros >> 8) ^ int(table[(zeros ^ byte) & 0xFF])
        self._of_zeros, self._places = zeros, np.arange(summed)

    def of(self, frames: NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Return the checksums (K,) of frames (K, length)."""
        added = self._tables[self._places, frames[:, 1:-2]]
        found: NDArray[np.uint16] = np.bitwise_xor.reduce(added, axis=1) ^ np.uint16(self._of_zeros)
        return found
