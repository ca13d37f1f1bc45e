"""Conversion between mission items and flight plans."""

import math

import numpy as np
import pytest

from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import NedOrigin
from testbed.flight.leader_control import MissionController
from testbed.guidance.flight_plan import (
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    WaypointLeg,
    make_plan,
)
from testbed.mavlink.mission_plans import (
    ItemFlightPlan,
    home_item,
    items_from_mission,
    items_of_segments,
    plan_from_items,
)
from testbed.mavlink.vehicle_control import MissionItem, Rejection
from testbed.plan.world import build
from testbed.scenario import load_scenario

ORIGIN = NedOrigin(latitude_deg=-35.36, longitude_deg=149.16, elevation_m=584.0)
PARAMS = GuidanceMission(legs=(), airspeed=22.0)
HERE = (10.0, -20.0, 100.0)
RELATIVE, SEA = 6, 5


def item(command, north=0.0, east=0.0, up=100.0, *, frame=RELATIVE, parameters=(0.0,) * 4):
    latitude, longitude, _ = geodetic_from_ned(np.array([north, east, 0.0]), ORIGIN)
    return MissionItem(command, frame, parameters, float(latitude), float(longitude), up)


def waypoints(*points):
    return [item(16, *point) for point in points]


def jump(to, times):
    return MissionItem(177, 2, (to, times, 0.0, 0.0), 0.0, 0.0, 0.0)


def plan(*items):
    found = plan_from_items([home_item(ORIGIN), *items], HERE, PARAMS, 60.0, ORIGIN)
    assert not isinstance(found, Rejection), found
    return found


def rejection(*items):
    found = plan_from_items([home_item(ORIGIN), *items], HERE, PARAMS, 60.0, ORIGIN)
    assert isinstance(found, Rejection)
    return found


def test_waypoints_in_order_then_circle_at_last():
    found = plan(*waypoints((500.0, 0.0, 120.0), (500.0, 400.0, 90.0)))
    first, second, last = found.plan.segments
    assert first.start == HERE
    assert np.allclose(first.end, (500.0, 0.0, 120.0), atol=1e-6)
    assert np.allclose(second.end, (500.0, 400.0, 90.0), atol=1e-6)
    assert last.circle and np.allclose(last.end, (500.0, 400.0, 90.0), atol=1e-6)
    assert found.items == (1, 2, 2)


def test_item_altitudes_above_home_or_sea():
    (part, _) = plan(item(16, 500.0, 0.0, 684.0, frame=SEA)).plan.segments
    assert part.end[2] == pytest.approx(100.0)
    assert "MAV_FRAME 1" in rejection(item(16, 500.0, frame=1)).text


def test_do_jump_makes_laps():
    square = waypoints((400.0, 0.0, 100.0), (400.0, 400.0, 100.0), (0.0, 400.0, 100.0))
    found = plan(*square, jump(1, 2), item(17, 0.0, 0.0, 100.0, parameters=(0.0, 0.0, -90.0, 0.0)))
    assert found.items == (1, 2, 3) * 3 + (5,)
    circle = found.plan.segments[-1]
    assert (circle.radius, circle.clockwise) == (90.0, False)
    ever = plan(*square, jump(2, -1))
    # one way to item 1, then items 2 and 3 again and again
    assert ever.items == (1, 2, 3, 2, 3)
    assert ever.plan.repeat_from == 3


def test_change_speed_applies_from_its_item_on():
    items = waypoints((600.0, 0.0, 100.0), (600.0, 600.0, 100.0))
    speed = MissionItem(178, 2, (0.0, 25.0, -1.0, 0.0), 0.0, 0.0, 0.0)
    assert plan(items[0], speed, items[1]).airspeeds == (22.0, 25.0, 25.0)


@pytest.mark.parametrize("command", [18, 19])
def test_loiter_turns_are_counted_or_timed(command):
    radius, turns = 100.0, 2.0
    asked = turns if command == 18 else turns * 2.0 * math.pi * radius / 22.0
    circle, *_ = plan(
        item(command, 300.0, 0.0, 100.0, parameters=(asked, 0.0, radius, 0.0)),
        *waypoints((0.0, 0.0, 100.0)),
    ).plan.segments
    assert circle.turns == pytest.approx(turns)


def test_circle_is_widened_to_the_bank_limit():
    (circle,) = plan(item(17, 300.0, 0.0, 100.0, parameters=(0.0, 0.0, 20.0, 0.0))).plan.segments
    tightest = 22.0**2 / (9.80665 * math.tan(math.radians(30.0)))
    assert circle.radius == pytest.approx(tightest)
    # one that has no radius leaves a quarter of that to steer with
    (circle,) = plan(item(17, 300.0, 0.0, 100.0)).plan.segments
    assert circle.radius == pytest.approx(1.25 * tightest)


def test_zero_position_is_the_current_one():
    (circle,) = plan(MissionItem(17, RELATIVE, (0.0,) * 4, 0.0, 0.0, 150.0)).plan.segments
    assert circle.end == (*HERE[:2], 150.0)


