"""A turbulence field that all aircraft share: frozen and homogeneous, of von Kármán's spectrum.

The field is a sum of levels: grids that repeat in all three directions, each four times as coarse
as the one before. A level carries its own band of wavenumbers, which fades into its neighbours', so
that all of them together carry the spectrum from metres to kilometres in tens of megabytes. In a
level every wave k is drawn as

    u_i(k) = A_i(k) (k × n(k))_i,   A_i² = E_i(k)/(4πk⁴) times the volume of a wave,

with n complex white noise (J. Mann, Wind field simulation, Probabilistic Engineering Mechanics 13,
1998, for isotropic air). North and east have the E of one σ and length, down that of another: each
component has the one-point and two-point spectra of `atmosphere.spectra`. Where σ and length are
the same for all components, the velocity of the air has no divergence.

Grids are inclined to the vertical, VERTICAL, and each is turned about it from the one before. A
level flight leaves a grid on one side and enters it on the other at a height where it has not been:
within five edges, 512 m in the finest grid, no point on its altitude is nearer in the grid than
0.039 edges but those that are near in the air. That is five cells of the finest grid and 3.7 of
the others; at three, waves of a level's band are uncorrelated. On longer straight flights a course
comes back to where it was in one grid or another, but not in two at once.

Between the nodes a grid is interpolated by cubic B-splines.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import cos, floor, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.atmosphere.spectra import energy
from testbed.core.compile import kernel
from testbed.core.errors import InputError
from testbed.core.random import named_stream
from testbed.core.records import Array, Record, Records, Values, Vector, allocate

IntArray = NDArray[np.int64]
Coefficients = NDArray[np.float32]

FINEST = 0.8  # m, cell of the finest grid: waves of 2 m and longer, whole from 2.9 m on
RATIO = 4  # of the cells of a grid and the one before
COUNTS = (128, 96)  # cells along an edge of the finest grid and of all others
# As parts of the largest wavenumber that cells can carry: a band is whole up to the first and zero
# from the second on, where a cubic spline puts 4 % of a wave's variance outside the band.
BAND_WHOLE, BAND_END = 0.55, 0.8
# In five edges no course comes back in a grid to less than 0.039 edges from where it was: in the
# widest grid of so many scale lengths along an edge that is 2.5 lengths, where correlation is low.
STRAIGHT = 5.0
WIDEST = 64.0
LEAST_WIDEST = 8.0  # scale lengths along an edge, for the longest waves to be in the grid at all
MAX_UNRESOLVED = 0.2  # of the variance
# Grids with cells of so many reaches are sampled at airframes' centres only: at the reach, the
# gradient misses 3 % of the amplitude of their shortest waves.
NEAR = 8.0
# The vertical along a grid's axes, found by search: no sum of up to seven edges is nearly level.
VERTICAL = np.array([0.03901, 0.20770, 0.97741])
GOLDEN_ANGLE = pi * (3.0 - sqrt(5.0))  # rad about the vertical from grid to grid
# DFT of the cubic B-spline's autocorrelation at 0, 1, 2, 3 cells
SPLINE = np.array([2416.0, 1191.0, 120.0, 1.0]) / 5040.0
NODES = 4  # of a spline about a point, along each axis
# cells, the first ones again behind the last along a grid's third axis: the nodes about a point are
# neighbours in memory
OVERLAP = NODES - 1

# One level of a field.
GRID_LEVEL = np.dtype(
    [
        ("first", "i8"),  # row of `FieldGrid.values` of cell 0, 0, 0; the third index is fastest
        ("count", "i8"),  # cells along the edge
        ("axes", "f8", (3, 3)),  # NED metres to cells along the grid's own axes
        ("at_points", "?"),  # sampled at every point of an airframe; else at its centre only
    ],
    align=True,
)


class FieldGrid(NamedTuple):
    """The grids of a field, the finest first."""

    values: Coefficients  # (rows, 3) spline coefficients north, east, down, m/s
    levels: Records  # (L,) of GRID_LEVEL


@dataclass(frozen=True, slots=True)
class TurbulenceField:
    """A turbulence field and its statistics.

    Attributes:
        grid: the spline coefficients.
        sigma: (3,) m/s as specified, north, east and down.
        length: (3,) m as specified.
        variance: (3,) m²/s², over all fields that seeds can make.
        unresolved: (3,) part of the specified variance that is missing, in waves too short.
        cell: (L,) m along a cell.
        edge: (L,) m after which a grid repeats along its own axes.
        memory: bytes.
    """

    grid: FieldGrid
    sigma: Array
    length: Array
    variance: Array
    unresolved: Array
    cell: Array
    edge: Array
    memory: int


def empty_grid() -> FieldGrid:
    """Return a grid without levels: no turbulence."""
    return FieldGrid(np.zeros((0, 3), dtype=np.float32), allocate(GRID_LEVEL, 0))


def make_field(
    seed: int,
    sigma: Array,
    length: Array,
    *,
    finest_m: float = FINEST,
    widest_m: float | None = None,
    path_m: float = 80_000.0,
    reach_m: float = 1.5,
) -> TurbulenceField:
    """Make a field of von Kármán turbulence.

    Args:
        seed: of the run; same seed, same field.
        sigma: (3,) m/s of the components north, east and down; the first two equal.
        length: (3,) m, scale lengths as MIL-F-8785C has them; the first two equal.
        finest_m: cell of the finest grid. Waves shorter than three cells are missing.
        widest_m: least edge of the widest grid; None: as path and longest length need.
        path_m: how far a flight goes straight on, in the air; 80 km is an hour at 22 m/s.
        reach_m: largest distance of an airframe's sample points from its centre.

    Raises:
        InputError: a field cannot have these statistics, or the cells are too coarse for them.
    """
    sigma, length = np.asarray(sigma, dtype=np.float64), np.asarray(length, dtype=np.float64)
    _check(sigma, length, finest_m, reach_m)
    widest = _least_edge(float(length.max()), path_m, widest_m)
    cells, counts = grid_levels(finest_m, widest)
    rows = counts**2 * (counts + OVERLAP)
    values = np.zeros((int(rows.sum()), 3), dtype=np.float32)
    levels = allocate(GRID_LEVEL, len(cells))
    levels["first"] = first = np.concatenate([[0], np.cumsum(rows)[:-1]])
    levels["count"], levels["at_points"] = counts, cells < NEAR * reach_m
    levels["axes"] = [grid_axes(level) / cell for level, cell in enumerate(cells)]

    def fill(level: int) -> Array:
        count = int(counts[level])
        part = values[first[level] : first[level] + rows[level]]
        part = part.reshape(count, count, count + OVERLAP, 3)
        rng = named_stream(seed, f"air/field/{level}")
        return _draw_level(part, rng, cells, counts, level, sigma, length)

    with ThreadPoolExecutor() as pool:  # each level has a random stream and an array of its own
        variance = sum(pool.map(fill, range(len(cells))), start=np.zeros(3))
    unresolved = np.array([unresolved_variance(cells[0], each) for each in length])
    grid, edges = FieldGrid(values, levels), cells * counts
    memory = values.nbytes + levels.nbytes
    return TurbulenceField(grid, sigma, length, variance, unresolved, cells, edges, memory)


def _check(sigma: Array, length: Array, finest: float, reach: float) -> None:
    """Check that the field exists and its cells resolve its waves."""
    if not (sigma.shape == length.shape == (3,) and (sigma >= 0.0).all() and (length > 0.0).all()):
        raise InputError("field: write three sigma of 0 or more and three lengths above 0")
    if sigma[0] != sigma[1] or length[0] != length[1]:
        raise InputError(
            "field: north and east have the same statistics in a field without a direction: write "
            f"the first two of sigma equal, not {sigma[0]:g} and {sigma[1]:g}, and of the length, "
            f"not {length[0]:g} and {length[1]:g}"
        )
    if not (finest > 0.0 and reach >= 0.0):
        raise InputError("field: write a finest_m above 0 and a reach_m of 0 or more")
    unresolved = unresolved_variance(finest, float(length.min()))
    if unresolved > MAX_UNRESOLVED:
        raise InputError(
            f"field: cells of {finest:g} m miss {100.0 * unresolved:.0f} % of the variance at a "
            f"scale length of {length.min():g} m: write a longer length, or a smaller finest_m"
        )


def _least_edge(length: float, path: float, requested: float | None) -> float:
    """Return the least edge, m, of the widest grid."""
    if requested is None:
        return max(WIDEST * length, path / STRAIGHT)
    least = max(LEAST_WIDEST * length, path / STRAIGHT)
    if not requested >= least:
        raise InputError(
            f"field: a grid {requested:g} m wide is too small for a scale length of {length:g} m "
            f"and a path of {path:g} m: write a widest_m of at least {least:g}, or none"
        )
    return requested


def grid_levels(finest: float, widest: float) -> tuple[Array, IntArray]:
    """Return cell sizes, m, and cells per edge (L,) of the grids."""
    cells, counts = [finest], [COUNTS[0]]
    while cells[-1] * counts[-1] < widest:
        counts.append(COUNTS[1])
        cells.append(cells[-1] * RATIO)
    return np.array(cells), np.array(counts)


def grid_axes(level: int) -> Array:
    """Return the axes (3, 3) of a level's grid, in rows, resolved in NED."""
    down = VERTICAL / np.linalg.norm(VERTICAL)
    east = np.cross(down, [1.0, 0.0, 0.0])
    east /= np.linalg.norm(east)
    horizontal = np.stack([np.cross(east, down), east, down], axis=1)
    angle = level * GOLDEN_ANGLE
    turn = [[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]]
    out: Array = horizontal @ turn
    return out


