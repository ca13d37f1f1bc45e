"""The shared turbulence field: von Kármán's closed forms, and that it does not repeat.

One field by default; TESTBED_AIR_SAMPLES=60 makes more of them.
"""

import os
from itertools import pairwise

import numpy as np
import pytest
from cases import ALL, some
from places import ROOT
from reference.adapters_atmosphere import sample_field
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.special import gamma, jv, kv
from scipy.stats import binom, chi2, norm

from testbed.atmosphere.spectra import KNEE, cross_spectra, energy
from testbed.atmosphere.turbulence_field import (
    BAND_END,
    FINEST,
    MAX_UNRESOLVED,
    grid_axes,
    level_energy,
    make_field,
    mode_power,
    unresolved_variance,
    wavenumbers,
)
from testbed.core.errors import InputError

SAMPLES = int(os.environ.get("TESTBED_AIR_SAMPLES", "2" if ALL else "1"))
AIR = (ROOT / "docs" / "air.md").read_text(encoding="utf-8")
SIGMA = np.array([1.6, 1.6, 1.2])  # m/s
LENGTH = np.array([263.0, 263.0, 100.0])  # m, of 100 m above the ground
COURSES = np.radians([0.0, 67.0, 203.0])
APART = [0.0, 5.0, 50.0, 500.0]  # m to the right of the first probe
STEPS = 8192  # of 1 m along a track; nothing in the field is shorter than 2 m
BANDS = np.geomspace(4.0, 400.0, 21)  # waves along a track: 2 km to 20 m, two decades
# A Hann window makes neighbouring ordinates of a periodogram of white noise alike by 4/9, the
# next but one by 1/36: so many of them count for one.
ALIKE = 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0)
CHANCE = 1e-4  # of a right field to fail one check


def level(course):
    return np.array([np.cos(course), np.sin(course), 0.0])


@pytest.fixture(scope="module")
def field():
    """The first field of the flights."""
    return make_field(0, SIGMA, LENGTH)


@pytest.fixture(scope="module")
def isotropic():
    """A field of another seed."""
    return make_field(3, np.full(3, 1.5), np.full(3, 150.0), reach_m=0.0)


@pytest.fixture(scope="module")
def flights(field):
    """Windowed transforms (seeds, courses, probes, 3, frequencies) of u, v, w along tracks.

    And the mean squares (seeds, 3) at points all over the widest grid.
    """
    window = np.sqrt(2.0 / 3.0) * (1.0 - np.cos(2.0 * np.pi * np.arange(STEPS) / STEPS))
    found, squares = [], []
    for seed in range(SAMPLES):
        made = make_field(seed, SIGMA, LENGTH) if seed else field
        rng = np.random.default_rng([7, seed])
        far = rng.uniform(0.0, 1e5, (100_000, 3))
        squares.append((sample_field(made.grid, far, far[:, np.newaxis]) ** 2).mean(axis=(0, 1)))
        for course in COURSES:
            along, right = level(course), level(course + np.pi / 2)
            start = rng.uniform(0.0, 1e5, 3) + np.multiply.outer(APART, right)
            at = start[:, np.newaxis] + np.multiply.outer(np.arange(STEPS), along)
            ned = sample_field(made.grid, at.reshape(-1, 3), at.reshape(-1, 1, 3))
            ned = ned.reshape(at.shape)
            uvw = np.stack([ned @ along, ned @ right, ned[..., 2]], axis=1)
            found.append(np.fft.rfft(uvw * window)[..., : int(BANDS[-1])])
    return np.array(found).reshape(SAMPLES, len(COURSES), *found[0].shape), np.array(squares)


