"""Trim without a rudder, wind, inertia, natural modes and the speed model, on JSBSim itself."""

import json
import math
import os
import re
import sys
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from aircraft_copies import changed
from cases import ALL, some
from places import ROOT
from snapshot import check_snapshot
from typer.testing import CliRunner

from testbed.autopilot.parameters import read_params
from testbed.cli.main import app
from testbed.commissioning.speed_step import speed_step
from testbed.core.errors import InputError
from testbed.core.frames import FOOT, GRAVITY
from testbed.core.records import ActuatorCommand, NedOrigin, WindInput
from testbed.scenario import load_middle_loop
from testbed.vehicle import fleet as fleet_module
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import (
    AircraftError,
    airframe,
    linearize_aircraft,
    trim_aircraft,
)
from testbed.vehicle.linearize import CONTROLS, STATES, find_modes
from testbed.vehicle.trim import InitialState, TrimError, TrimPoint

RASCAL = ROOT / "aircraft" / "rascal110"
X8 = ROOT / "aircraft" / "skywalker_x8"
HIGH = NedOrigin(elevation_m=-600.0)
LEVEL = TrimPoint(22.0, altitude=400.0)
DENSITY = 1.1787  # kg/m³, standard atmosphere at 400 m
PRESSURE = 0.5 * DENSITY * 22.0**2
MASS = 14.5 * 0.45359237  # kg
AREA, SPAN, CHORD = 10.57 * FOOT**2, 9.17 * FOOT, 1.15 * FOOT
SLUG_FOOT2 = 14.593903 * FOOT**2  # kg m²
IXX, IYY = 1.9601 * SLUG_FOOT2, 1.5601 * SLUG_FOOT2  # with the tank, 0.0101 slug ft²


NO_RUDDER = (r'<channel name="yaw">.*?</channel>', "")


def servo(surface):
    """A servo before a surface, with JSBSim's own actuator."""
    actuator = (
        f'<actuator name="fcs/{surface}-servo"> <input> fcs/{surface}-cmd-norm </input>'
        "<lag> 20 </lag> <rate_limit> 5 </rate_limit> </actuator>"
    )
    pattern = rf'(<aerosurface_scale name="fcs/{surface}">\s*<input>) fcs/{surface}-cmd-norm'
    return pattern, rf"{actuator}\1 fcs/{surface}-servo"


class TestWithoutRudder:
    def test_straight_flight_leans_against_the_torque(self, tmp_path):
        folder = changed(RASCAL, tmp_path, NO_RUDDER)
        result = trim_aircraft(folder, TrimPoint(20.0))
        assert not result.has_rudder
        assert result.residual < 1e-6
        assert result.controls.rudder == 0.0
        assert result.turn_rate == 0.0
        assert 1e-4 < abs(result.placement.roll) < math.radians(2.0)
        # The weight's share against side force and drag across the nose, CYβ = −1 and CD = 0.033;
        # Earth's rotation has the rest, 2 Ω V.
        weight = MASS * GRAVITY * math.sin(result.placement.roll)
        balance = weight - 0.5 * DENSITY * 20.0**2 * AREA * 1.033 * result.beta
        assert balance == pytest.approx(0.0, abs=MASS * 1.46e-4 * 20.0)

    @pytest.mark.parametrize("bank", [0.5, -0.5])
    def test_a_turn_keeps_the_bank_and_finds_its_rate(self, tmp_path, bank):
        folder = changed(RASCAL, tmp_path, NO_RUDDER)
        result = trim_aircraft(folder, TrimPoint(20.0, bank=bank))
        assert result.residual < 1e-6
        assert result.placement.roll == bank
        assert result.beta != 0.0
        # The slip's side force takes from the turn or adds to it: m V ω = m g tan φ + Y / cos φ.
        side = -0.5 * DENSITY * 20.0**2 * AREA * result.beta / MASS
        rate = (GRAVITY * math.tan(bank) + side / math.cos(bank)) / 20.0
        assert result.turn_rate == pytest.approx(rate, rel=0.01)
        fleet = JsbsimFleet(
            [folder], [InitialState((0.0, 0.0, -1000.0), 0.0, 20.0, 0.0, bank)], HIGH, 200
        )
        before = fleet.read().euler[0]
        fleet.step(fleet.trimmed, 200)
        turned = fleet.read().euler[0] - before
        assert turned == pytest.approx([0.0, 0.0, result.turn_rate], abs=1e-3)

    def test_the_x8_trims_over_its_speeds(self):
        for airspeed in (12.0, 15.0, 18.0, 21.0):
            result = trim_aircraft(X8, TrimPoint(airspeed))
            assert not result.has_rudder
            assert result.residual < 1e-6
            assert abs(result.placement.roll) < math.radians(1.0)

    def test_with_a_rudder_nothing_changed(self):
        assert trim_aircraft(RASCAL, LEVEL).has_rudder
        assert trim_aircraft(RASCAL, LEVEL).placement.roll == 0.0