def level_energy(wavenumber: Array, cells: Array, level: int) -> Array:
    """Return the part of the energy at wavenumbers, rad/m, in a level.

    The parts of all levels add up to one.
    """
    part = _fade(wavenumber * cells[level] / pi)
    if level + 1 < len(cells):
        part = part - _fade(wavenumber * cells[level + 1] / pi)
    return part


def _fade(part: Array) -> Array:
    """Return 1 up to BAND_WHOLE, 0 from BAND_END on, smooth in the logarithm between."""
    with np.errstate(divide="ignore"):  # of wavenumber zero
        way = (np.log(part) - np.log(BAND_WHOLE)) / (np.log(BAND_END) - np.log(BAND_WHOLE))
    out: Array = np.cos(0.5 * pi * np.clip(way, 0.0, 1.0)) ** 2
    return out


def unresolved_variance(finest: float, length: float) -> float:
    """Return the variance share of waves too short for a cell size, m."""
    wavenumber = np.geomspace(1e-3 / length, 1e5 * max(1.0 / length, 1.0 / finest), 4000)
    density = wavenumber * energy(wavenumber, 1.0, length) / 1.5
    lost = np.trapezoid(density * (1.0 - _fade(wavenumber * finest / pi)), np.log(wavenumber))
    return float(lost)


