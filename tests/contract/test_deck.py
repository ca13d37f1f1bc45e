"""Aircraft as programs outside command them, without any program outside."""

import math

import numpy as np
import pytest
from run_flight import Collector, short

from testbed.frames import geodetic_from_ned
from testbed.links.cockpit import Item, Mode, Refusal
from testbed.metrics import outside
from testbed.sim.deck import Deck
from testbed.sim.loop import fly
from testbed.sim.outside import Outside
from testbed.sim.run import run
from testbed.sim.world import build
from testbed.state import Origin

EXTERNAL = "fleet.2.commanded_by=external"


def flown(script=None, *changes, seconds=10.0, commanded=True):
    """The frames of a flight in which `script`, by times in s, does things to the deck."""
    world = build(short(*changes, seconds=seconds), commanded=commanded)
    left = sorted((script or {}).items())

    def before(now, due):
        while left and left[0][0] <= now:
            left.pop(0)[1](world.deck.cockpits)
        return False

    collector = Collector()
    assert fly(world, [collector], before) == "flown"
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
def unwatched():
    """Frames of a flight that nobody outside looks at."""
    return flown(commanded=False)


@pytest.fixture(scope="module")
def quiet():
    """The same where somebody looks, and asks for nothing."""
    return flown()


def test_who_looks_on_changes_no_bit(quiet, unwatched):
    same_bits(quiet, unwatched)


def follower_away(frames, row=3):
    """How far a follower is from its slot at the end, m."""
    return float(np.linalg.norm(frames[-1].formation.error_ned[row - 1]))


def test_a_follower_loiters_where_it_was_and_comes_back():
    place = {}

    def away(cockpits):
        assert cockpits[3].change_mode(Mode.LOITER) is None
        place["centre"] = cockpits[3]._navigator.here

    frames = flown({20.0: away, 60.0: lambda c: c[3].change_mode(Mode.FBWA)}, seconds=110.0)
    at = times(frames)
    north, east, up = place["centre"]
    position = of(frames, lambda frame: frame.truth.position_ned[3])
    far = np.hypot(position[:, 0] - north, position[:, 1] - east)
    settled = (at > 45.0) & (at < 60.0)
    speed = of(frames, lambda frame: frame.truth.airspeed[3])[settled]
    bank = of(frames, lambda frame: frame.truth.euler[3, 0])[settled]
    # WP_LOITER_RAD of 60 m is widened to what 45 deg of bank can fly at 22 m/s with some to spare
    tightest = 22.0**2 / (9.80665 * math.tan(math.radians(45.0)))
    radius = max(60.0, 1.25 * tightest)
    # L1 has no integral: the slip of such a turn, worth 2.6 deg of bank, leaves the circle wide
    assert abs(far[settled] - radius).max() < 0.08 * radius
    assert abs(-position[settled, 2] - up).max() < 2.0
    assert abs(speed - 22.0).max() < 1.0
    # the bank of a steady turn, V²/(g R), and what the side force of its slip of 0.7 deg takes
    assert np.degrees(bank).mean() == pytest.approx(
        math.degrees(math.atan(22.0**2 / (9.80665 * far[settled].mean()))), abs=3.0
    )
    others = of(frames, lambda frame: np.linalg.norm(frame.formation.error_ned[:2], axis=1))
    assert others[at > 40.0].max() < 3.0
    # the law closes a gap of hundreds of metres at some 3 m/s: it is on its way
    gap = of(frames, lambda frame: np.linalg.norm(frame.formation.error_ned[2]))
    closing = -np.diff(gap[(at > 75.0)]) / np.diff(at[at > 75.0])
    assert closing.min() > 2.0
    said = [event.text for event in events(frames) if event.source == "uav3"]
    assert [text for text in said if "mode" in text] == ["mode LOITER", "mode FBWA"]


def nearest(frames, row, place, after_s=0.0):
    """How near an aircraft came to a place (north, east), m."""
    path = of([f for f in frames if f.time_s >= after_s], lambda f: f.truth.position_ned[row, :2])
    return np.linalg.norm(path - place, axis=1).min()


