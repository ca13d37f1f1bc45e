"""Broken servos and motors: what reaches the surfaces, by hand and by a second mixing."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from testbed.errors import InputError
from testbed.sim.breakdowns import nothing_fails
from testbed.state import Surfaces
from testbed.vehicle.breakage import SURFACES, Rig, broken, check_faults, resting, stacked

AILERON, ELEVATOR, RUDDER, LEFT, RIGHT = range(5)
NOTHING = np.nan


def tailed(elevator_down=0.30):
    up = np.array([[0.35, 0.35, 0.35, 0.0, 0.0]])
    down = np.array([[0.35, elevator_down, 0.35, 0.0, 0.0]])
    return Rig(np.array([[True, True, True, False, False]]), np.array([NOTHING]), up, down)


def wing(mixing=1.0):
    travel = np.array([[0.0, 0.0, 0.0, 0.6, 0.6]])
    fitted = np.array([[False, False, False, True, True]])
    return Rig(fitted, np.array([mixing]), travel, travel.copy())


def told(aileron=0.0, elevator=0.0, rudder=0.0, throttle=0.5):
    return Surfaces(*(np.array([value]) for value in (aileron, elevator, rudder, throttle)))


def random_told(rng, n):
    return Surfaces(*rng.uniform(-1.0, 1.0, (3, n)), rng.uniform(0.0, 1.0, n))


def mixed(surfaces, mixing):
    """What an aircraft's own mixer makes of commands: the edges of its elevons, up positive."""
    left = np.clip(mixing * (surfaces.elevator - surfaces.aileron), -1.0, 1.0)
    right = np.clip(mixing * (surfaces.elevator + surfaces.aileron), -1.0, 1.0)
    return left, right


def once(surfaces, failing, rig, *, before=None, flow=(0.0, 0.0)):
    before = resting(surfaces if before is None else before, rig)
    return broken(surfaces, before, failing, np.array([flow]), rig)[0]


def sticking(column, at=NOTHING):
    failing = nothing_fails(1)
    failing.stuck[0, column], failing.stuck_at[0, column] = True, at
    return failing


def floating(*columns, ratio=0.5):
    failing = nothing_fails(1)
    failing.floating[0, list(columns)], failing.floats[0, list(columns)] = True, ratio
    return failing


def test_what_is_whole_does_as_it_is_told_to_the_bit():
    rng = np.random.default_rng(1)
    rig = stacked([tailed(), wing(), wing(0.5)] * 20)
    surfaces, before = random_told(rng, 60), resting(random_told(rng, 60), rig)
    out, after = broken(surfaces, before, nothing_fails(60), rng.normal(0.0, 0.1, (60, 2)), rig)
    for ours, theirs in zip(out, surfaces, strict=True):
        assert np.array_equal(ours, theirs)
    assert np.array_equal(after.stood, resting(surfaces, rig).stood, equal_nan=True)


def test_power_is_the_share_of_the_throttle_that_is_left():
    for power in (0.0, 0.5, 1.0):
        failing = nothing_fails(1)._replace(power=np.array([power]))
        out = once(told(throttle=0.8), failing, tailed())
        assert out.throttle[0] == 0.8 * power


def test_a_hung_autopilot_holds_servos_and_throttle_and_the_motor_fades_beside_it_once():
    rig = tailed()
    first, later = told(0.1, 0.2, 0.3, 0.8), told(-0.5, -0.6, -0.7, 0.1)
    failing = nothing_fails(1)._replace(frozen=np.array([True]), power=np.array([0.5]))
    servos = resting(first, rig)
    for _ in range(5):
        out, servos = broken(later, servos, failing, np.zeros((1, 2)), rig)
        assert [each[0] for each in out] == [0.1, 0.2, 0.3, 0.4]
    out, _ = broken(later, servos, nothing_fails(1), np.zeros((1, 2)), rig)
    assert out == later


