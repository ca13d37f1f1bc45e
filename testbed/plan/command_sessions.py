"""Build the sessions by which external programs command aircraft."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

from testbed.autopilot.parameters import FbwaParams
from testbed.commands.autopilot_session import AutopilotSession
from testbed.commands.navigator import NavigatorConfig
from testbed.core.records import FbwaCommand, Records
from testbed.flight.array_commands import ArrayCommands
from testbed.flight.external_control import CommandSession, ExternalControl
from testbed.flight.leader_control import LeaderController, MissionController
from testbed.flight.schedule import Clock
from testbed.flight.vehicles import JsbsimVehicles
from testbed.guidance.flight_plan import GuidanceMission
from testbed.mavlink.mission_plans import ItemFlightPlan, items_from_mission, items_of_segments
from testbed.mavlink.vehicle_control import FlightMode, VehicleControl
from testbed.plan.fleet import Fleet, PlannedAircraft
from testbed.scenario.aircraft import External
from testbed.vehicle.trim import InitialState, TrimResult

_BANK_LIMIT_DEG, _CLIMB_LIMIT_MPS = 45.0, 1.5  # of a follower's circles and missions


def build_array_commands(
    fleet: Fleet, jsbsim: JsbsimVehicles | None, commands: Records
) -> ArrayCommands | None:
    """Build the commands of a program in this process; None: no aircraft takes any."""
    trims = {}
    for row, one in enumerate(fleet.aircraft):
        takes = one.takes_commands and isinstance(one.section.commanded_by, External)
        if jsbsim is not None and takes:
            trims[row] = trimmed_command(jsbsim.fleet.trims[fleet.model_rows.index(row)])
    return ArrayCommands(fleet.names, commands, trims) if trims else None


def trimmed_command(trim: TrimResult) -> FbwaCommand[float]:
    """Return the command of the flight in trim."""
    return FbwaCommand(trim.placement.pitch, trim.placement.roll, trim.controls.throttle)


def build_external_control(
    fleet: Fleet,
    clock: Clock,
    leader: LeaderController | None,
    starts: Sequence[InitialState],
    jsbsim: JsbsimVehicles | None,
    companions: External | None = None,
) -> ExternalControl:
    """Build the sessions of all aircraft.

    Args:
        fleet: the N aircraft.
        clock: of the run.
        leader: of the scenario's own leader; None: there is none.
        starts: N.
        jsbsim: the vehicles with flight models.
        companions: how companion computers that the run starts command the followers; None: it
            starts none.
    """
    vehicles: list[VehicleControl] = []
    sessions: list[tuple[int, CommandSession]] = []
    for row, one in enumerate(fleet.aircraft):
        if jsbsim is None or not one.takes_commands:
            vehicles.append(_uncommandable(one))
            continue
        tune, fleet_row = one.params, fleet.model_rows.index(row)
        source = one.section.commanded_by
        trim = jsbsim.fleet.trims[fleet_row]
        north, east, down = starts[row].position_ned
        own = leader if row == 0 and isinstance(leader, MissionController) else None
        flight_params = own.plan.mission if own else _flight_params(tune, starts[row].airspeed)
        config = NavigatorConfig(
            row=row,
            start=(north, east, -down),
            trim=trimmed_command(trim),
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
        external = source if isinstance(source, External) else None
        session = AutopilotSession(
            one.name,
            config,
            tune,
            partial(jsbsim.retune, fleet_row),
            external=companions if companions is not None and row else external,
            mission=mission,
            companion=companions is not None,
        )
        vehicles.append(session)
        sessions.append((row, session))
    if companions is not None:
        for vehicle, start in zip(vehicles, starts, strict=True):
            vehicle.companion = True
            # as of autopilots that were switched on below their starts
            north, east, _ = start.position_ned
            vehicle.local_origin_ned = float(north), float(east), 0.0
    return ExternalControl(vehicles, sessions)


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
