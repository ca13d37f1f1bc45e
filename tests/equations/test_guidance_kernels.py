"""The guidance kernels do what the mission follower says, on random plans and states."""

import math

import numpy as np

from testbed.core.records import AIRCRAFT, allocate
from testbed.guidance import guidance_step as guidance
from testbed.guidance.altitude_airspeed_hold import HoldGains, HoldMemory
from testbed.guidance.flight_plan import Level, LoiterLeg, Mission, WaypointLeg, expand_laps
from testbed.guidance.mission_follower import LeaderMemory, step, unicycle_step

DT, ROW, STATES = 0.04, 2, 2000


def flights(seed):
    """Plans, memories and estimates; many just where a part ends."""
    rng = np.random.default_rng(seed)
    for _ in range(STATES // 20):
        points = rng.uniform(-800.0, 800.0, (4, 3)) * (1.0, 1.0, 0.05) + (0.0, 0.0, 100.0)
        levels = rng.uniform((80.0, 0.2), (150.0, 2.0), (3, 2)).tolist()
        circle = LoiterLeg(
            tuple(rng.uniform(-300.0, 300.0, 2).tolist()),
            rng.uniform(150.0, 300.0),
            tuple(Level(*level) for level in levels),
            clockwise=bool(rng.integers(2)),
        )
        around = WaypointLeg(tuple(map(tuple, points.tolist())), 2)
        legs = (around, circle) if rng.integers(2) else (circle, around)
        mission = Mission(legs=legs, airspeed=rng.uniform(18.0, 26.0), period=rng.uniform(10, 20))
        plan = expand_laps(mission, (0.0, 0.0, 100.0))
        gains = HoldGains(reference=rng.uniform(0.1, 0.5), path=rng.uniform(0.2, 0.8))
        for _ in range(20):
            number = int(rng.integers(len(plan.segments)))
            part = plan.segments[number]
            hold = HoldMemory(*rng.normal((100.0, 0.0, 0.02, 0.3), (10.0, 1.0, 0.02, 0.3)).tolist())
            memory = LeaderMemory(
                number,
                rng.normal(100.0, 20.0),
                bool(part.circle and rng.integers(2)),
                2.0 * math.pi * part.turns * rng.choice([0.5, 1.0]),
                rng.uniform(-math.pi, math.pi),
                hold,
            )
            near = rng.choice([50.0, 500.0])
            off = rng.normal(0.0, near, (4, 3)) * (1.0, 1.0, 0.1)
            position = np.array([*part.end[:2], -part.end[2]]) + off
            velocity = rng.normal(0.0, (15.0, 15.0, 2.0), (4, 3))
            euler = rng.normal(0.0, 0.4, (4, 3))
            airspeed = rng.uniform(12.0, 30.0, 4)
            yield plan, gains, memory, (position, velocity, euler, airspeed)


def own_of(plan, gains, memory):
    segments = guidance.segment_records(plan)
    return segments, guidance.begin_flight(plan, memory, dt=DT, gains=gains)


def aircraft_at(position, velocity, euler, airspeed):
    """Records of four aircraft whose estimates are these; their truth is elsewhere."""
    aircraft = allocate(AIRCRAFT, 4)
    aircraft["truth"]["position_ned"] = 1e6
    estimate = aircraft["estimate"]
    estimate["position_ned"], estimate["velocity_ned"] = position, velocity
    estimate["euler"], estimate["airspeed"] = euler, airspeed
    return aircraft


def numbers(memory):
    return [*memory[:-1], *memory.hold]


def agree(ours, theirs):
    pairs = zip(ours, theirs, strict=True)
    return all(math.isclose(*pair, rel_tol=1e-12, abs_tol=1e-13) for pair in pairs)


def test_kernels_equal_the_mission_follower():
    """Its libraries round a hypotenuse in a hundred otherwise, and a square in a thousand."""
    lines, circles, levels = 0, 0, 0
    for plan, gains, memory, (position, velocity, euler, airspeed) in flights(61):
        segments, own = own_of(plan, gains, memory)
        assert guidance.memory_of(own) == memory
        before = own.copy()
        aircraft = aircraft_at(position, velocity, euler, airspeed)
        untouched = aircraft.copy()
        row = position[ROW].tolist(), velocity[ROW].tolist()
        guidance.guide(ROW, aircraft, segments, own)
        *ours, after = step(
            memory, *row, euler[ROW, 0].item(), airspeed[ROW].item(), plan, DT, gains
        )
        assert agree(ours, aircraft["control"][ROW].item())
        assert agree(numbers(after), numbers(guidance.memory_of(own)))
        left = guidance.memory_of(own)
        # the memory is written in place, and the command of that row, and nothing else
        own["memory"] = memory
        assert own.tobytes() == before.tobytes()
        aircraft["control"][ROW] = untouched["control"][ROW]
        assert (aircraft == untouched).all()

        went = plan.segments[memory.segment]
        lines += left.segment != memory.segment and not went.circle
        circles += left.segment != memory.segment and went.circle and not went.continues
        levels += left.segment != memory.segment and went.continues

        speed, omega = guidance.guide_unicycle(ROW, aircraft, segments, own)
        wanted, turning, after = unicycle_step(memory, *row, plan, DT, gains)
        assert agree((wanted, *turning), (speed, *omega))
        assert agree(numbers(after), numbers(guidance.memory_of(own)))
        north, east, down = row[1]
        gamma = math.atan2(-down, math.hypot(north, east))
        assert agree(aircraft["control"][ROW].item(), (gamma, euler[ROW, 0], 0.0))
    assert min(lines, circles, levels) > 15, "the states reach every end of a part"


def test_turns_are_counted_the_short_way():
    """The second route: the remainder of the change of bearing by whole turns."""
    counted = 0
    for plan, gains, memory, (position, velocity, *_) in flights(62):
        part = plan.segments[memory.segment]
        row = position[ROW].tolist()
        _, _, after = unicycle_step(memory, row, velocity[ROW].tolist(), plan, DT, gains)
        if not memory.captured or after.segment != memory.segment:
            continue
        bearing = math.atan2(row[1] - part.end[1], row[0] - part.end[0])
        change = math.remainder(bearing - memory.bearing, 2.0 * math.pi)
        assert after.turned == memory.turned + (change if part.clockwise else -change)
        counted += 1
    assert counted > 150


def test_flight_params_do_not_change_the_memory():
    plan, gains, memory, state = next(flights(63))
    segments, own = own_of(plan, gains, memory)
    faster = Mission(legs=(), airspeed=plan.mission.airspeed + 2.0, climb_limit=0.5)
    guidance.set_flight_params(own, faster)
    assert guidance.memory_of(own) == memory
    _, other = own_of(plan._replace(mission=faster), gains, memory)
    assert own.tobytes() == other.tobytes()
    aircraft = aircraft_at(*state)
    guidance.guide(ROW, aircraft, segments, own)
    assert aircraft["control"]["throttle"][ROW] > 0.0