def test_servos_that_lag_change_no_trim(tmp_path):
    """JSBSim's actuators remember: the trim waits for them, and the flight begins settled."""
    folder = changed(RASCAL, tmp_path, servo("elevator"), servo("aileron"), servo("rudder"))
    quick, slow = trim_aircraft(RASCAL, LEVEL), trim_aircraft(folder, LEVEL)
    assert slow.residual < 1e-6
    for name in CONTROLS:
        assert getattr(slow.controls, name) == pytest.approx(
            getattr(quick.controls, name), abs=1e-6
        )
    fleet = JsbsimFleet([folder], [InitialState((0.0, 0.0, -100.0))], NedOrigin(), 200)
    assert fleet.read().acceleration_ned[0] == pytest.approx([0, 0, 0], abs=1e-4)
    a, b = linearize_aircraft(folder, LEVEL).a, linearize_aircraft(RASCAL, LEVEL).a
    assert a == pytest.approx(b, abs=1e-3)


def test_an_aircraft_that_was_edited_is_read_again(tmp_path):
    folder = changed(RASCAL, tmp_path)
    model = folder / f"{folder.name}.xml"
    before = airframe(folder), trim_aircraft(folder, LEVEL)
    assert airframe(folder) is before[0] and trim_aircraft(folder, LEVEL) is before[1]
    seen, text = model.stat(), model.read_text()
    [span] = re.findall(r"<wingspan[^>]*>\s*([\d.]+)", text)
    wider = span[:-1] + ("8" if span[-1] != "8" else "9")
    model.write_text(re.sub(r"(<wingspan[^>]*>\s*)[\d.]+", rf"\g<1>{wider}", text))
    os.utime(model, ns=(seen.st_atime_ns, seen.st_mtime_ns))
    assert model.stat().st_size == seen.st_size  # as old and as long, but not the same
    after = airframe(folder), trim_aircraft(folder, LEVEL)
    assert after[0].span / before[0].span == pytest.approx(float(wider) / float(span))
    assert after[1] is not before[1]
    model.write_text(text)
    assert airframe(folder) == before[0]


