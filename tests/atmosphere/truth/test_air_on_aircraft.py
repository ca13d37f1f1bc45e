"""The air acts on the flight models: wind, wind gradients and a wake's rolling moment."""

import math
import sys
from functools import partial

import numpy as np
import pytest
from aircraft_copies import changed

from testbed.airframes.powerplant import AircraftError
from testbed.core.records import NedOrigin, WindInput
from testbed.core.standard_atmosphere import density_ratio
from testbed.plan.air import (
    temperature_offset,
    temperature_warnings,
)
from testbed.plan.measured_fleet import resolve
from testbed.plan.world import build
from testbed.scenario import find_aircraft, load_scenario, set_duration
from testbed.vehicle.environment import INTEGRATORS, JSBSIM_DEFAULT_INTEGRATORS
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import airframe, trim_aircraft
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.trim import InitialState, TrimError, TrimPoint

AIRCRAFT = {"rascal110": 22.0, "skywalker_x8": 18.0}
RATE = 200
RHO = 1.225 * (1.0 - 2.25577e-5 * 700.0) ** 4.25588  # kg/m³, ISA at 700 m
SLUG_FOOT2 = 1.3558179483  # kg m²


def pressure(speed):
    return 0.5 * RHO * speed**2


def flown(
    name,
    *,
    rates=(0.0, 0.0, 0.0),
    wind=(0.0, 0.0, 0.0),
    roll=0.0,
    ticks=1,
    integrators=INTEGRATORS,
):
    """State and air data of an aircraft in trim 400 m up, some ticks after a wind sets in."""
    start = InitialState((0.0, 0.0, -400.0), airspeed=AIRCRAFT[name])
    origin = NedOrigin(elevation_m=300.0)
    fleet = JsbsimFleet([find_aircraft(name)], [start], origin, RATE, integrators)
    fleet.set_wind(WindInput(np.array([wind]), np.array([rates]), np.array([roll])))
    fleet.step(fleet.trimmed, ticks)
    return fleet.read(), fleet.air()


def gained(name, **does):
    """Angular acceleration, rad/s², of the first step with this air, minus that in still air.

    JSBSim moves with the forces of the step before: the second step is the first to change. By
    Euler's method the rates change by the acceleration times the step.
    """
    moved, still = (
        flown(name, ticks=2, integrators=JSBSIM_DEFAULT_INTEGRATORS, **each)[0]
        for each in (does, {})
    )
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


WIND, TURN, ROLL = slice(0, 3), slice(3, 6), 6  # columns of `pack_wind`


@pytest.mark.parametrize(
    ("columns", "test", "arguments"),
    [
        (TURN, test_roll_gradient_rolls_the_aircraft, ("rascal110", 0.137, 0.1)),
        (
            TURN,
            test_damping_acts_on_rates_relative_to_the_air,
            ("rascal110", 1, 12.0 - 7.0, 1.55 * SLUG_FOOT2),
        ),
        (ROLL, test_wake_delta_cl_acts_as_rolling_moment, ("skywalker_x8",)),
        (WIND, test_gust_changes_airspeed_at_once, ()),
    ],
)
def test_air_of_the_other_sign_is_found(monkeypatch, columns, test, arguments):
    set_wind = JsbsimFleet.set_wind

    def set_reversed(fleet, wind):
        set_wind(fleet, wind)
        fleet._wind_numbers[:, columns] *= -1.0

    monkeypatch.setattr(JsbsimFleet, "set_wind", set_reversed)
    with pytest.raises(AssertionError):
        test(*arguments)


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


def standard_density(altitude, warmer=0.0):
    """Hydrostatic equilibrium from 1013.25 hPa at sea level, 6.5 K per km: kg/m³."""
    at_sea_level = 288.15 + warmer
    temperature = at_sea_level - 0.0065 * altitude
    pressure_pa = 101325.0 * (temperature / at_sea_level) ** 5.2558797
    return pressure_pa / (287.052874 * temperature)


@pytest.mark.parametrize("warmer", [-30.0, 0.0, 19.0, 35.0])
def test_density_ratio_is_hydrostatic(warmer):
    altitudes = np.array([0.0, 400.0, 3000.0])
    expected = standard_density(altitudes, warmer) / 1.225
    np.testing.assert_allclose(density_ratio(altitudes, warmer), expected, rtol=1e-5)


def test_warm_air_lowers_equivalent_airspeed():
    """What a pitot tube measures at 22 m/s, 400 m above sea level."""
    for warmer in (0.0, 19.0):
        start = InitialState((0.0, 0.0, -100.0), airspeed=22.0, temperature_offset=warmer)
        fleet = JsbsimFleet(
            [find_aircraft("rascal110")], [start], NedOrigin(elevation_m=300.0), RATE
        )
        expected = 22.0 * math.sqrt(standard_density(400.0, warmer) / 1.225)
        assert fleet.read().equivalent_airspeed[0] == pytest.approx(expected, rel=2e-5)