def resolved(along, lateral):
    """Cross-spectra (A, 3, F) per rad/m, two-sided, of the waves that the cells can carry."""
    top = BAND_END * np.pi / FINEST
    nodes, weights = np.polynomial.legendre.leggauss(60)
    grid = np.concatenate([np.geomspace(1e-5, 0.1, 60)[:-1], np.arange(0.1, top, 0.1), [top]])
    middle, half = (grid[1:] + grid[:-1]) / 2, (grid[1:] - grid[:-1]) / 2
    k = np.concatenate([(m + h * nodes) for m, h in zip(middle, half, strict=True)])
    measure = np.concatenate([h * weights for h in half])
    even, odd = (jv(order, np.multiply.outer(lateral, k)) for order in (0, 2))
    out = np.empty((len(lateral), 3, len(along)))
    for i, each in enumerate(along):
        whole = np.hypot(each, k)  # k across the flight
        share = level_energy(whole, np.array([FINEST]), 0) * measure * 2.0 * np.pi * k
        shapes = (
            k**2 * even,
            each**2 * even + k**2 * (even + odd) / 2.0,
            each**2 * even + k**2 * (even - odd) / 2.0,
        )
        for axis, shape in enumerate(shapes):
            density = energy(whole, SIGMA[axis], LENGTH[axis]) / (4.0 * np.pi * whole**4)
            out[:, axis, i] = (share * density * shape).sum(axis=-1)
    return out


@pytest.fixture(scope="module")
def expected():
    """Cross-spectra (probes, 3, F) of the first probe with every other, per wave on a track."""
    unit = 2.0 * np.pi / STEPS
    grid = unit * np.geomspace(2.0, BANDS[-1] + 2.0, 40)
    wave = np.arange(1, int(BANDS[-1]) + 1)
    out = []
    for probe in resolved(grid, APART):
        scale = grid ** (5.0 / 3.0)  # without which they have a slope
        forms = CubicSpline(np.log(grid), probe * scale, axis=-1)(np.log(unit * wave[1:]))
        spectra = np.column_stack([probe[:, :1], forms / (unit * wave[1:]) ** (5.0 / 3.0)])
        # the window spreads a spectrum over its neighbours
        spread = spectra.copy()
        spread[:, 1:-1] = (4.0 * spectra[:, 1:-1] + spectra[:, :-2] + spectra[:, 2:]) / 6.0
        out.append(np.concatenate([np.zeros((3, 1)), spread[:, :-1]], axis=1))
    return np.array(out)


def bands():
    return [slice(int(np.ceil(low)), int(np.ceil(high))) for low, high in pairwise(BANDS)]


def test_cells_keep_the_spectra_over_two_decades(expected):
    """All but what waves beyond theirs have in them: 5 % of u at 20 m, and 1.2 % at 50 m."""
    wave = np.arange(4, int(BANDS[-1]))
    closed = cross_spectra(wave / STEPS, 1.0, SIGMA, LENGTH) / (4.0 * np.pi)
    # Of E ~ k^(−5/3) the integral of E/k (1 − k₁²/k²) from K on is 3/5 K^(−5/3) against
    # (3/5 − 3/11) k₁^(−5/3) of the whole; and that of E/k (1 + k₁²/k²) is less than it, by half.
    lost = 11.0 / 6.0 * (2.0 * np.pi * wave / STEPS / (0.65 * np.pi / FINEST)) ** (5.0 / 3.0)
    ratio = expected[0][:, 4:] / closed
    assert (ratio > 1.0 - lost - 0.01).all()
    assert (ratio < 1.01).all()


def enough_inside(inside):
    """As many as 95 % of so many checks can be expected to pass."""
    inside = np.asarray(inside)
    return inside.sum() >= binom.ppf(CHANCE, inside.size, 0.95)


def test_field_spectra_along_three_courses(flights, expected):
    """Each band of waves within the 95 % band of χ² of the closed form, 19 times in 20.

    And every component's over all courses and waves, as large as what it should be on average.
    """
    power = (abs(flights[0][:, :, 0]) ** 2).mean(axis=0) / STEPS  # (courses, 3, waves)
    for course in power:
        inside = []
        for axis, part in np.ndindex(3, len(BANDS) - 1):
            at = bands()[part]
            form = expected[0, axis, at] * 2.0 * np.pi
            freedom = 2.0 * SAMPLES * form.sum() ** 2 / (form**2).sum()
            freedom /= ALIKE if at.stop - at.start > 1 else 1.0
            ratio = course[axis, at].sum() / form.sum()
            low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
            inside.append(low < ratio < high)
        assert enough_inside(inside)
    asked = slice(bands()[0].start, bands()[-1].stop)
    ratio = (power[..., asked] / (2.0 * np.pi * expected[0, :, asked])).mean(axis=(0, 2))
    count = SAMPLES * len(COURSES) * (asked.stop - asked.start) / ALIKE
    assert abs(ratio - 1.0).max() < norm.ppf(1.0 - CHANCE / 6.0) / np.sqrt(count)


