"""Linearisation, modes, first-order fits, crab angles and tensors of inertia, by hand."""

import math

import numpy as np
import pytest

from testbed.airframes.inertia import impossible_inertia, unlikely_inertia
from testbed.commissioning.identify import FirstOrder, fit_first_order
from testbed.core.frames import euler_rates
from testbed.vehicle.linearize import CONTROLS, STATES, find_modes, linearize
from testbed.vehicle.trim import (
    Controls,
    Placement,
    TrimError,
    TrimPoint,
    TrimResult,
    course_through_air,
)

PLACED = Placement((20.0, 0.1, 0.5), (0.01, 0.02, 0.03), 0.2, 0.05, 0.0)
HELD = Controls(0.02, 0.1, -0.03, 0.3)
TRIM = TrimResult(TrimPoint(20.0), 0.0, 0.0, 0.0, HELD, 70.0, PLACED, True, 0.0)
FORCED = [name for name in STATES if name not in ("theta", "phi")]


class LinearAircraft:
    """Accelerations linear in state and controls; the propeller settles at 50 + 60 throttle."""

    has_rudder = True
    has_lag = False
    has_engine = has_propeller = True
    throttle_lags = False

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.a, self.b = rng.normal(size=(9, 9)), rng.normal(size=(9, 4))
        self.propeller_rps = 0.0
        self.placed = PLACED, HELD

    def derivative(self):
        placement, controls = self.placed
        u, v, w = placement.velocity_body
        p, q, r = placement.rates_body
        state = np.array([u, w, q, placement.pitch, self.propeller_rps, v, p, r, placement.roll])
        values = np.array([getattr(controls, name) for name in CONTROLS])
        return dict(zip(STATES, self.a @ state + self.b @ values, strict=True))

    def accelerations(self, placement, controls, *, spin):
        self.placed = placement, controls
        if spin:
            self.propeller_rps = 50.0 + 60.0 * controls.throttle
        found = self.derivative()
        return np.array([found[name] for name in "uvwpqr"])

    def propeller_acceleration(self):
        return self.derivative()["n"]


def test_a_linear_aircraft_gives_its_own_matrices():
    aircraft = LinearAircraft(4)
    linear = linearize(aircraft, TRIM)
    rows = [STATES.index(name) for name in FORCED]
    assert linear.a[rows] == pytest.approx(aircraft.a[rows], abs=1e-7)
    assert linear.b[rows] == pytest.approx(aircraft.b[rows], abs=1e-7)


def test_the_attitude_follows_the_kinematics():
    linear = linearize(LinearAircraft(5), TRIM)

    def angles(phi, theta, p, q, r):
        return euler_rates(np.array([phi, theta, 0.0]), np.array([p, q, r]))[:2]

    where = ("phi", "theta", "p", "q", "r")
    at = np.array([0.2, 0.05, 0.01, 0.02, 0.03])
    for j, name in enumerate(where):
        moved = np.zeros(5)
        moved[j] = 1e-6
        slope = (angles(*(at + moved)) - angles(*(at - moved))) / 2e-6
        column = linear.a[:, STATES.index(name)]
        found = column[[STATES.index("phi"), STATES.index("theta")]]
        assert found == pytest.approx(slope, abs=1e-6)
    assert not linear.b[[STATES.index("phi"), STATES.index("theta")]].any()


def test_a_control_at_its_stop_is_moved_inwards():
    aircraft = LinearAircraft(6)
    stopped = TrimResult(
        TrimPoint(20.0), 0.0, 0.0, 0.0, Controls(1.0, -1.0, 0.0, 0.0), 70.0, PLACED, True, 0.0
    )
    linear = linearize(aircraft, stopped)
    rows = [STATES.index(name) for name in FORCED]
    assert linear.a[rows] == pytest.approx(aircraft.a[rows], abs=1e-7)
    assert linear.b[rows] == pytest.approx(aircraft.b[rows], abs=1e-7)


def blocks(**pairs):
    """A matrix (9, 9) of 2 x 2 blocks with the eigenvalues given, and reals, by their states."""
    a = np.zeros((9, 9))
    for names, value in pairs.items():
        rows = [STATES.index(name) for name in names.split("_")]
        if len(rows) == 1:
            a[rows[0], rows[0]] = value
        else:
            a[np.ix_(rows, rows)] = [[value.real, value.imag], [-value.imag, value.real]]
    return a


SOUND = {
    "u_theta": -0.1 + 0.5j,
    "w_q": -4.0 + 3.0j,
    "n": -9.0,
    "v_r": -1.0 + 5.0j,
    "p": -8.0,
    "phi": 0.05,
}
NAMES = {
    "u_theta": "phugoid",
    "w_q": "short period",
    "n": "propeller",
    "v_r": "Dutch roll",
    "p": "roll",
    "phi": "spiral",
}


def test_modes_are_named_by_what_takes_part():
    """Whatever the units of the states, and in whatever order the eigenvalues come."""
    rng = np.random.default_rng(8)
    for _ in range(5):
        scale = np.diag(np.exp(rng.normal(0.0, 2.0, 9)))
        modes = find_modes(scale @ blocks(**SOUND) @ np.linalg.inv(scale))
        found = {mode.name: mode.eigenvalue for mode in modes}
        assert found.keys() == set(NAMES.values())
        for states, name in NAMES.items():
            assert found[name] == pytest.approx(SOUND[states], abs=1e-9)
        assert all(sum(mode.participation.values()) == pytest.approx(1.0) for mode in modes)


