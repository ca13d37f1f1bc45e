"""Pistons, turboprops, jets and gliders of the installed JSBSim: started, trimmed, linearised."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from aircraft_copies import TWIN, changed, of_jsbsim
from cases import ALL

import testbed
from testbed.airframes import powerplant
from testbed.airframes.powerplant import AircraftError
from testbed.compiled.compiled_fleet import untranslated
from testbed.core.errors import InputError
from testbed.core.frames import FOOT, GRAVITY
from testbed.core.records import ActuatorCommand, NedOrigin
from testbed.scenario import library
from testbed.vehicle import jsbsim_adapter, jsbsim_model
from testbed.vehicle.fleet import JsbsimFleet, place_model
from testbed.vehicle.jsbsim_adapter import (
    airframe,
    airframe_warnings,
    find_cruise,
    linearize_aircraft,
    trim_aircraft,
)
from testbed.vehicle.linearize import STATES, find_modes
from testbed.vehicle.trim import InitialState, TrimError, TrimPoint

RATE_HZ = 100
SPEEDS = {"c172p": 55.0, "c182": 60.0, "DHC6": 70.0, "T37": 100.0, "SGS": 28.0}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    place = tmp_path_factory.mktemp("aircraft")
    return {name: of_jsbsim(name, place) for name in SPEEDS}


def start(name, **keys):
    return InitialState((0.0, 0.0, -1000.0), airspeed=SPEEDS[name], **keys)


def placed(folder, **keys):
    return place_model(folder, start(folder.name, **keys), NedOrigin(), RATE_HZ).model


def value(model, name):
    return model.node(name).get_double_value()


@pytest.mark.parametrize("name", [each for each in SPEEDS if ALL or each != "c182"])
def test_trimmed_flight_goes_on(folders, name):
    """For 10 s with the controls of the trim: the engines run, and nothing moves.

    Of the two with a governor the DHC6 is always flown.
    """
    fleet = JsbsimFleet([folders[name]], [start(name)], NedOrigin(), RATE_HZ)
    (trim,), first = fleet.trims, fleet.read()
    assert trim.residual < 1e-6
    fleet.step(fleet.trimmed, 10 * RATE_HZ)
    last = fleet.read()
    assert last.airspeed == pytest.approx(SPEEDS[name], abs=0.05)
    climbed = first.position_ned[0, 2] - last.position_ned[0, 2]
    climb = SPEEDS[name] * math.sin(trim.flight_path_angle)
    assert climbed == pytest.approx(10.0 * climb, abs=0.5)
    assert np.isnan(fleet.air().propeller_rps[0]) == (name in ("T37", "SGS"))
    assert np.isnan(fleet.air().state_of_charge[0])


def test_thrust_is_shaft_power_times_efficiency(folders):
    model = placed(folders["c172p"])
    power = value(model, "propulsion/engine/power-hp") * 550.0  # ft lb/s
    speed = value(model, "velocities/vt-fps")
    efficiency = value(model, "propulsion/engine/thrust-lbs") * speed / power
    assert 0.6 < efficiency < 0.9


def test_engines_not_started_give_no_trim(folders, tmp_path, monkeypatch):
    """What the start is for: a piston at rest only brakes."""
    monkeypatch.setattr(powerplant.Powerplant, "runs", property(lambda power: True))
    with pytest.raises(TrimError, match="a propeller stands still"):
        trim_aircraft(of_jsbsim("c172p", tmp_path), TrimPoint(55.0))


def test_all_engines_have_one_throttle(folders):
    model = placed(folders["T37"])
    thrusts = [value(model, f"propulsion/engine[{k}]/thrust-lbs") for k in range(2)]
    assert thrusts[0] == thrusts[1] > 100.0
    # along the path, thrust carries the drag
    alpha = value(model, "aero/alpha-rad")
    drag = value(model, "forces/fwx-aero-lbs")
    assert sum(thrusts) * math.cos(alpha) == pytest.approx(drag, rel=2e-3)


def test_glider_descends_at_drag_over_lift(folders):
    model = placed(folders["SGS"])
    trim = trim_aircraft(folders["SGS"], TrimPoint(SPEEDS["SGS"], altitude=1300.0))
    lift, drag = (value(model, f"forces/fw{axis}-aero-lbs") for axis in "zx")
    assert math.tan(-trim.flight_path_angle) == pytest.approx(drag / lift, rel=2e-3)
    assert not trim.has_engine and trim.controls.throttle == 0.0
    with pytest.raises(TrimError, match="its flight-path angle follows from its airspeed"):
        trim_aircraft(folders["SGS"], TrimPoint(SPEEDS["SGS"], flight_path_angle=0.02))


@pytest.mark.parametrize("name", ["c172p", "T37"])
def test_fuel_is_frozen_or_burnt(folders, name):
    """Burnt, the mass falls by the flow of the fuel; frozen, by nothing at all."""
    lost = []
    for burn in (False, True):
        model = placed(folders[name], fuel_burn=burn)
        first = value(model, "inertia/weight-lbs")
        for _ in range(20 * RATE_HZ):
            model.fdm.run()
        lost.append(first - value(model, "inertia/weight-lbs"))
    engines = 1 if name == "c172p" else 2
    flow = sum(value(model, f"propulsion/engine[{k}]/fuel-flow-rate-pps") for k in range(engines))
    assert lost[0] == 0.0
    assert lost[1] == pytest.approx(20.0 * flow, rel=0.02)
    assert lost[1] > 0.05


def test_fuel_burn_needs_fuel(folders, tmp_path):
    rascal = library() / "aircraft" / "rascal110"
    with pytest.raises(AircraftError, match="no engine that burns fuel"):
        place_model(rascal, InitialState((0.0, 0.0, -200.0), fuel_burn=True), NedOrigin(), RATE_HZ)
    empty = changed(
        folders["c172p"],
        tmp_path,
        (r"<contents(.*?)>[^<]*</contents>", r"<contents\1>0</contents>"),
    )
    with pytest.raises(AircraftError, match="its tanks are empty"):
        placed(empty, fuel_burn=True)


def test_flight_is_reset_and_not_saved(tmp_path):
    """By an error that names what only JSBSim flies; a reset begins the same flight again."""
    folder = of_jsbsim("c172p", tmp_path)
    for file in ("autopilot.param", "middle_loop.yaml"):
        shutil.copy(library() / "aircraft" / "rascal110" / file, folder)
    aircraft = testbed.Aircraft(str(folder), airspeed_mps=55.0, altitude_m=1000.0)
    speeds = [[aircraft.step(0.02, 0.1, 0.7).airspeed for _ in range(20)]]
    with pytest.raises(InputError, match="cannot be saved; .*<piston_engine> is not translated"):
        aircraft.simulation.save()
    aircraft.reset()
    speeds.append([aircraft.step(0.02, 0.1, 0.7).airspeed for _ in range(20)])
    assert speeds[0] == speeds[1]


def test_glider_is_said_before_the_flight(folders):
    (text,) = airframe_warnings(folders["SGS"])
    assert text.startswith("SGS has no engine: its throttle has no effect")
    assert airframe_warnings(folders["c172p"]) == ()


def test_what_has_no_wing_is_named(tmp_path):
    with pytest.raises(TrimError, match="mk82: its lift coefficient grows by 0.08"):
        find_cruise(of_jsbsim("mk82", tmp_path))


def test_control_without_effect_is_named(tmp_path):
    pattern = r'(<aerosurface_scale name="fcs/elevator">\s*<input>) fcs/elevator-cmd-norm'
    deaf = changed(
        library() / "aircraft" / "rascal110", tmp_path, (pattern, r"\1 fcs/flap-cmd-norm")
    )
    with pytest.raises(TrimError, match="the commands of elevator have no effect"):
        trim_aircraft(deaf, TrimPoint(14.0))


def test_cruise_speed_has_its_lift_coefficient(folders):
    """Where there is steady flight at once, as for a Cessna: 0.4 at sea level."""
    trim, measured = find_cruise(folders["c172p"]), airframe(folders["c172p"])
    pressure = 0.5 * 1.225 * trim.point.airspeed**2
    assert measured.mass * GRAVITY / (pressure * measured.area) == pytest.approx(0.4)


class TestPropellerMode:
    def test_piston_equals_the_decay_of_its_speed(self, folders):
        """Held in the wind of the trim, from a speed that it has in a slightly faster wind."""
        folder = folders["c172p"]
        linear = linearize_aircraft(folder, TrimPoint(55.0, altitude=1300.0))
        n = linear.states.index("n")
        model = placed(folder)
        trim = trim_aircraft(folder, TrimPoint(55.0, altitude=1300.0))
        speeds = []
        for factor in (1.0, 1.01):
            u, v, w = (factor * each for each in trim.placement.velocity_body)
            faster = replace(trim.placement, velocity_body=(u, v, w))
            model.accelerations(faster, trim.controls, spin=True)
            model.accelerations(trim.placement, trim.controls, spin=False)
            model.node("forces/hold-down").set_double_value(1.0)
            for wind, name in zip(model.winds, ("north", "east", "down"), strict=True):
                wind.set_double_value(-value(model, f"velocities/v-{name}-fps"))
            rows = []
            for _ in range(20):
                rows.append(model.propeller_rps)
                model.fdm.run()
            model.node("forces/hold-down").set_double_value(0.0)
            speeds.append(np.array(rows))
        gap = speeds[1] - speeds[0]
        rate = np.log(gap[-1] / gap[0]) / (19 / RATE_HZ)
        assert linear.a[n, n] == pytest.approx(rate, rel=0.05)
        modes = {mode.name: mode for mode in find_modes(linear.a, linear.states)}
        assert modes["propeller"].eigenvalue.real < -1.0

    @pytest.mark.parametrize("name", ["T37", "SGS", "c182"])
    def test_none_without_propeller_or_with_governor(self, folders, name):
        linear = linearize_aircraft(folders[name], TrimPoint(SPEEDS[name]))
        assert linear.states == tuple(each for each in STATES if each != "n")
        assert linear.a.shape == (8, 8) and linear.b.shape == (8, 4)
        names = {mode.name for mode in find_modes(linear.a, linear.states)}
        assert "propeller" not in names and {"phugoid", "Dutch roll"} <= names
        throttle = linear.b[linear.states.index("u"), 3]
        assert (throttle > 1.0) if name != "SGS" else throttle == pytest.approx(0.0, abs=1e-6)


def test_piston_throttle_is_of_settled_engine(folders):
    """The slope between two settled throttles, by A and B: that of the propeller is in n."""
    folder = folders["c172p"]
    point = TrimPoint(55.0, altitude=1300.0)
    linear, trim = linearize_aircraft(folder, point), trim_aircraft(folder, point)
    model = placed(folder)
    n, u = (linear.states.index(each) for each in "nu")
    found = []
    for change in (-0.02, 0.02):
        controls = replace(trim.controls, throttle=trim.controls.throttle + change)
        found.append(model.accelerations(trim.placement, controls, spin=True)[0])
    settled = (found[1] - found[0]) / 0.04
    static = linear.b[u, 3] - linear.a[u, n] * linear.b[n, 3] / linear.a[n, n]
    assert static == pytest.approx(settled, rel=0.05)


def test_rate_of_incidence_is_no_lag(folders, tmp_path):
    """A Cessna's moments depend on it; a servo before its elevator lags."""
    fleet = JsbsimFleet([folders["c172p"]], [start("c172p")], NedOrigin(), RATE_HZ)
    assert not fleet._models[0].has_lag
    servo = (
        '<actuator name="fcs/servo"><input>fcs/elevator-cmd-norm</input><lag>20</lag></actuator>'
        r"\1fcs/servo"
    )
    pattern = r'(<summer name="Pitch Trim Sum">\s*<input>)\s*fcs/elevator-cmd-norm'
    assert placed(changed(folders["c172p"], tmp_path, (pattern, servo))).has_lag