@pytest.mark.parametrize(
    ("items", "number", "why"),
    [
        ([item(84)], 1, "is not supported"),
        ([item(16, 10.0, 10.0, 2.0)], 1, "2 m above the ground"),
        ([item(16, 10.0, 10.0, 1e30)], 1, "to 20000 m"),
        ([item(16, math.nan)], 1, "not finite"),
        ([MissionItem(16, RELATIVE, (0.0,) * 4, 40.0, 149.0, 100.0)], 1, "100 km"),
        ([item(17), item(84)], 2, "is not supported"),
        ([item(17), jump(2, -1)], 2, "two waypoints"),
        ([item(16), jump(1, -1)], 2, "two waypoints"),
        ([item(16), jump(3, 2)], 2, "DO_JUMP"),
        ([item(16), item(16), jump(1, 1e6)], 3, "DO_JUMP"),
        ([item(16), jump(1, 1000), jump(1, 1000), *[jump(1, 1000)] * 20], 1, "10000 or fewer"),
        ([item(18, parameters=(0.0, 0.0, 90.0, 0.0))], 1, "turns"),
        ([MissionItem(178, 2, (0.0, math.nan, 0.0, 0.0), 0.0, 0.0, 0.0)], 1, "airspeed"),
        ([jump(0, 1)], 1, "DO_JUMP"),
    ],
)
def test_unflyable_item_is_rejected_by_number(items, number, why):
    found = rejection(*items)
    assert found.item == number
    assert why in found.text


TURN = {"parameters": (1.0, 0.0, 90.0, 0.0)}


@pytest.mark.parametrize(
    ("items", "flown", "repeat_from", "note"),
    [
        # a loop with a circle in it
        ([item(16), item(18, **TURN), jump(1, 2)], (1, 2) * 3, 5, ""),
        ([item(16), item(18, **TURN), jump(1, -1)], (1, 2, 1, 2), 2, ""),
        # loops in each other; the inner one makes its jumps once, as ArduPlane does
        ([item(16), item(16), jump(2, 1), jump(1, 1), item(17)], (1, 2, 2, 1, 2, 5), 5, ""),
        # a loop over a change of speed
        ([item(16), item(16), MissionItem(178, 2, (0, 25.0, 0, 0), 0, 0, 0), jump(1, 1)],
         (1, 2, 1, 2, 2), 4, ""),
        # forward, over items that only MISSION_SET_CURRENT reaches
        ([item(16), jump(4, 1), item(16), item(17)], (1, 4), 1, "MISSION_SET_CURRENT: item 3"),
        ([item(16), item(20), item(189), item(16), item(21, up=0.0)], (1, 2), 1, "items 4, 5"),
        # a landing, and actions of cameras
        ([item(22), item(206), item(16), item(21, up=0.0)], (1, 3, 4), 2, "item 4: does not land"),
        ([item(16), item(206), item(17)], (1, 3), 1, "no effect here: item 2"),
        ([item(16, frame=10), item(17, frame=11)], (1, 2), 1, "the ground is flat"),
    ],
)  # fmt: skip
def test_missions_of_ground_stations_are_kept(items, flown, repeat_from, note):
    found = plan(*items)
    assert found.items == flown
    assert found.plan.repeat_from == repeat_from
    assert note in "; ".join(found.notes) and bool(note) == bool(found.notes)


def test_landing_is_a_circle_at_the_altitude_before():
    *_, last = plan(item(16, 300.0, 0.0, 60.0), item(21, 900.0, 0.0, 0.0)).plan.segments
    assert last.circle and np.allclose(last.end, (900.0, 0.0, 60.0), atol=1e-6)


def test_unreached_item_is_flown_from_there():
    items = [home_item(ORIGIN), item(16), item(17), item(16, 500.0), item(16, 900.0), jump(3, -1)]
    found = plan_from_items(items, HERE, PARAMS, 60.0, ORIGIN, 4)
    assert found.items == (4, 3, 4, 3, 4)[: len(found.items)]
    assert found.plan.segments[0].start == HERE


def test_altitude_above_terrain_is_above_home():
    for frame in (3, 6, 10, 11):
        (leg, _) = plan(item(16, 500.0, frame=frame)).plan.segments
        assert leg.end[2] == 100.0


def test_resumed_loop_with_a_circle_repeats_in_full():
    found = plan(item(18, **TURN), item(16, 500.0), jump(1, -1))
    left = found.resume(found.plan.repeat_from, HERE)
    assert left.items == (1, 2, 1, 2) and left.plan.repeat_from == 2


def test_mission_without_positions_is_rejected():
    assert (
        "write an item with a position"
        in rejection(MissionItem(178, 2, (0.0, 20.0, 0.0, 0.0), 0.0, 0.0, 0.0)).text
    )


def on(found, item):
    return found.resume(found.segment_of(item), HERE)


