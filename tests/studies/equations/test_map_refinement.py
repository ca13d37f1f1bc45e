"""Refinement of a map, on fields that are known everywhere."""

import math

import numpy as np
import pytest

from testbed.studies.map_refinement import CHANGE, points_to_add

LEVELS, SIZE = 4, 65  # cells of 16 points a side, four by four of them
X, Y = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(-1, 1, SIZE), indexing="ij")


def fly(field, completed=None, *, contour=None, levels=LEVELS):
    """Return the points (m, n) that are flown in the end, and the number of rounds."""
    every = np.ones(field.shape, dtype=bool) if completed is None else completed
    flown = np.zeros(field.shape, dtype=bool)
    for rounds in range(100):
        values = np.where(flown, field, math.nan)
        wanted = points_to_add(levels, values, flown, flown & every, contour)
        if not wanted.any():
            return flown, rounds
        assert not (wanted & flown).any()
        flown |= wanted
    raise AssertionError("does not end")


def crossed(inside):
    """Return the cells (m - 1, n - 1) of one point a side of which some corners are inside."""
    corners = np.stack([inside[:-1, :-1], inside[1:, :-1], inside[:-1, 1:], inside[1:, 1:]])
    return corners.any(axis=0) & ~corners.all(axis=0)


def whole(flown):
    """Return the cells of one point a side whose four corners were flown."""
    return flown[:-1, :-1] & flown[1:, :-1] & flown[:-1, 1:] & flown[1:, 1:]


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.3, -0.2), (0.9, 0.9)])
def test_circle_is_flown_in_full_resolution(centre):
    """Every cell that the contour crosses, and few others; no point inside the far cells."""
    radius = np.hypot(X - centre[0], Y - centre[1])
    flown, rounds = fly(radius, contour=0.55)
    cells = crossed(radius < 0.55)
    assert cells.sum() > 20 and whole(flown)[cells].all()
    assert flown.sum() < 0.35 * flown.size and rounds >= LEVELS + 1
    coarse = np.zeros_like(flown)
    coarse[::8, ::8] = True
    far = np.abs(radius - 0.55) > 0.8
    assert not (flown & far & ~coarse).any()


@pytest.mark.parametrize("contour", [0.0, 0.5, 1.0])
def test_contour_at_the_numbers_themselves_is_followed(contour):
    """At the lower and at the higher of two numbers as between them. Their change is small."""
    field = np.where(X > 0.1, 1.0, 0.0)
    field[0, 0] = 1000.0
    flown, _ = fly(field, contour=contour)
    edge = crossed(X > 0.1)
    assert whole(flown)[edge].all()
    assert not whole(fly(field, contour=2.0)[0])[edge].any()


def test_contour_through_a_side_is_followed():
    """A tongue that enters a coarse cell between its corners, from a cell that is refined."""
    inside = (X < -0.9) | (np.abs(Y - 0.25) < 0.1) & (X < 0.9)
    field = np.where(inside, 1.0, 0.0) + 1e-3 * X
    flown, _ = fly(field, contour=0.5)
    assert whole(flown)[crossed(inside)].all()


def test_boundary_of_lost_flights_is_flown():
    """Numbers of lost flights decide nothing, whatever they are."""
    completed = X + 0.5 * Y**2 < 0.2
    field = np.where(completed, 1.0, 1e6 * Y)
    flown, _ = fly(field, completed)
    assert whole(flown)[crossed(completed)].all()
    assert flown.sum() < 0.3 * flown.size
    assert (fly(np.where(completed, 1.0, math.nan), completed)[0] == flown).all()
    # negative control: the same numbers without outcomes do not show the boundary
    assert not whole(fly(field)[0])[crossed(completed)].all()


def test_cells_of_large_change_are_halved():
    """A step is followed to full resolution, a plane is left coarse."""
    step = np.tanh(40.0 * (X - 0.1))
    flown, _ = fly(step)
    rises = np.diff(step[:, 0]) > CHANGE * np.ptp(step)
    assert rises.any() and whole(flown)[rises].all()
    assert fly(0.7 * X + 0.2 * Y)[1] == 1


def test_constant_field_is_flown_coarse():
    """Also where no flight has a number, or all were lost."""
    coarse = np.zeros((SIZE, SIZE), dtype=bool)
    coarse[:: 2**LEVELS, :: 2**LEVELS] = True
    nothing = np.full((SIZE, SIZE), math.nan)
    for field, completed in ((0.0 * X, None), (nothing, None), (X, np.zeros_like(coarse))):
        flown, rounds = fly(field, completed, contour=0.0)
        assert rounds == 1 and (flown == coarse).all()


def test_grid_may_have_different_counts():
    field = np.hypot(X[:17, :33], Y[:17, :33])
    flown, _ = fly(field, contour=1.0, levels=3)
    assert flown.shape == (17, 33) and flown[::8, ::8].all()


def test_next_points_depend_on_flown_ones_only():
    """Values where nothing was flown are not read."""
    radius = np.hypot(X, Y)
    flown = np.zeros((SIZE, SIZE), dtype=bool)
    flown[:: 2**LEVELS, :: 2**LEVELS] = True
    known = points_to_add(LEVELS, np.where(flown, radius, math.nan), flown, flown, 0.5)
    assert (points_to_add(LEVELS, radius, flown, np.ones_like(flown), 0.5) == known).all()
