"""The air's velocity at places in a field of turbulence: cubic splines through its tables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.air import airframe
from testbed.compiled import ready_of, twin_of
from testbed.state import Array


class Tables(NamedTuple):
    """The periodic boxes of a field, the finest first."""

    # (cells + 1, 3) spline coefficients north, east, down, m/s; the last row is there because the
    # twin reads by fours
    values: NDArray[np.float32]
    first: NDArray[np.int64]  # (boxes,) row of a box's cell 0, 0, 0; its third index runs fastest
    counts: NDArray[np.int64]  # (boxes,) cells along its edge
    axes: Array  # (boxes, 3, 3) NED metres to cells along the box's own axes
    near: int  # so many of them are looked up at every point, the coarser ones at centres only


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
    nodes = (base.astype(np.int64)[..., np.newaxis] + np.arange(-1, 3)) % tables.counts[box]
    row = nodes[..., 0, :, np.newaxis] * tables.counts[box] + nodes[..., 1, np.newaxis, :]
    row = row[..., np.newaxis] * tables.counts[box] + nodes[..., 2, np.newaxis, np.newaxis, :]
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


def felt_in_field(
    tables: Tables, position: Array, euler: Array, body: Array, carried: Array, mean: Array
) -> tuple[Array, Array]:
    """Wind (N, 3) NED and turn (N, 3) of the field's air, as `airframe.felt` takes them.

    Args:
        tables: of the field.
        position: (N, 3) m of airframes, NED.
        euler: (N, 3) rad, their attitudes.
        body: (N, 5, 3) m, their points.
        carried: (3,) m, how far the mean wind has carried the field.
        mean: (N, 3) m/s, the mean wind there.
    """
    in_air = position - carried
    points = airframe.place(in_air, euler, body)
    wind, rates = airframe.felt(sample(tables, in_air, points), euler, body)
    return wind + mean, rates


def write_felt_in_field(
    tables: Tables,
    position: Array,
    euler: Array,
    body: Array,
    carried: Array,
    mean: Array,
    wind: Array,
    rates: Array,
) -> None:
    """As `felt_in_field`, into arrays that are there."""
    wind[:], rates[:] = felt_in_field(tables, position, euler, body, carried, mean)


FIELD = twin_of(sample, "testbed.air.field_twin")
READY_FELT_IN_FIELD = ready_of(write_felt_in_field, "testbed.air.field_twin")
