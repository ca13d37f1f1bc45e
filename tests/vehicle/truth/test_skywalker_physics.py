"""The Skywalker X8 in JSBSim: published derivatives, elevons, stall, battery and its tune.

The coefficients are those of Gryte et al., ICUAS 2018; aircraft/skywalker_x8/SOURCE.md.
"""

import inspect
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from aircraft_copies import changed
from forked import run_program
from places import ROOT

from testbed.autopilot.fbwa import settled_autopilots, step_autopilots
from testbed.autopilot.parameters import make_gains, read_params
from testbed.core.frames import FOOT, GRAVITY
from testbed.core.records import ActuatorCommand, FbwaCommand, NedOrigin
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import trim_aircraft
from testbed.vehicle.trim import InitialState, TrimError, TrimPoint

X8 = ROOT / "aircraft" / "skywalker_x8"
ORIGIN, SEA = NedOrigin(), NedOrigin(elevation_m=0.0)
MASS, AREA, SPAN, CHORD = 3.364, 0.75, 2.10, 0.3571  # kg, m², m, m
TRAVEL, FASTEST = math.radians(35.0), math.radians(200.0)
POUND, SLUG_FOOT3 = 4.4482216152605, 515.3788  # N, kg/m³
CAPACITY, RESISTANCE, FULL = 10.0, 0.03, 16.8  # Ah, ohm, V


def _fleet(*starts: InitialState, rate: int = 200) -> JsbsimFleet:
    return JsbsimFleet([X8] * len(starts), starts, ORIGIN, rate)


def _cruise(rate: int = 200):
    """One aircraft in trim at 18 m/s, and JSBSim itself to ask and to upset."""
    fleet = _fleet(InitialState((0.0, 0.0, -100.0), airspeed=18.0), rate=rate)
    return fleet, fleet.bare_runs()[0].__self__


@pytest.fixture(scope="module")
def bench():
    return _cruise()[1]


def _put(fdm, alpha=0.03, beta=0.0, rates=(0.0, 0.0, 0.0), pitch=0.0, roll=0.0, speed=18.0):
    """Place the aircraft; `pitch` and `roll` are δe and δa in rad."""
    wind = (math.cos(alpha) * math.cos(beta), math.sin(beta), math.sin(alpha) * math.cos(beta))
    for axis, part in zip("uvw", wind, strict=True):
        fdm[f"ic/{axis}-fps"] = speed * part / FOOT
    for axis, rate in zip("pqr", rates, strict=True):
        fdm[f"ic/{axis}-rad_sec"] = rate
    fdm["fcs/elevator-cmd-norm"], fdm["fcs/aileron-cmd-norm"] = pitch / TRAVEL, roll / TRAVEL
    fdm.run_ic()


def _coefficients(fdm, **state) -> np.ndarray:
    """CL, CD, CY along and across the wind, Cl, Cm, Cn in body axes, from forces and moments."""
    _put(fdm, **state)
    alpha, beta = state.get("alpha", 0.03), state.get("beta", 0.0)
    pressure = 0.5 * fdm["atmosphere/rho-slugs_ft3"] * SLUG_FOOT3 * 18.0**2
    forces = [fdm[f"forces/fb{axis}-aero-lbs"] * POUND for axis in "xyz"]
    moments = [fdm[f"moments/{axis}-aero-lbsft"] * POUND * FOOT for axis in "lmn"]
    x, y, z = np.array(forces) / (pressure * AREA)
    ahead = x * math.cos(alpha) + z * math.sin(alpha)  # in the plane of symmetry
    drag = -(ahead * math.cos(beta) + y * math.sin(beta))
    side = y * math.cos(beta) - ahead * math.sin(beta)
    lift = x * math.sin(alpha) - z * math.cos(alpha)
    turning = np.array(moments) / (pressure * AREA * np.array([SPAN, CHORD, SPAN]))
    return np.array([lift, drag, side, *turning])


def _slope(fdm, name: str, index: int | None = None, step: float = 0.02) -> np.ndarray:
    def at(value: float) -> np.ndarray:
        if index is None:
            return _coefficients(fdm, **{name: value})
        rates = [0.0, 0.0, 0.0]
        rates[index] = value * 2.0 * 18.0 / (CHORD if index == 1 else SPAN)
        return _coefficients(fdm, rates=tuple(rates))

    middle = 0.03 if name == "alpha" else 0.0
    return (at(middle + step) - at(middle - step)) / (2.0 * step)