def waypoint(cockpits, row, frames_ahead, right, up):
    """A mission item ahead of an aircraft and to its right, m, as it flies now."""
    navigator = cockpits[row]._navigator
    north, east, _ = navigator.here
    # Simulation 3 begins eastwards
    place = np.array([north - right, east + frames_ahead, 0.0])
    latitude, longitude, _ = geodetic_from_ned(place, Origin()).tolist()
    return Item(16, 6, (0.0,) * 4, latitude, longitude, up), place[:2]


def test_a_mission_begins_where_the_aircraft_is_when_it_begins_it():
    """Uploaded first and flown later, as ground stations do: no waypoint is passed by then."""
    box = {}

    def upload(cockpits):
        first, box["first"] = waypoint(cockpits, 3, 150.0, 60.0, 100.0)
        second, _ = waypoint(cockpits, 3, 600.0, -300.0, 100.0)
        assert cockpits[3].change_mission([first, first, second]) is None

    items = {}
    frames = flown(
        {
            2.0: upload,
            14.0: lambda c: c[3].change_mode(Mode.AUTO),
            15.0: lambda c: items.update(soon=c[3].item),
            59.0: lambda c: items.update(late=c[3].item),
        },
        seconds=60.0,
    )
    assert items == {"soon": 1, "late": 2}
    assert nearest(frames, 3, box["first"], 14.0) < 90.0  # the page's waypoint radius


def test_a_leader_that_is_taken_off_its_mission_goes_on_to_the_same_waypoint():
    place = np.array([640.0, 640.0])  # Simulation 3's first
    items = {}
    frames = flown(
        {
            20.0: lambda c: (items.update(before=c[0].item), c[0].change_mode(Mode.LOITER)),
            45.0: lambda c: c[0].change_mode(Mode.AUTO),
            46.0: lambda c: items.update(after=c[0].item),
        },
        seconds=80.0,
    )
    assert items == {"before": 1, "after": 1}
    assert nearest(frames, 0, place, 45.0) < 90.0
    assert frames[-1].truth.airspeed[0] == pytest.approx(22.0, abs=1.0)


def test_circles_that_are_flown_follow_what_they_depend_on():
    """Airspeed, radius and bank, each of one aircraft; they circle 10 m above one another."""
    centres, answers = {}, []
    radii = {
        1: 1.25 * 28.0**2 / 9.80665,
        2: 150.0,
        3: 1.25 * 22.0**2 / (9.80665 * math.tan(math.radians(25.0))),
    }

    def away(cockpits):
        for row in radii:
            centres[row] = cockpits[row]._navigator.here[:2]
            assert cockpits[row].change_mode(Mode.LOITER) is None

    def change(cockpits):
        answers.append(cockpits[1].change_airspeed(28.0))
        answers.append(cockpits[2].change_parameter("WP_LOITER_RAD", 150.0))
        answers.append(cockpits[3].change_parameter("ROLL_LIMIT_DEG", 25.0))

    frames = flown({2.0: away, 30.0: change}, seconds=100.0)
    assert answers == [None] * 3
    settled = of([f for f in frames if f.time_s > 85.0], lambda f: f.truth.position_ned)
    for row, radius in radii.items():
        far = np.linalg.norm(settled[:, row, :2] - centres[row], axis=1)
        assert np.abs(far - radius).max() < 0.12 * radius, row
        assert np.ptp(far) < 0.03 * radius, row


def test_a_place_takes_an_aircraft_out_of_its_failsafe():
    box = {}

    def go(cockpits):
        seat = cockpits[3]
        box["before"] = seat.failsafe
        assert seat.fly_to(38.01, 0.0, None, None) is None
        box["after"] = seat.failsafe

    flown(
        {
            1.0: lambda c: c[3].change_mode(Mode.GUIDED),
            2.0: lambda c: c[3].sticks(0.1, 0.0, 0.5, attitude=True),
            5.0: go,
        },
        seconds=6.0,
    )
    assert box == {"before": True, "after": False}


def test_every_item_of_a_page_can_be_gone_on_at():
    world = build(short(), commanded=True)
    leader = world.deck.cockpits[0]
    places = [k for k, each in enumerate(leader.mission) if k and each.command != 177]
    for number in places:
        assert leader.go_on_at(number) is None
        assert leader.item == number
    assert leader.go_on_at(len(leader.mission)) is not None


