"""Broken aircraft against second routes: power, moments, circuits and linear motion by hand.

The coefficients are those of aircraft/rascal110/rascal110.xml and of Gryte et al. for the
Skywalker X8, written out here again, with the tables of the two propellers.
"""

import math

import numpy as np
import pytest
from cases import some
from places import ROOT
from scipy.linalg import expm
from scipy.optimize import brentq

from testbed.autopilot.parameters import make_gains, read_params
from testbed.core.call_list import run_steps
from testbed.core.errors import InputError
from testbed.core.frames import FOOT
from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    FbwaCommand,
    NedOrigin,
    VehicleState,
    WindInput,
    allocate,
    fields_of,
    write_fields,
)
from testbed.flight.faults import no_faults
from testbed.flight.vehicles import JsbsimVehicles, UnicycleVehicles
from testbed.vehicle import control_surfaces
from testbed.vehicle.control_surfaces import SURFACES
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import linearize_aircraft
from testbed.vehicle.linearize import STATES
from testbed.vehicle.trim import InitialState, TrimPoint
from testbed.vehicle.unicycle import make_unicycles

FOLDERS = ROOT / "aircraft"
RASCAL, X8 = FOLDERS / "rascal110", FOLDERS / "skywalker_x8"
PERIOD, TICKS = 0.02, 4  # s, of the autopilot, and steps of the base rate in it
GRAVITY = 9.800  # m/s², at 38° N
LEFT, RIGHT = SURFACES.index("left-elevon"), SURFACES.index("right-elevon")


def period_of(vehicles):
    """The steps of one period of the autopilots, and of what has failed."""
    steps = vehicles.fault_steps(floating=True)
    return *vehicles.autopilot_steps, *steps, *vehicles.output_steps


class Flight:
    """Aircraft behind their autopilots, and their rows of the records of a run."""

    def __init__(self, fleet, gains, aircraft=None, rows=None):
        n = len(fleet.trims)
        self.aircraft = allocate(AIRCRAFT, n) if aircraft is None else aircraft
        self.rows = np.arange(n) if rows is None else np.array(rows)
        self.fleet, self.vehicles = fleet, JsbsimVehicles(fleet, gains, self.aircraft, self.rows)
        self._period = period_of(self.vehicles)

    def _copied(self, kind, name):
        records = fields_of(kind, self.aircraft[name])
        return kind(*(each[self.rows] for each in records))

    def read(self):
        return self._copied(VehicleState, "truth")

    def air(self):
        return self.fleet.air()

    @property
    def surfaces(self):
        return self._copied(ActuatorCommand, "surfaces")

    def control(self, estimate, command, failing):
        """One period of the autopilots, and of what has failed."""
        aircraft = self.aircraft
        write_fields(aircraft["estimate"], estimate)
        write_fields(aircraft["command"], command)
        write_fields(aircraft["faults"], failing)
        run_steps(self._period, 0.0)

    def control_again(self):
        """One more period with the same command and faults, by the truth."""
        self.aircraft["estimate"] = self.aircraft["truth"]
        run_steps(self._period, 0.0)

    def step(self, ticks):
        self.vehicles.step(ticks, None)

    def blow(self, wind):
        write_fields(self.aircraft["wind"], wind)
        for step in self.vehicles.wind_steps:
            step(0.0)

    def lost(self):
        return self.fleet.lost(self.read())

    def remove(self, lost):
        self.vehicles.remove(lost)


def flown(*folders, airspeed, altitude=400.0, apart=50.0):
    starts = [
        InitialState((0.0, i * apart, -altitude), airspeed=airspeed) for i in range(len(folders))
    ]
    fleet = JsbsimFleet(folders, starts, NedOrigin(), 200)
    tunes = [read_params(folder / "autopilot.param") for folder in folders]
    return Flight(fleet, make_gains(tunes, PERIOD))


def inside(vehicles, row=0):
    """JSBSim itself, to ask it what the testbed does not."""
    return vehicles.fleet.bare_runs()[row].__self__


