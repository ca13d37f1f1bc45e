"""Commands from external programs to the aircraft of a run, and the building of their sessions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from testbed.autopilot.parameters import FbwaParams
from testbed.core.records import BoolArray, Event, FbwaCommand, Records, VehicleState
from testbed.guidance.flight_plan import GuidanceMission
from testbed.mavlink.mission_plans import ItemFlightPlan, items_from_mission, items_of_segments
from testbed.mavlink.vehicle_control import FlightMode, VehicleControl
from testbed.plan.fleet import Fleet, PlannedAircraft
from testbed.scenario.aircraft import External
from testbed.sim.autopilot_session import AutopilotSession
from testbed.sim.build_leader import LeaderSetup
from testbed.sim.leader_control import MissionController
from testbed.sim.navigator import NavigatorConfig
from testbed.sim.schedule import Clock
from testbed.sim.vehicles import JsbsimVehicles, LeaderInput, Steps
from testbed.vehicle.trim import InitialState

_BANK_LIMIT_DEG, _CLIMB_LIMIT_MPS = 45.0, 1.5  # of a follower's circles and missions


class ExternalControl:
    """Apply external commands to the aircraft; also the controller of a commandable leader.

    Attributes:
        vehicles: of N aircraft, leader first.
    """

    def __init__(self, vehicles: Sequence[VehicleControl]) -> None:
        """Start with every aircraft under the scenario's own control."""
        self.vehicles = tuple(vehicles)
        self._sessions = [
            (row, each) for row, each in enumerate(vehicles) if isinstance(each, AutopilotSession)
        ]
        self._lockstep = [session for _, session in self._sessions if session.lockstep]
        self._events: list[Event] = []
        self.input: LeaderInput = np.zeros(1), np.zeros(3)

    @property
    def commands_leader(self) -> bool:
        """Whether the leader has a session, which then serves as its `LeaderController`."""
        return bool(self._sessions) and self._sessions[0][0] == 0

    @property
    def waiting(self) -> list[str]:
        """Names of the aircraft that lockstep waits for a command of."""
        return [session.name for session in self._lockstep if session.waiting]

    @property
    def timeout_s(self) -> float:
        """How long lockstep waits, s of wall-clock time."""
        return min((session.timeout_s for session in self._lockstep), default=math.inf)

    def guide(
        self, now: float, estimate: VehicleState, lost: BoolArray, frozen: BoolArray | None
    ) -> None:
        """Step the guidance of all sessions; each control period of the leader, before control.

        Args:
            now: s
            estimate: of N aircraft.
            lost: (N,) aircraft that crashed or broke.
            frozen: (N,) aircraft whose autopilot is frozen; None: none.
        """
        for row, session in self._sessions:
            session.lost = bool(lost[row])
            session.frozen = frozen is not None and bool(frozen[row])
            if not session.lost:
                session.guide(now, estimate)

    def steps(self, aircraft: Records) -> Steps:
        """Return the step that writes the leader's command; see `LeaderController`."""
        _, leader = self._sessions[0]

        def write(now: float) -> None:
            command = leader.command
            assert command is not None  # only a follower's session may leave it to the law
            aircraft["control"][0] = command

        return (write,)

    def override_commands(self, aircraft: Records) -> None:
        """Write `command` of the aircraft that their sessions control."""
        for row, session in self._sessions:
            if session.command is not None:
                aircraft["command"][row] = session.command

    def mask_diagnostics(self, followers: Records) -> Records:
        """Clear the limiter flags and saturations of followers that the law does not control.

        Args:
            followers: (n,) of FOLLOWER.

        Returns:
            The same, or a copy where any is cleared.
        """
        rows = self._commanded_followers()
        if not rows:
            return followers
        masked = followers.copy()
        masked["limiter_flags"][rows] = masked["saturations"][rows] = 0
        return masked

    def left_formation(self, left: BoolArray) -> BoolArray:
        """Mark followers that the law does not control as having left the formation, (n,)."""
        rows = self._commanded_followers()
        if not rows:
            return left
        out = left.copy()
        out[rows] = True
        return out

    def _commanded_followers(self) -> list[int]:
        """Rows, among n followers, of those that a session controls."""
        return [row - 1 for row, each in self._sessions if row and each.command is not None]

    def command_counts(self) -> Mapping[str, Mapping[str, int]]:
        """Count the executed external requests, by aircraft and kind; for the metrics."""
        return {
            session.name: dict(session.command_counts)
            for _, session in self._sessions
            if session.command_counts
        }

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""
        events = [
            *self._events,
            *(event for _, session in self._sessions for event in session.pop_events()),
        ]
        self._events = []
        return events

    def add_events(self, events: Sequence[Event]) -> None:
        """Add events to those that `pop_events` returns next."""
        self._events += events

    def expect_commands(self, now: float) -> None:
        """Wait, in lockstep, for a command in reply to the sample of this time, s."""
        for session in self._lockstep:
            session.expect_command(now)


