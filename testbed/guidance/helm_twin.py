"""The compiled twins of `helm.fly` and `helm.fly_ideal`, which call the source of `leader` itself.

numba compiles that source as it stands, with records in place of plans, parts and gains: there is
no second copy of the equations.
"""

# The plain functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from inspect import isfunction

from numba.extending import register_jitable

from testbed.compiled import twin
from testbed.guidance import l1, leader, longitudinal, mission
from testbed.guidance.leader import LeaderMemory
from testbed.guidance.longitudinal import HoldMemory
from testbed.guidance.mission import Plan

for _module in (l1, longitudinal, leader):
    for _each in vars(_module).values():
        if isfunction(_each) and _each.__module__ == _module.__name__:
            register_jitable(_each)
register_jitable(mission.climbed)


@twin
def _memory_of(m):
    h = m.hold
    hold = HoldMemory(h.altitude, h.climb, h.pitch, h.throttle)
    return LeaderMemory(m.part, m.altitude_from, m.captured, m.turned, m.bearing, hold)


@twin
def _keep(m, memory):
    m.part, m.altitude_from, m.captured = memory.part, memory.altitude_from, memory.captured
    m.turned, m.bearing = memory.turned, memory.bearing
    h, hold = m.hold, memory.hold
    h.altitude, h.climb, h.pitch, h.throttle = hold.altitude, hold.climb, hold.pitch, hold.throttle


@twin
def fly(position_ned, velocity_ned, euler, airspeed, row, parts, own):
    o = own[0]
    pitch, roll, throttle, memory = leader.step(
        _memory_of(o.memory),
        position_ned[row],
        velocity_ned[row],
        euler[row, 0],
        airspeed[row],
        Plan(o.manner, parts, o.repeat_from),
        o.dt,
        o.gains,
    )
    _keep(o.memory, memory)
    return pitch, roll, throttle


@twin
def fly_ideal(position_ned, velocity_ned, row, parts, own):
    o = own[0]
    plan = Plan(o.manner, parts, o.repeat_from)
    speed, turn, memory = leader.unicycle_step(
        _memory_of(o.memory), position_ned[row], velocity_ned[row], plan, o.dt, o.gains
    )
    _keep(o.memory, memory)
    return speed, turn
