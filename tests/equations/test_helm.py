"""Guidance at the helm does what `leader` says, plain and compiled, on random plans and states."""

import math

import numpy as np
import pytest

from testbed.guidance import helm
from testbed.guidance.leader import LeaderMemory, step, unicycle_step
from testbed.guidance.longitudinal import HoldGains, HoldMemory
from testbed.guidance.mission import Level, LoiterLeg, Mission, WaypointLeg, unroll

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
        plan = unroll(mission, (0.0, 0.0, 100.0))
        gains = HoldGains(reference=rng.uniform(0.1, 0.5), path=rng.uniform(0.2, 0.8))
        for _ in range(20):
            number = int(rng.integers(len(plan.parts)))
            part = plan.parts[number]
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
    return helm.table(plan), helm.begin_flight(plan, memory, dt=DT, gains=gains)


def numbers(memory):
    return [*memory[:-1], *memory.hold]


def test_the_helm_is_the_leaders_guidance_in_one_row():
    """To the bit, with the memory written where it lies and nothing else changed."""
    for plan, gains, memory, (position, velocity, euler, airspeed) in flights(60):
        parts, own = own_of(plan, gains, memory)
        assert helm.memory_of(own) == memory
        before = own.copy()
        row = position[ROW].tolist(), velocity[ROW].tolist()
        told = helm.fly(position, velocity, euler, airspeed, ROW, parts, own)
        *ours, after = step(
            memory, *row, euler[ROW, 0].item(), airspeed[ROW].item(), plan, DT, gains
        )
        assert (told, helm.memory_of(own)) == (tuple(ours), after)
        own["memory"] = memory
        assert own.tobytes() == before.tobytes()

        moved = helm.fly_ideal(position, velocity, ROW, parts, own)
        *ours, after = unicycle_step(memory, *row, plan, DT, gains)
        assert (moved, helm.memory_of(own)) == (tuple(ours), after)


def agree(ours, theirs):
    pairs = zip(ours, theirs, strict=True)
    return all(math.isclose(*pair, rel_tol=1e-12, abs_tol=1e-13) for pair in pairs)


def test_the_compiled_helm():
    """Its libraries round a hypotenuse in a hundred otherwise, and a square in a thousand."""
    pytest.importorskip("numba")
    from testbed.guidance import helm_twin

    lines, circles, levels = 0, 0, 0
    for plan, gains, memory, state in flights(61):
        (parts, ours), (_, theirs) = own_of(plan, gains, memory), own_of(plan, gains, memory)
        told = helm_twin.fly(*state, ROW, parts, theirs)
        assert agree(helm.fly(*state, ROW, parts, ours), told)
        left = helm.memory_of(ours)
        assert agree(numbers(left), numbers(helm.memory_of(theirs)))

        went = plan.parts[memory.part]
        lines += left.part != memory.part and not went.circle
        circles += left.part != memory.part and went.circle and not went.onward
        levels += left.part != memory.part and went.onward

        ours["memory"] = theirs["memory"] = memory
        given = (*state[:2], ROW, parts)
        wanted, turning = helm.fly_ideal(*given, ours)
        speed, turn = helm_twin.fly_ideal(*given, theirs)
        assert agree((wanted, *turning), (speed, *turn))
        assert agree(numbers(helm.memory_of(ours)), numbers(helm.memory_of(theirs)))
    assert min(lines, circles, levels) > 15, "the states reach every end of a part"


def test_turns_are_counted_the_short_way():
    """The second route: the remainder of the change of bearing by whole turns."""
    counted = 0
    for plan, gains, memory, (position, velocity, *_) in flights(62):
        part = plan.parts[memory.part]
        row = position[ROW].tolist()
        _, _, after = unicycle_step(memory, row, velocity[ROW].tolist(), plan, DT, gains)
        if not memory.captured or after.part != memory.part:
            continue
        bearing = math.atan2(row[1] - part.end[1], row[0] - part.end[0])
        change = math.remainder(bearing - memory.bearing, 2.0 * math.pi)
        assert after.turned == memory.turned + (change if part.clockwise else -change)
        counted += 1
    assert counted > 150


def test_another_manner_leaves_the_memory_alone():
    plan, gains, memory, state = next(flights(63))
    parts, own = own_of(plan, gains, memory)
    faster = Mission(legs=(), airspeed=plan.mission.airspeed + 2.0, climb_limit=0.5)
    helm.change_manner(own, faster)
    assert helm.memory_of(own) == memory
    _, other = own_of(plan._replace(mission=faster), gains, memory)
    assert own.tobytes() == other.tobytes()
    assert helm.fly(*state, ROW, parts, own)[2] > 0.0
