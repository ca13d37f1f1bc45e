"""The compiled twin of `field_sample`: splines written out per point.

A test holds it to the numpy function. numba compiles each function at its first call. The sums over
nodes are most of what a field costs, so north, east and down are taken at once, as lanes of one
vector: LLVM is told so, for its own search for such lanes is off in numba. A lane rounds as the
same sum does by itself.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import floor

import numpy as np
from llvmlite import ir

from testbed.air.field_sample import MORE, NODES
from testbed.compiled import instructions, twin

LANES = 4  # north, east, down, and one that is nobody's
_SINGLES = ir.VectorType(ir.FloatType(), LANES)
_DOUBLES = ir.VectorType(ir.DoubleType(), LANES)


def _vector(builder, numbers):
    """Four numbers as the lanes of a vector."""
    out = ir.Constant(_DOUBLES, ir.Undefined)
    for lane, number in enumerate(numbers):
        out = builder.insert_element(out, number, ir.Constant(ir.IntType(32), lane))
    return out


def _tuple(context, builder, kind, vector):
    """The lanes of a vector as a tuple."""
    lanes = [ir.Constant(ir.IntType(32), lane) for lane in range(LANES)]
    return context.make_tuple(builder, kind, [builder.extract_element(vector, k) for k in lanes])


@instructions
def _along(typing, values, row, weights):
    """Σ weights × values over the four nodes of a line, which begins at a row, in lanes.

    A row of three is read as four numbers: behind the last one there has to be a number more.
    """

    def generate(context, builder, signature, args):
        values, row, weights = args
        table = context.make_array(signature.args[0])(context, builder, values)
        line = builder.gep(table.data, [builder.mul(row, ir.Constant(row.type, 3))])
        total = None
        for node in range(NODES):
            place = builder.gep(line, [ir.Constant(row.type, 3 * node)])
            place = builder.bitcast(place, _SINGLES.as_pointer())
            weight = _vector(builder, [builder.extract_value(weights, node)] * LANES)
            term = builder.fmul(weight, builder.fpext(builder.load(place, align=4), _DOUBLES))
            total = term if total is None else builder.fadd(total, term)
        return _tuple(context, builder, signature.return_type, total)

    return weights(values, row, weights), generate


@instructions
def _plus(typing, total, weight, numbers):
    """Total + weight × numbers, in lanes."""

    def generate(context, builder, signature, args):
        total, weight, numbers = args
        total, numbers = (
            _vector(builder, [builder.extract_value(each, lane) for lane in range(LANES)])
            for each in (total, numbers)
        )
        total = builder.fadd(total, builder.fmul(_vector(builder, [weight] * LANES), numbers))
        return _tuple(context, builder, signature.return_type, total)

    return total(total, weight, numbers), generate


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
def _nodes(lowest, count, apart):
    """Rows of the four nodes about a place along an axis, which are so many rows apart."""
    a = (lowest - 1) % count
    b = a + 1 if a + 1 < count else 0
    c = b + 1 if b + 1 < count else 0
    d = c + 1 if c + 1 < count else 0
    # unsigned, which no index has to be tested
    return np.uint64(a * apart), np.uint64(b * apart), np.uint64(c * apart), np.uint64(d * apart)


@twin
def _cells(axes, box, north, east, down):
    return (
        axes[box, 0, 0] * north + axes[box, 0, 1] * east + axes[box, 0, 2] * down,
        axes[box, 1, 0] * north + axes[box, 1, 1] * east + axes[box, 1, 2] * down,
        axes[box, 2, 0] * north + axes[box, 2, 1] * east + axes[box, 2, 2] * down,
    )


@twin
def _add_plane(values, row, lines, wx, wy, wz, total):
    """The sum over the 16 nodes of a plane, onto the total."""
    total = _plus(total, wx * wy[0], _along(values, row + lines[0], wz))
    total = _plus(total, wx * wy[1], _along(values, row + lines[1], wz))
    total = _plus(total, wx * wy[2], _along(values, row + lines[2], wz))
    return _plus(total, wx * wy[3], _along(values, row + lines[3], wz))


@twin
def _velocity(values, first, count, cells):
    """The velocity at a place in a box."""
    x, y, z = floor(cells[0]), floor(cells[1]), floor(cells[2])
    wx, wy, wz = _weights(cells[0] - x), _weights(cells[1] - y), _weights(cells[2] - z)
    line = count + MORE
    planes, lines = _nodes(x, count, count * line), _nodes(y, count, line)
    row = np.uint64(first + (z - 1) % count)
    total = (0.0, 0.0, 0.0, 0.0)
    total = _add_plane(values, row + planes[0], lines, wx[0], wy, wz, total)
    total = _add_plane(values, row + planes[1], lines, wx[1], wy, wz, total)
    total = _add_plane(values, row + planes[2], lines, wx[2], wy, wz, total)
    return _add_plane(values, row + planes[3], lines, wx[3], wy, wz, total)


@twin
def _add_line(values, row, wx, sx, wy, sy, wz, sz, totals):
    """The sums over the nodes of a line, onto velocity and derivatives."""
    value, slope = _along(values, row, wz), _along(values, row, sz)
    both, by_x, by_y = wx * wy, sx * wy, wx * sy
    return (
        _plus(totals[0], both, value),
        _plus(totals[1], by_x, value),
        _plus(totals[2], by_y, value),
        _plus(totals[3], both, slope),
    )


@twin
def _velocity_and_slopes(values, first, count, cells):
    """The velocity and its derivatives by the three cell coordinates."""
    x, y, z = floor(cells[0]), floor(cells[1]), floor(cells[2])
    wx, wy, wz = _weights(cells[0] - x), _weights(cells[1] - y), _weights(cells[2] - z)
    sx, sy, sz = _slopes(cells[0] - x), _slopes(cells[1] - y), _slopes(cells[2] - z)
    line = count + MORE
    planes, lines = _nodes(x, count, count * line), _nodes(y, count, line)
    row = np.uint64(first + (z - 1) % count)
    none = (0.0, 0.0, 0.0, 0.0)
    totals = none, none, none, none
    for i in range(NODES):
        at, weight, slope = row + planes[i], wx[i], sx[i]
        totals = _add_line(values, at + lines[0], weight, slope, wy[0], sy[0], wz, sz, totals)
        totals = _add_line(values, at + lines[1], weight, slope, wy[1], sy[1], wz, sz, totals)
        totals = _add_line(values, at + lines[2], weight, slope, wy[2], sy[2], wz, sz, totals)
        totals = _add_line(values, at + lines[3], weight, slope, wy[3], sy[3], wz, sz, totals)
    return totals


def sample(tables, centre, points):
    out = np.empty(points.shape)
    write_sample(*tables, centre, points, out)
    return out


@twin
def write_sample(values, first, counts, axes, near, centre, points, out):
    for n in range(points.shape[0]):
        north, east, down = centre[n, 0], centre[n, 1], centre[n, 2]
        for k in range(points.shape[1]):
            out[n, k, 0] = out[n, k, 1] = out[n, k, 2] = 0.0
            for box in range(near):
                cells = _cells(axes, box, points[n, k, 0], points[n, k, 1], points[n, k, 2])
                u, v, w, _ = _velocity(values, first[box], counts[box], cells)
                out[n, k, 0] += u
                out[n, k, 1] += v
                out[n, k, 2] += w
        for box in range(near, len(first)):
            cells = _cells(axes, box, north, east, down)
            there, by_x, by_y, by_z = _velocity_and_slopes(values, first[box], counts[box], cells)
            for k in range(points.shape[1]):
                x, y, z = points[n, k, 0] - north, points[n, k, 1] - east, points[n, k, 2] - down
                x, y, z = _cells(axes, box, x, y, z)
                for c in range(3):
                    out[n, k, c] += there[c] + x * by_x[c] + y * by_y[c] + z * by_z[c]
