"""Guidance that flies an aircraft through its own autopilot or an ideal vehicle, or nobody."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from testbed.guidance import leader as guidance
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Plan
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
        memory: guidance.LeaderMemory,
        *,
        dt: float,
        gains: HoldGains,
        ideal: bool = False,
        row: int = 0,
    ) -> None:
        """Begin the plan with this memory, stepping every `dt` s."""
        self.plan, self.memory = plan, memory
        self._dt, self._gains, self._ideal, self._row = dt, gains, ideal, row

    def command(self, estimate: VehicleState) -> tuple[Sticks, Turn | None]:
        """See `Pilot`."""
        row = self._row
        position = estimate.position_ned[row].tolist()
        velocity = estimate.velocity_ned[row].tolist()
        if self._ideal:
            speed, turn, self.memory = guidance.unicycle_step(
                self.memory, position, velocity, plan=self.plan, dt=self._dt, gains=self._gains
            )
            ahead = math.hypot(velocity[0], velocity[1])
            climb = math.atan2(-velocity[2], ahead)
            return (climb, float(estimate.euler[row, 0]), 0.0), (speed, np.array(turn))
        pitch, roll, throttle, self.memory = guidance.step(
            self.memory,
            position,
            velocity,
            float(estimate.euler[row, 0]),
            float(estimate.airspeed[row]),
            plan=self.plan,
            dt=self._dt,
            gains=self._gains,
        )
        return (pitch, roll, throttle), None


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
