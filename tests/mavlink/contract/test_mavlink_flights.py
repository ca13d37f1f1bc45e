"""Navigation targets and telemetry logs of complete flights."""

import math

import numpy as np
import pytest
from cases import some
from run_flight import Collector, short

from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import FbwaCommand
from testbed.flight.loop import fly
from testbed.flight_logs.flight_import import read_flight
from testbed.mavlink.vehicle_control import FlightMode
from testbed.plan.world import build
from testbed.runs.external_options import ExternalOptions
from testbed.runs.run import run

LEADER, FOLLOWER = 0, 2
TOLERANCE_M = 0.6  # more than the change of a position in one control period


class Targets:
    """Records the estimated position and the target of each aircraft."""

    def __init__(self, world):
        self.world, self.samples = world, []

    def begin(self, info):
        pass

    def observe(self, sample):
        places = sample.estimate.position_ned.tolist()
        pairs = [
            (c.target, place)
            for c, place in zip(self.world.external_control.vehicles, places, strict=True)
        ]
        self.samples.append((sample.time_s, pairs))

    def end(self, summary, events):
        pass

    def between(self, begin, end, row):
        return [pairs[row] for time, pairs in self.samples if begin < time < end]


@pytest.fixture(scope="module")
def targets():
    """Fly with a leader that leaves its mission and a follower that leaves its slot."""
    world = build(short(seconds=75.0), commanded=True)
    leader, follower = (world.external_control.vehicles[row] for row in (LEADER, FOLLOWER))
    away = geodetic_from_ned(np.array([300.0, 900.0, 0.0]), world.info.origin)
    left = [
        (42.0, lambda: leader.set_mode(FlightMode.LOITER)),
        (44.0, lambda: follower.set_mode(FlightMode.LOITER)),
        (60.0, lambda: leader.set_mode(FlightMode.GUIDED)),
        (62.0, lambda: leader.set_loiter_point(float(away[0]), float(away[1]), 140.0, -150.0)),
        (64.0, lambda: leader.set_airspeed(24.0)),
        (70.0, lambda: leader.set_mode(FlightMode.FBWA)),
        (70.0, lambda: leader.set_manual_command(FbwaCommand(roll=0.0, pitch=0.05, throttle=0.5))),
    ]

    def before(now, due):
        while left and left[0][0] <= now:
            assert left.pop(0)[1]() is None
        return False

    recorder = Targets(world)
    assert fly(world, [recorder], before) == "completed"
    return recorder


def test_target_on_leg_is_its_end_and_course(targets):
    # eastward along 640 m north; the next leg, southward along 640 m east, starts at about 28 s
    for target, (north, _, _) in targets.between(0.1, 20.0, LEADER):
        assert target[:4] == (640.0, 640.0, 100.0, 22.0)
        assert target.course == pytest.approx(math.pi / 2)
        assert target.crosstrack == pytest.approx(north - 640.0, abs=TOLERANCE_M)
    turning = targets.between(32.0, 42.0, LEADER)
    for target, (_, east, _) in turning:
        assert target[:2] == (0.0, 640.0)
        assert target.crosstrack == pytest.approx(east - 640.0, abs=TOLERANCE_M)
    assert max(abs(target.crosstrack) for target, _ in turning) > 5.0


@pytest.mark.parametrize(("row", "start"), [(LEADER, 42.0), (FOLLOWER, 44.0)])
def test_target_on_circle_is_its_centre(targets, row, start):
    inside = targets.between(start + 0.1, 60.0, row)
    (centre,) = {target[:2] for target, _ in inside}
    radii = []
    for target, (north, east, _) in inside:
        to_north, to_east = centre[0] - north, centre[1] - east
        radii.append(math.hypot(to_north, to_east) - target.crosstrack)
        if math.hypot(to_north, to_east) > 20.0:
            off = math.remainder(target.course - math.atan2(to_east, to_north), math.tau)
            # the error of the bearing of a point 20 m away or more
            assert abs(off) < TOLERANCE_M / 20.0
    assert max(radii) - min(radii) < 2 * TOLERANCE_M
    assert min(radii) > 59.0
    assert inside[0][0].crosstrack < -55.0  # it sets out from the centre


def test_target_of_reposition_is_as_commanded(targets):
    found = {target for target, _ in targets.between(64.1, 70.0, LEADER)}
    for target in found:
        assert target[:2] == pytest.approx((300.0, 900.0), abs=0.01)
        assert target[2:4] == (140.0, 24.0)


def test_target_in_failsafe_is_its_circle(targets):
    # failsafe 1.5 s after the manual command at 70 s
    assert None not in {target for target, _ in targets.between(72.0, 80.0, LEADER)}


def test_target_is_none_without_guidance(targets):
    assert {target for target, _ in targets.between(70.1, 71.0, LEADER)} == {None}
    assert {target for target, _ in targets.between(0.0, 44.0, FOLLOWER)} == {None}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Return the tlog of a run, and its samples."""
    folder, frames = tmp_path_factory.mktemp("flight") / "run", Collector()
    run(short(seconds=20.0), out=folder, observers=[frames], external=ExternalOptions(tlog=True))
    return folder / "run.tlog", frames.frames


@pytest.mark.parametrize(("row", "mode"), [(0, "AUTO"), *some([(1, "FBWA"), (3, "FBWA")], 1)])
def test_tlog_of_a_run_imports_as_flown(flight, row, mode):
    path, frames = flight
    read = read_flight(path, system=row + 1, mode=mode)
    assert not [note for note in read.notes if "not in the log" in note]
    assert read.sources["theta_cmd_rad"].endswith(" + STAB_PITCH_DOWN")
    columns = read.columns
    # at whole seconds all messages are sent, so that held values are current
    seconds = [k for k, t in enumerate(columns["t_s"]) if t > 0.5 and abs(t - round(t)) < 1e-6]
    then = {round(frame.time_s, 6): frame for frame in frames}
    assert len(seconds) >= 18
    lowered = 0
    for k in seconds:
        frame = then[round(float(columns["t_s"][k]), 6)]
        found = [each[row] for each in frame.command]
        # angles have single precision; STAB_PITCH_DOWN uses the throttle in whole µs
        assert columns["theta_cmd_rad"][k] == pytest.approx(found[0], abs=2e-4)
        assert columns["phi_cmd_rad"][k] == pytest.approx(found[1], abs=1e-6)
        assert columns["throttle_cmd"][k] == pytest.approx(frame.surfaces.throttle[row], abs=5.1e-4)
        assert columns["pwm_ele"][k] == pytest.approx(
            1500 - 500 * frame.surfaces.elevator[row], abs=0.51
        )
        assert columns["pwm_ail"][k] == pytest.approx(
            1500 + 500 * frame.surfaces.aileron[row], abs=0.51
        )
        assert columns["pwm_rud"][k] == pytest.approx(
            1500 - 500 * frame.surfaces.rudder[row], abs=0.51
        )
        lowered += frame.surfaces.throttle[row] < 0.2
    assert (lowered > 0) == (row > 0)  # the leader's throttle stays above its trim
