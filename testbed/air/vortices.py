"""The velocity about horseshoe vortices, and the pairs of them that stand for a wing's sheet."""

from __future__ import annotations

import numpy as np

from testbed.state import Array

NEAREST = 1e-18  # m², so that a vortex's own end has a velocity: none


def pairs(count: int) -> tuple[Array, Array]:
    """An elliptic wing's sheet as pairs: places (count,) in half spans and shares of circulation.

    Strips of equal angle θ of y = (b/2) cos θ, each drawn together at its centroid.
    """
    edges = np.linspace(0.0, 0.5 * np.pi, count + 1)
    shares = np.diff(np.sin(edges))
    return np.diff(0.5 * edges + 0.25 * np.sin(2.0 * edges)) / shares, shares


def horseshoe(at: Array, half_span: Array, core: Array) -> Array:
    """Velocity (..., 3) m/s of a horseshoe vortex of unit circulation, forward, right and down.

    Biot and Savart's law for the bound vortex and for the two that trail backwards without end,
    each with Burnham and Hallock's factor r²/(r² + r_c²).

    Args:
        at: (..., 3) m from the middle of the bound vortex, forward, right, down.
        half_span: (...,) m, of the bound vortex.
        core: r_c (...,) m.
    """
    x, y, z = np.moveaxis(at, -1, 0)
    y1, y2 = y - half_span, y + half_span  # from the right tip and from the left
    r1 = np.sqrt(x * x + y1 * y1 + z * z + NEAREST)
    r2 = np.sqrt(x * x + y2 * y2 + z * z + NEAREST)
    square = core * core + z * z
    trail1 = (1.0 - x / r1) / (y1 * y1 + square)
    trail2 = (1.0 - x / r2) / (y2 * y2 + square)
    bound = (y2 / r2 - y1 / r1) / (x * x + square)
    out = np.stack(
        [z * bound, z * (trail1 - trail2), y2 * trail2 - y1 * trail1 - x * bound], axis=-1
    )
    return np.asarray(out / (4.0 * np.pi))
