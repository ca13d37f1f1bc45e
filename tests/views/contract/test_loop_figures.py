"""Bode and Nyquist diagrams and root loci, of loops that are known by hand."""

import numpy as np
import pytest

from testbed.views.loop_figures import (
    LoopCurves,
    LoopsAtBank,
    bode_figure,
    nyquist_figure,
    root_locus_figure,
)

HZ = np.geomspace(0.01, 10.0, 400)
FACTORS = np.linspace(0.0, 4.0, 81)


def loops(response, poles=None):
    poles = np.zeros((len(FACTORS), 1), dtype=complex) if poles is None else poles
    return [LoopsAtBank("straight", [LoopCurves("uav1", HZ, response, FACTORS, poles)])]


def curve(panel):
    return next(line for line in panel.lines if line.label == "uav1")


@pytest.mark.parametrize("turns", [0, 1, -2])
def test_phase_has_no_jumps_and_is_below_zero(turns):
    """Of an integrator with a latency, whichever turn the first angle is in."""
    omega = 2.0 * np.pi * HZ
    response = 1.0 / (1j * omega) * np.exp(-0.2j * omega) * np.exp(2j * np.pi * turns)
    (magnitude,), (phase,) = bode_figure("t", "", loops(response)).rows
    assert curve(magnitude).y == pytest.approx(1.0 / omega)
    shown = np.isfinite(curve(phase).y)
    assert curve(phase).y[shown] == pytest.approx((-90.0 - np.degrees(0.2 * omega))[shown])
    assert magnitude.x_limits == phase.x_limits == (0.01, 10.0)


def test_nyquist_curve_is_near_minus_one_and_mirrored():
    omega = 2.0 * np.pi * HZ
    ((panel,),) = nyquist_figure("t", "", loops(1.0 / (1j * omega + 0.01))).rows
    own = curve(panel)
    known = np.isfinite(own.x)
    assert 0 < known.sum() < len(HZ) and panel.equal
    assert np.hypot(own.x[known] + 1.0, own.y[known]).max() <= 2.0
    mirror = panel.lines[1]
    np.testing.assert_array_equal(mirror.y, -own.y)


def test_branches_of_a_root_locus_do_not_jump():
    """s² + 2 s + 1 + g: poles -1 ± i √g, whose order in each row is by chance."""
    poles = -1.0 + 1j * np.sqrt(FACTORS)[:, np.newaxis] * np.array([1.0, -1.0])
    flipped = np.random.default_rng(1).random(len(FACTORS)) < 0.5
    poles[flipped] = poles[flipped, ::-1]
    ((panel,),) = root_locus_figure("t", "", loops(np.ones(len(HZ)), poles)).rows
    own = curve(panel)
    known = np.isfinite(own.y)
    assert own.x[known] == pytest.approx(-1.0)
    assert 2.0 * np.pi * own.y[known] == pytest.approx(np.sqrt(FACTORS)[known])
    closed = next(line for line in panel.lines if line.label == "factor 1")
    assert np.nanmax(closed.y) == pytest.approx(1.0 / (2.0 * np.pi))
