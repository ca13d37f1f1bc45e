"""Named random streams: adding an aircraft does not change the numbers of others."""

from __future__ import annotations

import hashlib

import numpy as np


def named_stream(seed: int, name: str) -> np.random.Generator:
    """Make a generator that depends only on seed and name, such as "air/uav2"."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "little")))