class TestWind:
    @pytest.mark.parametrize(
        ("course", "wind"),
        some(product([0.0, 1.0, -2.5], [(0.0, 6.0, 0.0), (8.0, 0.0, 0.0), (-3.0, 5.0, 0.5)]), 4),
    )
    def test_the_start_is_trimmed_in_the_moving_air(self, course, wind):
        start = InitialState(
            (0.0, 0.0, -400.0), course=course, flight_path_angle=0.03, wind_ned=wind
        )
        fleet = JsbsimFleet([RASCAL], [start], NedOrigin(), 200)
        state, air = fleet.read(), fleet.air()
        assert state.airspeed[0] == pytest.approx(22.0, abs=1e-9)
        assert air.wind_ned[0] == pytest.approx(wind, abs=1e-12)
        through_air = state.velocity_ned[0] - wind
        assert np.linalg.norm(through_air) == pytest.approx(22.0, abs=1e-6)
        assert -through_air[2] == pytest.approx(22.0 * math.sin(0.03), abs=1e-6)
        track = math.atan2(state.velocity_ned[0, 1], state.velocity_ned[0, 0])
        assert track == pytest.approx(course, abs=1e-9)
        assert air.alpha[0] == pytest.approx(fleet.trims[0].alpha, abs=1e-9)
        assert air.beta[0] == pytest.approx(fleet.trims[0].beta, abs=1e-9)
        # What is left is Earth's rotation, 2 Ω × v: the trim is that of northward flight.
        assert state.acceleration_ned[0] == pytest.approx([0, 0, 0], abs=4.5e-3)
        fleet.step(fleet.trimmed, 200)
        later = fleet.read()
        assert later.euler[0] == pytest.approx(state.euler[0], abs=2e-3)
        assert later.velocity_ned[0] == pytest.approx(state.velocity_ned[0], abs=0.05)
        assert fleet.air().wind_ned[0] == pytest.approx(wind, abs=1e-12)

    def test_a_crosswind_crabs_by_hand(self):
        """6 m/s from the left at 22 m/s: the nose points asin(6/22) = 15.83° into it."""
        start = InitialState((0.0, 0.0, -400.0), wind_ned=(0.0, 6.0, 0.0))
        fleet = JsbsimFleet([RASCAL], [start], NedOrigin(), 200)
        state = fleet.read()
        assert math.degrees(state.euler[0, 2]) == pytest.approx(-15.83, abs=0.02)
        assert state.velocity_ned[0] == pytest.approx([math.sqrt(22.0**2 - 36.0), 0, 0], abs=1e-6)

    def test_air_that_does_nothing_is_still_air_to_the_bit(self):
        start = InitialState((0.0, 0.0, -100.0), course=1.0, bank=0.2)
        one = JsbsimFleet([RASCAL], [start], NedOrigin(), 200)
        two = JsbsimFleet([RASCAL], [start], NedOrigin(), 200)
        two.set_wind(WindInput(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1)))
        for fleet in (one, two):
            fleet.step(fleet.trimmed, 100)
        for ours, theirs in zip(one.read(), two.read(), strict=True):
            assert np.array_equal(ours, theirs)

    def test_a_storm_is_refused(self):
        for wind in ((0.0, 23.0, 0.0), (-22.0, 0.0, 0.0)):
            start = InitialState((0.0, 0.0, -400.0), wind_ned=wind)
            with pytest.raises(TrimError, match="cannot fly a course"):
                JsbsimFleet([RASCAL], [start], NedOrigin(), 200)


class TestInertia:
    def test_no_rigid_body_has_the_published_x8_set(self, tmp_path):
        numbers = {"ixx": 1.229, "iyy": 0.1702, "izz": 0.8808, "ixz": 0.9343}
        folder = changed(
            RASCAL,
            tmp_path,
            *(
                (
                    rf'<{name} unit="SLUG\*FT2"> .*? </{name}>',
                    f'<{name} unit="KG*M2"> {n} </{name}>',
                )
                for name, n in numbers.items()
            ),
        )
        # By hand: the pair x, z has 1.0549 ± √(0.1741² + 0.9343²) = 0.1045 and 2.0053. The tank
        # adds 0.0137 to Jxx and Jyy.
        with pytest.raises(AircraftError) as error:
            trim_aircraft(folder, LEVEL)
        text = str(error.value)
        assert f"{folder / 'rascal110.xml'}: mass_balance" in text
        assert "J1 + J2 ≥ J3 fails: 0.29" in text
        assert "< 2.01" in text
        with pytest.raises(AircraftError, match="J1 \\+ J2"):
            JsbsimFleet([folder], [InitialState((0.0, 0.0, -100.0))], NedOrigin(), 200)

    def test_a_negative_moment_is_refused(self, tmp_path):
        folder = changed(RASCAL, tmp_path, (r"<ixz .*?</ixz>", '<ixz unit="SLUG*FT2"> 2.5 </ixz>'))
        with pytest.raises(AircraftError, match="J1 > 0 fails"):
            trim_aircraft(folder, LEVEL)


def modes_of(folder, point):
    return {mode.name: mode for mode in find_modes(linearize_aircraft(folder, point, HIGH).a)}


