"""One field of turbulence for all aircraft: frozen, homogeneous, and the same for everyone.

It is a sum of boxes that repeat in all three directions, each four times as coarse as the one
before. A box carries its own band of wavenumbers, which fades into its neighbours', so that all of
them carry von Kármán's spectrum from metres to kilometres in tens of megabytes. In a box every
wave k is drawn as

    u_i(k) = A_i(k) (k × n(k))_i,   A_i² = E_i(k)/(4πk⁴) times the volume of a wave,

with n complex white noise (J. Mann, Wind field simulation, Probabilistic Engineering Mechanics 13,
1998, for isotropic air). North and east have the E of one σ and length, down that of another: each
component has the one-point and two-point spectra of `testbed.air.coherence`. Where σ and length
are the same for all, the air's velocity has no divergence.

Boxes lie at a slant to the vertical, VERTICAL, and each is turned about it from the one before. A
level flight leaves a box on one side and enters it on the other at a height where it has not been:
within five edges, 512 m in the finest box, no place on its level is nearer in the box than 0.039
edges but those that are near in the air. That is five cells of the finest box and 3.7 of the
others; at three, waves of a box's band are no longer alike. On longer ways a course comes back
to where it was in one box or another, but not in two at once.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from testbed.air.coherence import energy
from testbed.air.field_sample import MORE, Tables
from testbed.errors import InputError
from testbed.state import Array
from testbed.streams import stream

Counts = NDArray[np.int64]

FINEST = 0.8  # m, cell of the finest box: waves of 2 m and longer, whole from 2.9 m on
COARSER = 4  # times the cell of the box before
COUNTS = (128, 96)  # cells along an edge of the finest box and of all others
# Of the largest wavenumber that cells can carry: a band is whole up to the first, gone at the
# second, where a cubic spline puts 4 % of a wave's variance into waves that are not in the band.
WHOLE, GONE = 0.55, 0.8
# In five edges no course comes back in a box to less than 0.039 edges from where it was: in the
# widest box of so many scale lengths along an edge that is 2.5 lengths, where little is alike.
STRAIGHT = 5.0
WIDE = 64.0
LEAST_WIDE = 8.0  # scale lengths along an edge, for the longest waves to be in the box at all
MOST_MISSING = 0.2  # of the variance
# Boxes with cells of so many reaches are looked up at centres only: at the reach, the gradient
# leaves 3 % of the amplitude of their shortest waves behind.
NEAR = 8.0
# The vertical along a box's axes, found by search: no sum of up to seven edges is nearly level.
VERTICAL = np.array([0.03901, 0.20770, 0.97741])
TURN = pi * (3.0 - sqrt(5.0))  # rad about the vertical from box to box: the golden angle
# DFT of the cubic B-spline's autocorrelation at 0, 1, 2, 3 cells
SPLINE = np.array([2416.0, 1191.0, 120.0, 1.0]) / 5040.0


@dataclass(frozen=True, slots=True)
class Field:
    """A field of turbulence, and what it is.

    Attributes:
        tables: what `testbed.air.field_sample.FIELD` looks up.
        sigma: (3,) m/s as asked, north, east and down.
        length: (3,) m as asked.
        variance: (3,) m²/s² of the field, over all fields that seeds can make.
        missing: (3,) share of the variance asked for that it does not have: of waves too short.
        cell: (boxes,) m along a cell.
        edge: (boxes,) m after which a box repeats along its own axes.
        memory: bytes.
    """

    tables: Tables
    sigma: Array
    length: Array
    variance: Array
    missing: Array
    cell: Array
    edge: Array
    memory: int


def make_field(
    seed: int,
    sigma: Array,
    length: Array,
    *,
    finest_m: float = FINEST,
    widest_m: float | None = None,
    path_m: float = 80_000.0,
    reach_m: float = 1.5,
) -> Field:
    """A field of von Kármán turbulence.

    Args:
        seed: of the run; same seed, same field.
        sigma: (3,) m/s of the components north, east and down; the first two alike.
        length: (3,) m, scale lengths as MIL-F-8785C has them; the first two alike.
        finest_m: cell of the finest box. Waves shorter than three cells are missing.
        widest_m: least edge of the widest box; None: as the path and the longest length need.
        path_m: how far a flight goes straight on, in the air; 80 km is an hour at 22 m/s.
        reach_m: how far from their centres airframes feel the air.
    """
    sigma, length = np.asarray(sigma, dtype=np.float64), np.asarray(length, dtype=np.float64)
    _check(sigma, length, finest_m, reach_m)
    widest = _widest(float(length.max()), path_m, widest_m)
    cells, counts = boxes(finest_m, widest)
    axes = np.stack([box_axes(box) / cell for box, cell in enumerate(cells)])
    rows = counts**2 * (counts + MORE)
    values = np.zeros((int(rows.sum()) + 1, 3), dtype=np.float32)
    first = np.concatenate([[0], np.cumsum(rows)[:-1]])

    def fill(box: int) -> Array:
        count = int(counts[box])
        part = values[first[box] : first[box] + rows[box]].reshape(count, count, count + MORE, 3)
        rng = stream(seed, f"air/field/{box}")
        return _fill(part, rng, cells, counts, box, sigma, length)

    with ThreadPoolExecutor() as pool:  # each box has a stream and a part of its own
        variance = sum(pool.map(fill, range(len(cells))), start=np.zeros(3))
    near = int((cells < NEAR * reach_m).sum())
    tables = Tables(values, first, counts, axes, near)
    missing = np.array([missing_share(cells[0], each) for each in length])
    memory = sum(each.nbytes for each in (values, first, counts, axes))
    return Field(tables, sigma, length, variance, missing, cells, cells * counts, memory)


def _check(sigma: Array, length: Array, finest: float, reach: float) -> None:
    """Refuse what no such field can have, and cells too coarse for its waves."""
    if not (sigma.shape == length.shape == (3,) and (sigma >= 0.0).all() and (length > 0.0).all()):
        raise InputError("field: write three sigma of 0 or more and three lengths above 0")
    if sigma[0] != sigma[1] or length[0] != length[1]:
        raise InputError(
            "field: north and east are alike in a field that knows no direction: write the first "
            f"two of sigma alike, not {sigma[0]:g} and {sigma[1]:g}, and of the length, not "
            f"{length[0]:g} and {length[1]:g}"
        )
    if not (finest > 0.0 and reach >= 0.0):
        raise InputError("field: write a finest_m above 0 and a reach_m of 0 or more")
    lost = missing_share(finest, float(length.min()))
    if lost > MOST_MISSING:
        raise InputError(
            f"field: cells of {finest:g} m miss {100.0 * lost:.0f} % of the variance at a scale "
            f"length of {length.min():g} m: write a longer length, or a smaller finest_m"
        )


def _widest(length: float, path: float, asked: float | None) -> float:
    """The least edge, m, of the widest box."""
    if asked is None:
        return max(WIDE * length, path / STRAIGHT)
    least = max(LEAST_WIDE * length, path / STRAIGHT)
    if not asked >= least:
        raise InputError(
            f"field: a box {asked:g} m wide is too small for a scale length of {length:g} m and a "
            f"path of {path:g} m: write a widest_m of at least {least:g}, or none"
        )
    return asked


def boxes(finest: float, widest: float) -> tuple[Array, Counts]:
    """Cells, m, and numbers of cells along an edge (boxes,) of the boxes up to a width."""
    cells, counts = [finest], [COUNTS[0]]
    while cells[-1] * counts[-1] < widest:
        counts.append(COUNTS[1])
        cells.append(cells[-1] * COARSER)
    return np.array(cells), np.array(counts)


def box_axes(box: int) -> Array:
    """The axes (3, 3) of a box, in rows, resolved in NED."""
    down = VERTICAL / np.linalg.norm(VERTICAL)
    east = np.cross(down, [1.0, 0.0, 0.0])
    east /= np.linalg.norm(east)
    level = np.stack([np.cross(east, down), east, down], axis=1)
    angle = box * TURN
    turn = [[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]]
    out: Array = level @ turn
    return out


def band(wavenumber: Array, cells: Array, box: int) -> Array:
    """Share of the energy at wavenumbers, rad/m, that a box carries; all boxes' sum to one."""
    share = _fade(wavenumber * cells[box] / pi)
    if box + 1 < len(cells):
        share = share - _fade(wavenumber * cells[box + 1] / pi)
    return share


