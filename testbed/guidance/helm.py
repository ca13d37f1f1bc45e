"""The helm: guidance as it is called every control period, from a row of the estimates.

A plan, the gains and the memory lie in records of numbers, made once, which it costs little to give
to compiled code; the memory is written where it lies. `fly` and `fly_ideal` have twins in
`helm_twin`, compiled from the source of `leader` itself.
"""

from __future__ import annotations

from dataclasses import astuple, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.guidance.leader import LeaderMemory, step, unicycle_step
from testbed.guidance.longitudinal import HoldGains, HoldMemory
from testbed.guidance.mission import Mission, Part, Plan
from testbed.state import Array

Records = NDArray[np.void]

MANNER = tuple(each.name for each in fields(Mission) if each.name != "legs")
GAINS = tuple(each.name for each in fields(HoldGains))
PART = np.dtype(
    [
        ("circle", "?"),
        ("start", "f8", (3,)),
        ("end", "f8", (3,)),
        ("turn", "f8"),
        ("radius", "f8"),
        ("clockwise", "?"),
        ("turns", "f8"),
        ("onward", "?"),
    ]
)
MEMORY = np.dtype(
    [
        ("part", "i8"),
        ("altitude_from", "f8"),
        ("captured", "?"),
        ("turned", "f8"),
        ("bearing", "f8"),
        ("hold", [(name, "f8") for name in HoldMemory._fields]),
    ]
)
OWN = np.dtype(
    [
        ("manner", [(name, "f8") for name in MANNER]),
        ("repeat_from", "i8"),
        ("gains", [(name, "f8") for name in GAINS]),
        ("dt", "f8"),
        ("memory", MEMORY),
    ]
)


def table(plan: Plan) -> Records:
    """The parts of a plan as records."""
    return np.array(list(plan.parts), dtype=PART)


def begin_flight(plan: Plan, memory: LeaderMemory, *, dt: float, gains: HoldGains) -> Records:
    """What an aircraft has of its own, a record (1,): its manner, gains and memory.

    It is flown with the table of the same plan, stepping every `dt` s.
    """
    own = np.zeros(1, dtype=OWN)
    own["repeat_from"], own["dt"] = plan.repeat_from, dt
    own["gains"] = astuple(gains)
    own["memory"] = memory
    change_manner(own, plan.mission)
    return own


def change_manner(own: Records, mission: Mission) -> None:
    """Fly as this mission says from now on; its legs are not looked at."""
    own["manner"] = tuple(getattr(mission, name) for name in MANNER)


def memory_of(own: Records) -> LeaderMemory:
    """What it remembers now."""
    memory = LeaderMemory(*own["memory"][0].item())
    return memory._replace(hold=HoldMemory(*memory.hold))


def fly(
    position_ned: Array,
    velocity_ned: Array,
    euler: Array,
    airspeed: Array,
    row: int,
    parts: Records,
    own: Records,
) -> tuple[float, float, float]:
    """Pitch (rad), roll (rad), throttle (0..1) of the aircraft in a row; its memory moves on.

    Args:
        position_ned: (N, 3) m
        velocity_ned: (N, 3) m/s over the ground
        euler: (N, 3) rad
        airspeed: (N,) true, m/s
        row: of the aircraft among the N.
        parts: the table of its plan.
        own: what `begin_flight` gave; it is changed.
    """
    memory, plan, dt, gains = _read(parts, own)
    pitch, roll, throttle, memory = step(
        memory,
        position_ned[row].tolist(),
        velocity_ned[row].tolist(),
        float(euler[row, 0]),
        float(airspeed[row]),
        plan,
        dt,
        gains,
    )
    own["memory"] = memory
    return pitch, roll, throttle


def fly_ideal(
    position_ned: Array, velocity_ned: Array, row: int, parts: Records, own: Records
) -> tuple[float, tuple[float, float, float]]:
    """Speed (m/s) and turn (rad/s) of the ideal vehicle in a row; its memory moves on.

    The arguments are those of `fly`.
    """
    memory, plan, dt, gains = _read(parts, own)
    position, velocity = position_ned[row].tolist(), velocity_ned[row].tolist()
    speed, turn, memory = unicycle_step(memory, position, velocity, plan, dt, gains)
    own["memory"] = memory
    return speed, turn


class _Parts:
    """The parts of a table, each made when it is asked for."""

    def __init__(self, records: Records) -> None:
        self._records = records

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, k: int) -> Part:
        circle, start, end, *more = self._records[k].item()
        return Part(circle, start.tolist(), end.tolist(), *more)


def _read(records: Records, own: Records) -> tuple[LeaderMemory, Plan, float, HoldGains]:
    manner, repeat_from, gains, dt, _ = own[0].item()
    mission = Mission(legs=(), **dict(zip(MANNER, manner, strict=True)))
    parts: Any = _Parts(records)  # as much of a tuple as guidance needs
    plan = Plan(mission, parts, repeat_from)
    return memory_of(own), plan, dt, HoldGains(**dict(zip(GAINS, gains, strict=True)))


READY_FLY = ready_of(fly, "testbed.guidance.helm_twin")
READY_FLY_IDEAL = ready_of(fly_ideal, "testbed.guidance.helm_twin")