def told(roll_deg, pitch_deg, throttle, n=1):
    return FbwaCommand(
        pitch=np.full(n, math.radians(pitch_deg)),
        roll=np.full(n, math.radians(roll_deg)),
        throttle=np.full(n, float(throttle)),
    )


def fly(vehicles, failing, command, seconds, each=None):
    for number in range(round(seconds / PERIOD)):
        if number:
            vehicles.control_again()
        else:
            vehicles.control(vehicles.read(), command, failing)
        vehicles.step(TICKS)
        if each is not None:
            each()


def hung(n=1):
    """Servos keep what trims the aircraft: flight with fixed controls."""
    return no_faults(n)._replace(frozen=np.ones(n, dtype=bool))


def density(height):
    """Of the standard atmosphere, kg/m³, at a height in m above the origin's 300 m."""
    return 1.225 * (1.0 - 0.0065 * (300.0 + height) / 288.15) ** 4.2559


class Rascal:
    MASS, AREA, SPAN, DIAMETER = 14.5 * 0.45359237, 10.57 * FOOT**2, 9.17 * FOOT, 18 * 0.0254
    ADVANCE = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.4]
    THRUST = "776 744 712 655 588 518 419 318 172 -58 -549"
    POWER = "902 893 880 860 810 742 681 572 467 167 -803"

    @staticmethod
    def lift(alpha, down):
        return 0.25 + 5.0 * alpha + 0.2 * down

    @staticmethod
    def drag(alpha, beta, down):
        lift = Rascal.lift(alpha, down)
        form = 0.028 + (0.028 * abs(alpha) + 0.05 * abs(beta)) / 0.26
        return form + 0.04 * lift**2 + 0.03 / 0.09 * down**2

    @staticmethod
    def elevator_down(surfaces):
        up = surfaces.elevator[0]
        return -0.35 * up if up > 0.0 else -0.30 * up

    @staticmethod
    def shaft(throttle, rps, charge):
        return 2207.27 * throttle


class Skywalker:
    MASS, AREA, SPAN, DIAMETER = 3.364, 0.75, 2.10, 14 * 0.0254
    ADVANCE = [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.9, 1.0, 1.4]
    THRUST = "1050 1005 935 835 695 505 272 125 -25 -130 -190 -265 -330 -550"
    POWER = "460 470 475 460 428 362 257 180 92 10 -55 -140 -200 -360"

    @staticmethod
    def lift(alpha, down):
        return 0.0867 + 4.0203 * alpha + 0.2781 * down

    @staticmethod
    def drag(alpha, beta, down):
        slipping = -0.00584 * beta + 0.14781 * beta**2
        return 0.01970 + 0.07909 * alpha + 1.05547 * alpha**2 + slipping + 0.06335 * down**2

    @staticmethod
    def elevator_down(surfaces):
        return -math.radians(35.0) * surfaces.elevator[0]

    @staticmethod
    def shaft(throttle, rps, charge):
        """Four cells behind 30 mΩ, an ESC, 40 mΩ, 450 rpm/V, and 1 A that the motor turns for."""
        cell = np.interp(charge, [0.05, 0.10, 0.20, 0.90, 1.00], [3.50, 3.65, 3.73, 4.08, 4.20])
        back = 60.0 * rps / 450.0
        current = max(0.0, throttle * 4.0 * cell - back) / (0.04 + 0.03 * throttle**2)
        return (current - 1.0) * back


def thrust(kind, airspeed, rho, throttle, charge):
    """N, at the speed at which the propeller takes what the shaft gives."""

    def coefficient(text, rps):
        table = [float(number) * 1e-4 for number in text.split()]
        return np.interp(airspeed / (rps * kind.DIAMETER), kind.ADVANCE, table)

    def left(rps):
        taken = coefficient(kind.POWER, rps) * rho * rps**3 * kind.DIAMETER**5
        return kind.shaft(throttle, rps, charge) - taken

    rps = brentq(left, airspeed / (1.4 * kind.DIAMETER), 200.0)
    return coefficient(kind.THRUST, rps) * rho * rps**2 * kind.DIAMETER**4


