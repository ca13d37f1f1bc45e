"""Build the companion computers of a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from testbed.commands.autopilot_session import MANUAL_ANGLE_LIMIT
from testbed.core.errors import InputError
from testbed.core.geodetic import local_frame
from testbed.core.records import Array, Records
from testbed.flight.companion import Companions
from testbed.flight.companion_link import LinkedAutopilots, MavlinkCompanions
from testbed.flight.own_state import IMU, VELOCITY, AttitudeLimits
from testbed.flight.schedule import Clock
from testbed.flight.vehicles import JsbsimVehicles
from testbed.plan.command_sessions import trimmed_command
from testbed.plan.fleet import FormationPlan
from testbed.scenario import Scenario

_LINK = "controller.companion.link: mavlink"


def build_companions(
    scenario: Scenario,
    fleet: FormationPlan,
    clock: Clock,
    aircraft: Records,
    jsbsim: JsbsimVehicles | None,
) -> Companions | None:
    """Build the companion computers; None where nothing is between autopilots and controllers.

    Args:
        scenario: that is flown.
        fleet: its aircraft.
        clock: of the run.
        aircraft: (N,) of AIRCRAFT of the run.
        jsbsim: its vehicles with flight models; None: there are none.

    Raises:
        InputError: the scenario cannot be flown with the link that it asks for.
    """
    section = scenario.controller.companion
    latencies = section.state_latency_s, section.command_latency_s
    if section.link == "mavlink":
        problem = next(_link_problems(scenario, fleet, clock), None)
        if problem is not None:
            raise InputError(f"{_LINK}: {problem}")
        source = IMU if section.acceleration == "imu" else VELOCITY
        linked = LinkedAutopilots(
            local_frame(fleet.origin), source, _command_limits(fleet), _trims(fleet, jsbsim)
        )
        return MavlinkCompanions(aircraft, clock, *latencies, linked)
    return Companions(aircraft, clock, *latencies) if any(latencies) else None


def _link_problems(scenario: Scenario, fleet: FormationPlan, clock: Clock) -> Iterator[str]:
    """Yield why states and commands cannot pass through MAVLink, with what to write."""
    network, rates = scenario.network, scenario.rates
    if network.encoding != "follow-target":
        yield (
            "messages between aircraft are FOLLOW_TARGET, too (write network.encoding: "
            "follow-target)"
        )
    ideal = [each.name for each in fleet.followers if not each.has_model]
    if ideal:
        names = ", ".join(ideal)
        yield f"{names}: an ideal vehicle has no autopilot (write vehicle: jsbsim)"
    if not rates.synchronous or clock.transmit_schedules or clock.broadcast != clock.control:
        yield (
            "a companion broadcasts each state that it reads, and then steps its controller (write "
            f"rates.broadcast_hz: {rates.control_hz}, synchronous: true, and no network.broadcast)"
        )
    if 1000 % rates.control_hz:
        yield (
            f"rates.control_hz: {rates.control_hz}: MAVLink counts time in ms (write a rate whose "
            "period is a whole number of them, as 20, 25, 40 or 50)"
        )


def _command_limits(fleet: FormationPlan) -> AttitudeLimits:
    """Return the limits (N,) of the angles that autopilots take from an attitude target."""
    params = [each.params for each in fleet.aircraft]
    degrees = (
        [each.roll_limit_deg for each in params],
        [each.ptch_lim_max_deg for each in params],
        [each.ptch_lim_min_deg for each in params],
    )
    angles = np.array([[math.radians(one) for one in each] for each in degrees])
    return AttitudeLimits(*np.clip(angles, -MANUAL_ANGLE_LIMIT, MANUAL_ANGLE_LIMIT))


def _trims(fleet: FormationPlan, jsbsim: JsbsimVehicles | None) -> Array:
    """Return the commands (N, 3) of level flight of those with flight models; NaN for others."""
    trims = np.full((len(fleet.names), 3), np.nan)
    if jsbsim is not None:
        for k, row in enumerate(fleet.model_rows):
            trims[row] = trimmed_command(jsbsim.fleet.trims[k])
    return trims