def test_the_numbers_of_a_mode_by_hand():
    modes = {mode.name: mode for mode in find_modes(blocks(**SOUND))}
    short = modes["short period"]
    assert (short.frequency, short.damping) == (pytest.approx(5.0), pytest.approx(0.8))
    assert short.time_constant == pytest.approx(0.25)
    assert short.period == pytest.approx(2.0 * math.pi / 3.0)
    spiral = modes["spiral"]
    assert spiral.half_or_double == pytest.approx(13.863, abs=1e-3)
    assert spiral.time_constant == pytest.approx(-20.0)
    assert spiral.damping is None
    assert spiral.period is None


def test_what_fits_no_name_is_unclassified():
    """An overdamped short period, and roll and spiral that have become one pair."""
    strange = {
        "u_theta": -0.1 + 0.5j,
        "w": -3.0,
        "q": -6.0,
        "n": -9.0,
        "v_r": -1.0 + 5.0j,
        "p_phi": -2.0 + 1.0j,
    }
    modes = find_modes(blocks(**strange))
    unknown = sorted(mode.eigenvalue.real for mode in modes if mode.name == "unclassified")
    assert unknown == pytest.approx([-6.0, -3.0, -2.0])
    assert {m.name for m in modes} == {"phugoid", "propeller", "Dutch roll", "unclassified"}


def test_an_aircraft_that_neither_grows_nor_fades():
    modes = find_modes(blocks(**(SOUND | {"phi": 0.0})))
    spiral = next(mode for mode in modes if mode.name == "spiral")
    assert spiral.time_constant is None
    assert spiral.half_or_double is None


@pytest.mark.parametrize(
    ("pole", "delay", "gain"), [(0.64, 0.3, 1.0), (0.4, 0.0, 1.2), (3, 1, 0.7)]
)
def test_a_first_order_response_is_found_again(pole, delay, gain):
    time = np.arange(0.0, 20.0, 0.04)
    truth = FirstOrder(pole, delay, gain, 0.0)
    response = gain * (1.0 - np.exp(-pole * np.maximum(time - delay, 0.0)))
    assert truth.response(time) == pytest.approx(response)
    found = fit_first_order(time, response)
    assert found.pole == pytest.approx(pole, rel=1e-4)
    assert found.time_constant == pytest.approx(1.0 / pole, rel=1e-4)
    assert found.delay == pytest.approx(delay, abs=1e-4)
    assert found.gain == pytest.approx(gain, rel=1e-4)
    assert found.rms < 1e-5


def test_a_wrong_gain_shows_in_the_error():
    time = np.arange(0.0, 20.0, 0.04)
    response = 1.2 * (1.0 - np.exp(-0.5 * time))
    held = fit_first_order(time, response, gain=1.0)
    assert held.gain == 1.0
    assert 0.1 < held.rms < 0.2
    with pytest.raises(ValueError, match="too few"):
        fit_first_order(time[:5], response[:5])


def test_the_wind_triangle_closes():
    rng = np.random.default_rng(2)
    for _ in range(50):
        airspeed, course = rng.uniform(15.0, 30.0), rng.uniform(-3.0, 3.0)
        north, east = rng.uniform(-9.0, 9.0, 2)
        through = course_through_air(airspeed, course, (north, east, 1.0))
        ground = airspeed * np.exp(1j * through) + complex(north, east)
        assert np.angle(ground * np.exp(-1j * course)) == pytest.approx(0.0, abs=1e-12)
    assert course_through_air(20.0, 0.7, (0.0, 0.0, 0.0)) == 0.7
    with pytest.raises(TrimError, match="wind of 21 m/s"):
        course_through_air(20.0, 0.0, (0.0, 21.0, 0.0))


def test_which_tensors_a_rigid_body_can_have():
    rng = np.random.default_rng(3)
    for _ in range(50):  # any points with mass make a possible one
        points, masses = rng.normal(size=(6, 3)), rng.uniform(0.1, 2.0, 6)
        tensor = sum(
            m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points, strict=True)
        )
        assert impossible_inertia(tensor) is None
    plate = np.diag([1.0, 2.0, 3.0])
    assert impossible_inertia(plate) is None and unlikely_inertia(plate) == ""
    # estimates a fifth too small and too large are unlikely, larger errors impossible
    estimated = plate * [0.8, 0.8, 1.19]
    assert impossible_inertia(estimated) is None
    assert "J1 + J2 is 33 % less than J3" in unlikely_inertia(estimated)
    assert "J1 + J2 ≥ J3 fails: 3 < 4.6" in impossible_inertia(plate + np.diag([0, 0, 1.6]))
    assert "J1 > 0 fails" in impossible_inertia(np.diag([1.0, 1.0, -0.5]))
    assert "they must be finite" in impossible_inertia(np.diag([1.0, 1.0, np.nan]))
    # The diagonal alone satisfies the inequalities; the products break them.
    coupled = np.diag([1.0, 1.0, 1.0])
    coupled[0, 2] = coupled[2, 0] = 0.6
    assert "0.4" in unlikely_inertia(coupled)
