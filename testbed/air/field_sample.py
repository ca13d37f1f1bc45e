"""The air's velocity at places in a field of turbulence: cubic splines through its tables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import twin_of
from testbed.state import Array

NODES = 4  # about a place, along each axis
MORE = NODES - 1  # cells


class Tables(NamedTuple):
    """The periodic boxes of a field, the finest first.

    Along its third axis a box has MORE cells, which are the first ones again: the nodes about a
    place are neighbours in the table.
    """

    # (rows + 1, 3) spline coefficients north, east, down, m/s; the last row is there because the
    # twin reads by fours
    values: NDArray[np.float32]
    first: NDArray[np.int64]  # (boxes,) row of a box's cell 0, 0, 0; its third index runs fastest
    counts: NDArray[np.int64]  # (boxes,) cells along its edge
    axes: Array  # (boxes, 3, 3) NED metres to cells along the box's own axes
    near: int  # so many of them are looked up at every point, the coarser ones at centres only


def no_field() -> Tables:
    """Tables without a box: still air."""
    none = np.zeros(0, dtype=np.int64)
    return Tables(np.zeros((1, 3), dtype=np.float32), none, none, np.zeros((0, 3, 3)), 0)


def sample(tables: Tables, centre: Array, points: Array) -> Array:
    """Velocities (N, K, 3) of the air, m/s NED, at K points of each of N airframes.

    Coarse boxes are looked up at an airframe's centre, with their gradient, and are linear from
    there to its points. Places are in the frame of the air: what carries the air is taken off.

    Args:
        tables: of the field.
        centre: (N, 3) m, NED.
        points: (N, K, 3) m, NED.
    """
    out = np.zeros(points.shape)
    arms = points - centre[:, np.newaxis, :]
    for box, axes in enumerate(tables.axes):
        if box < tables.near:
            out += _look_up(tables, box, points @ axes.T)[..., 0, :]
        else:
            found = _look_up(tables, box, centre @ axes.T)
            out += found[:, np.newaxis, 0, :] + arms @ axes.T @ found[:, 1:, :]
    return out


def _look_up(tables: Tables, box: int, cells: Array) -> Array:
    """Velocity and its derivatives by the three cell coordinates (..., 4, 3) at those (..., 3)."""
    base = np.floor(cells)
    weights, slopes = _spline(cells - base)
    count = tables.counts[box]
    lowest = (base.astype(np.int64)[..., np.newaxis] - 1) % count
    nodes = lowest + np.arange(NODES)
    across = nodes[..., :2, :] % count
    row = across[..., 0, :, np.newaxis] * count + across[..., 1, np.newaxis, :]
    row = row[..., np.newaxis] * (count + MORE) + nodes[..., 2, np.newaxis, np.newaxis, :]
    values = tables.values[tables.first[box] + row].astype(np.float64)
    terms = np.stack([weights, weights, weights, weights], axis=-2)  # (..., axis, term, 4)
    for axis in range(3):
        terms[..., axis, axis + 1, :] = slopes[..., axis, :]
    out: Array = np.einsum(
        "...ti,...tj,...tk,...ijkc->...tc",
        *(terms[..., axis, :, :] for axis in range(3)),
        values,
        optimize=True,
    )
    return out


def _spline(part: Array) -> tuple[Array, Array]:
    """Weights (..., 4) of the four nodes about a place, and their derivatives, at 0..1 (...)."""
    t, u = part, 1.0 - part
    weights = np.stack(
        [u**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * u**2 + 3.0 * u**3, t**3], axis=-1
    )
    slopes = np.stack([-(u**2), 3.0 * t**2 - 4.0 * t, 4.0 * u - 3.0 * u**2, t**2], axis=-1)
    return weights / 6.0, slopes / 2.0


FIELD = twin_of(sample, "testbed.air.field_twin")