def test_warm_air_takes_power_by_true_airspeed():
    """At one dynamic pressure incidence and thrust are the same, and all speeds are as 1/√ρ.

    The Rascal's throttle is the power of its shaft.
    """
    rascal, warmer = find_aircraft("rascal110"), 19.0
    faster = math.sqrt(standard_density(400.0) / standard_density(400.0, warmer))
    cold, warm = (
        trim_aircraft(rascal, TrimPoint(22.0 * factor, temperature_offset=offset))
        for factor, offset in ((1.0, 0.0), (faster, warmer))
    )
    assert faster == pytest.approx(1.0312, abs=1e-4)
    assert warm.alpha == pytest.approx(cold.alpha, abs=1e-6)
    assert warm.controls.throttle / cold.controls.throttle == pytest.approx(faster, rel=1e-4)
    assert warm.propeller_rps / cold.propeller_rps == pytest.approx(faster, rel=1e-4)


def test_air_that_is_not_warmed_is_found(monkeypatch, tmp_path):
    copies = {"rascal110": changed(find_aircraft("rascal110"), tmp_path)}  # trimmed anew
    monkeypatch.setattr(sys.modules[__name__], "find_aircraft", copies.get)
    monkeypatch.setattr(JsbsimModel, "warm", lambda model, offset: None)
    for test in (
        test_warm_air_lowers_equivalent_airspeed,
        test_warm_air_takes_power_by_true_airspeed,
    ):
        with pytest.raises(AssertionError):
            test()


def test_density_of_standard_air_in_warm_air_is_found(monkeypatch):
    standard = partial(density_ratio, temperature_offset=0.0)
    here = sys.modules[__name__]
    monkeypatch.setattr(here, "density_ratio", lambda heights, warmer: standard(heights))
    with pytest.raises(AssertionError):
        test_density_ratio_is_hydrostatic(19.0)


def test_ground_temperature_acts_on_all_densities():
    """32 °C at 300 m is 18.95 K above the standard atmosphere: flight model, wakes, leader."""
    hot = "air.temperature_c=32"
    straight = "leader.path={kind: virtual, speed_mps: 22, curve: {kind: straight}}"
    scenario = set_duration(load_scenario("close-formation-wake", [hot, straight]), 1.0)
    offset = temperature_offset(scenario.air, 300.0)
    assert offset == pytest.approx(32.0 - 15.0 + 0.0065 * 300.0)
    world = build(scenario)
    truth = world.aircraft["truth"]
    density = standard_density(300.0 - truth["position_ned"][:, 2], offset)
    expected = truth["airspeed"] * np.sqrt(density / 1.225)
    np.testing.assert_allclose(truth["equivalent_airspeed"], expected, rtol=2e-5)
    altitude = 300.0 + scenario.leader.start.altitude_m
    known = standard_density(altitude, offset)
    assert world.air._wakes.wake["density"][0] == pytest.approx(known, rel=1e-5)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (["leader.vehicle=unicycle", "fleet.*.vehicle=unicycle"], "temperature_c has no effect"),
        (
            ["fleet.uav1.autopilot=ardupilot"],
            "the true airspeed that it computes is wrong by -3.0 %",
        ),
    ],
)
def test_temperature_that_misses_aircraft_is_warned_of(changes, text):
    scenario = load_scenario("simulation-3", ["air.temperature_c=32", *changes])
    fleet = resolve(scenario)
    offset = temperature_offset(scenario.air, fleet.origin.elevation_m)
    height = scenario.leader.start.altitude_m
    (event,) = temperature_warnings(fleet, offset, height)
    assert text in event.text and event.level == "warning"
    assert not list(temperature_warnings(fleet, 0.0, height))


def test_x8_top_speed_hardly_depends_on_temperature():
    """25.59 m/s in standard air, 25.66 m/s in air that is 19 K warmer."""
    x8 = find_aircraft("skywalker_x8")
    for warmer, flown, too_fast in ((0.0, 25.57, 25.62), (19.0, 25.64, 25.69)):
        trim_aircraft(x8, TrimPoint(flown, temperature_offset=warmer))
        with pytest.raises(TrimError, match="no steady flight"):
            trim_aircraft(x8, TrimPoint(too_fast, temperature_offset=warmer))


def test_more_battery_cells_raise_the_top_speed():
    x8 = find_aircraft("skywalker_x8")
    with pytest.raises(TrimError, match="no steady flight"):
        trim_aircraft(x8, TrimPoint(27.0))
    four, five = (trim_aircraft(x8, TrimPoint(22.0, cells=cells)) for cells in (4, 5))
    # the motor's voltage for one thrust and speed is the same: throttle times that of the cells
    assert five.controls.throttle == pytest.approx(0.8 * four.controls.throttle, rel=0.01)
    assert trim_aircraft(x8, TrimPoint(31.5, cells=5)).controls.throttle < 1.0
    with pytest.raises(TrimError, match="no steady flight"):
        trim_aircraft(x8, TrimPoint(31.7, cells=5))
    with pytest.raises(AircraftError, match="has no battery/cells"):
        trim_aircraft(find_aircraft("rascal110"), TrimPoint(22.0, cells=5))
