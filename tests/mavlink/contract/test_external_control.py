"""External commands to aircraft, given directly to their sessions."""

import math

import numpy as np
import pytest
from run_flight import Collector, short

from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import FbwaCommand, NedOrigin
from testbed.flight.external_control import ExternalControl
from testbed.flight.loop import fly
from testbed.mavlink.vehicle_control import FlightMode, MissionItem, Rejection
from testbed.metrics.facts import describe_commands
from testbed.plan.world import build
from testbed.runs.external_options import ExternalOptions
from testbed.runs.run import run

EXTERNAL = "fleet.2.commanded_by=external"


def set_manual(session, roll, pitch, throttle, **options):
    command = FbwaCommand(roll=roll, pitch=pitch, throttle=throttle)
    return session.set_manual_command(command, **options)


def flown(script=None, *changes, seconds=10.0, commanded=True):
    """Fly while `script` calls functions of all sessions at times in s; return the samples."""
    world = build(short(*changes, seconds=seconds), commanded=commanded)
    left = sorted((script or {}).items())

    def before(now, due):
        while left and left[0][0] <= now:
            left.pop(0)[1](world.external_control.vehicles)
        return False

    collector = Collector()
    assert fly(world, [collector], before) == "completed"
    return collector.frames


def of(frames, pick):
    return np.array([pick(frame) for frame in frames])


def times(frames):
    return of(frames, lambda frame: frame.time_s)


def events(frames):
    return [event for frame in frames for event in frame.events]


def same_bits(ones, others):
    for one, other in zip(ones, others, strict=True):
        for left, right in zip(one.truth, other.truth, strict=True):
            assert left.tobytes() == right.tobytes()
        for left, right in zip(one.command, other.command, strict=True):
            assert left.tobytes() == right.tobytes()


@pytest.fixture(scope="module")
def without_sessions():
    """Return the samples of a flight without sessions."""
    return flown(commanded=False)


@pytest.fixture(scope="module")
def uncommanded():
    """Return the samples of a flight with sessions that get no commands."""
    return flown()


def test_sessions_without_commands_change_no_bit(uncommanded, without_sessions):
    same_bits(uncommanded, without_sessions)


def test_only_attitude_targets_in_guided_are_guided():
    """A circle in GUIDED, its failsafe and sticks in FBWA are flown as in FBWA."""

    def mode(name):
        return lambda sessions: sessions[3].set_mode(FlightMode[name])

    def target(sessions):
        assert set_manual(sessions[3], 0.1, 0.05, 0.3, attitude=True) is None

    script = {1.0: mode("GUIDED"), 2.0: target, 5.0: mode("LOITER"), 6.0: mode("FBWA")}
    frames = flown(script, seconds=7.0)
    guided = of(frames, lambda frame: frame.records[0]["guided"].copy())
    assert not guided[:, :3].any()
    # the failsafe is 1.5 s later
    found = times(frames)[guided[:, 3]]
    assert (found.min(), found.max()) == pytest.approx((2.0, 3.5), abs=0.1)
    assert len(found) == pytest.approx(1.5 * 25, abs=2)


def follower_away(frames, row=3):
    """Return the distance of a follower from its slot at the end, m."""
    return float(np.linalg.norm(frames[-1].formation.error_ned[row - 1]))