# Columns CL, CD, CY, Cl, Cm, Cn. The drag's slopes are those at α = 0.03 and β = δe = 0.
PUBLISHED = [
    ("alpha", None, [4.0203, 0.07909 + 2 * 0.03 * 1.05547, 0, 0, -0.4629, 0]),
    ("beta", None, [0, -0.00584, -0.22387, -0.08490, 0, 0.0283]),
    ("pitch", None, [0.2781, 0, 0, 0, -0.2292, 0]),
    ("roll", None, [0, 0, 0.04328, 0.12019, 0, -0.00339]),
    ("p", 0, [0, 0, -0.13736, -0.40420, 0, 0.00437]),
    ("q", 1, [3.87, 0, 0, 0, -1.3012, 0]),
    ("r", 2, [0, 0, 0.08387, 0.05552, 0, -0.0720]),
]


@pytest.mark.parametrize(("name", "index", "expected"), PUBLISHED)
def test_published_derivatives(bench, name, index, expected) -> None:
    # What is left is the stall's blend (5e-5 of CLα) and the Earth's rotation in the rates.
    assert _slope(bench, name, index) == pytest.approx(expected, rel=1e-3, abs=2e-5)


def test_published_values_at_rest_and_curvatures(bench) -> None:
    zero = _coefficients(bench, alpha=0.0)
    assert zero == pytest.approx([0.0867, 0.01970, 0, 0, 0.02275, 0], abs=1e-5)
    for name, curvature in (("alpha", 1.05547), ("beta", 0.14781), ("pitch", 0.06335)):
        h = 0.05
        up, down = (_coefficients(bench, **{"alpha": 0.0, name: value})[1] for value in (h, -h))
        assert (up + down - 2.0 * zero[1]) / (2.0 * h * h) == pytest.approx(curvature, rel=1e-3)


def test_inertia_from_moments_and_accelerations(bench) -> None:
    """J with the sign of its product: a push to the right roll also yaws the nose right."""
    moments, accelerations = [], []
    for state in ({"roll": 0.1}, {"pitch": 0.1}, {"beta": 0.2}, {"beta": -0.1, "roll": 0.2}):
        _put(bench, **state)
        moments.append([bench[f"moments/{a}-total-lbsft"] * POUND * FOOT for a in "lmn"])
        accelerations.append([bench[f"accelerations/{a}dot-rad_sec2"] for a in "pqr"])
    inverse = np.linalg.lstsq(np.array(moments), np.array(accelerations), rcond=None)[0].T
    inertia = np.linalg.inv(inverse)
    # JSBSim's factor from kg m² is 1e-4 off; the Earth's rotation adds 1e-4 rad/s².
    expected = [[0.335, 0, -0.029], [0, 0.140, 0], [-0.029, 0, 0.400]]
    assert inertia == pytest.approx(np.array(expected), abs=2e-4)
    low, middle, high = np.linalg.eigvalsh(inertia)
    assert 0.0 < low and high < low + middle


def test_trim_is_the_one_of_the_authors_simulator() -> None:
    """Theirs at 18 m/s and 1.225 kg/m³ stands at α = 0.0308 with δe = 0.0370."""
    trimmed = trim_aircraft(X8, TrimPoint(18.0, altitude=10.0), SEA)
    assert trimmed.alpha == pytest.approx(0.0308, abs=1e-4)
    assert -TRAVEL * trimmed.controls.elevator == pytest.approx(0.0370, abs=2e-4)


@pytest.mark.parametrize("airspeed", [15.0, 18.0, 22.0])
def test_level_trim(airspeed: float) -> None:
    trimmed = trim_aircraft(X8, TrimPoint(airspeed))
    assert trimmed.residual < 1e-6
    pressure = 0.5 * 1.1787 * airspeed**2 * AREA  # standard atmosphere at 400 m
    lift = 0.0867 + 4.0203 * trimmed.alpha - 0.2781 * TRAVEL * trimmed.controls.elevator
    assert pressure * lift == pytest.approx(MASS * GRAVITY, rel=0.01)  # thrust carries the rest
    assert 0.02275 - 0.4629 * trimmed.alpha + 0.2292 * TRAVEL * trimmed.controls.elevator == (
        pytest.approx(0.0, abs=1e-6)
    )
    # The motor's torque is the propeller's: some hundredths of a newton metre, held by the elevons.
    assert 0.0 < trimmed.controls.aileron < 0.02


