"""Guidance: the L1 law, the hold and the mission, each against arithmetic or a second route."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from testbed.core.compile import entry
from testbed.core.frames import GRAVITY
from testbed.core.records import AIRCRAFT, allocate
from testbed.guidance import l1
from testbed.guidance.altitude_airspeed_hold import (
    CLIMB_ACCELERATION,
    GAINS,
    HOLD,
    climb_demand,
    hold,
)
from testbed.guidance.flight_plan import (
    FlightPlan,
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    WaypointLeg,
    climb_profile,
    make_plan,
    polyline,
)
from testbed.guidance.mission_follower import begin_flight, guide, segment_records
from testbed.scenario.middle_loop import Guidance

L1 = {"period": 15.0, "damping": 0.75}


class HoldMemory(NamedTuple):
    """The fields of HOLD."""

    altitude: float
    climb: float
    pitch: float
    throttle: float


SQUARE = ((660.0, 0.0, 100.0), (660.0, 660.0, 100.0), (0.0, 660.0, 100.0), (0.0, 0.0, 100.0))
CIRCLE = LoiterLeg((330.0, 330.0), 120.0, (LoiterLevel(100.0, 1.0), LoiterLevel(120.0, 1.0)))


def test_look_ahead_by_hand() -> None:
    # 0.75 · 15 s · 22 m/s / π = 247.5 / π
    assert l1.look_ahead(22.0, **L1) == pytest.approx(78.7817, abs=1e-4)


def test_line_acceleration_by_hand() -> None:
    # On the line, 30° to its left of it in heading: 4 · 0.5625 · 484 / 78.7817 · sin 30° = 6.9115
    velocity = (22.0 * math.cos(math.pi / 6), -22.0 * math.sin(math.pi / 6))
    acceleration = l1.line_acceleration((100.0, 0.0), velocity, (0.0, 0.0), (500.0, 0.0), **L1)
    assert acceleration == pytest.approx(6.91150, abs=1e-4)
    # Parallel to it, 10 m to the right: −4 · 0.5625 · 484 / 78.7817 · 10 / 78.7817 = −1.7546
    acceleration = l1.line_acceleration((100.0, 10.0), (22.0, 0.0), (0.0, 0.0), (500.0, 0.0), **L1)
    assert acceleration == pytest.approx(-1.75460, abs=1e-4)


@pytest.mark.parametrize("speed", [15.0, 22.0])
@pytest.mark.parametrize("period, damping", [(15.0, 0.75), (20.0, 0.9)])
def test_line_loop_has_its_period_and_damping(speed: float, period: float, damping: float) -> None:
    """Finite differences of the law give the coefficients of ÿ + 2ζω ẏ + ω² y = 0."""

    def lateral(right: float, drift: float) -> float:
        velocity = (math.sqrt(speed**2 - drift**2), drift)
        line = ((0.0, 0.0), (900.0, 0.0))
        return l1.line_acceleration((400.0, right), velocity, *line, period=period, damping=damping)

    small = 1e-3  # the law is odd and smooth at zero: the error is of third order
    omega = math.sqrt(-(lateral(small, 0.0) - lateral(-small, 0.0)) / (2.0 * small))
    twice = -(lateral(0.0, small) - lateral(0.0, -small)) / (2.0 * small)
    assert 2.0 * math.pi / omega == pytest.approx(period, rel=1e-6)
    assert twice / (2.0 * omega) == pytest.approx(damping, rel=1e-6)


@pytest.mark.parametrize("clockwise", [True, False])
def test_circle_loop(clockwise: bool) -> None:
    """On the circle a = V²/R inwards; radial error and rate add ω² and 2ζω."""
    side = 1.0 if clockwise else -1.0

    def inward(distance: float, outward: float) -> float:
        velocity = (outward, side * 22.0)  # north of the centre, east is clockwise
        acceleration, captured = l1.circle_acceleration(
            (distance, 0.0), velocity, (0.0, 0.0), radius=120.0, clockwise=clockwise, **L1
        )
        assert captured
        return side * acceleration

    assert inward(120.0, 0.0) == pytest.approx(22.0**2 / 120.0, rel=1e-12)
    small = 1e-4
    omega = 2.0 * math.pi / 15.0
    stiffness = (inward(120.0 + small, 0.0) - inward(120.0 - small, 0.0)) / (2.0 * small)
    # the centripetal term itself falls with the distance, by V²/R²
    assert stiffness + 22.0**2 / 120.0**2 == pytest.approx(omega**2, rel=1e-6)
    rate = (inward(120.0, small) - inward(120.0, -small)) / (2.0 * small)
    assert rate == pytest.approx(2.0 * 0.75 * omega, rel=1e-6)


def test_line_from_far_heads_for_the_near_end() -> None:
    line = ((0.0, 0.0), (500.0, 0.0))
    behind = l1.line_acceleration((-300.0, 100.0), (0.0, 22.0), *line, **L1)
    assert behind < 0.0  # the start is ahead to the left of an eastward flight
    past = l1.line_acceleration((600.0, -100.0), (0.0, -22.0), *line, **L1)
    assert past < 0.0  # the end lies to the south-east: the shorter way from west is left
    aimed = l1.line_acceleration((-300.0, 0.0), (22.0, 0.0), *line, **L1)
    assert aimed == pytest.approx(0.0, abs=1e-12)


def test_turn_distance_is_limited_by_both_distances() -> None:
    by = {"waypoint_radius": 90.0, **L1}
    assert l1.turn_distance(22.0, math.pi / 2, **by) == pytest.approx(78.7817, abs=1e-4)
    assert l1.turn_distance(22.0, -math.pi / 4, **by) == pytest.approx(39.3908, abs=1e-4)
    assert l1.turn_distance(22.0, 3.0, **(by | {"waypoint_radius": 60.0})) == 60.0


def test_roll_of_a_coordinated_turn() -> None:
    assert l1.roll_command(GRAVITY, bank_limit=1.0) == pytest.approx(math.pi / 4)
    assert l1.roll_command(-20.0, bank_limit=0.5) == -0.5


def test_climb_profile_is_continuous_and_complete() -> None:
    parts = np.linspace(0.0, 1.0, 2001)
    done, slope = np.array([climb_profile(float(part), level_off=0.2) for part in parts]).T
    assert (done[0], done[-1]) == (0.0, 1.0)
    # Straight part: 1 / (1 − 0.1). Central differences of a curve with second derivative ≤ 5.6.
    assert slope[1000] == pytest.approx(1.0 / 0.9)
    inside = slice(2, -2)
    assert np.gradient(done, parts)[inside] == pytest.approx(slope[inside], abs=0.003)


def test_hold_in_trim_commands_the_trim() -> None:
    memory = HoldMemory(altitude=100.0, climb=0.0, pitch=0.01, throttle=0.24)
    pitch, throttle, after = _hold(memory)
    assert (pitch, throttle, after) == (0.01, 0.24, memory)


def test_hold_signs_and_anti_windup() -> None:
    memory = HoldMemory(altitude=100.0, climb=0.0, pitch=0.0, throttle=0.24)
    pitch, throttle, after = _hold(memory, altitude=98.0)
    assert pitch > 0.0 and after.pitch > 0.0
    pitch, throttle, after = _hold(memory, airspeed=10.0)
    assert throttle == 1.0 and after.throttle == memory.throttle
    _, banked, _ = _hold(memory, roll=math.radians(30.0))
    # k_φ (1/cos² 30° − 1) = 0.12 / 3
    assert banked == pytest.approx(0.24 + 0.04)


def test_climb_reference_limits_rate_and_change() -> None:
    memory = HoldMemory(altitude=100.0, climb=0.0, pitch=0.0, throttle=0.24)
    climbs = [0.0]
    for _ in range(2000):
        _, _, memory = _hold(memory, altitude=memory.altitude, altitude_target=130.0)
        climbs.append(memory.climb)
    change = np.diff(climbs)
    assert max(climbs) == pytest.approx(1.5)
    assert np.abs(change).max() <= CLIMB_ACCELERATION * 0.02 + 1e-12
    assert memory.altitude == pytest.approx(130.0, abs=0.01)  # e^(−0.3·(40−20)) of 5 m is 0.012 m


def _hold(memory: HoldMemory, **different: float) -> tuple[float, float, HoldMemory]:
    state = {
        "altitude": 100.0,
        "climb": 0.0,
        "airspeed": 22.0,
        "roll": 0.0,
        "altitude_target": 100.0,
    }
    records, gains = allocate(HOLD, 1), allocate(GAINS, 1)
    records[0], gains[0] = memory, tuple(Guidance().model_dump()[name] for name in GAINS.names)
    pitch, throttle = _step_hold(records, gains, *(state | different).values())
    return pitch, throttle, HoldMemory(*records[0].item())


@entry
def _step_hold(memory, gains, altitude, climb, airspeed, roll, target):  # noqa: ANN001, ANN202
    demand = climb_demand(memory[0], altitude, target, 0.0, 1.5, 0.02)
    return hold(memory[0], gains[0], demand, climb, airspeed, roll, 22.0, 0.02)


def test_plan_counts_laps_and_turns() -> None:
    raised = tuple(point[:2] + (150.0 if i in (1, 3) else 100.0,) for i, point in enumerate(SQUARE))
    mission = GuidanceMission(
        legs=(WaypointLeg(SQUARE, 2), WaypointLeg(raised, 2), CIRCLE), airspeed=22.0
    )
    plan = make_plan(mission, (-200.0, 0.0, 100.0))
    assert len(plan.segments) == 18 and plan.repeat_from == 17
    lines, levels = plan.segments[:16], plan.segments[16:]
    assert [round(math.degrees(part.turn)) for part in lines[:-1]] == [90] * 15
    assert round(math.degrees(lines[-1].turn)) == 135  # from west to the centre, north-east
    assert lines[8].start == SQUARE[3] and lines[9].end[2] == 150.0
    assert [part.end for part in levels] == [(330.0, 330.0, 100.0), (330.0, 330.0, 120.0)]
    assert [part.continues for part in levels] == [True, False]


def test_last_waypoints_repeat() -> None:
    plan = make_plan(
        GuidanceMission(legs=(WaypointLeg(SQUARE, 1),), airspeed=22.0), (-200.0, 0.0, 100.0)
    )
    assert plan.segments[plan.repeat_from].start == SQUARE[3]
    result = fly(plan, (-200.0, 0.0, 100.0), 300.0)  # 200 m + two laps of 2,493 m take 236 s
    assert {int(part) for part in result["part"]} == set(range(8))
    assert result["part"][-1] < 8 and result["part"].max() == 7


def test_polyline_is_the_commanded_path() -> None:
    plan = make_plan(
        GuidanceMission(legs=(WaypointLeg(SQUARE), CIRCLE), airspeed=22.0), (-9.0, 0.0, 100.0)
    )
    points = polyline(plan)
    assert points[:5].tolist() == [[-9.0, 0.0, -100.0]] + [[n, e, -h] for n, e, h in SQUARE]
    assert np.hypot(*(points[5:, :2] - 330.0).T) == pytest.approx(120.0)
    assert set(points[5:, 2]) == {-100.0, -120.0}


def test_mission_is_followed_in_order() -> None:
    """A point-mass aircraft flies a lap with climbs, then counts the turns of the circle."""
    points = tuple(point[:2] + (150.0 if i in (1, 3) else 100.0,) for i, point in enumerate(SQUARE))
    mission = GuidanceMission(legs=(WaypointLeg(points), CIRCLE), airspeed=22.0)
    plan = make_plan(mission, (-200.0, 0.0, 100.0))
    result = fly(plan, (-200.0, 0.0, 100.0), 330.0)
    switch = np.flatnonzero(np.diff(result["part"])) + 1
    assert len(switch) == 5
    *switch, level = switch
    # each corner is passed at its own altitude, to the lag of the climb
    assert result["altitude"][switch] == pytest.approx([100, 150, 100, 150], abs=1.0)
    # and no farther than the turn distance, but with all the bank allowed: no rounded corners
    corner = np.array(SQUARE)[:, :2]
    distance = np.hypot(*(result["position"][switch, :2] - corner).T)
    assert np.all(distance < 79.0) and np.all(distance > 77.0)
    lap = result["time"] < result["time"][switch[-1]]
    assert np.degrees(result["roll"][lap].max()) == pytest.approx(30.0, abs=0.1)
    # 50 m over the 581 m between the turns, less what the levelling-off adds (6 %)
    steady = np.abs(result["position"][:, 1] - 250.0) < 50.0
    assert np.abs(result["climb"][lap & steady]).max() == pytest.approx(2.01, abs=0.1)

    circle = result["time"] > result["time"][switch[-1]] + 60.0
    radius = np.hypot(*(result["position"][circle, :2] - 330.0).T)
    assert np.abs(radius - 120.0).max() < 2.0
    bearing = np.unwrap(np.arctan2(*(result["position"][:, 1::-1] - 330.0).T))
    first = np.flatnonzero(result["captured"])[0]
    assert bearing[level] - bearing[first] == pytest.approx(2.0 * math.pi, abs=0.01)
    assert result["altitude"][-1] == pytest.approx(120.0, abs=0.2)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("start", [(-600.0, 0.0), (330.0, 300.0), (330.0, 1500.0)])
def test_circle_is_captured_from_anywhere(clockwise: bool, start: tuple[float, float]) -> None:
    leg = replace(CIRCLE, clockwise=clockwise)
    plan = make_plan(GuidanceMission(legs=(leg,), airspeed=22.0), (*start, 100.0))
    result = fly(plan, (*start, 100.0), 180.0)
    late = result["time"] > 150.0
    relative = result["position"][late, :2] - 330.0
    assert np.abs(np.hypot(*relative.T) - 120.0).max() < 2.0
    turning = np.diff(np.unwrap(np.arctan2(relative[:, 1], relative[:, 0])))
    assert np.all(turning > 0.0) if clockwise else np.all(turning < 0.0)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"legs": ()}, "at least one leg"),
        ({"airspeed": 0.0}, "airspeed: must be positive"),
        ({"bank_limit": 1.6}, "between 0 and 90 degrees"),
        ({"bank_limit": 0.2}, "raise bank_limit_deg"),
        ({"legs": (WaypointLeg(SQUARE, 0), CIRCLE)}, r"legs\[0\].laps"),
        ({"legs": (WaypointLeg((SQUARE[0],)),)}, "end the mission with a leg of kind loiter"),
        ({"legs": (WaypointLeg(((30.0, 0.0, 100.0), *SQUARE[1:])), CIRCLE)}, "apart"),
        ({"legs": (WaypointLeg(((660.0, 0.0, 400.0),)), CIRCLE)}, "flatten it"),
        ({"legs": (WaypointLeg(SQUARE), replace(CIRCLE, levels=()))}, r"legs\[1\].levels"),
        ({"legs": (replace(CIRCLE, levels=(LoiterLevel(100.0, 0.0),)),)}, r"levels\[0\].turns"),
    ],
)
def test_invalid_mission_is_an_error(change: dict, words: str) -> None:
    mission = replace(GuidanceMission(legs=(WaypointLeg(SQUARE), CIRCLE), airspeed=22.0), **change)
    with pytest.raises(ValueError, match=words):
        make_plan(mission, (0.0, 0.0, 100.0))


def fly(
    plan: FlightPlan, start: tuple[float, float, float], duration: float
) -> dict[str, np.ndarray]:
    """Fly a plan with a coordinated-turn point mass: first-order roll, pitch, path and thrust."""
    dt = 0.04
    north, east, up = start
    speed, course, gamma, roll, pitch = plan.mission.airspeed, 0.0, 0.0, 0.0, 0.02
    state = begin_flight(plan, (up, 0.0, 0.02, 0.24), dt=dt, gains=Guidance().model_dump())
    segments, aircraft = segment_records(plan), allocate(AIRCRAFT, 1)
    own, memory, command = aircraft["estimate"], state["memory"], aircraft["control"]
    rows = []
    for tick in range(round(duration / dt)):
        velocity = (
            speed * math.cos(gamma) * math.cos(course),
            speed * math.cos(gamma) * math.sin(course),
            -speed * math.sin(gamma),
        )
        own["position_ned"], own["velocity_ned"] = (north, east, -up), velocity
        own["euler"][0, 0], own["airspeed"] = roll, speed
        guide(0, aircraft, segments, state)
        theta, phi, throttle = command[0].item()
        rows.append(
            (tick * dt, (north, east, up), -velocity[2], roll)
            + (memory["segment"].item(), memory["captured"].item())
        )
        course += GRAVITY * math.tan(roll) / speed * dt
        roll += (phi - roll) / 0.3 * dt
        pitch += (theta - pitch) / 0.3 * dt
        incidence = 0.02 + 0.05 * (1.0 / math.cos(roll) - 1.0)
        gamma += (pitch - incidence - gamma) / 0.35 * dt
        load = 1.0 / math.cos(roll) ** 2 - 1.0
        thrust = 6.0 * (throttle - 0.24 - 0.12 * load) - 0.15 * (speed - 22.0)
        speed += (thrust - 0.42 * speed * math.sin(gamma)) * dt
        north += velocity[0] * dt
        east += velocity[1] * dt
        up -= velocity[2] * dt
    names = ("time", "position", "climb", "roll", "part", "captured")
    result = {
        name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)
    }
    return result | {"altitude": result["position"][:, 2]}
