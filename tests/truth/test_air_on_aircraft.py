"""What the air does reaches the aircraft: its wind, its turn and a wake's rolling moment."""

import math

import numpy as np
import pytest

from testbed.scenario import find_aircraft
from testbed.state import AirFelt, Origin
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_door import airframe
from testbed.vehicle.start import Start

AIRCRAFT = {"rascal110": 22.0, "skywalker_x8": 18.0}
RATE = 200
RHO = 1.225 * (1.0 - 2.25577e-5 * 700.0) ** 4.25588  # kg/m³, ISA at 700 m
SLUG_FOOT2 = 1.3558179483  # kg m²


def pressure(speed):
    return 0.5 * RHO * speed**2


def flown(name, *, rates=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0), roll=0.0, ticks=1):
    """An aircraft in trim 400 m up, in air that begins to do this; its state and data later."""
    start = Start((0.0, 0.0, -400.0), airspeed=AIRCRAFT[name])
    fleet = JsbsimFleet([find_aircraft(name)], [start], Origin(elevation_m=300.0), RATE)
    fleet.blow(AirFelt(np.array([wind]), np.array([rates]), np.array([roll])))
    fleet.step(fleet.trimmed, ticks)
    return fleet.read(), fleet.air()


def gained(name, **does):
    """p, q, r won by the first step that knows the air, rad/s², over one in still air.

    JSBSim moves with the forces of the step before: the second step is the first to know.
    """
    felt, still = flown(name, ticks=2, **does)[0], flown(name, ticks=2)[0]
    return (felt.rates_body - still.rates_body)[0] * RATE


@pytest.mark.parametrize(("name", "constant"), [("rascal110", 0.137), ("skywalker_x8", 0.049)])
@pytest.mark.parametrize("turn", [0.1, -0.2])
def test_an_aircraft_rolls_with_the_air(name, constant, turn):
    """After five time constants of the roll mode, 2 V Ixx / (q S b² Clp), before it slips much."""
    state, air = flown(name, rates=(turn, 0.0, 0.0), ticks=round(5.0 * constant * RATE))
    assert state.rates_body[0, 0] == pytest.approx(turn, rel=0.1)
    assert air.rates_body[0] == pytest.approx([turn, 0.0, 0.0])


@pytest.mark.parametrize(
    ("name", "axis", "derivative", "inertia"),
    [
        ("rascal110", 0, 0.40, 1.95 * SLUG_FOOT2),
        ("rascal110", 1, 12.0 - 7.0, 1.55 * SLUG_FOOT2),
        ("rascal110", 2, 0.15, 1.91 * SLUG_FOOT2),
        ("skywalker_x8", 1, 1.3012, 0.140),
    ],
)
def test_damping_acts_on_the_turn_against_the_air_by_hand(name, axis, derivative, inertia):
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
def test_a_rolling_moment_coefficient_is_felt_as_one(name):
    """By hand: ṗ = q S b Cl Izz / (Ixx Izz − Ixz²)."""
    frame, speed = airframe(find_aircraft(name)), AIRCRAFT[name]
    ixx, izz, ixz = {
        "rascal110": (1.95 * SLUG_FOOT2, 1.91 * SLUG_FOOT2, 0.0),
        "skywalker_x8": (0.335, 0.400, -0.029),
    }[name]
    moment = pressure(speed) * frame.area * frame.span * 0.01
    expected = moment * izz / (ixx * izz - ixz**2)
    assert gained(name, roll=0.01)[0] == pytest.approx(expected, rel=0.01)


def test_a_gust_is_airspeed_at_once():
    state, air = flown("rascal110", wind=(-2.0, 0.0, 0.0))
    assert state.airspeed[0] == pytest.approx(24.0, abs=0.05)
    assert air.wind_ned[0] == pytest.approx([-2.0, 0.0, 0.0], abs=1e-9)
    up, _ = flown("rascal110", wind=(0.0, 0.0, -1.0), ticks=20)
    level, _ = flown("rascal110", ticks=20)
    climb = (level.velocity_ned - up.velocity_ned)[0, 2]
    assert 0.0 < climb < 1.0


def test_what_the_air_knows_of_the_airframes():
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