def test_follower_loiters_in_place_and_rejoins():
    point = {}

    def away(sessions):
        assert sessions[3].set_mode(FlightMode.LOITER) is None
        point["centre"] = sessions[3]._navigator.position

    frames = flown({10.0: away, 45.0: lambda c: c[3].set_mode(FlightMode.FBWA)}, seconds=70.0)
    at = times(frames)
    north, east, up = point["centre"]
    position = of(frames, lambda frame: frame.truth.position_ned[3])
    distance = np.hypot(position[:, 0] - north, position[:, 1] - east)
    settled = (at > 33.0) & (at < 45.0)
    speed = of(frames, lambda frame: frame.truth.airspeed[3])[settled]
    bank = of(frames, lambda frame: frame.truth.euler[3, 0])[settled]
    # WP_LOITER_RAD of 60 m is widened to what 45 deg of bank can fly at 22 m/s with some to spare
    tightest = 22.0**2 / (9.80665 * math.tan(math.radians(45.0)))
    radius = max(60.0, 1.25 * tightest)
    # L1 has no integral: the sideslip in such a turn, worth 2.6 deg of bank, widens the circle
    assert abs(distance[settled] - radius).max() < 0.08 * radius
    assert abs(-position[settled, 2] - up).max() < 2.0
    assert abs(speed - 22.0).max() < 1.0
    # the bank of a steady turn, V²/(g R), within the effect of its sideslip of 0.7 deg
    assert np.degrees(bank).mean() == pytest.approx(
        math.degrees(math.atan(22.0**2 / (9.80665 * distance[settled].mean()))), abs=3.0
    )
    others = of(frames, lambda frame: np.linalg.norm(frame.formation.error_ned[:2], axis=1))
    assert others[at > 40.0].max() < 3.0
    # the law reduces an error of hundreds of metres at some 3 m/s
    error = of(frames, lambda frame: np.linalg.norm(frame.formation.error_ned[2]))
    closing = -np.diff(error[(at > 60.0)]) / np.diff(at[at > 60.0])
    assert closing.min() > 2.0
    texts = [event.text for event in events(frames) if event.source == "uav3"]
    assert [text for text in texts if "mode" in text] == ["mode LOITER", "mode FBWA"]


def nearest(frames, row, point, after_s=0.0):
    """Return the smallest distance of an aircraft from a position (north, east), m."""
    path = of([f for f in frames if f.time_s >= after_s], lambda f: f.truth.position_ned[row, :2])
    return np.linalg.norm(path - point, axis=1).min()


def waypoint(sessions, row, ahead, right, up):
    """Make a mission item ahead of an aircraft and to its right, m."""
    navigator = sessions[row]._navigator
    north, east, _ = navigator.position
    # Simulation 3 starts eastwards
    point = np.array([north - right, east + ahead, 0.0])
    latitude, longitude, _ = geodetic_from_ned(point, NedOrigin()).tolist()
    return MissionItem(16, 6, (0.0,) * 4, latitude, longitude, up), point[:2]


def test_mission_starts_at_current_position():
    """A mission uploaded before AUTO is entered, as by ground stations, passes no waypoint yet."""
    box = {}

    def upload(sessions):
        first, box["first"] = waypoint(sessions, 3, 150.0, 60.0, 100.0)
        second, _ = waypoint(sessions, 3, 600.0, -300.0, 100.0)
        assert sessions[3].set_mission([first, first, second]) is None

    items = {}
    frames = flown(
        {
            2.0: upload,
            14.0: lambda c: c[3].set_mode(FlightMode.AUTO),
            15.0: lambda c: items.update(soon=c[3].current_item),
            59.0: lambda c: items.update(late=c[3].current_item),
        },
        seconds=60.0,
    )
    assert items == {"soon": 1, "late": 2}
    assert nearest(frames, 3, box["first"], 14.0) < 90.0  # the scenario's waypoint radius


def test_leader_resumes_mission_at_same_waypoint():
    point = np.array([640.0, 640.0])  # Simulation 3's first
    items = {}
    frames = flown(
        {
            10.0: lambda c: (
                items.update(before=c[0].current_item),
                c[0].set_mode(FlightMode.LOITER),
            ),
            30.0: lambda c: c[0].set_mode(FlightMode.AUTO),
            31.0: lambda c: items.update(after=c[0].current_item),
        },
        seconds=65.0,
    )
    assert items == {"before": 1, "after": 1}
    assert nearest(frames, 0, point, 30.0) < 90.0
    assert frames[-1].truth.airspeed[0] == pytest.approx(22.0, abs=1.0)