@pytest.mark.parametrize("column", [AILERON, ELEVATOR, RUDDER])
def test_a_surface_sticks_where_it_is_said_or_where_it_was(column):
    rig, before, now = tailed(), told(0.1, 0.2, 0.3), told(-0.4, -0.5, -0.6)
    assert once(now, sticking(column, 0.9), rig)[column][0] == 0.9
    servos, failing = resting(before, rig), sticking(column)
    for _ in range(3):  # and it stays there, whatever the autopilot says meanwhile
        out, servos = broken(now, servos, failing, np.zeros((1, 2)), rig)
        assert out[column][0] == before[column][0]
        others = [i for i in range(3) if i != column]
        assert [out[i][0] for i in others] == [now[i][0] for i in others]
    assert broken(now, servos, nothing_fails(1), np.zeros((1, 2)), rig)[0] == now


@pytest.mark.parametrize("mixing", [1.0, 0.7, 0.5])
@pytest.mark.parametrize("column", [LEFT, RIGHT])
def test_a_stuck_elevon_leaves_the_other_to_both_axes_also_at_its_stops(column, mixing):
    """The aircraft mixes what comes out into the stuck elevon and the other as it was asked for."""
    rng = np.random.default_rng(2)
    n = 500
    surfaces, rig = random_told(rng, n), stacked([wing(mixing)] * n)
    failing = nothing_fails(n)
    failing.stuck[:, column], failing.stuck_at[:, column] = True, rng.uniform(-1.0, 1.0, n)
    out, _ = broken(surfaces, resting(surfaces, rig), failing, np.zeros((n, 2)), rig)
    asked, flown = mixed(surfaces, mixing), mixed(out, mixing)
    at_its_stop = np.abs(asked[RIGHT - column]) == 1.0
    assert 0.0 < at_its_stop.mean() < 0.7 or mixing == 0.5  # which reaches its stops in a corner
    # rounding of a sum and a difference of numbers up to 2
    assert flown[column - LEFT] == pytest.approx(failing.stuck_at[:, column], abs=1e-15)
    assert flown[RIGHT - column] == pytest.approx(asked[RIGHT - column], abs=1e-15)
    if mixing == 1.0:
        assert all((np.abs(each) <= 1.0).all() for each in out[:2])


def test_an_elevon_that_stuck_does_not_creep():
    """10 000 periods of other commands leave it where it was to the bit, though it is unmixed."""
    rng, rig = np.random.default_rng(3), wing()
    servos = resting(told(0.123, 0.345), rig)
    where, failing = servos.stood[0, LEFT], sticking(LEFT)
    for aileron, elevator in rng.uniform(-1.0, 1.0, (10_000, 2)):
        _, servos = broken(told(aileron, elevator), servos, failing, np.zeros((1, 2)), rig)
    assert servos.stood[0, LEFT] == where == 0.345 - 0.123


def test_floating_surfaces_give_way_to_the_flow():
    """Half of 0.1 rad: air from below lifts the elevator's edge, 0.35 rad at 1 and 0.30 at −1."""
    rig = tailed()
    from_below = once(told(), floating(ELEVATOR), rig, flow=(0.1, 0.0))
    from_above = once(told(), floating(ELEVATOR), rig, flow=(-0.1, 0.0))
    assert from_below.elevator[0] == pytest.approx(0.05 / 0.35, rel=1e-15)
    assert from_above.elevator[0] == pytest.approx(-0.05 / 0.30, rel=1e-15)
    # air from the right blows the rudder's edge to the left, which yaws left: our negative
    from_the_right = once(told(), floating(RUDDER), rig, flow=(0.3, 0.1))
    assert from_the_right.rudder[0] == pytest.approx(-0.05 / 0.35, rel=1e-15)
    # both ailerons go up alike
    assert once(told(aileron=0.7), floating(AILERON), rig, flow=(0.2, 0.1)).aileron[0] == 0.0
    # its stop, and a surface that floats against the flow
    assert once(told(), floating(ELEVATOR), rig, flow=(1.5, 0.0)).elevator[0] == 1.0
    against = once(told(), floating(ELEVATOR, ratio=-0.5), rig, flow=(0.1, 0.0))
    assert against.elevator[0] == pytest.approx(-0.05 / 0.30, rel=1e-15)