def test_windmilling_drag_is_that_of_the_docs() -> None:
    """1.1 N for the Rascal at 19 m/s and 1.4 N for the X8 at 18 m/s."""
    drag = [
        -thrust(kind, airspeed, density(100.0), 0.0, 1.0)
        for kind, airspeed in ((Rascal, 19.0), (Skywalker, 18.0))
    ]
    rascal, x8 = (f"{each:.1f} N" for each in drag)
    assert f"{rascal} on the\nRascal at 19 m/s" in control_surfaces.__doc__
    assert f"{x8} on the X8 at\n18 m/s" in control_surfaces.__doc__
    faults = (FOLDERS.parent / "docs" / "faults.md").read_text()
    assert f"{rascal} on the Rascal at 19 m/s" in faults


def climb(kind, airspeed, rho, beta, down, pull):
    """m/s, of steady straight flight: lift and drag carry the weight with this thrust, N."""
    pressure, weight = 0.5 * rho * airspeed**2 * kind.AREA, kind.MASS * GRAVITY
    gamma = 0.0
    for _ in range(20):

        def sinking(alpha, gamma=gamma):
            lift = pressure * kind.lift(alpha, down) + pull * math.sin(alpha)
            return lift - weight * math.cos(gamma)

        alpha = brentq(sinking, -0.15, 0.2)
        along = pull * math.cos(alpha) - pressure * kind.drag(alpha, beta, down)
        gamma = math.asin(along / weight)
    return airspeed * math.sin(gamma)


@pytest.mark.parametrize(
    ("kind", "folder", "fault", "pitch_deg", "throttle", "left"),
    [
        *some(
            [
                (Rascal, RASCAL, {"power": 0.0}, -3.0, 0.5, 0.0),  # about its best glide
                (Skywalker, X8, {"power": 0.0}, -2.0, 0.7, 0.0),
                (Rascal, RASCAL, {}, 3.0, 0.5, 0.5),
                (Rascal, RASCAL, {"power": 0.5}, 3.0, 0.5, 0.25),
                (Skywalker, X8, {"power": 0.8}, 3.0, 1.0, 0.8),
            ],
            3,
        ),
        (Skywalker, X8, {"charge": 0.1}, 3.0, 1.0, 1.0),
    ],
)
def test_climb_and_sink_balance_power(kind, folder, fault, pitch_deg, throttle, left) -> None:
    """(T − D) V / (m g) with the thrust of the propeller that takes what the shaft gives."""
    vehicles = flown(folder, airspeed=18.0, altitude=500.0)
    failing, command, track = no_faults(1), told(0.0, pitch_deg, throttle), []
    for name, value in fault.items():
        getattr(failing, name)[:] = value

    def note():
        state = vehicles.read()
        track.append((state.airspeed[0], -state.position_ned[0, 2]))

    fly(vehicles, failing, command, 22.0)
    fly(vehicles, failing, command, 2.0, note)
    (first, low), (last, high) = track[0], track[-1]
    gained = high - low + (last**2 - first**2) / (2.0 * GRAVITY)
    energy = gained / (PERIOD * (len(track) - 1))  # what it would climb at this airspeed
    airspeed, height = np.mean(track, axis=0)
    air, down = vehicles.air(), kind.elevator_down(vehicles.surfaces)
    charge = air.state_of_charge[0]
    pull = thrust(kind, airspeed, density(height), left, charge)
    expected = climb(kind, airspeed, density(height), air.beta[0], down, pull)
    shown = inside(vehicles)["propulsion/engine/thrust-lbs"] * 4.4482216152605
    # Half of the power is worth 0.9 m/s to the Rascal, a full battery 1.2 m/s to the X8. What is
    # left is the propeller's lag while the airspeed drifts, 0.01 m/s, and the X8's current of now.
    assert shown == pytest.approx(pull, abs=0.03)
    assert energy == pytest.approx(expected, abs=0.02)


