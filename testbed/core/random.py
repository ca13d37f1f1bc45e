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

    Attributes:
        block: (BLOCK, N, K) numbers of some steps.
        used: (1,) how many of these steps have been taken; BLOCK: `refill` comes first.
    """

    def __init__(self, own: Sequence[Streams], shared: Streams = ()) -> None:
        """See the class; the first numbers are drawn with the first step."""
        self._own, self._shared = own, shared
        [width] = {sum(each for _, each in (*shared, *streams)) for streams in own}
        self.block = np.empty((BLOCK, len(own), width))
        self.used = np.array([BLOCK], dtype=np.int64)

    def refill(self) -> None:
        """Draw the numbers of the next steps."""
        count = len(self.block)
        shared = [each.standard_normal((count, width)) for each, width in self._shared]
        for row, streams in enumerate(self._own):
            own = (each.standard_normal((count, width)) for each, width in streams)
            np.concatenate([*shared, *own], axis=1, out=self.block[:, row])
        self.used[0] = 0

    def draw(self) -> NDArray[np.float64]:
        """Return the next numbers (N, K), which are overwritten when they are all used."""
        if self.used[0] == len(self.block):
            self.refill()
        self.used[0] += 1
        numbers: NDArray[np.float64] = self.block[self.used[0] - 1]
        return numbers


class ZeroNumbers(NormalNumbers):
    """Zeros in place of random numbers, for errors of which none has a standard deviation."""

    def __init__(self, own: Sequence[Streams], shared: Streams = ()) -> None:
        super().__init__(own, shared)
        self.block[...] = 0.0

    def refill(self) -> None:
        """Begin with the first zeros again."""
        self.used[0] = 0