def test_traits_are_those_of_settled_motors(monkeypatch):
    """Traits of an aircraft whose propeller never settles would be those of some last step."""
    x8 = library() / "aircraft" / "skywalker_x8"
    found = jsbsim_adapter._find_traits(x8)
    monkeypatch.setattr(jsbsim_model, "_MAX_SPIN_STEPS", 2001)
    assert jsbsim_adapter._find_traits._function(x8) == found
    assert not found.has_rudder


def test_electric_twin_is_translated(tmp_path):
    """Two motors on one throttle need half of it each; `test_compiled_elements` compares it."""
    rascal = library() / "aircraft" / "rascal110"
    twin = changed(rascal, tmp_path, TWIN)
    one, two = (trim_aircraft(each, TrimPoint(22.0)) for each in (rascal, twin))
    assert two.controls.throttle == pytest.approx(0.5 * one.controls.throttle, rel=0.3)
    assert untranslated(twin, 200) == ()


def test_throttle_step_of_a_jet_spools(folders):
    """In flight its thrust follows the throttle over seconds, and rises."""
    fleet = JsbsimFleet([folders["T37"]], [start("T37")], NedOrigin(), RATE_HZ)
    node = fleet._models[0].node("propulsion/engine[1]/thrust-lbs")
    fleet.step(fleet.trimmed, 1)
    before = node.get_double_value()
    full = ActuatorCommand(*(np.array(each) for each in fleet.trimmed))._replace(
        throttle=np.ones(1)
    )
    fleet.step(full, RATE_HZ // 10)
    early = node.get_double_value()
    fleet.step(None, 5 * RATE_HZ)
    assert before < early < 0.9 * node.get_double_value()
    assert fleet.read().airspeed[0] > SPEEDS["T37"] + 2.0
    assert FOOT * value(fleet._models[0], "velocities/vt-fps") == fleet.read().airspeed[0]