def test_top_speed() -> None:
    assert trim_aircraft(X8, TrimPoint(25.0)).controls.throttle < 1.0
    with pytest.raises(TrimError, match="throttle 1.00"):
        trim_aircraft(X8, TrimPoint(26.5))


def test_stall(bench) -> None:
    """Slowest level flight just below 9 m/s at sea level; with more alpha lift falls."""
    assert trim_aircraft(X8, TrimPoint(9.0, altitude=10.0), SEA).alpha < math.radians(14.0)
    with pytest.raises(TrimError, match="no steady flight"):
        trim_aircraft(X8, TrimPoint(8.8, altitude=10.0), SEA)
    angles = np.radians(np.arange(0.0, 41.0))
    lift = np.array([_coefficients(bench, alpha=angle)[0] for angle in angles])
    top = int(np.argmax(lift))
    assert 12 <= top <= 15 and 0.9 < lift[top] < 1.05
    assert lift[20] < 0.4 * lift[top]
    plate = 2.0 * np.sin(angles) ** 2 * np.cos(angles)
    assert lift[25:] == pytest.approx(plate[25:], abs=2e-3)
    linear = 0.0867 + 4.0203 * angles[:9]
    assert lift[:9] == pytest.approx(linear, rel=1e-3)


def _elevons(fdm) -> tuple[float, float]:
    return fdm["fcs/left-elevon-pos-rad"], fdm["fcs/right-elevon-pos-rad"]


def _command(aileron: float, elevator: float, throttle: float = 0.7) -> ActuatorCommand:
    return ActuatorCommand(*(np.array([value]) for value in (aileron, elevator, 0.0, throttle)))


def test_elevons_limits_rate_and_signs() -> None:
    fleet, fdm = _cruise()
    positions = [_elevons(fdm)]
    for _ in range(60):
        fleet.step(_command(1.0, 0.0), 1)
        positions.append(_elevons(fdm))
    left, right = np.array(positions).T
    assert np.abs(np.diff([left, right])).max() == pytest.approx(FASTEST / 200.0, rel=1e-6)
    assert (left[-1], right[-1]) == pytest.approx((TRAVEL, -TRAVEL), rel=1e-2)  # left edge down
    assert np.all(np.abs([left, right]) <= TRAVEL)
    assert fleet.read().rates_body[0, 0] > 0.5  # rolls right
    fleet, fdm = _cruise()
    fleet.step(_command(0.0, 0.5), 20)  # our positive is nose up
    assert fleet.read().rates_body[0, 1] > 0.1
    fleet.step(_command(0.0, 0.5), 80)
    assert _elevons(fdm) == pytest.approx((-0.5 * TRAVEL, -0.5 * TRAVEL), rel=1e-3)
    fleet.step(_command(1.0, -1.0), 80)  # both at once saturate the left
    assert _elevons(fdm) == pytest.approx((TRAVEL, 0.0), abs=1e-2)


