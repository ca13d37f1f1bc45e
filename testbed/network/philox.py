"""Dice that are looked up rather than rolled: Philox4x32-10, a counter-based generator.

Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011. Four words
of 32 bits are a function of a key and a counter, so what befalls a packet depends on its link and
its number alone, whatever was drawn before and elsewhere.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]  # of 32 bits each

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
BUMPS = (0x9E3779B9, 0xBB67AE85)  # what the key gains from round to round
LOW = 0xFFFFFFFF
UNIT = 2.0**-32


def key_of(seed: int, name: str) -> tuple[int, int]:
    """The two words of a key that depends on the seed and a name only."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


def philox(
    key0: Any,  # noqa: ANN401 - integers or arrays of them
    key1: Any,  # noqa: ANN401
    counter: Any,  # noqa: ANN401
    copy: Any,  # noqa: ANN401
    block: Any,  # noqa: ANN401
) -> tuple[Words, Words, Words, Words]:
    """Four words for each key and counter (arrays of one shape).

    Args:
        key0: first word of the key.
        key1: second.
        counter: up to 64 bits, the first two words of the counter.
        copy: third word of the counter.
        block: fourth.
    """
    k0, k1, number = (np.asarray(each, dtype=np.uint64) for each in (key0, key1, counter))
    x2, x3 = (np.asarray(each, dtype=np.uint64) for each in (copy, block))
    x0: Words = number & np.uint64(LOW)
    x1: Words = number >> np.uint64(32)
    first, second = (np.uint64(each) for each in MULTIPLIERS)
    bump0, bump1 = (np.uint64(each) for each in BUMPS)
    low, half = np.uint64(LOW), np.uint64(32)
    for _ in range(ROUNDS):
        product0: Words = first * x0
        product1: Words = second * x2
        x0, x1, x2, x3 = (
            (product1 >> half) ^ x1 ^ k0,
            product1 & low,
            (product0 >> half) ^ x3 ^ k1,
            product0 & low,
        )
        k0, k1 = (k0 + bump0) & low, (k1 + bump1) & low
    return x0, x1, x2, x3


def unit(words: Any) -> Any:  # noqa: ANN401 - as above
    """Words as numbers in (0, 1), never an end."""
    return (words + 0.5) * UNIT