def fisher(course, expected, probe):
    """How many standard deviations coherences (3, bands) are from the closed form.

    The cross-spectrum is real, so that a coherence is the correlation of as many pairs of normal
    numbers as there are degrees of freedom: its inverse hyperbolic tangent is nearly normal.
    """
    first, other = course[:, :, 0], course[:, :, probe]
    out = np.empty((3, len(BANDS) - 1))
    for axis, part in np.ndindex(*out.shape):
        at = bands()[part]
        one, two = first[..., axis, at], other[..., axis, at]
        shared = (one * two.conj()).real.sum()
        found = shared / np.sqrt((abs(one) ** 2).sum() * (abs(two) ** 2).sum())
        form = expected[0, axis, at]
        true = expected[probe, axis, at].sum() / form.sum()
        count = 2.0 * one.shape[0] * one.shape[1] * form.sum() ** 2 / (form**2).sum()
        count /= ALIKE if at.stop - at.start > 1 else 1.0
        bias = true / (2.0 * (count - 1.0))
        out[axis, part] = (np.arctanh(found) - np.arctanh(true) - bias) * np.sqrt(count - 3.0)
    return out


@pytest.mark.parametrize("probe", [1, 2, 3], ids=["5 m", "50 m", "500 m"])
def test_field_coherence_of_two_probes(flights, expected, probe):
    """Of u, v and w, over all seeds and courses, against the closed form less what is missing."""
    off = fisher(flights[0], expected, probe)
    assert enough_inside(abs(off) < norm.ppf(0.975))
    assert abs(off).max() < norm.ppf(1.0 - CHANCE / 2.0 / off.size)


def test_field_variance_lacks_only_the_unresolved(field, flights):
    """In fields as large as they are the mean square itself varies: by all waves' squares."""
    lost = []
    for length in LENGTH:

        def density(x, length=length):
            k = np.exp(x)
            return (
                k
                * energy(k, 1.0, length)
                / 1.5
                * level_energy(np.array([k]), np.array([FINEST]), 0)[0]
            )

        carried = quad(density, -15.0, np.log(BAND_END * np.pi / FINEST), limit=400, epsabs=1e-6)[0]
        lost.append(1.0 - carried)
    assert field.unresolved == pytest.approx(lost, abs=1e-4)
    assert (field.unresolved < 0.03).all()
    # the lattice of waves stands for the integral
    assert field.variance == pytest.approx(SIGMA**2 * (1.0 - field.unresolved), rel=2e-3)
    spread = 2.0 * field.variance**2 / 100_000  # of so many places
    for _, power, waves in modes(field):
        spread += 2.0 * (power**2 / waves).sum(axis=1)
    off = (flights[1].mean(axis=0) - field.variance) / np.sqrt(spread / SAMPLES)
    assert abs(off).max() < norm.ppf(1.0 - CHANCE / 6.0)


def modes(field):
    """Wavenumbers (W, 3) NED, variances (3, W) and waves per mode (W,), of every level."""
    counts = field.grid.levels["count"]
    for level, edge in enumerate(field.edge):
        number, square = wavenumbers(field.cell, counts, level)
        each = mode_power(field.cell, counts, level, SIGMA, LENGTH)[:, square]
        k = grid_axes(level).T @ number
        waves = np.where(number[2] > 0, 2.0, 1.0)
        yield 2.0 * np.pi / edge * k.T, each * ((k**2).sum(axis=0) - k**2) * waves, waves


def covariance(distance, length):
    """f and g of von Kármán's field."""
    x = distance / (KNEE * length)
    root = 2.0 ** (2.0 / 3.0) / gamma(1.0 / 3.0) * np.cbrt(x)
    return root * kv(1.0 / 3.0, x), root * (kv(1.0 / 3.0, x) - 0.5 * x * kv(2.0 / 3.0, x))