def _fade(part: Array) -> Array:
    """1 up to WHOLE, 0 from GONE on, smooth in the logarithm between."""
    with np.errstate(divide="ignore"):  # the wave that is none
        way = (np.log(part) - np.log(WHOLE)) / (np.log(GONE) - np.log(WHOLE))
    out: Array = np.cos(0.5 * pi * np.clip(way, 0.0, 1.0)) ** 2
    return out


def missing_share(finest: float, length: float) -> float:
    """Share of the variance in waves too short for cells of a size, m."""
    wavenumber = np.geomspace(1e-3 / length, 1e5 * max(1.0 / length, 1.0 / finest), 4000)
    density = wavenumber * energy(wavenumber, 1.0, length) / 1.5
    lost = np.trapezoid(density * (1.0 - _fade(wavenumber * finest / pi)), np.log(wavenumber))
    return float(lost)


def waves(cells: Array, counts: Counts, box: int) -> tuple[Counts, Counts]:
    """The waves of a box by their numbers along its edges (3, W), and the squares of these (W,).

    The third number is not negative: a wave stands for its opposite too, but where it is zero.
    """
    most = int(0.5 * GONE * counts[box])
    whole = np.arange(-most, most + 1)
    square = whole[:, np.newaxis, np.newaxis] ** 2 + whole[:, np.newaxis] ** 2 + whole[most:] ** 2
    unit = 2.0 * pi / (cells[box] * counts[box])
    carried = band(unit * np.sqrt(np.arange(square.max() + 1.0)), cells, box) > 0.0
    carried[0] = False  # a mean is the mean wind's
    place = np.nonzero(carried[square])
    return np.stack(place) - np.array([[most], [most], [0]]), square[place]