def test_an_airspeed_given_by_hand_outlives_a_jump_in_the_mission():
    world = build(short(), commanded=True)
    leader = world.deck.cockpits[0]
    assert leader.change_airspeed(25.0) is None
    assert leader.go_on_at(3) is None
    assert leader._navigator._mission.plan.mission.airspeed == 25.0


def test_sticks_are_flown_from_the_next_period_on_and_their_silence_is_a_failsafe():
    bank, pitch = math.radians(20.0), math.radians(3.0)
    script = {
        round(t, 2): lambda c: c[3].sticks(bank, pitch, 0.5) for t in np.arange(2.0, 8.0, 0.1)
    }
    frames = flown(script | {14.0: lambda c: c[3].sticks(0.0, 0.0, 0.4)}, EXTERNAL, seconds=16.0)
    at = times(frames)
    told = of(frames, lambda frame: [column[3] for column in frame.command])
    first = np.flatnonzero(np.isclose(told[:, 1], bank))[0]
    assert at[first] == pytest.approx(2.0, abs=1e-9)
    held = (at >= 2.0) & (at < 9.38)
    assert np.allclose(told[held], [pitch, bank, 0.5], rtol=0, atol=1e-12)
    said = [(event.time_s, event.level, event.text) for event in events(frames)]
    # the failsafe: 1.5 s after the last command, and before the first one, whose clock is the start
    silent = [(t, level) for t, level, text in said if "hears no commands for 1.5 s" in text]
    assert [level for _, level in silent] == ["warning"] * 3
    assert [t for t, _ in silent] == pytest.approx([1.52, 9.4, 15.52], abs=0.05)
    back = [t for t, _, text in said if text == "hears commands again"]
    assert back == pytest.approx([2.0, 14.0], abs=0.05)
    rolled = of(frames, lambda frame: frame.truth.euler[3, 0])[(at > 5.0) & (at < 8.0)]
    assert np.degrees(rolled).mean() == pytest.approx(20.0, abs=1.5)


@pytest.mark.parametrize(
    ("row", "why"), [(1, "commanded_by: external"), (0, "in AUTO: sticks are for FBWA")]
)
def test_sticks_that_nobody_asked_for_are_refused_and_move_nothing(unwatched, row, why):
    refusals = []
    frames = flown({2.0: lambda c: refusals.append(c[row].sticks(0.5, 0.1, 1.0))})
    assert why in refusals[0].text
    same_bits(frames, unwatched)


def test_a_leader_is_flown_by_hand_in_fbwa():
    def take(cockpits):
        assert cockpits[0].change_mode(Mode.FBWA) is None
        assert cockpits[0].sticks(math.radians(15.0), 0.0, 0.45) is None

    frames = flown({5.0: take}, seconds=6.0)
    assert frames[-1].command.roll[0] == pytest.approx(math.radians(15.0))
    assert math.degrees(frames[-1].truth.euler[0, 0]) > 5.0


@pytest.mark.parametrize("name", ["RLL_RATE_P", "RLL2SRV_TCONST", "ROLL_LIMIT_DEG"])
def test_a_parameter_acts_at_once_and_only_on_its_aircraft(quiet, name):
    values = {"RLL_RATE_P": 0.02, "RLL2SRV_TCONST": 2.0, "ROLL_LIMIT_DEG": 1.0}
    answers = []

    def change(cockpits):
        answers.append(cockpits[1].change_parameter(name, values[name]))

    changed = flown({4.0: change}, seconds=5.0)
    assert answers == [None]
    before = [k for k, frame in enumerate(quiet) if frame.time_s <= 4.0 - 1e-9]
    same_bits(quiet[: len(before)], changed[: len(before)])
    at = len(before) + 1
    assert changed[at].surfaces.aileron[1] != quiet[at].surfaces.aileron[1]
    assert changed[at].surfaces.aileron[2] == quiet[at].surfaces.aileron[2]
    said = [event.text for event in events(changed) if event.source == "uav1"]
    assert said[0].startswith(f"{name} {values[name]:g} (was ")


