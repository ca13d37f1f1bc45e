"""The Rascal in JSBSim: trim, glide, turn, derivatives as published, and good manners."""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aircraft_copies import changed
from forked import run_program
from places import ROOT
from reference.motion import motion, state_of

from testbed.autopilot.fbwa import settled_autopilots, step_autopilots
from testbed.autopilot.parameters import make_gains, read_params
from testbed.core.frames import FOOT, GRAVITY
from testbed.core.geodetic import RADIANS, WGS84_A, WGS84_E2, local_frame
from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    FbwaCommand,
    NedOrigin,
    VehicleState,
    allocate,
    fields_of,
)
from testbed.vehicle import fleet as fleet_module
from testbed.vehicle.environment import INTEGRATORS, JSBSIM_DEFAULT_INTEGRATORS, Integrators
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import AircraftError, trim_aircraft
from testbed.vehicle.jsbsim_io import write_truth
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.trim import InitialState, TrimError, TrimPoint

RASCAL = ROOT / "aircraft" / "rascal110"
ORIGIN = NedOrigin()
MASS = 14.5 * 0.45359237  # kg
AREA = 10.57 * FOOT**2  # m²
SPAN, CHORD = 9.17 * FOOT, 1.15 * FOOT


def _fleet(*starts: InitialState, integrators: Integrators = INTEGRATORS) -> JsbsimFleet:
    return JsbsimFleet([RASCAL] * len(starts), starts, ORIGIN, 200, integrators)


def test_level_trim() -> None:
    trimmed = trim_aircraft(RASCAL, TrimPoint(22.0, altitude=400.0))
    assert trimmed.residual < 1e-6  # m/s² and rad/s²
    assert trimmed.controls.throttle == pytest.approx(0.22, abs=0.015)  # "near 22 %"
    # Lift carries the weight: C_L from the published table at that alpha, with the density of the
    # standard atmosphere at 400 m, 1.1787 kg/m³. The thrust's own share is 0.3 %.
    elevator = -0.35 * trimmed.controls.elevator
    lift_coefficient = 0.25 + trimmed.alpha * 5.0 + 0.2 * elevator
    lift = 0.5 * 1.1787 * 22.0**2 * AREA * lift_coefficient
    assert lift == pytest.approx(MASS * GRAVITY, rel=0.005)


def test_trimmed_flight_stays() -> None:
    """Ten seconds with fixed controls: nothing kicks the aircraft, the propeller turns from 0 s."""
    fleet = _fleet(
        InitialState((0.0, 0.0, -100.0)), InitialState((0.0, 50.0, -100.0), course=2.0, bank=0.4)
    )
    start, air = fleet.read(), fleet.air()
    assert (air.propeller_rps > 60.0).all()
    assert start.acceleration_ned[0] == pytest.approx([0, 0, 0], abs=1e-4)
    fleet.step(fleet.trimmed, 400)
    now = fleet.read()
    # The spiral mode is slow; two seconds of it leave a milliradian.
    assert now.euler[:, :2] == pytest.approx(start.euler[:, :2], abs=2e-3)
    assert now.airspeed == pytest.approx(22.0, abs=1e-2)
    assert now.position_ned[0] == pytest.approx([44.0, 0.0, -100.0], abs=0.05)


def test_turn_rate_and_radius() -> None:
    """V²/(g tan φ) in a trimmed turn, read from the track."""
    bank = math.radians(30.0)
    fleet = _fleet(InitialState((0.0, 0.0, -100.0), bank=bank))
    state = fleet.read()
    radius = 22.0**2 / (GRAVITY * math.tan(bank))
    acceleration = float(np.linalg.norm(state.acceleration_ned))
    assert acceleration == pytest.approx(22.0**2 / radius, rel=2e-3)  # local g is 9.800
    before = math.atan2(state.velocity_ned[0, 1], state.velocity_ned[0, 0])
    fleet.step(fleet.trimmed, 400)
    state = fleet.read()
    turned = math.atan2(state.velocity_ned[0, 1], state.velocity_ned[0, 0]) - before
    assert turned == pytest.approx(22.0 * 2.0 / radius, rel=0.01)


def _needs_throttle(airspeed: float, sink: float) -> bool:
    """Whether the engine has to pull in a straight flight that sinks by so many m/s."""
    try:
        trimmed = trim_aircraft(RASCAL, TrimPoint(airspeed, -math.asin(sink / airspeed)))
    except TrimError:  # even at idle it flies faster
        return False
    return trimmed.controls.throttle > 1e-3


