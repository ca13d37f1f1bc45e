"""The rolling moment of a wake against a vortex lattice, an independent model."""

import sys

import numpy as np
import pytest
from reference.adapters_atmosphere import add_wakes
from vortex_lattice import Wing, elliptic, rectangular

from testbed.atmosphere.wake import WakeModel
from testbed.core.frames import GRAVITY
from testbed.core.records import Airframe

CORE_SPANS = 0.05
DENSITY = 1.18  # kg/m³
# span m, area m², lift slope of the airframe per rad, mass kg, speed of level flight m/s
RASCAL = (2.795, 0.98198, 5.0, 6.577, 22.0)
SKYWALKER = (2.10, 0.75, 4.0203, 3.364, 18.0)
OFFSETS = np.arange(0.0, 1.51, 0.125)  # spans to the right of the leader, one span behind it
HALF = 4

CASES = {
    "rascal, rectangular": (RASCAL, rectangular),
    "rascal, elliptic": (RASCAL, elliptic),
    "skywalker, rectangular": (SKYWALKER, rectangular),
    "skywalker, elliptic": (SKYWALKER, elliptic),
}


def level_lift_coefficient(aircraft):
    _, area, _, mass, speed = aircraft
    return mass * GRAVITY / (0.5 * DENSITY * speed**2 * area)


def modelled(aircraft, offset):
    """Down wind over airspeed and rolling-moment coefficient of a follower in level flight."""
    span, area, slope, mass, speed = aircraft
    wing = Airframe(span=span, area=area, arm=0.8, mass=mass, lift_slope=slope)
    wakes = WakeModel(
        [wing, wing],
        sheds=np.array([True, False]),
        affected=np.array([False, True]),
        core_spans=CORE_SPANS,
        decay_s=None,
        memory_s=10.0,
        dt=0.005,
        density=DENSITY,
    )
    position = np.array([[0.0, 0.0, 0.0], [-span, offset * span, 0.0]])
    velocity = np.array([[speed, 0.0, 0.0]] * 2)
    wind, roll = add_wakes(wakes, position, velocity, np.zeros((2, 3)), np.zeros((2, 3)), 0.0)
    return wind[1, 2] / speed, roll[1]


def lattice(aircraft, planform, offsets=OFFSETS, **panels):
    """Lift lost over lift slope, and rolling-moment coefficient (offsets,) of the follower."""
    span, area = aircraft[:2]
    wing = Wing(span, area, planform(span, area), **panels)
    leader = wing.lifting(level_lift_coefficient(aircraft))
    behind = [
        wing.behind(wing, leader, np.array([span, offset * span, 0.0]), CORE_SPANS * span)
        for offset in offsets
    ]
    lost = np.array([-wing.lift_coefficient(each) for each in behind]) / wing.lift_slope()
    return lost, np.array([wing.wake_delta_cl(each) for each in behind])


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES.keys())
def both(request):
    aircraft, planform = request.param
    model = np.transpose([modelled(aircraft, offset) for offset in OFFSETS])
    return model, lattice(aircraft, planform), planform


def crossings(roll):
    """Offsets, in spans, at which the moment changes its sign beside the leader."""
    at = np.flatnonzero(roll[1:-1] * roll[2:] < 0.0) + 1
    part = roll[at] / (roll[at] - roll[at + 1])
    return OFFSETS[at] + part * (OFFSETS[at + 1] - OFFSETS[at])


def test_lattice_slender_wing_matches_lifting_line():
    """Its lift slope and its roll damping."""
    span, aspect_ratio = 1.0, 200.0
    wing = Wing(span, span**2 / aspect_ratio, elliptic(span, span**2 / aspect_ratio))
    mu = 2.0 / aspect_ratio
    # the chord is left out of the lifting line, so they differ by its part of the span
    close = 4.0 / aspect_ratio
    assert wing.lift_slope() == pytest.approx(2.0 * np.pi / (1.0 + mu), rel=close)
    rolling = wing.circulations(wing.y / (0.5 * span))  # right wing going down
    damping = -2.0 * np.pi / 8.0 / (1.0 + 2.0 * mu)
    assert wing.wake_delta_cl(rolling) == pytest.approx(damping, rel=close)


def test_lattice_is_fine_enough():
    coarse = lattice(RASCAL, rectangular)[1]
    fine = lattice(RASCAL, rectangular, OFFSETS[::4], chordwise=6, spanwise=60)[1]
    assert fine == pytest.approx(coarse[::4], abs=0.01 * abs(coarse).max())


def test_rolling_moment_half_a_span_aside_is_close(both):
    """Within 15 %."""
    (_, model), (_, reference), _ = both
    assert OFFSETS[HALF] == 0.5
    assert model[HALF] == pytest.approx(reference[HALF], rel=0.15)


def test_rolling_moment_changes_sign_as_the_lattices(both):
    (_, model), (_, reference), _ = both
    (here,), (there,) = crossings(model), crossings(reference)
    assert here == pytest.approx(there, abs=CORE_SPANS)
    assert abs(model[0]) < 1e-9 * abs(model).max()


def test_rolling_moment_has_the_lattices_shape(both):
    """Beside an elliptic wing."""
    (_, model), (_, reference), planform = both
    assert abs(model).argmax() == abs(reference).argmax()
    if planform is elliptic:  # a rectangular wing sheds more at its tips than the model's does
        assert abs(model - reference).max() < 0.15 * abs(reference).max()


def test_lift_lost_is_within_15_percent_of_the_maximum(both):
    (model, _), (reference, _), _ = both
    assert model == pytest.approx(reference, abs=0.15 * abs(reference).max())


@pytest.mark.parametrize(
    ("lift", "roll", "wider", "test"),
    [
        (1.0, -1.0, 1.0, test_rolling_moment_half_a_span_aside_is_close),
        (1.0, 1.0, 1.2, test_rolling_moment_changes_sign_as_the_lattices),
        (1.0, 1.0, 2.0, test_rolling_moment_has_the_lattices_shape),
        (1.3, 1.0, 1.0, test_lift_lost_is_within_15_percent_of_the_maximum),
    ],
    ids=["other sign", "20 % wider", "twice as wide", "lift 30 % too large"],
)
def test_wrong_wake_is_found(both, lift, roll, wider, test):
    """Factors of the model's lift, its moment and the distance of its vortices."""
    model, reference, planform = both
    stretched = [np.interp(OFFSETS / wider, OFFSETS, each) for each in model]
    wrong = np.array(stretched) * [[lift], [roll]]
    with pytest.raises(AssertionError):
        test((wrong, reference, planform))


def test_rectangular_wing_is_no_lifting_line(monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "elliptic", rectangular)
    with pytest.raises(AssertionError):
        test_lattice_slender_wing_matches_lifting_line()
