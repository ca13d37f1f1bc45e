"""Covariance of the estimated positions of a run."""

from __future__ import annotations

import numpy as np

from testbed.core.frames import enu_from_ned
from testbed.core.records import Array


class FixCovariance:
    """Average the squared errors of N estimated positions, from the first sample on."""

    def __init__(self, aircraft: int) -> None:
        """Start without samples."""
        self._sums = np.zeros((aircraft, 3, 3))  # m²
        self._count = 0

    def add(self, error_ned: Array) -> Array:
        """Add the next K samples.

        Args:
            error_ned: (K, N, 3) m, of the estimates; not finite in aircraft that have failed.

        Returns:
            (K, N, 3, 3) m², of east, north and up, after each sample.
        """
        enu = np.nan_to_num(enu_from_ned(error_ned), posinf=0.0, neginf=0.0)
        squares = np.concatenate([self._sums[None], enu[..., :, None] * enu[..., None, :]])
        # summed one by one, so that chunks of other lengths give the same bits
        sums = np.cumsum(squares, axis=0)[1:]
        counts = np.arange(self._count + 1, self._count + 1 + len(sums))
        self._sums, self._count = sums[-1], self._count + len(sums)
        out: Array = sums / counts[:, None, None, None]
        return out
