"""What links tell of whole flights: where guidance goes, and a log that `import` reads."""

import math

import numpy as np
import pytest
from run_flight import Collector, short

from testbed.frames import geodetic_from_ned
from testbed.links.cockpit import Mode
from testbed.mavlink.flights import read_flight
from testbed.sim.loop import fly
from testbed.sim.outside import Outside
from testbed.sim.run import run
from testbed.sim.world import build

LEADER, FOLLOWER = 0, 2
BEHIND_M = 0.6  # that a place believed one control period ago may be off, and to spare


class Targets:
    """Notes each aircraft's place, as it believes, and where it is going."""

    def __init__(self, world):
        self.world, self.seen = world, []

    def begin(self, info):
        pass

    def observe(self, frame):
        places = frame.estimate.position_ned.tolist()
        pairs = [
            (c.target, place) for c, place in zip(self.world.deck.cockpits, places, strict=True)
        ]
        self.seen.append((frame.time_s, pairs))

    def end(self, summary, events):
        pass

    def between(self, begin, end, row):
        return [pairs[row] for time, pairs in self.seen if begin < time < end]


@pytest.fixture(scope="module")
def targets():
    """A flight in which the leader leaves its mission and a follower its slot."""
    world = build(short(seconds=75.0), commanded=True)
    leader, follower = (world.deck.cockpits[row] for row in (LEADER, FOLLOWER))
    away = geodetic_from_ned(np.array([300.0, 900.0, 0.0]), world.info.origin)
    left = [
        (42.0, lambda: leader.change_mode(Mode.LOITER)),
        (44.0, lambda: follower.change_mode(Mode.LOITER)),
        (60.0, lambda: leader.change_mode(Mode.GUIDED)),
        (62.0, lambda: leader.fly_to(float(away[0]), float(away[1]), 140.0, -150.0)),
        (64.0, lambda: leader.change_airspeed(24.0)),
        (70.0, lambda: leader.change_mode(Mode.FBWA)),
        (70.0, lambda: leader.sticks(0.0, 0.05, 0.5)),
    ]

    def before(now, due):
        while left and left[0][0] <= now:
            assert left.pop(0)[1]() is None
        return False

    seen = Targets(world)
    assert fly(world, [seen], before) == "flown"
    return seen


def test_a_leg_is_told_by_its_end_its_course_and_what_is_left_of_it(targets):
    # eastward along 640 m north; the next, southward along 640 m east, is begun at about 28 s
    for target, (north, _, _) in targets.between(0.1, 20.0, LEADER):
        assert target[:4] == (640.0, 640.0, 100.0, 22.0)
        assert target.course == pytest.approx(math.pi / 2)
        assert target.crosstrack == pytest.approx(north - 640.0, abs=BEHIND_M)
    turning = targets.between(32.0, 42.0, LEADER)
    for target, (_, east, _) in turning:
        assert target[:2] == (0.0, 640.0)
        assert target.crosstrack == pytest.approx(east - 640.0, abs=BEHIND_M)
    assert max(abs(target.crosstrack) for target, _ in turning) > 5.0


@pytest.mark.parametrize(("row", "begun"), [(LEADER, 42.0), (FOLLOWER, 44.0)])
def test_a_circle_is_told_by_its_centre(targets, row, begun):
    inside = targets.between(begun + 0.1, 60.0, row)
    (centre,) = {target[:2] for target, _ in inside}
    radii = []
    for target, (north, east, _) in inside:
        to_north, to_east = centre[0] - north, centre[1] - east
        radii.append(math.hypot(to_north, to_east) - target.crosstrack)
        if math.hypot(to_north, to_east) > 20.0:
            off = math.remainder(target.course - math.atan2(to_east, to_north), math.tau)
            # the bearing of a place 20 m away or more, seen from half a metre beside
            assert abs(off) < BEHIND_M / 20.0
    assert max(radii) - min(radii) < 2 * BEHIND_M
    assert min(radii) > 59.0
    assert inside[0][0].crosstrack < -55.0  # it sets out from the centre


def test_a_place_is_told_as_it_was_asked_for(targets):
    told = {target for target, _ in targets.between(64.1, 70.0, LEADER)}
    for target in told:
        assert target[:2] == pytest.approx((300.0, 900.0), abs=0.01)
        assert target[2:4] == (140.0, 24.0)


def test_who_circles_for_want_of_commands_goes_there(targets):
    # sticks that were said once, at 70 s, are taken back 1.5 s later
    assert None not in {target for target, _ in targets.between(72.0, 80.0, LEADER)}


def test_who_is_flown_by_sticks_or_the_formation_goes_to_no_place(targets):
    assert {target for target, _ in targets.between(70.1, 71.0, LEADER)} == {None}
    assert {target for target, _ in targets.between(0.0, 44.0, FOLLOWER)} == {None}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A run with a log, and its frames."""
    folder, frames = tmp_path_factory.mktemp("flight") / "run", Collector()
    run(short(seconds=40.0), out=folder, observers=[frames], outside=Outside(tlog=True))
    return folder / "run.tlog", frames.frames


@pytest.mark.parametrize(("row", "mode"), [(0, "AUTO"), (1, "FBWA"), (3, "FBWA")])
def test_a_runs_log_is_imported_as_it_was_flown(flight, row, mode):
    path, frames = flight
    read = read_flight(path, system=row + 1, mode=mode)
    assert not [note for note in read.notes if "not in the log" in note]
    assert read.sources["theta_cmd_rad"].endswith(" + STAB_PITCH_DOWN")
    columns = read.columns
    # at whole seconds, from the first on, all that is held was said that moment
    seconds = [k for k, t in enumerate(columns["t_s"]) if t > 0.5 and abs(t - round(t)) < 1e-6]
    then = {round(frame.time_s, 6): frame for frame in frames}
    assert len(seconds) >= 38
    lowered = 0
    for k in seconds:
        frame = then[round(float(columns["t_s"][k]), 6)]
        told = [each[row] for each in frame.command]
        # angles in single precision, and the throttle that lowers the nose in whole µs
        assert columns["theta_cmd_rad"][k] == pytest.approx(told[0], abs=2e-4)
        assert columns["phi_cmd_rad"][k] == pytest.approx(told[1], abs=1e-6)
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
