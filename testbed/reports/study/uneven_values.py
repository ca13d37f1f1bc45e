"""Means of a study whose points have different numbers of seeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array


class UnevenValues:
    """Values of points with different numbers of units, such as seeds, where a mean needs care.

    Later units have values of some points only. The value of a unit is the mean of its differences
    from the means of their points, plus the mean of the points' means.
    """

    def __init__(self, values: Array, unit: NDArray[np.int64], point: NDArray[np.int64]) -> None:
        """Take values (n,), each of a unit and a point."""
        _, units = np.unique(unit, return_inverse=True)
        _, points = np.unique(point, return_inverse=True)
        shape = units.max() + 1, points.max() + 1
        self._sums, self._known = np.zeros(shape), np.zeros(shape)
        np.add.at(self._sums, (units, points), values)
        np.add.at(self._known, (units, points), 1.0)
        self._means = self._sums.sum(axis=0) / self._known.sum(axis=0)

    @property
    def of_units(self) -> Array:
        """Value of each unit (u,)."""
        every = np.arange(self._sums.shape[0])[None, :]
        found: Array = self.resample(every)[0]
        return found

    def resample(self, drawn: NDArray[np.int64]) -> Array:
        """Return the values of drawn units (d, u), with the points' means of each draw."""
        size = self._sums.shape[0]
        counts = np.apply_along_axis(np.bincount, 1, drawn, minlength=size).astype(np.float64)
        known = counts @ self._known
        # a point without any drawn unit has its mean
        means = np.where(known > 0.0, counts @ self._sums / np.maximum(known, 1.0), self._means)
        rest = self._sums.sum(axis=1) - means @ self._known.T  # of all values of a unit (d, u)
        values = means.mean(axis=1)[:, None] + rest / self._known.sum(axis=1)
        found: Array = np.take_along_axis(values, drawn, axis=1)
        return found