def test_a_stuck_aileron_rolls_as_published() -> None:
    """p = −(2 V / b) (Clδ δ + Clβ β + Clr r b / 2 V) / Clp a second later, all but steady."""
    for folder, span, clp, cld, clb, clr, travel, airspeed in (
        # the Rascal's side force acts 0.086 m below its centre of gravity
        (RASCAL, Rascal.SPAN, -0.40, 0.1273, -0.10 + 0.086 / Rascal.SPAN, 0.15, 0.35, 22.0),
        (X8, Skywalker.SPAN, -0.4042, 0.12019, -0.0849, 0.05552, math.radians(35.0), 18.0),
    ):
        vehicles, failing = flown(folder, airspeed=airspeed), hung()
        level, beta = vehicles.surfaces, vehicles.air().beta[0]
        if folder is RASCAL:
            failing.stuck[0, 0], failing.stuck_at[0, 0] = True, level.aileron[0] + 0.05
        else:  # the left elevon lower by 0.1 is an aileron of 0.05
            low = level.elevator[0] - level.aileron[0] - 0.10
            failing.stuck[0, LEFT], failing.stuck_at[0, LEFT] = True, low
        fly(vehicles, failing, told(0.0, 0.0, 0.0), 1.0)
        state, air = vehicles.read(), vehicles.air()
        rolling = cld * 0.05 * travel + clb * (air.beta[0] - beta)
        rolling += clr * state.rates_body[0, 2] * span / (2.0 * state.airspeed[0])
        expected = -2.0 * state.airspeed[0] / span * rolling / clp
        # The roll is not quite steady, and the propeller's torque follows the airspeed, which the
        # X8's stuck elevon changes too: 2 % of the roll rate. Without sideslip it would be 25 %.
        assert expected > 0.05
        assert state.rates_body[0, 0] == pytest.approx(expected, rel=0.03)


def test_floating_elevons_trim_at_zero_moment() -> None:
    """Cm0 + (Cmα − 0.3 Cmδ) α = 0, without thrust: the airspeed follows from the lift there."""
    vehicles, failing = flown(X8, airspeed=18.0, altitude=600.0), hung()
    failing.power[:] = 0.0
    failing.floating[0, [LEFT, RIGHT]], failing.floats[0, [LEFT, RIGHT]] = True, 0.3
    track = []

    def note():
        state, air = vehicles.read(), vehicles.air()
        track.append((air.alpha[0], state.airspeed[0], -state.position_ned[0, 2]))

    fly(vehicles, failing, told(0.0, 0.0, 0.0), 40.0, note)
    # the phugoid has shrunk to 0.2 m/s; its period is 9 s
    alpha, airspeed, height = np.mean(track[-450:], axis=0)
    expected = 0.02275 / (0.4629 - 0.3 * 0.2292)
    # the drop's Cmq q and the half-damped phugoid: 0.5 %
    assert alpha == pytest.approx(expected, rel=0.005)
    lift = Skywalker.lift(expected, -0.3 * expected) * 0.5 * density(height) * Skywalker.AREA
    assert airspeed == pytest.approx(math.sqrt(Skywalker.MASS * GRAVITY / lift), rel=0.01)
    held = vehicles.surfaces.elevator[0] * math.radians(35.0)
    assert held == pytest.approx(0.3 * vehicles.air().alpha[0], abs=1e-3)


def motion(vehicles):
    """The states of `linearize.STATES`."""
    state, air = vehicles.read(), vehicles.air()
    (v,), (alpha,), (beta,) = state.airspeed, air.alpha, air.beta
    p, q, r = state.rates_body[0]
    roll, pitch, _ = state.euler[0]
    u, w = v * math.cos(alpha) * math.cos(beta), v * math.sin(alpha) * math.cos(beta)
    return np.array([u, w, q, pitch, air.propeller_rps[0], v * math.sin(beta), p, r, roll])


