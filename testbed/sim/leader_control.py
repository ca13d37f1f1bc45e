"""Control an aircraft along a flight plan or a script."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Protocol

import numpy as np

from testbed.core.compile import Kernel
from testbed.core.records import AIRCRAFT, Array, Records, VehicleState, allocate
from testbed.guidance.flight_plan import FlightPlan, Mission
from testbed.guidance.mission_follower import (
    Hold,
    begin_flight,
    guide,
    guide_unicycle,
    segment_records,
    set_flight_params,
)
from testbed.sim.vehicles import ScriptedVehicle

FbwaInput = tuple[float, float, float]  # pitch (rad), roll (rad), throttle (0..1)
UnicycleInput = tuple[float, Array]  # u (m/s) and ω (3,) rad/s of an ideal vehicle
NO_INPUT: UnicycleInput = (0.0, np.zeros(3))


class LeaderController(Protocol):
    """Controller of the leader."""

    def step(self, aircraft: Records) -> UnicycleInput:
        """Write `control` of row 0 of AIRCRAFT; once per control period.

        Returns:
            The inputs of an ideal leader; zeros for others.
        """

    def kernels(self, aircraft: Records) -> list[Kernel]:
        """Return the compiled calls of `step`, for `core.compile.prepare`."""


class MissionController:
    """Guidance of one aircraft along a plan."""

    def __init__(
        self,
        plan: FlightPlan,
        held: Hold,
        *,
        dt: float,
        gains: Mapping[str, float],
        ideal: bool = False,
        row: int = 0,
    ) -> None:
        """Start a plan with this memory of the hold; steps come every `dt` s."""
        self._ideal, self._row = ideal, row
        self._plan, self._segments = plan, segment_records(plan)
        self._state = begin_flight(plan, held, dt=dt, gains=gains)
        self._scratch = allocate(AIRCRAFT, 1)

    @property
    def plan(self) -> FlightPlan:
        """The flight plan."""
        return self._plan

    @property
    def segment(self) -> int:
        """The segment of the plan that is flown."""
        return int(self._state["memory"]["segment"][0])

    @property
    def held(self) -> Hold:
        """Altitude, climb, pitch and throttle of the hold."""
        held: Hold = self._state["memory"]["hold"][0].item()
        return held

    @held.setter
    def held(self, held: Hold) -> None:
        self._state["memory"]["hold"] = held

    def set_flight_params(self, mission: Mission) -> None:
        """Set airspeed, limits and L1 parameters to those of a mission."""
        self._plan = self._plan._replace(mission=mission)
        set_flight_params(self._state, mission)

    def step(self, aircraft: Records) -> UnicycleInput:
        """See `LeaderController`."""
        if not self._ideal:
            guide(self._row, aircraft, self._segments, self._state)
            return NO_INPUT
        speed, omega = guide_unicycle(self._row, aircraft, self._segments, self._state)
        return speed, np.array(omega)

    def kernels(self, aircraft: Records) -> list[Kernel]:
        """See `LeaderController`."""
        call = guide_unicycle if self._ideal else guide
        return [partial(call, self._row, aircraft, self._segments, self._state)]

    def command(self, estimate: VehicleState) -> FbwaInput:
        """Compute the command of this aircraft from the estimates of N aircraft."""
        own, row = self._scratch["estimate"], self._row
        for name in ("position_ned", "velocity_ned", "euler", "airspeed"):
            own[name][0] = getattr(estimate, name)[row]
        guide(0, self._scratch, self._segments, self._state)
        pitch, roll, throttle = self._scratch["control"][0].item()
        return pitch, roll, throttle


class ScriptedController:
    """Controller of a scripted leader: its command is its own motion."""

    def __init__(self, leader: ScriptedVehicle) -> None:
        """Start with this leader."""
        self._leader = leader

    def step(self, aircraft: Records) -> UnicycleInput:
        """See `LeaderController`."""
        write_control(aircraft, 0, self._leader.command())
        return NO_INPUT

    def kernels(self, aircraft: Records) -> list[Kernel]:
        """See `LeaderController`: a script needs none."""
        return []


def write_control(aircraft: Records, row: int, command: FbwaInput) -> None:
    """Write `control` of one aircraft."""
    aircraft["control"][row] = command