def wavenumbers(cells: Array, counts: IntArray, level: int) -> tuple[IntArray, IntArray]:
    """Return the waves (3, W) of a level and their squares (W,).

    Waves are given by their numbers along the edges. The third number is not negative: a wave
    stands for its opposite too, except where it is zero.
    """
    most = int(0.5 * BAND_END * counts[level])
    whole = np.arange(-most, most + 1)
    square = whole[:, np.newaxis, np.newaxis] ** 2 + whole[:, np.newaxis] ** 2 + whole[most:] ** 2
    unit = 2.0 * pi / (cells[level] * counts[level])
    carried = level_energy(unit * np.sqrt(np.arange(square.max() + 1.0)), cells, level) > 0.0
    carried[0] = False  # the mean belongs to the mean wind
    index = np.nonzero(carried[square])
    return np.stack(index) - np.array([[most], [most], [0]]), square[index]


def mode_power(cells: Array, counts: IntArray, level: int, sigma: Array, length: Array) -> Array:
    """Return A_i² (3, M), m²/s², by the square of a wave's number.

    Times k² − k_i² it is the wave's part of σ_i².

    k is in waves along the edge too. It is zero for the wavenumber zero.
    """
    unit = 2.0 * pi / (cells[level] * counts[level])
    square = np.arange(1.0, 3.0 * (0.5 * counts[level]) ** 2)
    k = unit * np.sqrt(square)
    out = np.zeros((3, len(square) + 1))
    for axis in range(3):
        whole = energy(k, float(sigma[axis]), float(length[axis])) * level_energy(k, cells, level)
        out[axis, 1:] = whole * unit / (4.0 * pi * square**2)
    return out


