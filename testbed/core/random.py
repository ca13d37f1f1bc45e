"""Named random streams: adding an aircraft does not change the numbers of others."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

BLOCK = 256  # steps whose random numbers are drawn at a time; the numbers do not depend on it

# Random generators, and how many numbers each gives per step.
Streams: TypeAlias = Sequence[tuple[np.random.Generator, int]]


def named_stream(seed: int, name: str) -> np.random.Generator:
    """Make a generator that depends only on seed and name, such as "air/uav2"."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))


class NormalNumbers:
    """K standard normal numbers per step for each of N aircraft.

    Args:
        own: random streams of each aircraft, for the numbers behind the shared ones.
        shared: random streams common to all aircraft, for the first numbers.
    """

    def __init__(self, own: Sequence[Streams], shared: Streams = ()) -> None:
        """See the class."""
        self._own, self._shared = own, shared
        self._blocks: Sequence[NDArray[np.float64]] = ()
        self._next = 0

    def draw(self) -> NDArray[np.float64]:
        """Return the next numbers (N, K)."""
        if self._next == len(self._blocks):
            shared = [each.standard_normal((BLOCK, width)) for each, width in self._shared]
            rows = [
                [*shared, *(each.standard_normal((BLOCK, width)) for each, width in streams)]
                for streams in self._own
            ]
            block = np.stack([np.concatenate(row, axis=1) for row in rows], axis=1)
            self._blocks, self._next = list(block), 0
        self._next += 1
        return self._blocks[self._next - 1]
