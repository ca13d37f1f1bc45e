"""Counter-based random numbers: Philox4x32-10.

J. K. Salmon, M. A. Moraes, R. O. Dror and D. E. Shaw, "Parallel random numbers: as easy as 1, 2,
3", SC 2011. Four words of 32 bits are a function of a key and a counter. So the outcome of a packet
depends on the seed, the link and the packet's sequence number only.
"""

from __future__ import annotations

import hashlib
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import jitable

Words = NDArray[np.uint64]  # of 32 bits each
Word: TypeAlias = Any  # one of them, uint64

ROUNDS = 10
UNIT = 2.0**-32
LOW, HALF, ONE = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(1)
MULTIPLIER_0, MULTIPLIER_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
WEYL_0, WEYL_1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)  # added to the key each round


def key_of(seed: int, name: str) -> tuple[int, int]:
    """Return the two words of the key of a seed and a name."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


@jitable
def philox(key0: Any, key1: Any, counter: Any, copy: Any, block: Any) -> Any:  # noqa: ANN401
    """Return four random words for a key and a counter.

    In Python also for arrays of them.

    No product or sum exceeds 64 bits.

    Args:
        key0: first word of the key, uint64.
        key1: second word.
        counter: first two words of the counter, up to 64 bits.
        copy: third word.
        block: fourth word.
    """
    k0, k1, number = np.uint64(key0), np.uint64(key1), np.uint64(counter)
    x0, x1, x2, x3 = number & LOW, number >> HALF, np.uint64(copy), np.uint64(block)
    for _ in range(ROUNDS):
        p0, p1 = MULTIPLIER_0 * x0, MULTIPLIER_1 * x2
        x0, x1, x2, x3 = (p1 >> HALF) ^ x1 ^ k0, p1 & LOW, (p0 >> HALF) ^ x3 ^ k1, p0 & LOW
        k0, k1 = (k0 + WEYL_0) & LOW, (k1 + WEYL_1) & LOW
    return x0, x1, x2, x3


@jitable
def unit(word: Any) -> Any:  # noqa: ANN401
    """Return a word as a number in (0, 1), never 0 or 1.

    In Python also arrays of words.
    """
    return (word + 0.5) * UNIT