def test_glide() -> None:
    """Sink at 20 m/s, idle: drag over weight by hand, with the windmilling propeller's share."""
    lift_coefficient = MASS * GRAVITY / (0.5 * 1.1787 * 400.0 * AREA)
    clean = 20.0 * (0.028 + 0.0012 + 0.04 * lift_coefficient**2) / lift_coefficient
    assert clean == pytest.approx(2.2, abs=0.2)  # at zero thrust
    assert _needs_throttle(20.0, clean)  # the propeller brakes: it sinks by more
    assert not _needs_throttle(20.0, clean + 0.8)


def test_acceleration_and_velocity_are_derivatives() -> None:
    """Second route: central differences of velocity and position, in a manoeuvre."""
    fleet = _fleet(InitialState((30.0, -40.0, -100.0), course=1.0))
    level = fleet.trimmed
    pulled = ActuatorCommand(
        level.aileron + 0.3, level.elevator + 0.3, level.rudder, level.throttle + 0.3
    )
    fleet.step(pulled, 60)
    before = fleet.read()
    fleet.step(pulled, 1)
    now = fleet.read()
    fleet.step(pulled, 1)
    after = fleet.read()
    rate = 1.0 / (2.0 / 200.0)
    slope = (after.velocity_ned - before.velocity_ned) * rate
    # What is left is Earth's rotation and the truncation of the differences: mm/s².
    assert np.linalg.norm(slope) > 3.0
    assert now.acceleration_ned == pytest.approx(slope, abs=0.03)
    track = (after.position_ned - before.position_ned) * rate
    assert now.velocity_ned == pytest.approx(track, abs=3e-3)


def test_motion_kernel_equals_the_reference() -> None:
    """In rows of the records of more aircraft, of which only those asked for are written."""
    rng = np.random.default_rng(3)
    metres = WGS84_A * (1.0 - WGS84_E2), WGS84_A
    said = rng.normal(0.0, 2.0, (50, 17))
    # The equator at Greenwich, in metres per radian and feet; places within some metres.
    said[:, :2] *= 1e-7
    zero = np.zeros(17)
    scale = np.array([*metres, -FOOT, *[FOOT] * 6, *[1.0] * 6, FOOT, FOOT])
    wanted, rows = rng.random(50) < 0.7, rng.permutation(60)[:50]
    ours, aircraft = np.full(17 * 50, 7.0), allocate(AIRCRAFT, 60)
    for name in VehicleState._fields:
        aircraft["truth"][name] = 7.0
    motion(said, wanted, zero, scale, ours)
    frame = tuple(local_frame(NedOrigin(0.0, 0.0, 0.0), RADIANS))
    write_truth(rows, said, frame, aircraft, np.flatnonzero(wanted))
    theirs = fields_of(VehicleState, aircraft["truth"])
    others = np.setdiff1d(np.arange(60), rows[wanted])
    for one, two in zip(state_of(ours), theirs, strict=True):
        assert two[rows] == pytest.approx(one, abs=1e-12)  # sums of ten terms of size 10, rounded
        assert (two[others] == 7.0).all()


def _moments(**moved: float) -> np.ndarray:
    """p', q', r' times inertia over q̄ S (b, c̄, b) after moving one control from trim.

    By Euler's method the rates change by the acceleration times the step.
    """
    start = InitialState((0.0, 0.0, -100.0))
    fleet = _fleet(start, integrators=JSBSIM_DEFAULT_INTEGRATORS)
    level = fleet.trimmed
    values = {
        name: getattr(level, name) + moved.get(name, 0.0)
        for name in ("aileron", "elevator", "rudder", "throttle")
    }
    fleet.step(ActuatorCommand(**values), 1)
    first = fleet.read()
    fleet.step(ActuatorCommand(**values), 1)
    second = fleet.read()
    acceleration = (second.rates_body - first.rates_body)[0] * 200.0
    inertia = np.array([1.95, 1.55, 1.91]) * 14.593903 * FOOT**2
    pressure = 0.5 * 1.1787 * 22.0**2
    return acceleration * inertia / (pressure * AREA * np.array([SPAN, CHORD, SPAN]))