@pytest.mark.parametrize(
    ("folder", "airspeed", "roll_deg", "pitch_deg", "names"),
    [
        (RASCAL, 22.0, 2.0, 0.0, ("v", "p", "r", "phi")),
        (X8, 18.0, 2.0, 0.0, ("v", "r", "phi")),
        (X8, 18.0, 0.0, 1.0, ("u", "w", "theta")),
    ],
)
def test_a_frozen_autopilot_leaves_the_free_motion(
    folder, airspeed, roll_deg, pitch_deg, names
) -> None:
    """ẋ = A x + B u from where the autopilot froze, with u what it held then; told to turn hard."""
    vehicles = flown(folder, airspeed=airspeed)
    trim, rest, level = vehicles.fleet.trims[0], motion(vehicles), np.array(vehicles.surfaces)
    roll, pitch = np.degrees([trim.placement.roll, trim.placement.pitch])
    wanted = told(roll + roll_deg, pitch + pitch_deg, trim.controls.throttle)
    fly(vehicles, no_faults(1), wanted, 0.3)
    held, first = vehicles.surfaces, motion(vehicles) - rest
    moved = np.array(held).ravel() - level.ravel()
    linear = linearize_aircraft(folder, TrimPoint(airspeed, altitude=700.0))
    system = np.zeros((13, 13))
    system[:9, :9], system[:9, 9:] = linear.a, linear.b
    begun, step, track, free = np.concatenate([first, moved]), expm(system * PERIOD), [], []

    def note():
        track.append(motion(vehicles) - rest)
        free.append((np.linalg.matrix_power(step, len(track)) @ begun)[:9])

    fly(vehicles, hung(), told(40.0, 10.0, 1.0), 3.0, note)
    assert all(np.array_equal(now, then) for now, then in zip(vehicles.surfaces, held, strict=True))
    # What is not linear in 2° of bank, and on the X8 its servos' lag of 0.04 s: 2 %, and of u and θ
    # 4 %, for the pitch law lowers the nose with the throttle and the upset is larger.
    for name in names:
        column = STATES.index(name)
        ours, theirs = np.array(track)[:, column], np.array(free)[:, column]
        assert ours == pytest.approx(theirs, abs=0.05 * np.abs(theirs).max())


def test_autopilot_resumes_after_a_freeze() -> None:
    """Handed the same estimates, it says after a second of silence what it would have said."""
    hanging, awake = (flown(RASCAL, X8, airspeed=20.0) for _ in range(2))
    estimate, wanted = awake.read(), told(20.0, 1.0, 0.6, 2)
    one = no_faults(2)
    one.frozen[0] = True
    for _ in range(20):
        for each in (hanging, awake):
            each.control(estimate, wanted, no_faults(2))
    said = hanging.surfaces
    for _ in range(50):
        hanging.control(estimate, told(-30.0, 0.0, 0.3, 2), one)  # it does not hear this either
        assert [part[0] for part in hanging.surfaces] == [part[0] for part in said]
    for _ in range(3):
        for each in (hanging, awake):
            each.control(estimate, wanted, no_faults(2))
        assert [part[0] for part in hanging.surfaces] == [part[0] for part in awake.surfaces]
        assert hanging.surfaces.elevator[1] != awake.surfaces.elevator[1]  # it went on meanwhile
    assert hanging.surfaces.elevator[0] != said.elevator[0]