def _draw_level(
    values: Coefficients,
    rng: np.random.Generator,
    cells: Array,
    counts: IntArray,
    level: int,
    sigma: Array,
    length: Array,
) -> Array:
    """Draw the waves of a level into its grid (cells, cells, cells + OVERLAP, 3).

    Returns their variances (3,).
    """
    from scipy.fft import irfftn  # not every run has a field

    count = int(counts[level])
    number, square = wavenumbers(cells, counts, level)
    power = mode_power(cells, counts, level, sigma, length)
    k = (grid_axes(level).T @ number).astype(np.float32)
    # Where the third number is zero a wave and its opposite are both drawn, and the transform
    # takes the real part of their sum.
    stands_for = np.where(number[2] > 0, np.float32(2.0), np.float32(1.0))
    angle = 2.0 * pi / count * np.arange(count)[:, np.newaxis] * np.arange(4)
    smear = (np.cos(angle) @ (SPLINE * [1.0, 2.0, 2.0, 2.0])) ** -0.5
    x, y, z = number
    scale = (smear[x] * smear[y] * smear[z] * stands_for**-0.5).astype(np.float32)
    noise = rng.standard_normal((3, len(square), 2), dtype=np.float32).view(np.complex64)[..., 0]
    spectrum = np.zeros((count, count, count // 2 + 1), dtype=np.complex64)
    variance = np.empty(3)
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        root = np.sqrt(power[axis]).astype(np.float32)[square]
        drawn = k[after] * noise[last] - k[last] * noise[after]
        spectrum[x, y, z] = root * scale * drawn
        values[:, :, :count, axis] = irfftn(spectrum, s=(count, count, count), norm="forward")
        variance[axis] = (stands_for * root**2 * (k[after] ** 2 + k[last] ** 2)).sum(dtype=float)
    values[:, :, count:] = values[:, :, :OVERLAP]
    return variance


@kernel
def sample_field(
    values: Coefficients, levels: Records, centre: Vector, points: Array, air: Array
) -> None:
    """Sample a field at the points of one airframe.

    Coarse levels are sampled at the centre, with their gradient, and are linear from there to the
    points. Positions are in the frame of the air: without the displacement of the mean wind.

    Args:
        values: of `FieldGrid`.
        levels: (L,) of GRID_LEVEL.
        centre: (3,) m NED.
        points: (K, 3) m NED.
        air: (K, 3) m/s NED; written.
    """
    for k in range(len(points)):
        air[k, 0] = air[k, 1] = air[k, 2] = 0.0
    for level in levels:
        if level.at_points:
            for k in range(len(points)):
                cells = _to_cells(level.axes, points[k, 0], points[k, 1], points[k, 2])
                u, v, w = _velocity(values, level, cells)
                air[k, 0] += u
                air[k, 1] += v
                air[k, 2] += w
            continue
        cells = _to_cells(level.axes, centre[0], centre[1], centre[2])
        there, by_x, by_y, by_z = _velocity_and_gradient(values, level, cells)
        for k in range(len(points)):
            x, y, z = _to_cells(
                level.axes,
                points[k, 0] - centre[0],
                points[k, 1] - centre[1],
                points[k, 2] - centre[2],
            )
            for axis in range(3):
                air[k, axis] += there[axis] + x * by_x[axis] + y * by_y[axis] + z * by_z[axis]


@kernel
def _to_cells(axes: Array, north: float, east: float, down: float) -> Vector:
    """Resolve a vector, m, along a grid's axes, in cells."""
    return (
        axes[0, 0] * north + axes[0, 1] * east + axes[0, 2] * down,
        axes[1, 0] * north + axes[1, 1] * east + axes[1, 2] * down,
        axes[2, 0] * north + axes[2, 1] * east + axes[2, 2] * down,
    )


@kernel
def _velocity(values: Coefficients, level: Record, cells: Vector) -> Vector:
    """Return the velocity at a point of a grid, by its cell coordinates."""
    x, y, z = floor(cells[0]), floor(cells[1]), floor(cells[2])
    wx, wy, wz = _weights(cells[0] - x), _weights(cells[1] - y), _weights(cells[2] - z)
    line = level.count + OVERLAP
    planes, lines = _rows(x, level.count, level.count * line), _rows(y, level.count, line)
    first = np.uint64(level.first + (z - 1) % level.count)
    total = (0.0, 0.0, 0.0)
    for i in range(NODES):
        for j in range(NODES):
            along = _sum_line(values, first + planes[i] + lines[j], wz)
            total = _plus(total, wx[i] * wy[j], along)
    return total


@kernel
def _velocity_and_gradient(values: Coefficients, level: Record, cells: Vector) -> Values:
    """Return velocity and derivatives by the three cell coordinates at a point of a grid."""
    x, y, z = floor(cells[0]), floor(cells[1]), floor(cells[2])
    wx, wy, wz = _weights(cells[0] - x), _weights(cells[1] - y), _weights(cells[2] - z)
    sx, sy, sz = _slopes(cells[0] - x), _slopes(cells[1] - y), _slopes(cells[2] - z)
    line = level.count + OVERLAP
    planes, lines = _rows(x, level.count, level.count * line), _rows(y, level.count, line)
    first = np.uint64(level.first + (z - 1) % level.count)
    total = by_x = by_y = by_z = (0.0, 0.0, 0.0)
    for i in range(NODES):
        for j in range(NODES):
            row = first + planes[i] + lines[j]
            along, slope = _sum_line(values, row, wz), _sum_line(values, row, sz)
            total = _plus(total, wx[i] * wy[j], along)
            by_x = _plus(by_x, sx[i] * wy[j], along)
            by_y = _plus(by_y, wx[i] * sy[j], along)
            by_z = _plus(by_z, wx[i] * wy[j], slope)
    return total, by_x, by_y, by_z


@kernel
def _weights(t: float) -> Values:
    """Return the weights of the four nodes about a point.

    The point is at 0..1 between the middle two.
    """
    u = 1.0 - t
    return (
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    )


@kernel
def _slopes(t: float) -> Values:
    u = 1.0 - t
    return (-u * u / 2.0, (3.0 * t * t - 4.0 * t) / 2.0, (4.0 * u - 3.0 * u * u) / 2.0, t * t / 2.0)


@kernel
def _rows(cell: int, count: int, stride: int) -> Values:
    """Return the rows of the four nodes about a point along an axis."""
    a = (cell - 1) % count
    b = a + 1 if a + 1 < count else 0
    c = b + 1 if b + 1 < count else 0
    d = c + 1 if c + 1 < count else 0
    # unsigned: numba then omits the test for negative indices
    first, second = np.uint64(a * stride), np.uint64(b * stride)
    return first, second, np.uint64(c * stride), np.uint64(d * stride)


@kernel
def _sum_line(values: Coefficients, row: int, weights: Values) -> Vector:
    """Return Σ weights × values over four nodes along the third axis."""
    u = weights[0] * float(values[row, 0])
    v = weights[0] * float(values[row, 1])
    w = weights[0] * float(values[row, 2])
    for k in range(1, NODES):
        node = row + np.uint64(k)
        u += weights[k] * float(values[node, 0])
        v += weights[k] * float(values[node, 1])
        w += weights[k] * float(values[node, 2])
    return u, v, w


@kernel
def _plus(total: Vector, weight: float, velocity: Vector) -> Vector:
    """Return total + weight × velocity."""
    return (
        total[0] + weight * velocity[0],
        total[1] + weight * velocity[1],
        total[2] + weight * velocity[2],
    )