@pytest.mark.parametrize(
    ("control", "travel", "axis", "derivative"),
    [
        ("aileron", 0.35, 0, 0.1273),  # Clδa, left aileron down
        ("aileron", 0.35, 2, -0.03),  # Cnδa
        ("elevator", -0.35, 1, -0.5),  # Cmδe; our positive is nose up
        ("rudder", -0.35, 2, -0.05),  # Cnδr; our positive is nose right
        ("rudder", -0.35, 0, 0.01),  # Clδr
    ],
)
def test_published_control_derivatives(
    control: str, travel: float, axis: int, derivative: float
) -> None:
    # One step of damping takes up to 5 % of the roll and pitch moments; the tank adds to the
    # moments of inertia (0.2 slug ft²), which is why the pitch and roll numbers come out low.
    step = 0.05
    slope = (_moments(**{control: step}) - _moments(**{control: -step}))[axis] / (2 * step * travel)
    assert slope == pytest.approx(derivative, rel=0.15)


def test_an_impossible_trim_says_so() -> None:
    with pytest.raises(TrimError, match="no steady flight"):
        trim_aircraft(RASCAL, TrimPoint(6.0))
    with pytest.raises(TrimError, match="airspeed must be positive"):
        trim_aircraft(RASCAL, TrimPoint(-1.0))


def test_a_folder_without_an_aircraft_says_so(tmp_path: Path) -> None:
    with pytest.raises(AircraftError, match=r"no .*\.xml"):
        JsbsimFleet([tmp_path], [InitialState((0.0, 0.0, -100.0))], ORIGIN, 200)


def test_start_is_where_and_how_it_was_asked_for() -> None:
    start = InitialState(
        (700.0, -300.0, -150.0), course=-2.0, airspeed=20.0, flight_path_angle=0.05
    )
    fleet = _fleet(start)
    state, air = fleet.read(), fleet.air()
    assert state.position_ned[0] == pytest.approx(start.position_ned, abs=1e-3)
    assert math.atan2(*state.velocity_ned[0, 1::-1]) == pytest.approx(-2.0, abs=1e-9)
    assert -state.velocity_ned[0, 2] == pytest.approx(20.0 * math.sin(0.05), abs=1e-6)
    assert state.airspeed[0] == pytest.approx(20.0, abs=1e-6)
    # √(ρ/ρ0) at 450 m in the standard atmosphere
    assert state.equivalent_airspeed[0] == pytest.approx(20.0 * math.sqrt(0.95739), rel=1e-3)
    assert air.wind_ned[0] == pytest.approx([0, 0, 0], abs=1e-12)


def test_fleets_are_equal_to_the_bit() -> None:
    one = InitialState((0.0, 0.0, -100.0))
    pair, alone = _fleet(one, InitialState((0.0, 50.0, -120.0), bank=0.3)), _fleet(one)
    pair.step(pair.trimmed, 200)
    alone.step(alone.trimmed, 200)
    for name in VehicleState._fields:
        a, b = getattr(pair.read(), name)[0], getattr(alone.read(), name)[0]
        assert np.array_equal(a, b)


def test_ground_contact_is_noticed() -> None:
    fleet = _fleet(InitialState((0.0, 0.0, -5.0)), InitialState((0.0, 50.0, -100.0)))
    assert not fleet.lost(fleet.read()).any()
    level = fleet.trimmed
    dive = ActuatorCommand(level.aileron, level.elevator - 0.3, level.rudder, level.throttle * 0.0)
    fleet.step(dive, 400)
    assert fleet.lost(fleet.read())[0]


def test_the_tune_is_crisp_and_well_damped() -> None:
    """A 20° roll step: 63 % within 0.35 s, under 5 % of overshoot, hardly any pitch lost."""
    fleet = _fleet(InitialState((0.0, 0.0, -100.0)))
    gains = make_gains([read_params(RASCAL / "autopilot.param")], 0.02)
    autopilots = settled_autopilots(gains, fleet.trimmed)
    pitch = np.array([fleet.trims[0].placement.pitch])
    command = FbwaCommand(
        roll=np.radians([20.0]), pitch=pitch, throttle=fleet.trimmed.throttle + 0.02
    )
    euler = []
    for _ in range(150):
        state = fleet.read()
        euler.append(np.degrees(state.euler[0]))
        fleet.step(step_autopilots(autopilots, state, command), 4)
    roll = np.array(euler)[:, 0]
    assert np.argmax(roll > 0.632 * 20.0) * 0.02 < 0.35
    assert roll.max() < 1.05 * 20.0
    assert np.abs(roll[75:] - 20.0).max() < 0.5
    assert np.abs(np.array(euler)[:, 1] - np.degrees(pitch)).max() < 0.5


