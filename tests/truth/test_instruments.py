"""Flight models are read and set by their own functions as they are through Python, to the bit."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from testbed.scenario import find_aircraft
from testbed.state import AirFelt, Origin, Surfaces
from testbed.vehicle import addresses, instruments
from testbed.vehicle import fleet as fleets
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.legs import LONGEST, Leg
from testbed.vehicle.properties import READY_READ, READY_WRITE, read, write
from testbed.vehicle.start import Start

KINDS = ("rascal110", "skywalker_x8", "rascal110")
PERIODS, TICKS = 40, 4


def aloft():
    starts = [
        Start((0.0, 40.0 * row, -300.0), airspeed=20.0, state_of_charge=0.9 if row == 1 else 1.0)
        for row in range(len(KINDS))
    ]
    return JsbsimFleet([find_aircraft(kind) for kind in KINDS], starts, Origin(), 200)


def flown(remove=None):
    """All that is read of three aircraft that are pushed about, every period."""
    rng, fleet, out = np.random.default_rng(9), aloft(), []
    n = len(KINDS)
    for period in range(PERIODS):
        fleet.blow(AirFelt(*rng.normal(0.0, (3.0, 0.05), (n, 3, 2)).T.swapaxes(1, 2), np.zeros(n)))
        trim = fleet.trimmed
        fleet.step(Surfaces(*(each + rng.normal(0.0, 0.02, n) for each in trim)), TICKS)
        if period == remove:
            fleet._models[1].winds[0].set_double_value(math.nan)
        state, air = fleet.look(), fleet.air()
        out.append([np.array(each).ravel() for record in (state, air) for each in record])
        if fleet.lost(state).any():
            fleet.remove(fleet.lost(state))
    return [np.concatenate(each) for each in zip(*out, strict=True)]


@pytest.fixture
def hidden(monkeypatch):
    """A JSBSim whose library does not show its functions, as one built otherwise."""
    twins = pytest.importorskip("testbed.vehicle.properties_twin", exc_type=ImportError)
    if addresses.functions() is None:
        pytest.skip("this JSBSim does not show its functions")
    return lambda: monkeypatch.setattr(twins, "functions", lambda: None)


@pytest.mark.parametrize("remove", [None, 10])
def test_flights_are_the_same_to_the_bit(hidden, remove):
    shown = flown(remove)
    hidden()
    through_python = flown(remove)
    for one, two in zip(shown, through_python, strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_readable_functions_say_the_same(monkeypatch):
    pytest.importorskip("numba")
    compiled = flown()
    for name in ("note", "look", "sense_air", "blow", "command"):
        plainly = partial(partial, getattr(instruments, name))
        monkeypatch.setattr(fleets, f"READY_{name.upper()}", plainly)
    for one, two in zip(compiled, flown(), strict=True):
        # the same sums in another order: roundings, of positions some 1e3 m large
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-9)


def test_legs_that_are_flown_at_once_are_those_flown_one_by_one():
    """More than fit in one go, with motions asked for here and there; the others read as before."""
    rng, n = np.random.default_rng(4), len(KINDS)
    legs = tuple(
        Leg(int(rng.integers(1, 4)), tuple(rng.random(n) < 0.5)) for _ in range(3 * LONGEST)
    )
    at_once, apart = aloft(), aloft()
    before = np.array(at_once.look().position_ned)
    for k, leg in enumerate(legs):
        at_once.step(None, leg.ticks, () if 0 < k % LONGEST else legs[k:])
        apart.step(None, leg.ticks)
        true = apart.look()
        for row, wanted in enumerate((True,) * n if k % LONGEST == LONGEST - 1 else leg.wanted):
            if wanted:
                before[row] = true.position_ned[row]
        np.testing.assert_array_equal(at_once.look().position_ned, before)


def test_nobody_is_told_anything_in_the_midst_of_legs():
    fleet = aloft()
    fleet.step(fleet.trimmed, 1, (Leg(1), Leg(1)))
    still = AirFelt(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3))
    for wrong in (
        lambda: fleet.blow(still),
        fleet.air,
        lambda: fleet.discharge(np.full(3, np.nan)),
        lambda: fleet.remove(np.zeros(3, bool)),
        lambda: fleet.step(fleet.trimmed, 1),
    ):
        with pytest.raises(RuntimeError, match="flown on already"):
            wrong()
    fleet.air()


@pytest.mark.parametrize("then", [(2, ()), (1, (Leg(1),))])
def test_legs_that_were_flown_are_gone_through_as_they_were_told(then):
    fleet = aloft()
    fleet.step(None, 1, (Leg(1), Leg(1)))
    with pytest.raises(RuntimeError, match="flown on already"):
        fleet.step(None, *then)


def test_one_that_is_not_there_keeps_its_number(hidden):
    model = aloft()._models[0]
    nodes = [model.node("attitude/theta-rad"), None, model.node("velocities/vt-fps")]
    ours, theirs = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0])
    READY_READ(nodes, theirs)()
    read(nodes, ours)
    np.testing.assert_array_equal(theirs, ours)
    assert ours[1] == 2.0 and ours[2] == pytest.approx(20.0 / 0.3048)

    wind = [model.winds[0], None, model.winds[2]]
    for put in (lambda numbers: READY_WRITE(wind, numbers)(), lambda numbers: write(wind, numbers)):
        numbers = np.random.default_rng(3).normal(size=3)
        put(numbers)
        said = [each.get_double_value() for each in model.winds]
        assert said == [numbers[0], 0.0, numbers[2]]


def test_another_release_is_left_to_python(monkeypatch):
    """It may keep its properties elsewhere."""
    addresses.functions.cache_clear()
    monkeypatch.setattr(addresses, "RELEASE", "1.3.2")
    try:
        assert addresses.functions() is None
    finally:
        addresses.functions.cache_clear()


def test_what_is_known_is_the_release_that_is_pinned():
    """A release that is pinned anew is to be looked at: else flights become slower, unnoticed."""
    pins = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    assert f'"jsbsim=={addresses.RELEASE}"' in pins
