"""Control an aircraft along a flight plan or a script."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from testbed.core.call_list import Call, Steps
from testbed.core.records import AIRCRAFT, FbwaCommand, Records, VehicleState, allocate
from testbed.flight.vehicles import LeaderInput, command_own_motion
from testbed.guidance.flight_plan import FlightPlan, GuidanceMission
from testbed.guidance.mission_follower import (
    Hold,
    begin_flight,
    guide,
    guide_unicycle,
    segment_records,
    set_flight_params,
)


class LeaderController(Protocol):
    """Controller of the leader."""

    input: LeaderInput  # of an ideal leader; zeros for others

    def steps(self, aircraft: Records) -> Steps:
        """Return the steps that write `control` of row 0 of AIRCRAFT; once per control period."""


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
        self.input: LeaderInput = np.zeros(1), np.zeros(3)
        self._guide_scratch = self._guide(0, self._scratch)

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

    def set_flight_params(self, mission: GuidanceMission) -> None:
        """Set airspeed, limits and L1 parameters to those of a mission."""
        self._plan = self._plan._replace(mission=mission)
        set_flight_params(self._state, mission)

    def steps(self, aircraft: Records) -> Steps:
        """See `LeaderController`."""
        return (self._guide(self._row, aircraft),)

    def _guide(self, row: int, aircraft: Records) -> Call:
        plan = row, aircraft, self._segments, self._state
        return Call(guide_unicycle, *plan, *self.input) if self._ideal else Call(guide, *plan)

    def command(self, estimate: VehicleState) -> FbwaCommand[float]:
        """Compute the command of this aircraft from the estimates of N aircraft."""
        own, row = self._scratch["estimate"], self._row
        for name in ("position_ned", "velocity_ned", "euler", "airspeed"):
            own[name][0] = getattr(estimate, name)[row]
        self._guide_scratch(0.0)
        return FbwaCommand._make(self._scratch["control"][0].item())


class ScriptedController:
    """Controller of a scripted leader: its command is its own motion."""

    def __init__(self) -> None:
        self.input: LeaderInput = np.zeros(1), np.zeros(3)

    def steps(self, aircraft: Records) -> Steps:
        """See `LeaderController`."""
        return (Call(command_own_motion, aircraft),)
