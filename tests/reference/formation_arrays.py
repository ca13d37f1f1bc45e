"""Products of vectors on the last axis, fast for a handful of agents."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array


def dot(a: Array, b: Array) -> Array:
    """Inner product over the last axis (..., 3) -> (...,), summed in a fixed order."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def norm(a: Array) -> Array:
    """Euclidean norm over the last axis (..., 3) -> (...,)."""
    return np.sqrt(dot(a, a))


def scale(a: Array, b: Array) -> Array:
    """Vectors b (n, 3) times numbers a (n,)."""
    return np.expand_dims(a, 1) * b


def rotate(matrix: Array, vectors: Array) -> Array:
    """Each matrix (n, 3, 3) on each of its vectors (n, m, 3) -> (n, m, 3)."""
    out = np.empty(vectors.shape)
    for row in range(3):
        out[:, :, row] = (
            np.expand_dims(matrix[:, row, 0], 1) * vectors[:, :, 0]
            + np.expand_dims(matrix[:, row, 1], 1) * vectors[:, :, 1]
            + np.expand_dims(matrix[:, row, 2], 1) * vectors[:, :, 2]
        )
    return out


def cross(a: Array, b: Array) -> Array:
    """A × b of vectors a (n, 3) with each of b (n, m, 3) -> (n, m, 3)."""
    out = np.empty(b.shape)
    x, y, z = np.expand_dims(a[:, 0], 1), np.expand_dims(a[:, 1], 1), np.expand_dims(a[:, 2], 1)
    out[:, :, 0] = y * b[:, :, 2] - z * b[:, :, 1]
    out[:, :, 1] = z * b[:, :, 0] - x * b[:, :, 2]
    out[:, :, 2] = x * b[:, :, 1] - y * b[:, :, 0]
    return out
