"""The compiled twin of `field_sample`: splines written out per point.

A test holds it to the numpy function. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import floor

import numpy as np

from testbed.air.airframe_twin import felt, place
from testbed.compiled import twin


@twin
def _weights(t):
    u = 1.0 - t
    return (
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    )


@twin
def _slopes(t):
    u = 1.0 - t
    return (
        -u * u / 2.0,
        (3.0 * t * t - 4.0 * t) / 2.0,
        (4.0 * u - 3.0 * u * u) / 2.0,
        t * t / 2.0,
    )


@twin
def _nodes(base, count):
    """The four nodes about a place, each in the box; unsigned, which no index has to be tested."""
    a = (int(base) - 1) % count
    b = a + 1 if a + 1 < count else 0
    c = b + 1 if b + 1 < count else 0
    d = c + 1 if c + 1 < count else 0
    return np.uint64(a), np.uint64(b), np.uint64(c), np.uint64(d)


@twin
def _cells(axes, north, east, down):
    return (
        axes[0, 0] * north + axes[0, 1] * east + axes[0, 2] * down,
        axes[1, 0] * north + axes[1, 1] * east + axes[1, 2] * down,
        axes[2, 0] * north + axes[2, 1] * east + axes[2, 2] * down,
    )


@twin
def _about(first, count, axes, place):
    """Along each axis of the box: the first row of values, nodes, and how far past the second."""
    x, y, z = _cells(axes, place[0], place[1], place[2])
    fx, fy, fz = floor(x), floor(y), floor(z)
    nodes = _nodes(fx, count), _nodes(fy, count), _nodes(fz, count)
    return nodes, (x - fx, y - fy, z - fz), np.uint64(first), np.uint64(count)


@twin
def _along(values, row, nodes, w):
    """The sum over the four nodes of a line."""
    a, b, c, d = row + nodes[0], row + nodes[1], row + nodes[2], row + nodes[3]
    return (
        w[0] * values[a, 0] + w[1] * values[b, 0] + w[2] * values[c, 0] + w[3] * values[d, 0],
        w[0] * values[a, 1] + w[1] * values[b, 1] + w[2] * values[c, 1] + w[3] * values[d, 1],
        w[0] * values[a, 2] + w[1] * values[b, 2] + w[2] * values[c, 2] + w[3] * values[d, 2],
    )


@twin
def _add_velocity(values, first, count, axes, place, out):
    (ix, iy, iz), (x, y, z), first, count = _about(first, count, axes, place)
    wx, wy, wz = _weights(x), _weights(y), _weights(z)
    north = east = down = 0.0
    for i in range(4):
        for j in range(4):
            u, v, w = _along(values, first + (ix[i] * count + iy[j]) * count, iz, wz)
            weight = wx[i] * wy[j]
            north += weight * u
            east += weight * v
            down += weight * w
    out[0] += north
    out[1] += east
    out[2] += down


@twin
def _velocity_and_slopes(values, first, count, axes, place, out):
    """The velocity and its derivatives by the three cell coordinates into (4, 3)."""
    (ix, iy, iz), (x, y, z), first, count = _about(first, count, axes, place)
    wx, wy, wz = _weights(x), _weights(y), _weights(z)
    sx, sy, sz = _slopes(x), _slopes(y), _slopes(z)
    out[:] = 0.0
    for i in range(4):
        for j in range(4):
            row = first + (ix[i] * count + iy[j]) * count
            value, slope = _along(values, row, iz, wz), _along(values, row, iz, sz)
            both, by_x, by_y = wx[i] * wy[j], sx[i] * wy[j], wx[i] * sy[j]
            for c in range(3):
                out[0, c] += both * value[c]
                out[1, c] += by_x * value[c]
                out[2, c] += by_y * value[c]
                out[3, c] += both * slope[c]


@twin
def sample(tables, centre, points):
    values, near = tables.values, tables.near
    out = np.zeros(points.shape)
    found = np.empty((4, 3))
    for box in range(len(tables.first)):
        first, count, axes = tables.first[box], tables.counts[box], tables.axes[box]
        for n in range(len(points)):
            if box < near:
                for k in range(points.shape[1]):
                    _add_velocity(values, first, count, axes, points[n, k], out[n, k])
                continue
            _velocity_and_slopes(values, first, count, axes, centre[n], found)
            for k in range(points.shape[1]):
                dx, dy, dz = _cells(
                    axes,
                    points[n, k, 0] - centre[n, 0],
                    points[n, k, 1] - centre[n, 1],
                    points[n, k, 2] - centre[n, 2],
                )
                for c in range(3):
                    out[n, k, c] += (
                        found[0, c] + dx * found[1, c] + dy * found[2, c] + dz * found[3, c]
                    )
    return out


@twin
def felt_in_field(tables, position, euler, body, carried, mean):
    in_air = position - carried
    points = place(in_air, euler, body)
    wind, rates = felt(sample(tables, in_air, points), euler, body)
    return wind + mean, rates