@pytest.mark.parametrize(
    ("file", "pattern", "new", "test", "arguments"),
    [
        pytest.param(
            "rascal110.xml",
            r"(fcs/left-aileron-pos-rad </property> <value>) 0.1273",
            r"\1 -0.1273",
            test_published_control_derivatives,
            ("aileron", 0.35, 0, 0.1273),
            id="sign of the aileron",
        ),
        pytest.param(
            "rascal110.xml", r"(LBS\">) 13 ", r"\1 14 ", test_level_trim, (), id="a pound more"
        ),
        pytest.param(
            "rascal110.xml", r"0.00  0.028", "0.00  0.050", test_glide, (), id="drag by half more"
        ),
        pytest.param(
            "autopilot.param",
            r"RLL_RATE_P 0.944\n",
            "RLL_RATE_P 0.1\n",
            test_the_tune_is_crisp_and_well_damped,
            (),
            id="a tenth of the gain",
        ),
    ],
)
def test_wrong_numbers_of_the_aircraft_are_found(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    file: str,
    pattern: str,
    new: str,
    test: Callable[..., None],
    arguments: tuple[object, ...],
) -> None:
    copy = changed(RASCAL, tmp_path, (pattern, new), file=file)
    monkeypatch.setattr(sys.modules[__name__], "RASCAL", copy)
    with pytest.raises(AssertionError):
        test(*arguments)


def test_propeller_that_starts_at_rest_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place = JsbsimModel.place
    monkeypatch.setattr(sys.modules[__name__], "RASCAL", changed(RASCAL, tmp_path))

    def at_rest(*arguments: Any, spin: bool, **keywords: Any) -> None:
        place(*arguments, **keywords, spin=spin and "course" not in keywords)  # trim spins

    monkeypatch.setattr(JsbsimModel, "place", at_rest)
    with pytest.raises(AssertionError):
        test_trimmed_flight_stays()


def test_height_along_the_radius_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """JSBSim's height of the initial condition, without its correction."""
    locate = JsbsimModel.locate

    def uncorrected(model: JsbsimModel, position_ned: Any, origin: NedOrigin) -> None:
        locate(model, position_ned, origin)
        height = origin.elevation_m - position_ned[2]
        model.node("ic/h-sl-ft").set_double_value(height / FOOT)

    monkeypatch.setattr(JsbsimModel, "locate", uncorrected)
    with pytest.raises(AssertionError):
        test_start_is_where_and_how_it_was_asked_for()


@pytest.mark.parametrize(
    ("columns", "test"),
    [
        (slice(3, 6), test_turn_rate_and_radius),
        (slice(6, 9), test_acceleration_and_velocity_are_derivatives),
        (slice(3, 6), test_acceleration_and_velocity_are_derivatives),
        (slice(9, 12), test_motion_kernel_equals_the_reference),
    ],
)
def test_motion_in_wrong_units_is_found(
    monkeypatch: pytest.MonkeyPatch, columns: slice, test: Callable[[], None]
) -> None:
    write = write_truth

    def feet(rows: Any, numbers: np.ndarray, frame: Any, aircraft: Any, which: Any) -> None:
        numbers = numbers.copy()
        numbers[:, columns] /= FOOT
        write(rows, numbers, frame, aircraft, which)

    monkeypatch.setattr(fleet_module, "write_truth", feet)
    monkeypatch.setattr(sys.modules[__name__], "write_truth", feet)
    with pytest.raises(AssertionError):
        test()


def test_flight_opens_no_socket_and_writes_nothing(tmp_path: Path) -> None:
    code = f"""
import os, sys
from pathlib import Path
from testbed.core.records import NedOrigin
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.trim import InitialState
fleet = JsbsimFleet([Path({str(RASCAL)!r})], [InitialState((0.0, 0.0, -100.0))], NedOrigin(), 200)
fleet.step(fleet.trimmed, 200)
for number in os.listdir("/proc/self/fd"):
    try:
        target = os.readlink("/proc/self/fd/" + number)
    except OSError:
        continue
    if target.startswith("socket:"):
        sys.exit("an open socket")
"""
    assert run_program(code, folder=tmp_path) == (0, "", "")
    assert list(tmp_path.iterdir()) == []
