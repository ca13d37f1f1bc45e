"""The standard normal distribution; scipy, which computes it, is slow to import."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array


def probability(z: Array) -> Array:
    """Return Φ(z), the share of a standard normal below z (…)."""
    from scipy.special import ndtr

    below: Array = ndtr(z)
    return below


def quantile(share: NDArray[np.floating[Any]]) -> Array:
    """Return the z (…) that has this share 0..1 of a standard normal below it."""
    from scipy.special import ndtri

    z: Array = ndtri(share)
    return z
