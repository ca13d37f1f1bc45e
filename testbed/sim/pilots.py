"""Guidance that flies an aircraft through its own autopilot or an ideal vehicle, or nobody."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from testbed.guidance.helm import (
    READY_FLY,
    READY_FLY_IDEAL,
    begin_flight,
    change_manner,
    memory_of,
    table,
)
from testbed.guidance.leader import LeaderMemory
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Mission, Plan
from testbed.sim.vehicles import Replayed
from testbed.state import Array, UnicycleCommand, VehicleState

Sticks = tuple[float, float, float]  # pitch (rad), roll (rad), throttle (0..1)
Turn = tuple[float, Array]  # u (m/s) and ω (3,) rad/s of an ideal vehicle


class Pilot(Protocol):
    """What commands the leader."""

    def command(self, estimate: VehicleState) -> tuple[Sticks, Turn | None]:
        """Once per control period, from the estimates."""


class MissionPilot:
    """An aircraft flies a plan, from its own row of the estimates."""

    def __init__(
        self,
        plan: Plan,
        memory: LeaderMemory,
        *,
        dt: float,
        gains: HoldGains,
        ideal: bool = False,
        row: int = 0,
    ) -> None:
        """Begin the plan with this memory, stepping every `dt` s."""
        self._ideal, self._row = ideal, row
        self._plan, self._parts = plan, table(plan)
        self._own = begin_flight(plan, memory, dt=dt, gains=gains)
        self._estimate: VehicleState | None = None  # that a step is bound to

    @property
    def plan(self) -> Plan:
        """What is flown."""
        return self._plan

    @property
    def memory(self) -> LeaderMemory:
        """Where in the plan it is, and what its hold remembers."""
        return memory_of(self._own)

    @memory.setter
    def memory(self, memory: LeaderMemory) -> None:
        self._own["memory"] = memory

    def change_manner(self, mission: Mission) -> None:
        """Fly the parts of the plan as this mission says from now on."""
        self._plan = self._plan._replace(mission=mission)
        change_manner(self._own, mission)

    def command(self, estimate: VehicleState) -> tuple[Sticks, Turn | None]:
        """See `Pilot`."""
        if estimate is not self._estimate:
            self._estimate, self._fly = estimate, self._ready(estimate)
        if not self._ideal:
            return self._fly(), None
        speed, turn = self._fly()
        north, east, down = estimate.velocity_ned[self._row].tolist()
        climb = math.atan2(-down, math.hypot(north, east))
        return (climb, float(estimate.euler[self._row, 0]), 0.0), (speed, np.array(turn))

    def _ready(self, estimate: VehicleState) -> Callable[[], Any]:
        """A step from this record, whatever it will say."""
        position, velocity, own = estimate.position_ned, estimate.velocity_ned, self._own
        if self._ideal:
            return READY_FLY_IDEAL(position, velocity, self._row, self._parts, own)
        euler, airspeed = estimate.euler, estimate.airspeed
        return READY_FLY(position, velocity, euler, airspeed, self._row, self._parts, own)


class NoPilot:
    """The leader moves by itself."""

    def __init__(self, leader: Replayed) -> None:
        """Watch this leader."""
        self._leader = leader

    def command(self, estimate: VehicleState) -> tuple[Sticks, Turn | None]:
        """What it does stands for what it was told."""
        return self._leader.command, None


def with_ideal_leader(lead: Turn | None, told: UnicycleCommand) -> UnicycleCommand:
    """The followers' inputs (n) behind those of the leader: (n + 1); zeros where it has none."""
    speed, turn = lead or (0.0, np.zeros(3))
    return UnicycleCommand(
        np.concatenate([[speed], told.speed]),
        np.vstack([turn, told.turn]),
        np.concatenate([[speed], told.speed_desired]),
        np.vstack([np.zeros(3), told.direction]),
        np.concatenate([np.zeros(1, dtype=np.uint8), told.guards]),
    )