def test_floating_elevons_rise_together_and_one_alone_rolls_towards_it():
    rig, flow = wing(), (0.1, 0.2)  # 0.05 rad of 0.6
    both = once(told(0.3, -0.4), floating(LEFT, RIGHT), rig, flow=flow)
    assert both.elevator[0] == pytest.approx(0.05 / 0.6, rel=1e-15)
    assert both.aileron[0] == pytest.approx(0.0, abs=1e-16)
    one = once(told(), floating(LEFT), rig, flow=flow)
    assert mixed(one, 1.0)[0][0] == pytest.approx(0.05 / 0.6, rel=1e-14)
    assert mixed(one, 1.0)[1][0] == pytest.approx(0.0, abs=1e-16)
    assert one.aileron[0] < 0.0  # the left edge up rolls left


def test_what_sticks_does_not_float():
    failing = floating(ELEVATOR)
    failing.stuck[0, ELEVATOR] = True
    before = told(elevator=0.25)
    out = once(told(elevator=-0.8), failing, tailed(), before=before, flow=(0.3, 0.0))
    assert out.elevator[0] == 0.25


def test_each_aircraft_breaks_by_itself():
    rng = np.random.default_rng(4)
    n = 40
    rigs = [tailed() if i % 2 else wing() for i in range(n)]
    rig, surfaces, before = stacked(rigs), random_told(rng, n), random_told(rng, n)
    failing = nothing_fails(n)._replace(
        power=rng.uniform(0.0, 1.0, n),
        stuck=rng.random((n, 5)) < 0.2,
        stuck_at=np.where(rng.random((n, 5)) < 0.5, np.nan, rng.uniform(-1.0, 1.0, (n, 5))),
        floating=rng.random((n, 5)) < 0.2,
        floats=rng.uniform(0.0, 1.0, (n, 5)),
        frozen=rng.random(n) < 0.3,
    )
    flow = rng.normal(0.0, 0.1, (n, 2))
    together, _ = broken(surfaces, resting(before, rig), failing, flow, rig)
    for i in range(n):
        row = slice(i, i + 1)
        first = resting(Surfaces(*(each[row] for each in before)), rigs[i])
        own = type(failing)(*(each[row] for each in failing))
        alone, _ = broken(Surfaces(*(e[row] for e in surfaces)), first, own, flow[row], rigs[i])
        for ours, theirs in zip(alone, together, strict=True):
            assert ours[0] == theirs[i]


def test_nothing_that_was_handed_over_is_written_to():
    surfaces, rig, failing = told(0.1, 0.2, 0.3), wing(), sticking(LEFT, 0.5)
    failing.power[0] = 0.5
    before = resting(told(), rig)
    kept = [each.copy() for each in (*surfaces, *before.told, before.stood)]
    broken(surfaces, before, failing, np.zeros((1, 2)), rig)
    for now, then in zip((*surfaces, *before.told, before.stood), kept, strict=True):
        assert np.array_equal(now, then)


def _fault(kind, **keys):
    return SimpleNamespace(kind=kind, **keys)


@pytest.mark.parametrize(
    ("rig", "fault", "message"),
    [
        (
            tailed(),
            _fault("surface-stuck", surface="left-elevon"),
            "uav1: fault surface-stuck: no left-elevon .* kite has aileron, elevator, rudder",
        ),
        (
            wing(),
            _fault("surface-floating", surface="rudder"),
            "no rudder to break; kite has left-elevon, right-elevon",
        ),
        (
            tailed()._replace(up=np.zeros((1, 5))),
            _fault("surface-floating", surface="elevator"),
            "does not say how far its elevator goes .* write surface-stuck",
        ),
        (tailed(), _fault("battery-low"), "kite has no battery; write engine-out or thrust-loss"),
    ],
)
def test_a_fault_of_what_is_not_there_says_what_to_write(rig, fault, message):
    with pytest.raises(InputError, match=message):
        check_faults("uav1", "kite", rig, 0, battery=False, faults=[_fault("engine-out"), fault])


def test_faults_of_what_is_there_pass():
    whole = [_fault("surface-stuck", surface=name) for name in SURFACES[:3]]
    # neutral, so nothing needs be known of its travel
    blind = tailed()._replace(up=np.full((1, 5), math.nan))
    check_faults("uav1", "kite", tailed(), 0, battery=True, faults=[*whole, _fault("battery-low")])
    loose = [_fault("surface-floating", surface="aileron")]
    check_faults("uav1", "kite", blind, 0, battery=False, faults=loose)