@pytest.mark.parametrize("distance", [5.0, 50.0, 500.0])
def test_field_covariance_has_no_images(field, distance):
    """All fields' covariance of two places, on 36 courses: the closed form's, and no image's."""
    courses = np.array(some(np.arange(0.0, np.pi, np.pi / 36) + 0.01, 12))
    apart = distance * np.array([level(course) for course in courses])
    found = np.zeros((3, len(courses)))
    for k, power, _ in modes(field):
        found += power.astype(np.float32) @ np.cos((k @ apart.T).astype(np.float32))
    along, across = covariance(distance, LENGTH[:, np.newaxis])
    closed = across + (along - across) * (apart.T / distance) ** 2
    # what is missing has its own correlation at 5 m, which at 0 m is 3 %
    assert found / SIGMA[:, np.newaxis] ** 2 == pytest.approx(closed, abs=0.015)


def test_grid_images_lie_three_cells_off(field):
    """So that two aircraft up to 512 m apart on one level never meet the same turbulence."""
    edges = np.stack(np.meshgrid(*[np.arange(-6, 7)] * 3), axis=-1).reshape(-1, 3)
    edges = edges[edges.any(axis=1)]
    assert 5.0 * field.edge[0] > APART[-1]
    for level, count in enumerate(field.grid.levels["count"]):
        images = edges @ grid_axes(level)
        near_level = np.hypot(images[:, 0], images[:, 1]) < 5.05
        assert abs(images[near_level, 2]).min() > 0.039
        assert 0.039 * count > 3.0


def test_field_does_not_repeat_in_an_hour_straight_on(field):
    """80 km on 36 courses: no two grids repeat at once, and on most courses none does."""
    k = np.geomspace(1e-5, 6.0, 3000)
    distances = np.arange(300.0, 80_000.0, 4.0)
    courses = np.arange(0.0, np.pi, np.pi / 36.0) + 0.01
    alike, most = np.zeros((len(courses), len(distances))), 0.0
    for number, (cell, edge) in enumerate(zip(field.cell, field.edge, strict=True)):
        share = k * energy(k, 1.0, 100.0) * level_energy(k, field.cell, number) / 1.5
        most = max(most, np.trapezoid(share, np.log(k)))
        near = cell * np.arange(0.0, 40.0, 0.1)
        form = np.trapezoid(share * np.sinc(np.multiply.outer(near, k) / np.pi), np.log(k))
        for row, course in zip(alike, courses, strict=True):
            way = np.multiply.outer(grid_axes(number) @ level(course) / edge, distances)
            way = edge * np.sqrt(((way - np.rint(way)) ** 2).sum(axis=0))
            image = way < 0.9 * distances
            row[image] += np.interp(way[image], near, form, right=0.0)
    worst = abs(alike).max(axis=1)
    assert np.median(worst) < 0.05
    assert worst.max() < most


def test_field_isotropic_has_no_divergence(isotropic):
    """But for splines, whose images of a wave have no part in keeping its air together."""
    rng = np.random.default_rng(5)
    at = rng.uniform(0.0, 1e4, (4000, 1, 1, 3))
    step = 0.1 * np.array([1.0, -1.0])[:, np.newaxis] * np.eye(3)[:, np.newaxis, :]
    places = (at + step).reshape(-1, 1, 3)
    found = sample_field(isotropic.grid, places[:, 0], places).reshape(-1, 3, 2, 3)
    slopes = (found[:, :, 0] - found[:, :, 1]) / 0.2
    divergence = np.trace(slopes, axis1=1, axis2=2)
    unbound = (slopes[:, [0, 1, 2], [0, 1, 2]] ** 2).sum(axis=1)
    assert (divergence**2).mean() < 0.05**2 * unbound.mean()


