"""Flight models converge with the step as their method should, and begin in the wind's air."""

import math
from contextlib import contextmanager

import numpy as np
import pytest
from aircraft_copies import changed
from places import ROOT

from testbed.core.records import ActuatorCommand, NedOrigin
from testbed.vehicle.environment import INTEGRATORS
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.trim import InitialState

AIRCRAFT = ROOT / "aircraft"
RASCAL, X8 = AIRCRAFT / "rascal110", AIRCRAFT / "skywalker_x8"
HELD_HZ = 50
SURFACES = ("aileron", "elevator", "rudder")
WITHOUT_LEAD = INTEGRATORS._replace(control_lead=0.0)


def sinusoid(k):
    """Return the motion of a control at 1 Hz, at a tick of 50 Hz."""
    return 0.05 * math.sin(2.0 * math.pi * k / HELD_HZ)


def stop_to_stop(k):
    """Return the motion of a control that jumps every fifth of a second."""
    return 0.9 if k // 10 % 2 else -0.9


def manoeuvre(folder, rate_hz, controls, integrators=INTEGRATORS, motion_of=sinusoid):
    """Fly 4 s with moved controls, held at 50 Hz; return velocities, angles, rates (200, 9)."""
    fleet = JsbsimFleet(
        [folder], [InitialState((0.0, 0.0, -300.0))], NedOrigin(), rate_hz, integrators
    )
    trimmed, motion = fleet.trimmed, []
    for k in range(4 * HELD_HZ):
        moved = motion_of(k)
        surfaces = {
            name: held + moved * (name in controls) for name, held in trimmed._asdict().items()
        }
        fleet.step(ActuatorCommand(**surfaces), rate_hz // HELD_HZ)
        state = fleet.read()
        motion.append(np.concatenate([state.velocity_ned[0], state.euler[0], state.rates_body[0]]))
    return np.array(motion)


def ratio(folder, controls, integrators=INTEGRATORS, motion_of=sinusoid):
    """Return the ratio of the differences 200 to 400 Hz and 400 to 800 Hz; 2**order."""
    flown = [manoeuvre(folder, rate, controls, integrators, motion_of) for rate in (200, 400, 800)]
    first, second = (np.linalg.norm(b - a) for a, b in zip(flown, flown[1:], strict=False))
    return first / second


def without_alpha_dot(tmp_path):
    """Copy the Rascal without its term in the rate of change of the angle of attack."""
    return changed(RASCAL, tmp_path, ("aero/alphadot-rad_sec", "air/q-rad_sec"))


# the order of convergence


def test_x8_converges_with_second_order():
    assert ratio(X8, SURFACES) == pytest.approx(4.0, abs=0.3)


def test_rascal_converges_with_second_order(tmp_path):
    """JSBSim's rate of change of the angle of attack is that of the frame before: first order."""
    assert ratio(without_alpha_dot(tmp_path), SURFACES) == pytest.approx(4.0, abs=0.3)


def test_rascal_without_lead_has_first_order(tmp_path):
    """The negative control: a control acts half a frame late."""
    assert ratio(without_alpha_dot(tmp_path), SURFACES, WITHOUT_LEAD) == pytest.approx(2.0, abs=0.2)


def test_aileron_between_stops_converges(tmp_path):
    """In the first frame it exceeds its travel; held to it, it would act half a frame late."""
    copy = without_alpha_dot(tmp_path)
    assert ratio(copy, ("aileron",), motion_of=stop_to_stop) == pytest.approx(4.0, abs=0.6)


def test_throttle_converges_with_first_order():
    """JSBSim integrates the propeller's speed by Euler's method."""
    for folder in (RASCAL, X8):
        assert 1.8 < ratio(folder, ("throttle",)) < 2.6


@pytest.mark.parametrize("folder", [RASCAL, X8])
def test_settled_propeller_does_not_depend_on_rate(folder):
    def settled(rate_hz):
        fleet = JsbsimFleet([folder], [InitialState((0.0, 0.0, -300.0))], NedOrigin(), rate_hz)
        return fleet.air().propeller_rps[0], fleet.read().acceleration_ned[0]

    speed, acceleration = settled(800)
    for rate_hz in (20, 50, 100):
        own_speed, own_acceleration = settled(rate_hz)
        assert own_speed == pytest.approx(speed, rel=1e-12)
        assert own_acceleration == pytest.approx(acceleration, abs=1e-10)


# placement in wind


def first_step(folder, wind_ned, rate_hz=100):
    """Return the error of the velocity after one step (3,) m/s, and the acceleration before it."""
    origin = NedOrigin()
    start = InitialState((0.0, 0.0, -300.0), wind_ned=wind_ned)
    fleet = JsbsimFleet([folder], [start], origin, rate_hz)
    before = fleet.read()
    fleet.step(None, 1)
    v, a = before.velocity_ned[0], before.acceleration_ned[0]
    # north and down turn as the aircraft flies over the curved earth
    latitude, height = math.radians(origin.latitude_deg), origin.elevation_m + 300.0
    w = 1.0 - 6.69437999014e-3 * math.sin(latitude) ** 2
    across = 6378137.0 / math.sqrt(w) + height
    along = 6378137.0 * (1.0 - 6.69437999014e-3) / w**1.5 + height
    turning = np.array([v[1] / across, -v[0] / along, -v[1] * math.tan(latitude) / across])
    expected = v + (a - np.cross(turning, v)) / rate_hz
    return fleet.read().velocity_ned[0] - expected, a


WINDS = [
    (speed * math.cos(towards), speed * math.sin(towards), -updraught)
    for speed in (5.0, 8.0, 15.0)
    for towards in np.radians([0.0, 90.0, 180.0, 270.0])
    for updraught in (0.0, 3.0)
]


@pytest.mark.parametrize("folder", [RASCAL, X8])
def test_first_step_in_wind_has_its_acceleration(folder):
    """Trim in a uniform wind is trim in still air, apart from the rotation of the earth."""
    for wind_ned in WINDS:
        error, acceleration = first_step(folder, wind_ned)
        assert np.abs(error).max() < 1e-9
        assert np.abs(acceleration).max() < 0.01


@pytest.mark.parametrize("folder", [RASCAL, X8])
def test_suspended_runs_leave_still_air(folder, monkeypatch):
    """The negative control: they evaluate accelerations, and integrators remember the old ones."""
    step = JsbsimModel._step

    @contextmanager
    def suspended(self, dt):
        with step(self, dt):
            if dt < 1e-9:
                self.fdm.suspend_integration()
            yield
            self.fdm.resume_integration()

    monkeypatch.setattr(JsbsimModel, "_step", suspended)
    error, acceleration = first_step(folder, (-8.0, 0.0, 0.0))
    assert np.abs(acceleration).max() < 0.01
    assert 0.01 < np.linalg.norm(error) < 0.1