def test_a_battery_drops_and_goes_on_from_there() -> None:
    vehicles = flown(X8, X8, airspeed=18.0)
    wanted, failing = told(0.0, 2.0, 0.7, 2), no_faults(2)
    fly(vehicles, failing, wanted, 2.0)
    before = vehicles.air().state_of_charge.copy()
    failing.charge[0] = 0.4
    fly(vehicles, failing, wanted, PERIOD)
    dropped = vehicles.air().state_of_charge.copy()
    # of 10 Ah, less than 30 A in a period
    assert 0.4 - 30.0 * PERIOD / 3600.0 / 10.0 < dropped[0] < 0.4
    assert vehicles.air().battery_voltage[0] < 4.0 * 3.80 < vehicles.air().battery_voltage[1]
    assert 0.99 < dropped[1] < before[1]
    fly(vehicles, no_faults(2), wanted, 3.0)  # until the current is steady
    full, drawn = vehicles.air().state_of_charge[0], []

    def note():
        drawn.append(inside(vehicles)["battery/current-a"])

    fly(vehicles, no_faults(2), wanted, 3.0, note)
    gone = full - vehicles.air().state_of_charge[0]
    # sampled once in a period, within which it changes by less
    assert gone == pytest.approx(np.sum(drawn) * PERIOD / 3600.0 / 10.0, rel=1e-3)
    now = vehicles.air().state_of_charge.copy()
    vehicles.fleet.discharge(np.array([0.9, np.nan]))  # it is not filled
    vehicles.step(1)
    assert (vehicles.air().state_of_charge < now).all()


def test_a_stuck_elevon_stands_still_in_the_aircraft() -> None:
    vehicles, failing = flown(X8, airspeed=18.0), no_faults(1)
    fly(vehicles, failing, told(0.0, 2.0, 0.7), 1.0)
    failing.stuck[0, LEFT] = True
    fly(vehicles, failing, told(10.0, 2.0, 0.7), 1.0)  # its servo's lag is over
    left, right = [], []

    def note():
        left.append(inside(vehicles)["fcs/left-elevon-pos-rad"])
        right.append(inside(vehicles)["fcs/right-elevon-pos-rad"])

    fly(vehicles, failing, told(-10.0, 0.0, 0.7), 1.0, note)
    assert np.ptp(left) < 1e-9
    assert np.ptp(right) > 0.02


def test_fault_of_a_missing_part_is_refused() -> None:
    class Fault:
        kind, surface = "surface-stuck", "left-elevon"

    class Battery:
        kind = "battery-low"

    fleet = flown(RASCAL, X8, airspeed=20.0).fleet
    assert fleet.geometry.fitted.tolist() == [[True] * 3 + [False] * 2, [False] * 3 + [True] * 2]
    # the models' own numbers: 0.35 rad, the elevator 0.30 rad down, elevons 35°
    assert fleet.geometry.up[0, :3] == pytest.approx([0.35, 0.35, 0.35], rel=1e-12)
    assert fleet.geometry.down[0, :3] == pytest.approx([0.35, 0.30, 0.35], rel=1e-12)
    assert fleet.geometry.up[1, 3:] == pytest.approx(math.radians(35.0), rel=1e-8)
    assert fleet.geometry.mixing[1] == 1.0
    fleet.check_faults(1, "uav2", [Fault(), Battery()])
    with pytest.raises(InputError, match="uav1: .* one of aileron, elevator, rudder"):
        fleet.check_faults(0, "uav1", [Fault()])
    with pytest.raises(InputError, match="uav1: fault battery-low: rascal110 has no battery"):
        fleet.check_faults(0, "uav1", [Battery()])


def test_lost_aircraft_stays_and_others_fly_on() -> None:
    pair, other = flown(RASCAL, X8, airspeed=20.0), flown(RASCAL, X8, airspeed=20.0)
    wanted = told(10.0, 3.0, 0.6, 2)
    for each in (pair, other):
        fly(each, no_faults(2), wanted, 0.5)
    assert not pair.lost().any()
    before = pair.read()
    pair.remove(np.array([False, True]))
    for each in (pair, other):
        fly(each, no_faults(2), wanted, 0.5)
    assert pair.lost().tolist() == [False, True]
    for name in VehicleState._fields:
        now, then, theirs = (getattr(each, name) for each in (pair.read(), before, other.read()))
        assert np.array_equal(now[1], then[1])
        assert np.array_equal(now[0], theirs[0])