def test_active_circle_follows_its_parameters():
    """Change airspeed, radius and bank, each of one aircraft, while they circle."""
    centres, answers = {}, []
    radii = {
        1: 1.25 * 28.0**2 / 9.80665,
        2: 150.0,
        3: 1.25 * 22.0**2 / (9.80665 * math.tan(math.radians(25.0))),
    }

    def away(sessions):
        for row in radii:
            centres[row] = sessions[row]._navigator.position[:2]
            assert sessions[row].set_mode(FlightMode.LOITER) is None

    def change(sessions):
        answers.append(sessions[1].set_airspeed(28.0))
        answers.append(sessions[2].set_parameter("WP_LOITER_RAD", 150.0))
        answers.append(sessions[3].set_parameter("ROLL_LIMIT_DEG", 25.0))

    frames = flown({2.0: away, 12.0: change}, seconds=60.0)
    assert answers == [None] * 3
    settled = of([f for f in frames if f.time_s > 45.0], lambda f: f.truth.position_ned)
    for row, radius in radii.items():
        distance = np.linalg.norm(settled[:, row, :2] - centres[row], axis=1)
        assert np.abs(distance - radius).max() < 0.12 * radius, row
        assert np.ptp(distance) < 0.03 * radius, row


def test_loiter_point_ends_failsafe():
    box = {}

    def go(sessions):
        session = sessions[3]
        box["before"] = session.failsafe
        assert session.set_loiter_point(38.01, 0.0, None, None) is None
        box["after"] = session.failsafe

    flown(
        {
            1.0: lambda c: c[3].set_mode(FlightMode.GUIDED),
            2.0: lambda c: set_manual(c[3], 0.1, 0.0, 0.5, attitude=True),
            5.0: go,
        },
        seconds=6.0,
    )
    assert box == {"before": True, "after": False}


def test_every_scenario_item_can_be_current():
    world = build(short(), commanded=True)
    leader = world.external_control.vehicles[0]
    points = [k for k, each in enumerate(leader.mission) if k and each.command != 177]
    for number in points:
        assert leader.set_current_item(number) is None
        assert leader.current_item == number
    assert leader.set_current_item(len(leader.mission)) is not None


def test_item_that_is_not_reached_can_be_current():
    """A mission with a landing behind a circle without end is kept, and says what it flies."""
    leader = build(short(), commanded=True).external_control.vehicles[0]
    far = waypoint([leader], 0, 600.0, 0.0, 100.0)[0]._replace(frame=10)
    landing = far._replace(command=21, frame=3, z=0.0)
    circle = far._replace(command=17)
    leader.pop_events()
    assert leader.set_mission([far, far, circle, far, landing]) is None
    texts = " ".join(event.text for event in leader.pop_events())
    for words in ("the ground is flat", "does not land", "MISSION_SET_CURRENT: items 3, 4"):
        assert words in texts
    for number in (1, 2, 3, 4):
        assert leader.set_current_item(number) is None
        assert leader.current_item == number
    assert "no item 5" in leader.set_current_item(5).text


def test_commanded_airspeed_survives_item_change():
    world = build(short(), commanded=True)
    leader = world.external_control.vehicles[0]
    assert leader.set_airspeed(25.0) is None
    assert leader.set_current_item(3) is None
    assert leader._navigator._mission.plan.mission.airspeed == 25.0


def test_airspeed_without_effect_is_refused():
    world = build(short(), commanded=True)
    leader, follower = world.external_control.vehicles[:2]
    assert "the formation's commands set the throttle" in follower.set_airspeed(25.0).text
    assert follower.command_counts["airspeeds"] == 0
    assert leader.set_mode(FlightMode.FBWA) is None
    assert "manual commands set the throttle" in leader.set_airspeed(25.0).text
    assert follower.set_mode(FlightMode.LOITER) is None
    assert follower.set_airspeed(25.0) is None


