"""Actuator faults: commands that reach the surfaces, by hand and by a second mixing."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from reference import actuator_faults

from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, ActuatorCommand, allocate, fields_of, write_fields
from testbed.flight.faults import no_faults
from testbed.vehicle.control_surfaces import (
    SERVO,
    SURFACES,
    ControlGeometry,
    any_floats,
    apply_actuator_faults,
    check_faults,
    keep_flow,
    stack_geometry,
)

AILERON, ELEVATOR, RUDDER, LEFT, RIGHT = range(5)
NAN = np.nan


def tailed(elevator_down=0.30):
    up = np.array([[0.35, 0.35, 0.35, 0.0, 0.0]])
    down = np.array([[0.35, elevator_down, 0.35, 0.0, 0.0]])
    return ControlGeometry(np.array([[True, True, True, False, False]]), np.array([NAN]), up, down)


def wing(mixing=1.0):
    travel = np.array([[0.0, 0.0, 0.0, 0.6, 0.6]])
    fitted = np.array([[False, False, False, True, True]])
    return ControlGeometry(fitted, np.array([mixing]), travel, travel.copy())


def commands(aileron=0.0, elevator=0.0, rudder=0.0, throttle=0.5):
    return ActuatorCommand(*(np.array([value]) for value in (aileron, elevator, rudder, throttle)))


def random_commands(rng, n):
    return ActuatorCommand(*rng.uniform(-1.0, 1.0, (3, n)), rng.uniform(0.0, 1.0, n))


def mixed(surfaces, mixing):
    """Mix commands as an aircraft does: positions of its elevons, trailing edge up positive."""
    left = np.clip(mixing * (surfaces.elevator - surfaces.aileron), -1.0, 1.0)
    right = np.clip(mixing * (surfaces.elevator + surfaces.aileron), -1.0, 1.0)
    return left, right


class Actuators:
    """Servos and motors of N aircraft, which begin at some commands."""

    def __init__(self, before, geometry):
        n = len(before.aileron)
        self.rows, self.aircraft = np.arange(n), allocate(AIRCRAFT, n)
        self.servos, self.geometry = allocate(SERVO, n), geometry
        self.trimmed = np.stack(before, axis=1)
        self.drops = None

    def step(self, surfaces, faults, flow=None):
        """Step by a period; return the state of the surfaces and motors."""
        aircraft = self.aircraft
        write_fields(aircraft["surfaces"], surfaces)
        write_fields(aircraft["faults"], faults)
        if flow is not None:
            aircraft["air"]["alpha"], aircraft["air"]["beta"] = flow.T
            keep_flow(self.rows, aircraft, self.servos)
        self.drops = apply_actuator_faults(
            self.rows, aircraft, self.servos, self.trimmed, *self.geometry
        )
        return ActuatorCommand(*map(np.copy, fields_of(ActuatorCommand, aircraft["surfaces"])))


def once(surfaces, faults, geometry, *, before=None, flow=(0.0, 0.0)):
    actuators = Actuators(surfaces if before is None else before, geometry)
    return actuators.step(surfaces, faults, np.array([flow]))


def sticking(column, at=NAN):
    faults = no_faults(1)
    faults.stuck[0, column], faults.stuck_at[0, column] = True, at
    return faults


def floating(*columns, ratio=0.5):
    faults = no_faults(1)
    faults.floating[0, list(columns)], faults.floats[0, list(columns)] = True, ratio
    return faults


def test_without_faults_commands_are_unchanged():
    rng = np.random.default_rng(1)
    geometry = stack_geometry([tailed(), wing(), wing(0.5)] * 20)
    surfaces, actuators = random_commands(rng, 60), Actuators(random_commands(rng, 60), geometry)
    out = actuators.step(surfaces, no_faults(60), rng.normal(0.0, 0.1, (60, 2)))
    for ours, theirs in zip(out, surfaces, strict=True):
        assert np.array_equal(ours, theirs)


def test_power_scales_the_throttle():
    for power in (0.0, 0.5, 1.0):
        faults = no_faults(1)._replace(power=np.array([power]))
        out = once(commands(throttle=0.8), faults, tailed())
        assert out.throttle[0] == 0.8 * power


def test_frozen_autopilot_holds_servos_and_throttle():
    geometry = tailed()
    first, later = commands(0.1, 0.2, 0.3, 0.8), commands(-0.5, -0.6, -0.7, 0.1)
    faults = no_faults(1)._replace(frozen=np.array([True]), power=np.array([0.5]))
    actuators = Actuators(first, geometry)
    for _ in range(5):
        assert [each[0] for each in actuators.step(later, faults)] == [0.1, 0.2, 0.3, 0.4]
    assert actuators.step(later, no_faults(1)) == later


@pytest.mark.parametrize("column", [AILERON, ELEVATOR, RUDDER])
def test_stuck_surface_holds_its_position(column):
    geometry, before, now = tailed(), commands(0.1, 0.2, 0.3), commands(-0.4, -0.5, -0.6)
    assert once(now, sticking(column, 0.9), geometry)[column][0] == 0.9
    actuators, faults = Actuators(before, geometry), sticking(column)
    for _ in range(3):  # and it stays there, whatever the command
        out = actuators.step(now, faults)
        assert out[column][0] == before[column][0]
        others = [i for i in range(3) if i != column]
        assert [out[i][0] for i in others] == [now[i][0] for i in others]
    assert actuators.step(now, no_faults(1)) == now


@pytest.mark.parametrize("mixing", [1.0, 0.7, 0.5])
@pytest.mark.parametrize("column", [LEFT, RIGHT])
def test_stuck_elevon_leaves_both_axes_to_the_other(column, mixing):
    """The commands mix to the stuck elevon and to the commanded position of the other."""
    rng = np.random.default_rng(2)
    n = 500
    surfaces, geometry = random_commands(rng, n), stack_geometry([wing(mixing)] * n)
    faults = no_faults(n)
    faults.stuck[:, column], faults.stuck_at[:, column] = True, rng.uniform(-1.0, 1.0, n)
    out = Actuators(surfaces, geometry).step(surfaces, faults)
    asked, moved = mixed(surfaces, mixing), mixed(out, mixing)
    at_its_stop = np.abs(asked[RIGHT - column]) == 1.0
    assert 0.0 < at_its_stop.mean() < 0.7 or mixing == 0.5  # reaches its stops in a corner only
    # rounding of a sum and a difference of numbers up to 2
    assert moved[column - LEFT] == pytest.approx(faults.stuck_at[:, column], abs=1e-15)
    assert moved[RIGHT - column] == pytest.approx(asked[RIGHT - column], abs=1e-15)
    if mixing == 1.0:
        assert all((np.abs(each) <= 1.0).all() for each in out[:2])


def test_stuck_elevon_does_not_creep():
    """10 000 periods of other commands leave its position equal to the bit."""
    rng, geometry = np.random.default_rng(3), wing()
    actuators, faults = Actuators(commands(0.123, 0.345), geometry), sticking(LEFT)
    for aileron, elevator in rng.uniform(-1.0, 1.0, (10_000, 2)):
        actuators.step(commands(aileron, elevator), faults)
    assert actuators.servos["positions"][0, LEFT] == 0.345 - 0.123


def test_floating_surfaces_follow_the_flow():
    """Half of 0.1 rad: air from below raises the elevator, 0.35 rad at 1 and 0.30 at −1."""
    geometry = tailed()
    from_below = once(commands(), floating(ELEVATOR), geometry, flow=(0.1, 0.0))
    from_above = once(commands(), floating(ELEVATOR), geometry, flow=(-0.1, 0.0))
    assert from_below.elevator[0] == pytest.approx(0.05 / 0.35, rel=1e-15)
    assert from_above.elevator[0] == pytest.approx(-0.05 / 0.30, rel=1e-15)
    # air from the right deflects the rudder to the left, which yaws left: negative here
    from_the_right = once(commands(), floating(RUDDER), geometry, flow=(0.3, 0.1))
    assert from_the_right.rudder[0] == pytest.approx(-0.05 / 0.35, rel=1e-15)
    # both ailerons go up equally
    assert (
        once(commands(aileron=0.7), floating(AILERON), geometry, flow=(0.2, 0.1)).aileron[0] == 0.0
    )
    # at its stop, and a surface with a negative ratio
    assert once(commands(), floating(ELEVATOR), geometry, flow=(1.5, 0.0)).elevator[0] == 1.0
    against = once(commands(), floating(ELEVATOR, ratio=-0.5), geometry, flow=(0.1, 0.0))
    assert against.elevator[0] == pytest.approx(-0.05 / 0.30, rel=1e-15)


def test_floating_elevons_rise_and_a_single_one_rolls():
    geometry, flow = wing(), (0.1, 0.2)  # 0.05 rad of 0.6
    both = once(commands(0.3, -0.4), floating(LEFT, RIGHT), geometry, flow=flow)
    assert both.elevator[0] == pytest.approx(0.05 / 0.6, rel=1e-15)
    assert both.aileron[0] == pytest.approx(0.0, abs=1e-16)
    one = once(commands(), floating(LEFT), geometry, flow=flow)
    assert mixed(one, 1.0)[0][0] == pytest.approx(0.05 / 0.6, rel=1e-14)
    assert mixed(one, 1.0)[1][0] == pytest.approx(0.0, abs=1e-16)
    assert one.aileron[0] < 0.0  # the left edge up rolls left


def test_stuck_surface_does_not_float():
    faults = floating(ELEVATOR)
    faults.stuck[0, ELEVATOR] = True
    before = commands(elevator=0.25)
    out = once(commands(elevator=-0.8), faults, tailed(), before=before, flow=(0.3, 0.0))
    assert out.elevator[0] == 0.25


def test_faults_of_aircraft_are_independent():
    rng = np.random.default_rng(4)
    n = 40
    each_geometry = [tailed() if i % 2 else wing() for i in range(n)]
    geometry, surfaces, before = (
        stack_geometry(each_geometry),
        random_commands(rng, n),
        random_commands(rng, n),
    )
    faults = no_faults(n)._replace(
        power=rng.uniform(0.0, 1.0, n),
        stuck=rng.random((n, 5)) < 0.2,
        stuck_at=np.where(rng.random((n, 5)) < 0.5, np.nan, rng.uniform(-1.0, 1.0, (n, 5))),
        floating=rng.random((n, 5)) < 0.2,
        floats=rng.uniform(0.0, 1.0, (n, 5)),
        frozen=rng.random(n) < 0.3,
    )
    flow = rng.normal(0.0, 0.1, (n, 2))
    together = Actuators(before, geometry).step(surfaces, faults, flow)
    for i in range(n):
        row = slice(i, i + 1)
        first = Actuators(ActuatorCommand(*(each[row] for each in before)), each_geometry[i])
        own = type(faults)(*(each[row] for each in faults))
        alone = first.step(ActuatorCommand(*(e[row] for e in surfaces)), own, flow[row])
        for ours, theirs in zip(alone, together, strict=True):
            assert ours[0] == theirs[i]


def random_faults(rng, n):
    return no_faults(n)._replace(
        power=np.where(rng.random(n) < 0.5, 1.0, rng.uniform(0.0, 1.0, n)),
        stuck=rng.random((n, 5)) < 0.2,
        stuck_at=np.where(rng.random((n, 5)) < 0.5, np.nan, rng.uniform(-1.0, 1.0, (n, 5))),
        floating=rng.random((n, 5)) < 0.2,
        floats=rng.uniform(-1.0, 1.0, (n, 5)),
        frozen=rng.random(n) < 0.3,
    )


def difference_from_numpy(rule):
    """Return in how many of 5 periods of 200 aircraft kernels and numpy differ in any bit."""
    rng, n, found = np.random.default_rng(5), 200, 0
    geometry = stack_geometry([tailed(), wing(), wing(0.7), tailed(0.2)] * (n // 4))
    before = random_commands(rng, n)
    actuators, held = Actuators(before, geometry), np.stack(before, axis=1)
    servos = held, actuator_faults.positions(held, geometry.mixing)
    for _ in range(5):
        surfaces, faults = random_commands(rng, n), random_faults(rng, n)
        flow = rng.normal(0.0, 0.4, (n, 2))
        flow[::7] = -0.0
        ours = np.stack(actuators.step(surfaces, faults, flow), axis=1)
        theirs, servos = actuator_faults.actuate(
            np.stack(surfaces, axis=1), servos, faults, flow, geometry, rule
        )
        found += ours.tobytes() != theirs.tobytes()
    return found


def test_kernels_equal_numpy_to_the_bit():
    assert difference_from_numpy(actuator_faults.Rule()) == 0


@pytest.mark.parametrize("name", actuator_faults.Rule._fields)
def test_planted_rule_differs_from_the_kernels(name):
    usual = getattr(actuator_faults.Rule(), name)
    assert difference_from_numpy(actuator_faults.Rule()._replace(**{name: not usual})) == 5


def test_dropping_battery_asks_for_python():
    actuators, faults = Actuators(commands(), tailed()), no_faults(1)
    actuators.step(commands(), faults)
    assert not actuators.drops
    actuators.step(commands(), faults._replace(charge=np.array([0.2])))
    assert actuators.drops


def test_flow_is_read_where_a_surface_floats():
    actuators = Actuators(commands(), tailed())
    actuators.step(commands(), sticking(ELEVATOR))
    assert not any_floats(actuators.rows, actuators.aircraft)
    actuators.step(commands(), floating(ELEVATOR))
    assert any_floats(actuators.rows, actuators.aircraft)


def _fault(kind, **keys):
    return SimpleNamespace(kind=kind, **keys)


@pytest.mark.parametrize(
    ("geometry", "fault", "message"),
    [
        (
            tailed(),
            _fault("surface-stuck", surface="left-elevon"),
            "surface-stuck: kite has no left-elevon; write one of aileron, elevator, rudder",
        ),
        (
            wing(),
            _fault("surface-floating", surface="rudder"),
            "kite has no rudder; write one of left-elevon, right-elevon",
        ),
        (
            tailed()._replace(up=np.zeros((1, 5))),
            _fault("surface-floating", surface="elevator"),
            "has no travel of its elevator .* write surface-stuck",
        ),
        (tailed(), _fault("battery-low"), "kite has no battery; write engine-out or thrust-loss"),
    ],
)
def test_fault_of_a_missing_part_is_an_error(geometry, fault, message):
    with pytest.raises(InputError, match=message):
        check_faults(
            "uav1",
            "kite",
            geometry,
            0,
            engine=True,
            battery=False,
            faults=[_fault("engine-out"), fault],
        )


def test_faults_of_existing_parts_pass():
    whole = [_fault("surface-stuck", surface=name) for name in SURFACES[:3]]
    # a floating aileron stays neutral, so its travel is not needed
    blind = tailed()._replace(up=np.full((1, 5), math.nan))
    check_faults(
        "uav1",
        "kite",
        tailed(),
        0,
        engine=True,
        battery=True,
        faults=[*whole, _fault("battery-low")],
    )
    loose = [_fault("surface-floating", surface="aileron")]
    check_faults("uav1", "kite", blind, 0, engine=True, battery=False, faults=loose)