class TestModes:
    def test_the_roll_damping_is_the_published_one(self):
        linear = linearize_aircraft(RASCAL, LEVEL, HIGH)
        damping = PRESSURE * AREA * SPAN * (SPAN / 44.0) * -0.40 / IXX  # q̄ S b (b/2V) Clp / Ixx
        p = STATES.index("p")
        assert linear.a[p, p] == pytest.approx(damping, rel=2e-3)
        roll = modes_of(RASCAL, LEVEL)["roll"]
        assert roll.eigenvalue.real == pytest.approx(damping, rel=0.04)  # it slips a little

    def test_the_short_period_by_its_approximation(self):
        """ω² = M_q Z_w − M_α and 2 ζ ω = −(M_q + Z_w + M_α̇), from the published derivatives."""
        lift_slope = 5.0 + 0.03  # CLα, and CD: the force is across the flow
        arm = 1.0 / 13.8  # the aerodynamic reference lies an inch behind the centre of gravity
        moment = PRESSURE * AREA * CHORD / IYY
        m_alpha = moment * (-0.5 - lift_slope * arm)
        m_q = moment * (CHORD / 44.0) * -12.0
        m_alphadot = moment * (CHORD / 44.0) * -7.0
        z_w = -PRESSURE * AREA * lift_slope / (MASS * 22.0)
        frequency = math.sqrt(m_q * z_w - m_alpha)
        damping = -(m_q + z_w + m_alphadot) / (2.0 * frequency)
        mode = modes_of(RASCAL, LEVEL)["short period"]
        assert mode.frequency == pytest.approx(frequency, rel=0.03)
        assert mode.damping == pytest.approx(damping, rel=0.03)

    def test_lanchesters_phugoid(self):
        """√2 g/V where static stability dwarfs pitch damping, as on the X8; within 15 %."""
        for airspeed in (14.0, 18.0):
            phugoid = modes_of(X8, TrimPoint(airspeed))["phugoid"]
            assert phugoid.frequency == pytest.approx(math.sqrt(2.0) * 9.80665 / airspeed, rel=0.15)

    @pytest.mark.parametrize("folder", [RASCAL, X8], ids=lambda folder: folder.name)
    def test_every_mode_has_a_name(self, folder):
        names = {"short period", "phugoid", "roll", "Dutch roll", "spiral", "propeller"}
        assert set(modes_of(folder, TrimPoint(18.0))) == names

    def test_controls_do_what_was_published(self):
        linear = linearize_aircraft(RASCAL, LEVEL, HIGH)
        aileron = PRESSURE * AREA * SPAN * 0.1273 * 0.35 / IXX  # Clδa, 0.35 rad of travel
        assert linear.b[STATES.index("p"), 0] == pytest.approx(aileron, rel=5e-3)

    def test_free_flight_has_the_same_modes(self):
        """A kick and then fixed controls, by Prony's method; JSBSim knows α̇ a step late."""
        modes = modes_of(RASCAL, LEVEL)
        airspeed = free_flight("elevator", 40.0)[60::10, 0] - 22.0
        assert_prony(airspeed, 0.5, 3, modes["phugoid"].eigenvalue, 0.02)
        with pytest.raises(AssertionError):  # that of a flight 4 % slower
            assert_prony(airspeed, 0.5, 3, 1.04 * modes["phugoid"].eigenvalue, 0.02)
        yaw_rate = free_flight("rudder", 5.0)[:, 1]
        assert_prony(yaw_rate, 0.05, 4, modes["Dutch roll"].eigenvalue, 0.03)
        assert_prony(yaw_rate, 0.05, 4, modes["spiral"].eigenvalue, 0.03)


def free_flight(control, seconds):
    """Airspeed and yaw rate (k, 2) every 0.05 s after a fifth of a second of a control."""
    start = InitialState((0.0, 0.0, -1000.0))
    fleet = JsbsimFleet([RASCAL], [start], HIGH, 200)
    level = fleet.trimmed
    fleet.step(ActuatorCommand(**(level._asdict() | {control: getattr(level, control) + 0.02})), 40)
    rows = []
    for _ in range(round(seconds / 0.05)):
        fleet.step(level, 10)
        state = fleet.read()
        rows.append((state.airspeed[0], state.rates_body[0, 2]))
    return np.array(rows)


def assert_prony(signal, dt, order, expected, tolerance):
    """The sum of `order` exponentials that fits a signal has one of the expected exponent."""
    table = np.array([signal[i : i + order] for i in range(len(signal) - order)])
    factors = np.linalg.lstsq(table, signal[order:], rcond=None)[0]
    exponents = np.log(np.roots([1.0, *-factors[::-1]]).astype(complex)) / dt
    nearest = exponents[np.abs(exponents - expected).argmin()]
    assert abs(nearest - expected) < tolerance * abs(expected)