def build_external_control(
    fleet: Fleet,
    clock: Clock,
    leader: LeaderSetup,
    starts: Sequence[InitialState],
    jsbsim: JsbsimVehicles | None,
) -> ExternalControl:
    """Build the sessions of all aircraft.

    Args:
        fleet: the N aircraft.
        clock: of the run.
        leader: the leader.
        starts: N.
        jsbsim: the vehicles with flight models.
    """
    vehicles: list[VehicleControl] = []
    for row, one in enumerate(fleet.aircraft):
        if jsbsim is None or not one.takes_commands:
            vehicles.append(_uncommandable(one))
            continue
        tune, fleet_row = one.params, fleet.model_rows.index(row)
        source = one.section.commanded_by
        trim = jsbsim.fleet.trims[fleet_row]
        north, east, down = starts[row].position_ned
        controller = leader.controller
        own = controller if row == 0 and isinstance(controller, MissionController) else None
        flight_params = own.plan.mission if own else _flight_params(tune, starts[row].airspeed)
        config = NavigatorConfig(
            row=row,
            start=(north, east, -down),
            trim=FbwaCommand(trim.placement.pitch, trim.placement.roll, trim.controls.throttle),
            hold=one.guidance.model_dump(),
            flight_params=flight_params,
            origin=fleet.origin,
            dt=clock.control / clock.base_rate_hz,
        )
        mission = None
        if own:
            numbers = items_of_segments(flight_params)
            plan = ItemFlightPlan(own.plan, numbers, (flight_params.airspeed,) * len(numbers))
            mission = (plan, items_from_mission(flight_params, config.origin), own)
        vehicles.append(
            AutopilotSession(
                one.name,
                config,
                tune,
                partial(jsbsim.retune, fleet_row),
                external=source if isinstance(source, External) else None,
                mission=mission,
            )
        )
    return ExternalControl(vehicles)


def _uncommandable(one: PlannedAircraft) -> VehicleControl:
    if one.is_scripted:
        return VehicleControl(
            one.name, FlightMode.AUTO, "follows a path by itself: takes no commands"
        )
    mode = FlightMode.AUTO if one.row == 0 else FlightMode.FBWA
    if one.is_ideal:
        return VehicleControl(one.name, mode, "an ideal vehicle: it has no autopilot")
    return VehicleControl(one.name, mode, "flown by ArduPlane: connect to that")


def _flight_params(tune: FbwaParams, airspeed: float) -> GuidanceMission:
    """Limits and airspeed of a follower that flies a mission or a circle of its own."""
    return GuidanceMission(
        legs=(),
        airspeed=airspeed,
        bank_limit=math.radians(min(tune.roll_limit_deg, _BANK_LIMIT_DEG)),
        climb_limit=_CLIMB_LIMIT_MPS,
        period=tune.navl1_period,
        damping=tune.navl1_damping,
    )