def test_a_parameter_set_to_what_it_is_moves_nothing(quiet):
    def change(cockpits):
        for name, value in cockpits[1].parameters.items():
            assert cockpits[1].change_parameter(name, float(np.float32(value))) is None

    same_bits(quiet, flown({4.0: change}))


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("RLL_RATE_Q", 1.0, "no such parameter"),
        ("RLL_RATE_P", math.nan, "not a number"),
        ("AIRSPEED_MIN", -1.0, "greater than 0"),
        ("AIRSPEED_MAX", 1.0, "greater than AIRSPEED_MIN"),
        ("NAVL1_PERIOD", 0.0, "greater than 0"),
        ("WP_LOITER_RAD", 0.5, "1 m or more"),
        ("WP_RADIUS", math.inf, "1 m or more"),
        ("SERVO1_MIN", 3.4e38, "800 to 2200"),
        ("SERVO2_MAX", 900.0, "must rise"),
    ],
)
def test_a_parameter_that_cannot_be_flown_with_is_refused(name, value, why):
    world = build(short(), commanded=True)
    cockpit = world.deck.cockpits[1]
    before = dict(cockpit.parameters)
    assert why in cockpit.change_parameter(name, value).text
    assert cockpit.parameters == before


def test_disarming_in_flight_must_be_forced_and_stops_the_motor():
    refusals = []

    def first(cockpits):
        refusals.append(cockpits[2].arm(False, force=False))

    frames = flown(
        {
            1.0: first,
            2.0: lambda c: c[2].arm(False, force=True),
            4.0: lambda c: c[2].arm(True, force=False),
        },
        seconds=6.0,
    )
    at, throttle = times(frames), of(frames, lambda frame: frame.surfaces.throttle[2])
    assert "forced" in refusals[0].text
    assert (throttle[(at > 2.05) & (at < 4.0)] == 0.0).all()
    assert (throttle[at < 2.0] > 0.05).all() and (throttle[at > 4.1] > 0.05).all()


def test_ideal_and_replayed_aircraft_refuse_with_the_reason():
    world = build(short("fleet.0.vehicle=ideal"), commanded=True)
    refusal = world.deck.cockpits[1].change_mode(Mode.LOITER)
    assert "ideal vehicle" in refusal.text
    assert isinstance(world.deck, Deck)
    assert isinstance(world.deck.cockpits[1].sticks(0.0, 0.0, 0.0), Refusal)


def test_the_pages_mission_reads_as_items_that_fly_the_same_way():
    """Uploaded again as it was downloaded, it is flown to the bit as the page's own."""
    box = {}

    def again(cockpits):
        items = cockpits[0].mission
        box["items"] = items
        assert cockpits[0].change_mission(items) is None

    quiet = flown(seconds=60.0)
    frames = flown({0.0: again}, seconds=60.0)
    gap = of(frames, lambda frame: frame.truth.position_ned[0]) - of(
        quiet, lambda frame: frame.truth.position_ned[0]
    )
    assert np.abs(gap).max() < 0.01  # latitudes of 1e-13 degrees apart
    commands = [item.command for item in box["items"]]
    assert commands == [16] + [16] * 3 + [16] * 4 + [177] + [16] * 4 + [177] + [18] * 4 + [17]
    assert isinstance(box["items"][0], Item)


def test_the_metrics_say_what_was_done_from_outside_and_no_law_is_blamed_for_it(tmp_path):
    page = short(seconds=6.0)
    quiet = run(page, out=tmp_path / "quiet", outside=Outside(tlog=True))
    assert quiet.metrics["commanded"] == {}
    assert (tmp_path / "quiet" / "run.tlog").stat().st_size > 10_000
    world = build(page, commanded=True)
    leader, uav1 = world.deck.cockpits[:2]
    uav1.change_mode(Mode.LOITER)
    uav1.change_parameter("RLL_RATE_P", 0.1)
    leader.change_airspeed(23.0)
    leader.change_airspeed(24.0)
    assert world.deck.asked() == {
        "leader": {"airspeeds": 2},
        "uav1": {"modes": 1, "parameters": 1},
    }
    told = outside.describe_commands(world.deck.asked()).plain
    assert told.splitlines() == ["leader: airspeeds 2", "uav1: modes 1, parameters 1"]
    away = flown({2.0: lambda c: c[3].change_mode(Mode.LOITER)}, seconds=40.0)
    said = of(away, lambda frame: frame.formation.saturations)
    # far behind its slot the law asks for more throttle than there is, but does not fly
    assert (said[of(away, lambda frame: frame.time_s > 3.0), 2] == 0).all()