def strength(cells: Array, counts: Counts, box: int, sigma: Array, length: Array) -> Array:
    """A_i² (3, M) m²/s² by the square of a wave's number: times k² − k_i² its part of σ_i².

    k is in waves along the edge too. It is zero for the wave that is none.
    """
    unit = 2.0 * pi / (cells[box] * counts[box])
    square = np.arange(1.0, 3.0 * (0.5 * counts[box]) ** 2)
    k = unit * np.sqrt(square)
    out = np.zeros((3, len(square) + 1))
    for axis in range(3):
        whole = energy(k, float(sigma[axis]), float(length[axis])) * band(k, cells, box)
        out[axis, 1:] = whole * unit / (4.0 * pi * square**2)
    return out


def _fill(
    values: NDArray[np.float32],
    rng: np.random.Generator,
    cells: Array,
    counts: Counts,
    box: int,
    sigma: Array,
    length: Array,
) -> Array:
    """Draw the waves of a box into its table (cells, cells, cells + MORE, 3).

    Returns their variances (3,).
    """
    from scipy.fft import irfftn  # not every run has a field

    count = int(counts[box])
    number, square = waves(cells, counts, box)
    power = strength(cells, counts, box, sigma, length)
    k = (box_axes(box).T @ number).astype(np.float32)
    # Where the third number is zero a wave and its opposite are both drawn, and the transform
    # takes the real part of their sum.
    stands_for = np.where(number[2] > 0, np.float32(2.0), np.float32(1.0))
    angle = 2.0 * pi / count * np.arange(count)[:, np.newaxis] * np.arange(4)
    smear = (np.cos(angle) @ (SPLINE * [1.0, 2.0, 2.0, 2.0])) ** -0.5
    x, y, z = number
    level = (smear[x] * smear[y] * smear[z] * stands_for**-0.5).astype(np.float32)
    noise = rng.standard_normal((3, len(square), 2), dtype=np.float32).view(np.complex64)[..., 0]
    spectrum = np.zeros((count, count, count // 2 + 1), dtype=np.complex64)
    variance = np.empty(3)
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        root = np.sqrt(power[axis]).astype(np.float32)[square]
        drawn = k[after] * noise[last] - k[last] * noise[after]
        spectrum[x, y, z] = root * level * drawn
        values[:, :, :count, axis] = irfftn(spectrum, s=(count, count, count), norm="forward")
        variance[axis] = (stands_for * root**2 * (k[after] ** 2 + k[last] ** 2)).sum(dtype=float)
    values[:, :, count:] = values[:, :, :MORE]
    return variance
