"""The kernels of guidance on random plans and states, many just where a segment ends."""

import math
from functools import partial

import numpy as np
from cases import ALL

from testbed.core.records import AIRCRAFT, allocate
from testbed.guidance import mission_follower as guidance
from testbed.guidance.flight_plan import (
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    WaypointLeg,
    expand_laps,
)
from testbed.scenario.middle_loop import Guidance

DT, ROW, STATES = 0.04, 2, 2000 if ALL else 1000
GAINS = Guidance().model_dump()


def flights(seed):
    """Plans, guidance states of one aircraft and estimates of four."""
    rng = np.random.default_rng(seed)
    for _ in range(STATES // 20):
        points = rng.uniform(-800.0, 800.0, (4, 3)) * (1.0, 1.0, 0.05) + (0.0, 0.0, 100.0)
        levels = rng.uniform((80.0, 0.2), (150.0, 2.0), (3, 2)).tolist()
        circle = LoiterLeg(
            tuple(rng.uniform(-300.0, 300.0, 2).tolist()),
            rng.uniform(150.0, 300.0),
            tuple(LoiterLevel(*level) for level in levels),
            clockwise=bool(rng.integers(2)),
        )
        around = WaypointLeg(tuple(map(tuple, points.tolist())), 2)
        legs = (around, circle) if rng.integers(2) else (circle, around)
        mission = GuidanceMission(
            legs=legs, airspeed=rng.uniform(18.0, 26.0), period=rng.uniform(10, 20)
        )
        plan = expand_laps(mission, (0.0, 0.0, 100.0))
        for _ in range(20):
            number = int(rng.integers(len(plan.segments)))
            part = plan.segments[number]
            held = rng.normal((100.0, 0.0, 0.02, 0.3), (10.0, 1.0, 0.02, 0.3)).tolist()
            state = guidance.begin_flight(plan, tuple(held), dt=DT, gains=GAINS)
            state["memory"] = (
                number,
                rng.normal(100.0, 20.0),
                bool(part.circle and rng.integers(2)),
                2.0 * math.pi * part.turns * rng.choice([0.5, 1.0]),
                rng.uniform(-math.pi, math.pi),
                tuple(held),
            )
            near = rng.choice([50.0, 500.0])
            off = rng.normal(0.0, near, (4, 3)) * (1.0, 1.0, 0.1)
            position = np.array([*part.end[:2], -part.end[2]]) + off
            velocity = rng.normal(0.0, (15.0, 15.0, 2.0), (4, 3))
            euler = rng.normal(0.0, 0.4, (4, 3))
            airspeed = rng.uniform(12.0, 30.0, 4)
            yield plan, state, aircraft_at(position, velocity, euler, airspeed)


def aircraft_at(position, velocity, euler, airspeed):
    """Records of four aircraft whose estimates are these; their truth is elsewhere."""
    aircraft = allocate(AIRCRAFT, 4)
    aircraft["truth"]["position_ned"] = 1e6
    estimate = aircraft["estimate"]
    estimate["position_ned"], estimate["velocity_ned"] = position, velocity
    estimate["euler"], estimate["airspeed"] = euler, airspeed
    return aircraft


def guide_unicycle(aircraft, segments, state):
    """The speed, m/s, and turn rates (3,), rad/s, of the ideal vehicle in the row."""
    speed, omega = np.zeros(1), np.zeros(3)
    guidance.guide_unicycle(ROW, aircraft, segments, state, speed, omega)
    return speed[0], omega


def test_both_guides_make_the_same_progress():
    """Only the memory and the command of the row are written."""
    lines, circles, levels = 0, 0, 0
    for plan, state, aircraft in flights(61):
        segments, before, untouched = guidance.segment_records(plan), state.copy(), aircraft.copy()
        guidance.guide(ROW, aircraft, segments, state)
        after = state["memory"].copy()
        pitch, roll, throttle = aircraft["control"][ROW].item()
        assert abs(pitch) <= math.radians(20.0) and 0.0 <= throttle <= 1.0
        assert abs(roll) <= plan.mission.bank_limit
        state["memory"] = before["memory"]
        assert state.tobytes() == before.tobytes()
        aircraft["control"][ROW] = untouched["control"][ROW]
        assert (aircraft == untouched).all()

        went = plan.segments[before["memory"]["segment"][0]]
        moved = after["segment"][0] != before["memory"]["segment"][0]
        lines += moved and not went.circle
        circles += moved and went.circle and not went.continues
        levels += moved and went.continues

        speed, omega = guide_unicycle(aircraft, segments, state)
        for name in ("segment", "altitude_from", "captured", "turned", "bearing"):
            assert state["memory"][name] == after[name], name
        for name in ("altitude", "climb"):
            assert state["memory"]["hold"][name] == after["hold"][name], name
        for name in ("pitch", "throttle"):
            assert state["memory"]["hold"][name] == before["memory"]["hold"][name], name
        assert speed == plan.mission.airspeed and omega[0] == 0.0
        north, east, down = untouched["estimate"]["velocity_ned"][ROW]
        gamma = math.atan2(-down, math.hypot(north, east))
        expected = (gamma, untouched["estimate"]["euler"][ROW, 0], 0.0)
        found = aircraft["control"][ROW].item()
        assert all(map(partial(math.isclose, rel_tol=1e-12), found, expected))
    assert min(lines, circles, levels) > 0.0075 * STATES, "the states reach every end of a segment"


def test_turns_are_counted_the_short_way():
    """The second route: the remainder of the change of bearing by whole turns."""
    counted = 0
    for plan, state, aircraft in flights(62):
        before = state["memory"][0].copy()
        part = plan.segments[before["segment"]]
        guide_unicycle(aircraft, guidance.segment_records(plan), state)
        after = state["memory"][0]
        if not before["captured"] or after["segment"] != before["segment"]:
            continue
        north, east, _ = aircraft["estimate"]["position_ned"][ROW]
        bearing = math.atan2(east - part.end[1], north - part.end[0])
        change = math.remainder(bearing - before["bearing"], 2.0 * math.pi)
        turned = before["turned"] + (change if part.clockwise else -change)
        assert math.isclose(after["turned"], turned, rel_tol=1e-12, abs_tol=1e-13)
        counted += 1
    assert counted > 0.075 * STATES


def test_flight_params_do_not_change_the_memory():
    plan, state, aircraft = next(flights(63))
    before = state["memory"].copy()
    faster = GuidanceMission(legs=(), airspeed=plan.mission.airspeed + 2.0, climb_limit=0.5)
    guidance.set_flight_params(state, faster)
    assert state["memory"] == before
    assert state["flight_params"]["airspeed"] == faster.airspeed
    assert state["flight_params"]["climb_limit"] == 0.5
    speed, _ = guide_unicycle(aircraft, guidance.segment_records(plan), state)
    assert speed == faster.airspeed