@pytest.mark.parametrize("folder", [RASCAL, X8])
def test_aircraft_with_nan_state_is_removed(folder) -> None:
    vehicles = flown(folder, folder, airspeed=20.0)
    start, wanted = vehicles.read(), told(0.0, 2.0, 0.6, 2)
    wind = np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]])
    vehicles.blow(WindInput(wind, np.zeros((2, 3)), np.zeros(2)))
    vehicles.step(TICKS)
    assert not np.isfinite(vehicles.read().position_ned[0]).all()
    lost = vehicles.lost()
    assert lost.tolist() == [True, False]
    vehicles.remove(lost)
    vehicles.blow(WindInput(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(2)))
    fly(vehicles, no_faults(2), wanted, 0.2)
    state, air = vehicles.read(), vehicles.air()
    assert all(np.isfinite(each).all() for each in state)
    assert all(np.isfinite(each).all() for each in air[:4])
    for now, then in zip(state, start, strict=True):
        assert np.array_equal(now[0], then[0])
    assert state.position_ned[1, 0] > 4.0
    assert vehicles.lost().tolist() == [True, False]


def test_faults_and_losses_among_kinds_of_vehicles() -> None:
    aircraft = allocate(AIRCRAFT, 3)

    def one(row):
        fleet = JsbsimFleet(
            [RASCAL], [InitialState((0.0, 0.0, -400.0), airspeed=20.0)], NedOrigin(), 200
        )
        tune = make_gains([read_params(RASCAL / "autopilot.param")], PERIOD)
        return Flight(fleet, tune, aircraft, [row])

    first, last = one(0), one(2)
    unicycle = make_unicycles(
        np.array([[0.0, 10.0, -100.0]]), np.array([[20.0, 0.0, 0.0]]), np.ones(1)
    )
    parts = [last.vehicles, UnicycleVehicles(unicycle, 200, aircraft, np.array([1]))]
    parts.append(first.vehicles)
    aircraft["estimate"] = aircraft["truth"]
    write_fields(aircraft["command"], told(0.0, 2.0, 0.6, 3))
    failing = no_faults(3)
    failing.power[2] = 0.0
    write_fields(aircraft["faults"], failing)
    for each in parts:
        run_steps(period_of(each), 0.0)
    throttle = aircraft["surfaces"]["throttle"]
    assert throttle[0] > 0.0 and throttle[2] == 0.0
    lost = np.array([False, True, True])
    for each in parts:
        each.remove(lost)
    where = aircraft["truth"]["position_ned"].copy()
    for each in parts:
        each.step(20, None)
    moved = np.linalg.norm(aircraft["truth"]["position_ned"] - where, axis=1)
    assert moved[0] > 1.9 and (moved[1:] == 0.0).all()
    assert aircraft["stopped"].tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("test", "arguments"),
    [
        (test_climb_and_sink_balance_power, (Rascal, RASCAL, {"power": 0.5}, 3.0, 0.5, 0.25)),
        (test_a_stuck_aileron_rolls_as_published, ()),
        (test_floating_elevons_trim_at_zero_moment, ()),
        (test_a_battery_drops_and_goes_on_from_there, ()),
        (test_a_stuck_elevon_stands_still_in_the_aircraft, ()),
        (
            test_a_frozen_autopilot_leaves_the_free_motion,
            (RASCAL, 22.0, 2.0, 0.0, ("v", "p", "r", "phi")),
        ),
    ],
)
def test_fault_without_effect_is_found(monkeypatch, test, arguments) -> None:
    control = Flight.control

    def intact(flight, estimate, command, failing):
        control(flight, estimate, command, no_faults(len(flight.rows)))

    monkeypatch.setattr(Flight, "control", intact)
    with pytest.raises(AssertionError):
        test(*arguments)