def test_elevons_lag_by_time_whatever_the_rate() -> None:
    """63 % of a small step after 0.04 s, at 100 and at 400 steps a second."""
    for rate in (100, 400):
        fleet, fdm = _cruise(rate)
        before = _elevons(fdm)[0]
        level = fleet.trimmed
        small = ActuatorCommand(level.aileron + 0.02, level.elevator, level.rudder, level.throttle)
        fleet.step(small, rate // 25)
        gone = (_elevons(fdm)[0] - before) / (0.02 * TRAVEL)
        assert gone == pytest.approx(1.0 - math.exp(-1.0), abs=1e-6)


def test_charge_falls_by_the_integral_of_current() -> None:
    fleet, fdm = _cruise()
    assert fdm["battery/state-of-charge"] == 1.0  # nothing was drawn before the flight
    level, drawn = fleet.trimmed, 0.0
    for tick in range(2000):
        fleet.step(level if tick < 1000 else level._replace(throttle=np.ones(1)), 1)
        drawn += fdm["battery/current-a"] / 200.0
        if tick == 999:
            assert 1.3 < CAPACITY / fdm["battery/current-a"] < 1.7  # hours of endurance
    assert 1.0 - fdm["battery/state-of-charge"] == pytest.approx(drawn / 3600 / CAPACITY, rel=1e-3)
    # The circuit by hand: what the ESC takes, what the motor gets, what the battery has left.
    current = fdm["battery/current-a"]
    assert current == pytest.approx(1.0 * fdm["propulsion/engine/current-amperes"], rel=1e-6)
    left = fdm["battery/open-circuit-v"] - RESISTANCE * current
    assert fdm["battery/voltage-v"] == pytest.approx(left, rel=1e-12)
    assert left < FULL - 0.4


def test_power_goes_where_it_should() -> None:
    """Battery power, less both resistances and the no-load current, is the propeller's."""
    _, fdm = _cruise()
    fdm.run()
    throttle, current = fdm["fcs/throttle-cmd-norm"], fdm["battery/current-a"]
    motor = current / throttle
    losses = 0.04 * motor**2 + 1.0 * fdm["battery/back-emf-v"]
    shaft = fdm["battery/voltage-v"] * current - losses
    taken = fdm["propulsion/engine/propeller-power-ftlbps"] * POUND * FOOT
    assert shaft == pytest.approx(taken, rel=1e-3)
    thrust = fdm["propulsion/engine/thrust-lbs"] * POUND
    assert 0.5 < thrust * 18.0 / taken < 0.75  # the propeller's efficiency


def _settled_thrust(charge: float, speed: float) -> float:
    """Thrust in N at full throttle, held in the wind until the propeller turns steadily."""
    _, fdm = _cruise()
    fdm["battery/initial-state-of-charge"] = charge
    fdm["fcs/throttle-cmd-norm"] = 1.0
    _put(fdm, alpha=0.0, speed=speed)
    fdm["forces/hold-down"] = 1.0
    for axis in ("north", "east", "down"):
        fdm[f"atmosphere/wind-{axis}-fps"] = -fdm[f"velocities/v-{axis}-fps"]
    for _ in range(200):
        fdm.run()
    assert fdm["battery/state-of-charge"] == charge  # held down, it draws nothing
    return fdm["propulsion/engine/thrust-lbs"] * POUND


def test_an_empty_battery_gives_less_thrust() -> None:
    at_rest, in_flight = (
        [_settled_thrust(charge, speed) for charge in (1.0, 0.05)] for speed in (0.1, 20.0)
    )
    assert 20.0 < at_rest[0] < 28.0 and at_rest[1] < 0.8 * at_rest[0]
    assert in_flight[1] < 0.6 * in_flight[0]


def test_trims_and_flights_repeat_to_the_bit(tmp_path: Path) -> None:
    """In another process, after another trim: the same numbers, and not a word beside them."""
    flight = (
        "from pathlib import Path; from testbed.core.records import NedOrigin\n"
        "from testbed.vehicle.fleet import JsbsimFleet\n"
        "from testbed.vehicle.trim import InitialState\n"
        "from testbed.vehicle.jsbsim_adapter import trim_aircraft\n"
        "from testbed.vehicle.trim import TrimPoint\n"
        f"x8 = Path({str(X8)!r})\n"
        "trim_aircraft(x8, TrimPoint(16.0))\n"
        "start = InitialState((0.0, 0.0, -100.0), airspeed=18.0, bank=0.3)\n"
        "fleet = JsbsimFleet([x8], [start], NedOrigin(), 200)\n"
        "fleet.step(fleet.trimmed, 100)\n"
        "fdm = fleet.bare_runs()[0].__self__\n"
        "print(fleet.trims[0], fleet.read(), fdm['battery/state-of-charge'])\n"
    )
    code, output, errors = run_program(flight, folder=tmp_path)
    fleet = _fleet(InitialState((0.0, 0.0, -100.0), airspeed=18.0, bank=0.3))
    fleet.step(fleet.trimmed, 100)
    charge = fleet.bare_runs()[0].__self__["battery/state-of-charge"]
    assert (code, errors) == (0, "")
    assert output == f"{fleet.trims[0]} {fleet.read()} {charge}\n"
    assert list(tmp_path.iterdir()) == []


# 18 m/s, and the speeds of 0.6 and 1.4 of its dynamic pressure. At the slowest, stall prevention
# lets the aircraft bank by 39°.
@pytest.mark.parametrize(
    ("airspeed", "roll", "pitch", "within"),
    [
        (18.0, 20.0, 0.0, 0.30),
        (18.0, 50.0, 0.0, 0.50),
        (18.0, 0.0, 5.0, 0.30),
        (18.0, 0.0, -9.0, 0.30),
        (13.94, 20.0, 0.0, 0.30),
        (13.94, 36.0, 0.0, 0.42),
        (13.94, 0.0, 5.0, 0.30),
        (21.3, 50.0, 0.0, 0.50),
        (21.3, 0.0, 5.0, 0.30),
    ],
)
def test_the_tune(airspeed: float, roll: float, pitch: float, within: float) -> None:
    """63 % of a step within a time, at most 3 % of overshoot, the other axis hardly moved."""
    fleet = _fleet(InitialState((0.0, 0.0, -100.0), airspeed=airspeed))
    gains = make_gains([read_params(X8 / "autopilot.param")], 0.02)
    trimmed = fleet.trims[0]
    # Below the trim throttle the law lowers the nose; ask for what it takes away.
    lowered = 2.0 / 0.69 * max(0.0, 0.69 - trimmed.controls.throttle)
    level = np.degrees([trimmed.placement.roll, trimmed.placement.pitch])
    command = FbwaCommand(
        roll=np.radians([roll]),
        pitch=np.radians([level[1] + pitch + lowered]),
        throttle=fleet.trimmed.throttle,
    )
    autopilots, angles = settled_autopilots(gains, fleet.trimmed), []
    for _ in range(125):
        state = fleet.read()
        angles.append(np.degrees(state.euler[0, :2]) - level)
        fleet.step(step_autopilots(autopilots, state, command), 4)
    moved, other = (0, 1) if roll else (1, 0)
    track = np.array(angles)
    step = track[:, moved] / (roll or pitch)
    assert np.argmax(step > 0.632) * 0.02 < within
    assert step.max() < 1.03
    assert np.abs(step[75:] - 1.0).max() < 0.05
    assert np.abs(track[:, other]).max() < 3.0


@pytest.mark.parametrize(
    ("file", "pattern", "new", "test", "arguments"),
    [
        pytest.param(
            "skywalker_x8.xml", "-0.40420", "0.40420", test_published_derivatives, PUBLISHED[4],
            id="sign of Clp",
        ),
        pytest.param(
            "skywalker_x8.xml", "0.01970", "0.0200", test_published_values_at_rest_and_curvatures,
            (), id="CD0",
        ),
        pytest.param(
            "skywalker_x8.xml", r"-0.029 </ixz>", "0.029 </ixz>",
            test_inertia_from_moments_and_accelerations, (), id="sign of Jxz",
        ),
        pytest.param(
            "skywalker_x8.xml", "0.02275", "0.02375", test_trim_is_the_one_of_the_authors_simulator,
            (), id="Cm0",
        ),
        pytest.param(
            "Systems/elevons.xml", r'value="0.04"( *> fcs/elevon-lag)', r'value="0.05"\1',
            test_elevons_lag_by_time_whatever_the_rate, (), id="lag of the elevons",
        ),
        pytest.param(
            "Systems/battery.xml", r'value="10"', 'value="9.5"',
            test_charge_falls_by_the_integral_of_current, (), id="capacity",
        ),
        pytest.param(
            "Systems/battery.xml", r'value="0.04"', 'value="0.08"',
            test_power_goes_where_it_should, (), id="resistance of the motor",
        ),
        pytest.param(
            "autopilot.param", r"RLL_RATE_FF \S+", "RLL_RATE_FF 0", test_the_tune,
            (18.0, 20.0, 0.0, 0.30), id="no feed-forward",
        ),
    ],
)  # fmt: skip
def test_wrong_numbers_of_the_aircraft_are_found(
    monkeypatch, tmp_path, file, pattern, new, test, arguments
) -> None:
    copy = changed(X8, tmp_path, (pattern, new), file=file)
    monkeypatch.setattr(sys.modules[__name__], "X8", copy)
    takes_bench = "bench" in inspect.signature(test).parameters
    with pytest.raises(AssertionError):
        test(*([_cruise()[1]] if takes_bench else []), *arguments)