@cache
def pure_step():
    """Step of 0.2 m/s of level flight with throttle by feed-forward and P, and its profile."""
    firm = load_middle_loop(RASCAL, "rms").flight_path  # holds level flight best
    profile = load_middle_loop(RASCAL, "authors")
    speed = profile.speed.model_copy(update={"i": 0.0})
    pure = profile.model_copy(update={"speed": speed, "flight_path": firm})
    params = read_params(RASCAL / "autopilot.param")
    return pure, speed_step(RASCAL, pure, params, airspeed=22.0, step=0.2)


def test_speed_model_equals_the_linear_aircraft():
    """Level flight with throttle by feed-forward and P: one pole, X_T (dη/dV + k_sp).

    X_T is the acceleration by throttle, dη/dV the slope of the throttle that level flight needs.
    """
    pure, flown = pure_step()
    linear = linearize_aircraft(RASCAL, LEVEL, HIGH)
    u, n, throttle = STATES.index("u"), STATES.index("n"), CONTROLS.index("throttle")
    # The propeller, at 9 per second, follows at once.
    thrust = -linear.a[u, n] * linear.b[n, throttle] / linear.a[n, n]
    slow, fast = (
        trim_aircraft(RASCAL, TrimPoint(airspeed, altitude=400.0)).controls.throttle
        for airspeed in (21.8, 22.2)
    )
    pole = thrust * ((fast - slow) / 0.4 + pure.speed.p)
    assert flown.free.pole == pytest.approx(pole, rel=0.03)
    # It climbs by 0.1 m while the integral of (19) finds the new incidence, which costs speed.
    climbing = GRAVITY * flown.altitude_change / (flown.time[-1] * 22.0)
    gain = ((pure.eta_speed + pure.speed.p) * thrust - climbing / 0.2) / pole
    assert flown.free.gain == pytest.approx(gain, rel=0.03)
    assert flown.free.rms < 0.01
    assert flown.limited_s == 0.0


def test_a_step_that_cannot_be_flown_says_so():
    profile = load_middle_loop(RASCAL, "tuned")
    params = read_params(RASCAL / "autopilot.param")
    for step in (0.0, -22.0, math.nan):
        with pytest.raises(InputError, match="write 0.1 m/s or more"):
            speed_step(RASCAL, profile, params, airspeed=22.0, step=step)


MODES = TestModes()
CLP = r"(aero/p-relative-rad_sec </property> <value>) -0.40"
CMQ = r"(aero/q-relative-rad_sec </property> <value>) -12"
AILERON = r"(fcs/left-aileron-pos-rad </property> <value>) 0.1273"


@pytest.mark.parametrize(
    ("change", "test"),
    [
        pytest.param(
            (CLP, r"\1 -0.41"), MODES.test_the_roll_damping_is_the_published_one, id="Clp"
        ),
        pytest.param((CMQ, r"\1 -15"), MODES.test_the_short_period_by_its_approximation, id="Cmq"),
        pytest.param((AILERON, r"\1 0.13"), MODES.test_controls_do_what_was_published, id="Clda"),
    ],
)
def test_modes_with_a_wrong_derivative_are_found(monkeypatch, tmp_path, change, test):
    monkeypatch.setattr(sys.modules[__name__], "RASCAL", changed(RASCAL, tmp_path, change))
    with pytest.raises(AssertionError):
        test()


def test_start_without_the_wind_triangle_is_found(monkeypatch):
    """The nose along the course in a crosswind."""
    monkeypatch.setattr(fleet_module, "course_through_air", lambda speed, course, wind: course)
    with pytest.raises(AssertionError):
        TestWind().test_a_crosswind_crabs_by_hand()


def test_speed_model_of_other_thrust_is_found(monkeypatch):
    linear = linearize_aircraft(RASCAL, LEVEL, HIGH)
    stronger = replace(linear, b=1.1 * linear.b)

    monkeypatch.setattr(sys.modules[__name__], "linearize_aircraft", lambda *_: stronger)
    with pytest.raises(AssertionError):
        test_speed_model_equals_the_linear_aircraft()