def test_coarse_level_gradient_error_is_small(field):
    """Within 1.5 m of a centre: against sampling every level at every point."""
    rng = np.random.default_rng(6)
    centre = rng.uniform(0.0, 1e4, (2000, 3))
    off = rng.normal(size=(2000, 6, 3))
    points = centre[:, np.newaxis] + 1.5 * off / np.linalg.norm(off, axis=-1, keepdims=True)
    levels = field.grid.levels.copy()
    levels["at_points"] = True
    whole = sample_field(field.grid._replace(levels=levels), centre, points)
    error = sample_field(field.grid, centre, points) - whole
    near = int(field.grid.levels["at_points"].sum())
    assert 0 < near < len(field.cell)
    # of u cos(k·x) it leaves u (k·r)²/2 behind, and over all directions (k·r)⁴ is k⁴r⁴/5
    coarse = list(modes(field))[near:]
    left = sum((power * (k**2).sum(axis=1) ** 2).sum(axis=1) for k, power, _ in coarse)
    found = np.sqrt((error**2).mean(axis=(0, 1)))
    assert found == pytest.approx(np.sqrt(1.5**4 / 20.0 * left), rel=0.1)
    assert (found < 0.003 * SIGMA).all()


@pytest.mark.parametrize("distance", [5.0, 3.0])
def test_wind_difference_is_that_of_the_docs(field, distance):
    """Its variance between two points abreast, over all fields, beside the closed form."""
    apart = np.array([0.0, distance, 0.0])
    found = sum((power @ (1.0 - np.cos(k @ apart)) for k, power, _ in modes(field)))
    along, across = covariance(distance, LENGTH)
    closed = 1.0 - np.where(apart > 0.0, along, across)
    documented = "{:.2f}, {:.2f} and {:.2f}".format(*(found / (SIGMA**2 * closed)))
    assert documented in " ".join(AIR.split())


def test_field_same_seed_is_equal_to_the_bit(field, isotropic):
    """Of the same random numbers the other field would be alike in spite of its lengths."""
    again = make_field(0, SIGMA, LENGTH)
    np.testing.assert_array_equal(again.grid.values, field.grid.values)
    alike = np.corrcoef(*(each.grid.values.ravel()[::10] for each in (field, isotropic)))[0, 1]
    assert abs(alike) < 0.02


def test_field_memory_and_edges_are_as_reported(field):
    assert field.memory == sum(each.nbytes for each in field.grid)
    assert f"{1e-6 * field.memory:.0f} MB in all" in AIR
    assert (field.edge == field.cell * field.grid.levels["count"]).all()
    assert field.edge[-1] >= max(64.0 * LENGTH.max(), 80_000.0 / 5.0)
    counts = field.grid.levels["count"]
    assert len(field.grid.values) == (counts**2 * (counts + 3)).sum()


def test_field_zero_sigma_is_still_air():
    still = make_field(1, np.zeros(3), LENGTH, path_m=1000.0)
    assert not still.grid.values.any()
    assert not still.variance.any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"widest_m": 2000.0, "path_m": 1e4}, "a widest_m of at least 2104, or none"),
        ({"widest_m": 5000.0}, "a path of 80000 m: write a widest_m of at least 16000"),
        ({"length": [263.0, 263.0, 3.0]}, "a longer length, or a smaller finest_m"),
        ({"finest_m": 20.0}, "a longer length, or a smaller finest_m"),
        ({"finest_m": 0.0}, "a finest_m above 0"),
        ({"length": [263.0, 150.0, 100.0]}, "not 263 and 150"),
        ({"sigma": [1.0, -1.0, 1.0]}, "three sigma of 0 or more"),
        ({"length": [100.0, 100.0]}, "three lengths above 0"),
    ],
)
def test_field_invalid_parameters_are_rejected(changes, message):
    args = {"sigma": SIGMA, "length": LENGTH, **changes}
    with pytest.raises(InputError, match=message):
        make_field(1, **args)


def test_unresolved_variance_falls_with_the_cell():
    fine, coarse = (unresolved_variance(cell, 20.0) for cell in (0.2, 0.8))
    # E falls as k^(−5/3), and what lies beyond a k as k^(−2/3)
    assert coarse / fine == pytest.approx(4.0 ** (2.0 / 3.0), rel=0.02)
    assert fine < MAX_UNRESOLVED
