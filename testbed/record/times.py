"""Which frames two runs have at the same times."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array

Indices: TypeAlias = NDArray[np.intp]


def shared_frames(first_s: Array, second_s: Array) -> tuple[Indices, Indices]:
    """The frames (K,), in either run, of the times (.,) that both have.

    Nothing is rounded: times are ticks over the rate of ticks, and equal times are equal to the bit
    whatever these rates are.
    """
    found: Any = np.intersect1d(first_s, second_s, return_indices=True)
    return found[1], found[2]
