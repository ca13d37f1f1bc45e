"""The air acts on the flight models: wind, wind gradients and a wake's rolling moment."""

import math

import numpy as np
import pytest

from testbed.core.records import Origin, WindInput
from testbed.scenario import find_aircraft
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.initial_state import InitialState
from testbed.vehicle.jsbsim_adapter import airframe

AIRCRAFT = {"rascal110": 22.0, "skywalker_x8": 18.0}
RATE = 200
RHO = 1.225 * (1.0 - 2.25577e-5 * 700.0) ** 4.25588  # kg/m³, ISA at 700 m
SLUG_FOOT2 = 1.3558179483  # kg m²


def pressure(speed):
    return 0.5 * RHO * speed**2


def flown(name, *, rates=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0), roll=0.0, ticks=1):
    """State and air data of an aircraft in trim 400 m up, some ticks after a wind sets in."""
    start = InitialState((0.0, 0.0, -400.0), airspeed=AIRCRAFT[name])
    fleet = JsbsimFleet([find_aircraft(name)], [start], Origin(elevation_m=300.0), RATE)
    fleet.set_wind(WindInput(np.array([wind]), np.array([rates]), np.array([roll])))
    fleet.step(fleet.trimmed, ticks)
    return fleet.read(), fleet.air()


def gained(name, **does):
    """Angular acceleration, rad/s², of the first step with this air, minus that in still air.

    JSBSim moves with the forces of the step before: the second step is the first to change.
    """
    moved, still = flown(name, ticks=2, **does)[0], flown(name, ticks=2)[0]
    return (moved.rates_body - still.rates_body)[0] * RATE


@pytest.mark.parametrize(("name", "constant"), [("rascal110", 0.137), ("skywalker_x8", 0.049)])
@pytest.mark.parametrize("turn", [0.1, -0.2])
def test_roll_gradient_rolls_the_aircraft(name, constant, turn):
    """After five time constants of the roll mode, 2 V Ixx / (q S b² Clp), before it slips much."""
    state, air = flown(name, rates=(turn, 0.0, 0.0), ticks=round(5.0 * constant * RATE))
    assert state.rates_body[0, 0] == pytest.approx(turn, rel=0.1)
    assert air.wind_gradient_rates[0] == pytest.approx([turn, 0.0, 0.0])


@pytest.mark.parametrize(
    ("name", "axis", "derivative", "inertia"),
    [
        ("rascal110", 0, 0.40, 1.95 * SLUG_FOOT2),
        ("rascal110", 1, 12.0 - 7.0, 1.55 * SLUG_FOOT2),
        ("rascal110", 2, 0.15, 1.91 * SLUG_FOOT2),
        ("skywalker_x8", 1, 1.3012, 0.140),
    ],
)
def test_damping_acts_on_rates_relative_to_the_air(name, axis, derivative, inertia):
    """q S l (l / 2V) C times the air's turn, over the inertia; the X8 has products of inertia.

    In pitch C is Cmα̇ − Cmq: air that turns with q on the way through it raises the incidence by q.
    """
    frame, speed = airframe(find_aircraft(name)), AIRCRAFT[name]
    chord = {"rascal110": 1.15 * 0.3048, "skywalker_x8": 0.3571}[name]
    length = chord if axis == 1 else frame.span
    rates = np.zeros(3)
    rates[axis] = 0.2
    moment = pressure(speed) * frame.area * length**2 / (2.0 * speed) * derivative * 0.2
    assert gained(name, rates=rates)[axis] == pytest.approx(moment / inertia, rel=0.01)


@pytest.mark.parametrize("name", AIRCRAFT)
def test_wake_delta_cl_acts_as_rolling_moment(name):
    """By hand: ṗ = q S b Cl Izz / (Ixx Izz − Ixz²)."""
    frame, speed = airframe(find_aircraft(name)), AIRCRAFT[name]
    ixx, izz, ixz = {
        "rascal110": (1.95 * SLUG_FOOT2, 1.91 * SLUG_FOOT2, 0.0),
        "skywalker_x8": (0.335, 0.400, -0.029),
    }[name]
    moment = pressure(speed) * frame.area * frame.span * 0.01
    expected = moment * izz / (ixx * izz - ixz**2)
    assert gained(name, roll=0.01)[0] == pytest.approx(expected, rel=0.01)


def test_gust_changes_airspeed_at_once():
    state, air = flown("rascal110", wind=(-2.0, 0.0, 0.0))
    assert state.airspeed[0] == pytest.approx(24.0, abs=0.05)
    assert air.wind_ned[0] == pytest.approx([-2.0, 0.0, 0.0], abs=1e-9)
    up, _ = flown("rascal110", wind=(0.0, 0.0, -1.0), ticks=20)
    level, _ = flown("rascal110", ticks=20)
    climb = (level.velocity_ned - up.velocity_ned)[0, 2]
    assert 0.0 < climb < 1.0


def test_airframe_values_are_those_of_the_sources():
    """The sizes are those of SOURCE.md; the slope is the models' own derivative CLα."""
    rascal, x8 = (airframe(find_aircraft(name)) for name in AIRCRAFT)
    assert rascal.span == pytest.approx(9.17 * 0.3048)
    assert rascal.area == pytest.approx(10.57 * 0.3048**2)
    assert rascal.mass == pytest.approx(14.5 * 0.45359237, rel=1e-6)
    assert rascal.lift_slope == pytest.approx((1.40 - 0.25) / 0.23, rel=1e-3)
    assert rascal.arm == pytest.approx(32.5 * 0.0254)
    assert x8.span == pytest.approx(2.10)
    assert x8.lift_slope == pytest.approx(4.0203, rel=2e-3)
    assert x8.mass == pytest.approx(3.364, rel=1e-6)
    assert x8.arm == pytest.approx(0.5 * 0.3571)
    assert math.isfinite(x8.area)