def test_manual_command_then_timeout_failsafe():
    bank, pitch = math.radians(20.0), math.radians(3.0)
    script = {
        round(t, 2): lambda c: set_manual(c[3], bank, pitch, 0.5) for t in np.arange(2.0, 8.0, 0.1)
    }
    frames = flown(
        script | {14.0: lambda c: set_manual(c[3], 0.0, 0.0, 0.4)}, EXTERNAL, seconds=16.0
    )
    at = times(frames)
    commanded = of(frames, lambda frame: [column[3] for column in frame.command])
    first = np.flatnonzero(np.isclose(commanded[:, 1], bank))[0]
    assert at[first] == pytest.approx(2.0, abs=1e-9)
    held = (at >= 2.0) & (at < 9.38)
    assert np.allclose(commanded[held], [pitch, bank, 0.5], rtol=0, atol=1e-12)
    texts = [(event.time_s, event.level, event.text) for event in events(frames)]
    # failsafe 1.5 s after the last command; before the first one, 1.5 s after the start
    silent = [(t, level) for t, level, text in texts if "receives no commands for 1.5 s" in text]
    assert [level for _, level in silent] == ["warning"] * 3
    assert [t for t, _ in silent] == pytest.approx([1.52, 9.4, 15.52], abs=0.05)
    back = [t for t, _, text in texts if text == "receives commands again"]
    assert back == pytest.approx([2.0, 14.0], abs=0.05)
    rolled = of(frames, lambda frame: frame.truth.euler[3, 0])[(at > 5.0) & (at < 8.0)]
    assert np.degrees(rolled).mean() == pytest.approx(20.0, abs=1.5)


@pytest.mark.parametrize(
    ("row", "why"), [(1, "commanded_by: external"), (0, "mode AUTO: manual commands are for FBWA")]
)
def test_manual_command_of_follower_is_rejected(without_sessions, row, why):
    rejections = []
    frames = flown({2.0: lambda c: rejections.append(set_manual(c[row], 0.5, 0.1, 1.0))})
    assert why in rejections[0].text
    same_bits(frames, without_sessions)


def test_leader_takes_manual_commands_in_fbwa():
    def take(sessions):
        assert sessions[0].set_mode(FlightMode.FBWA) is None
        assert set_manual(sessions[0], math.radians(15.0), 0.0, 0.45) is None

    frames = flown({5.0: take}, seconds=6.0)
    assert frames[-1].command.roll[0] == pytest.approx(math.radians(15.0))
    assert math.degrees(frames[-1].truth.euler[0, 0]) > 5.0


@pytest.mark.parametrize("name", ["RLL_RATE_P", "RLL2SRV_TCONST", "ROLL_LIMIT_DEG"])
def test_parameter_acts_on_its_aircraft_only(uncommanded, name):
    values = {"RLL_RATE_P": 0.02, "RLL2SRV_TCONST": 2.0, "ROLL_LIMIT_DEG": 1.0}
    answers = []

    def change(sessions):
        answers.append(sessions[1].set_parameter(name, values[name]))

    changed = flown({4.0: change}, seconds=5.0)
    assert answers == [None]
    before = [k for k, frame in enumerate(uncommanded) if frame.time_s <= 4.0 - 1e-9]
    same_bits(uncommanded[: len(before)], changed[: len(before)])
    at = len(before) + 1
    assert changed[at].surfaces.aileron[1] != uncommanded[at].surfaces.aileron[1]
    assert changed[at].surfaces.aileron[2] == uncommanded[at].surfaces.aileron[2]
    texts = [event.text for event in events(changed) if event.source == "uav1"]
    assert texts[0].startswith(f"{name} {values[name]:g} (was ")