class TestCommands:
    def run(self, *arguments):
        return CliRunner().invoke(app, arguments, catch_exceptions=True)

    def test_trim_prints_table_and_json(self):
        done = self.run("trim", "rascal110", "--airspeed", "20", "--bank", "30", "--json", "-")
        assert done.exit_code == 0
        document = json.loads(done.stdout)
        assert document["load_factor"] == pytest.approx(1.0 / math.cos(math.radians(30)), rel=1e-6)
        assert document["turn_radius_m"] == pytest.approx(
            20.0**2 / (GRAVITY * math.tan(math.radians(30.0))), rel=1e-6
        )
        assert document["residual"] < 1e-6
        check_snapshot("trim", done.stderr)

    def test_narrow_terminal_cuts_no_number(self, monkeypatch):
        monkeypatch.setenv("COLUMNS", "60")
        for command in ("trim", "linearize"):
            done = self.run(command, "rascal110", "--airspeed", "22")
            assert done.exit_code == 0 and "…" not in done.stdout
        assert "-0.090 ± 0.351i  0.362  0.248    11.154" in done.stdout

    def test_linearize_prints_modes_and_json(self, tmp_path):
        path = tmp_path / "modes.json"
        done = self.run("linearize", "skywalker_x8", "--airspeed", "18", "--json", str(path))
        assert done.exit_code == 0
        check_snapshot("linearize", done.stdout)
        assert max(map(len, done.stdout.splitlines())) <= 80
        document = json.loads(path.read_text(encoding="utf-8"))
        values = np.linalg.eigvals(np.array(document["a"]))
        for mode in document["modes"]:
            assert np.abs(values - complex(*mode["eigenvalue_per_s"])).min() < 1e-9
        assert document["trim"]["rudder"] is None

    def test_step_prints_models_and_json(self):
        done = self.run("step", "rascal110", "--profile", "authors", "--json", "-")
        assert done.exit_code == 0
        document = json.loads(done.stdout)
        assert document["airspeed_mps"] == 22.0
        assert document["paper_poles_per_s"] == {
            "Rascal 110, simulation": 0.64,
            "Skywalker X8, flight": 0.4,
        }
        assert 0.2 < document["model_with_free_gain"]["pole_per_s"] < 0.4
        assert len(document["time_s"]) == len(document["ground_speed_mps"])
        assert document["throttle_limited_s"] == 0.0
        check_snapshot("step", done.stderr)

    def test_step_with_limited_throttle_warns(self, monkeypatch):
        """A line where the throttle is at a limit for more than 2 of the 20 s."""
        flown = []

        def fly(*arguments, **options):
            flown.append(speed_step(*arguments, **options))
            return flown[-1]

        name = "testbed.commissioning.speed_step.speed_step"
        monkeypatch.setattr(name, fly)
        done = self.run("step", "skywalker_x8", "--step", "6")
        check_snapshot("step_limited", done.stdout)
        monkeypatch.setattr(name, lambda *_, **__: replace(flown[0], limited_s=1.2))
        done = self.run("step", "skywalker_x8", "--step", "4")
        assert " throttle at a limit      1.20 s" in done.stdout
        assert "that of the motor" not in done.stdout

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            # at 5 m/s a dozen other airspeeds are tried in vain
            (("trim", "rascal110", "--airspeed", "5" if ALL else "8.8"), "no steady flight"),
            (("trim", "rascal110", "--airspeed", "nan"), "--airspeed"),
            (("trim", "nothing", "--airspeed", "20"), "no aircraft"),
            (
                ("trim", "rascal110", "--airspeed", "22", "--altitude", "-431"),
                "write -430 to 11000",
            ),
            (("trim", "rascal110", "--airspeed", "22", "--altitude", "11001"), "--altitude 11001"),
            (("linearize", "rascal110", "--airspeed", "22", "--altitude", "-1e4"), "--altitude"),
            (("linearize", "rascal110", "--airspeed", "-3"), "airspeed must be positive"),
            (("step", "rascal110", "--profile", "nope"), "no profile"),
            (("step", "rascal110", "--step", "0"), "0.1 m/s"),
            (("trim", "rascal110", "--airspeed", "20", "--json", "/no/x.json"), "no folder"),
        ],
    )
    def test_bad_input_error_has_the_remedy(self, arguments, words):
        done = self.run(*arguments)
        assert isinstance(done.exception, InputError)  # which main() turns into exit code 2
        assert words in str(done.exception)