def test_resumed_plan_starts_at_the_aircraft():
    items = waypoints((500.0, 0.0, 100.0), (500.0, 500.0, 100.0), (0.0, 500.0, 100.0))
    found = plan(*items, jump(1, -1))
    left = on(found, 2)
    assert left.items == (2, 3, 1, 2, 3)
    first = left.plan.segments[0]
    assert not first.circle and first.start == HERE
    # the turn onto the next leg is that from here on: from (510, 490) flown to west, to -500 north
    inbound = math.atan2(500.0 - HERE[1], 500.0 - HERE[0])
    assert first.turn == pytest.approx(math.remainder(math.pi - inbound, math.tau))
    assert left.plan.repeat_from == found.plan.repeat_from - 1
    assert found.segment_of(9) is None


@pytest.mark.parametrize("part", range(6))
def test_resumed_lap_repeats_in_full(part):
    found = plan(
        *waypoints((500.0, 0.0, 100.0), (500.0, 500.0, 100.0), (0.0, 500.0, 100.0)), jump(1, -1)
    )
    left = found.resume(part, HERE)
    result, at = [], 0
    for _ in range(20):
        result.append((left.items[at], left.plan.segments[at].start))
        at = at + 1 if at + 1 < len(left.plan.segments) else left.plan.repeat_from
    items = [item for item, _ in result]
    assert items == [(part + k) % 3 + 1 for k in range(20)]
    assert [start for _, start in result].count(HERE) == 1


def test_resumed_last_circle_is_endless():
    found = plan(*waypoints((500.0, 0.0, 100.0)), item(17, 0.0, 0.0, 100.0))
    left = on(found, 2)
    assert left.items == (2,) and left.plan.repeat_from == 0


def test_levels_of_a_circle_are_separate_items():
    legs = (
        WaypointLeg(((500.0, 0.0, 100.0),)),
        LoiterLeg(
            (300.0, 300.0),
            120.0,
            (LoiterLevel(100.0, 2.0), LoiterLevel(130.0, 1.0), LoiterLevel(90.0, 1.0)),
        ),
    )
    mission = GuidanceMission(legs=legs, airspeed=22.0)
    whole = ItemFlightPlan(make_plan(mission, HERE), items_of_segments(mission), (22.0,) * 4)
    assert [item.z for item in items_from_mission(mission, ORIGIN)[2:]] == [100.0, 130.0, 90.0]
    for number, altitude in ((2, 100.0), (3, 130.0), (4, 90.0)):
        left = on(whole, number)
        assert left.items == tuple(range(number, 5))
        assert left.plan.segments[0].end[2] == altitude
        assert left.plan.repeat_from == 4 - number


def test_loiter_to_altitude_has_enough_turns():
    (circle, *_) = plan(
        item(31, 300.0, 0.0, 200.0, parameters=(0.0, 100.0, 0.0, 0.0)),
        *waypoints((0.0, 0.0, 200.0)),
    ).plan.segments
    flown_s = circle.turns * 2.0 * math.pi * circle.radius / 22.0
    assert flown_s * PARAMS.climb_limit > 100.0


def test_circle_radius_follows_its_airspeed():
    slow = MissionItem(178, 2, (0.0, 16.0, -1.0, 0.0), 0.0, 0.0, 0.0)
    circle = item(17, 300.0, 0.0, 100.0, parameters=(0.0, 0.0, 60.0, 0.0))
    found = plan(*waypoints((600.0, 0.0, 100.0)), slow, circle)
    assert found.plan.segments[-1].radius == 60.0
    assert found.plan.mission.airspeed == 22.0


def test_total_number_of_legs_is_limited(monkeypatch):
    monkeypatch.setattr("testbed.mavlink.mission_plans.expand_laps", pytest.fail)  # takes long
    items = waypoints(*((100.0 * k, 0.0, 100.0) for k in range(1, 700)))
    assert "10000 or fewer" in rejection(*items, jump(1, 1000)).text


@pytest.mark.parametrize("name", ["simulation-3", "experiment-2", "close-formation-wake"])
def test_scenario_mission_as_items_gives_same_plan(name):
    suite = load_scenario(name)
    assert suite.leader.path.kind == "mission"
    pilot = build(suite).formation.leader_controller
    assert isinstance(pilot, MissionController)
    plan_of_page, mission = pilot.plan, pilot.plan.mission
    origin = NedOrigin(**suite.scenario.origin.model_dump())
    again = plan_from_items(
        items_from_mission(mission, origin), plan_of_page.segments[0].start, mission, 60.0, origin
    )
    assert again.items == items_of_segments(mission)
    assert again.plan.repeat_from == plan_of_page.repeat_from
    for ours, theirs in zip(plan_of_page.segments, again.plan.segments, strict=True):
        assert ours.circle == theirs.circle
        assert np.allclose(ours.start, theirs.start, atol=1e-6)
        assert np.allclose(ours.end, theirs.end, atol=1e-6)
        assert (ours.radius, ours.clockwise) == (theirs.radius, theirs.clockwise)


def test_plan_of_joined_legs_equals_make_plan():
    legs = (WaypointLeg(((500.0, 0.0, 100.0), (500.0, 500.0, 100.0))),)
    mission = GuidanceMission(legs=legs, airspeed=22.0)
    assert make_plan(mission, HERE).segments[0].start == HERE