def test_parameter_set_to_same_value_changes_nothing(uncommanded):
    def change(sessions):
        for name, value in sessions[1].parameters.items():
            assert sessions[1].set_parameter(name, float(np.float32(value))) is None

    same_bits(uncommanded, flown({4.0: change}))


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("RLL_RATE_Q", 1.0, "no such parameter"),
        ("RLL_RATE_P", math.nan, "nan; it must be 0 to 20"),
        ("AIRSPEED_MIN", -1.0, "must be 1 to 400"),
        ("AIRSPEED_MAX", 1.0, "greater than AIRSPEED_MIN"),
        ("NAVL1_PERIOD", 0.0, "must be 1 to 600"),
        ("WP_LOITER_RAD", 0.5, "1 m or more"),
        ("WP_RADIUS", math.inf, "1 m or more"),
        ("SERVO1_MIN", 3.4e38, "800 to 2200"),
        ("SERVO2_MAX", 900.0, "SERVO2_MIN (1000) must be less"),
    ],
)
def test_invalid_parameter_value_is_rejected(name, value, why):
    world = build(short(), commanded=True)
    session = world.external_control.vehicles[1]
    before = dict(session.parameters)
    assert why in session.set_parameter(name, value).text
    assert session.parameters == before


def test_forced_disarm_stops_the_motor():
    rejections = []

    def first(sessions):
        rejections.append(sessions[2].set_armed(False, force=False))

    frames = flown(
        {
            1.0: first,
            2.0: lambda c: c[2].set_armed(False, force=True),
            4.0: lambda c: c[2].set_armed(True, force=False),
        },
        seconds=6.0,
    )
    at, throttle = times(frames), of(frames, lambda frame: frame.surfaces.throttle[2])
    assert "forced" in rejections[0].text
    assert (throttle[(at > 2.05) & (at < 4.0)] == 0.0).all()
    assert (throttle[at < 2.0] > 0.05).all() and (throttle[at > 4.1] > 0.05).all()


def test_uncommandable_vehicles_reject_with_reason():
    world = build(short("fleet.0.vehicle=unicycle"), commanded=True)
    rejection = world.external_control.vehicles[1].set_mode(FlightMode.LOITER)
    assert "ideal vehicle" in rejection.text
    assert isinstance(world.external_control, ExternalControl)
    assert isinstance(set_manual(world.external_control.vehicles[1], 0.0, 0.0, 0.0), Rejection)


def test_scenario_mission_as_items_flies_the_same():
    """The scenario's mission, downloaded and uploaded again, is flown in the same way."""
    box = {}

    def again(sessions):
        items = sessions[0].mission
        box["items"] = items
        assert sessions[0].set_mission(items) is None

    uncommanded = flown(seconds=35.0)  # beyond the first corner
    frames = flown({0.0: again}, seconds=35.0)
    error = of(frames, lambda frame: frame.truth.position_ned[0]) - of(
        uncommanded, lambda frame: frame.truth.position_ned[0]
    )
    assert np.abs(error).max() < 0.01  # latitudes differ by 1e-13 degrees
    commands = [item.command for item in box["items"]]
    assert commands == [16] + [16] * 3 + [16] * 4 + [177] + [16] * 4 + [177] + [18] * 4 + [17]
    assert isinstance(box["items"][0], MissionItem)


def test_metrics_count_commands_and_mask_law(tmp_path):
    scenario = short(seconds=6.0)
    uncommanded = run(scenario, out=tmp_path / "run", external=ExternalOptions(tlog=True))
    assert uncommanded.metrics["commanded"] == {}
    assert (tmp_path / "run" / "run.tlog").stat().st_size > 10_000
    world = build(scenario, commanded=True)
    leader, uav1 = world.external_control.vehicles[:2]
    uav1.set_mode(FlightMode.LOITER)
    uav1.set_parameter("RLL_RATE_P", 0.1)
    leader.set_airspeed(23.0)
    leader.set_airspeed(24.0)
    assert world.external_control.command_counts() == {
        "leader": {"airspeeds": 2},
        "uav1": {"modes": 1, "parameters": 1},
    }
    commanded = describe_commands(world.external_control.command_counts()).plain
    assert commanded.splitlines() == ["leader: airspeeds 2", "uav1: modes 1, parameters 1"]
    away = flown({2.0: lambda c: c[3].set_mode(FlightMode.LOITER)}, seconds=15.0)
    saturations = of(away, lambda frame: frame.formation.saturations)
    # far behind its slot the law's throttle saturates, but does not control the aircraft
    assert (saturations[of(away, lambda frame: frame.time_s > 3.0), 2] == 0).all()
