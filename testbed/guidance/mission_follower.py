"""Guide an aircraft along a flight plan, from its estimate to its commands.

`guide` is for aircraft with an autopilot, `guide_unicycle` for ideal vehicles; both follow the same
path. Plan, gains and memory are records; the memory is written in place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import GRAVITY, gamma_of
from testbed.core.records import Array, Record, Records, Values, Vector, allocate, record_of
from testbed.guidance import l1
from testbed.guidance.altitude_airspeed_hold import (
    GAINS,
    HOLD,
    IDEAL_PATH_GAIN,
    climb_demand,
    hold,
    path_angle,
)
from testbed.guidance.flight_plan import (
    LEVEL_OFF,
    FlightPlan,
    GuidanceMission,
    Segment,
    climb_profile,
)

FLIGHT_PARAMS = tuple(each.name for each in fields(GuidanceMission) if each.name != "legs")
SEGMENT = record_of(Segment)
# Progress of an aircraft in its flight plan, and the memory of its hold.
MEMORY = np.dtype(
    [
        ("segment", "i8"),  # index into the segments of the plan
        ("altitude_from", "f8"),  # m, altitude reference at the start of this segment
        ("captured", "?"),  # the aircraft has reached the circle, and its turns are counted
        ("turned", "f8"),  # rad around the circle in this segment, positive in its direction
        ("bearing", "f8"),  # rad, from the centre to the aircraft
        ("hold", HOLD),
    ]
)
# The guidance of one aircraft besides the segments: parameters, gains and memory.
GUIDANCE_STATE = np.dtype(
    [
        ("flight_params", [(name, "f8") for name in FLIGHT_PARAMS]),
        ("repeat_from", "i8"),
        ("gains", GAINS),
        ("dt", "f8"),
        ("memory", MEMORY),
    ]
)
Hold = tuple[float, float, float, float]  # the fields of HOLD


def segment_records(plan: FlightPlan) -> Records:
    """Pack the segments of a plan into records (K,) of SEGMENT."""
    segments = allocate(SEGMENT, len(plan.segments))
    segments[:] = list(plan.segments)
    return segments


def begin_flight(plan: FlightPlan, held: Hold, *, dt: float, gains: Mapping[str, float]) -> Records:
    """Return the guidance of one aircraft at the start of a plan, (1,) of GUIDANCE_STATE.

    Args:
        plan: flight plan.
        held: altitude, climb, pitch and throttle of the hold; pitch and throttle of level trim are
            zero for an ideal vehicle.
        dt: s, between two steps.
        gains: of the hold, by the names of GAINS.
    """
    own = allocate(GUIDANCE_STATE, 1)
    own["repeat_from"], own["dt"] = plan.repeat_from, dt
    own["gains"] = tuple(gains[name] for name in GAINS.names or ())
    own["memory"]["altitude_from"], own["memory"]["hold"] = held[0], held
    set_flight_params(own, plan.mission)
    return own


def set_flight_params(own: Records, mission: GuidanceMission) -> None:
    """Set airspeed, limits and L1 parameters to those of a mission.

    Its legs are not read.
    """
    own["flight_params"] = tuple(getattr(mission, name) for name in FLIGHT_PARAMS)


@entry
def guide(row: int, aircraft: Records, segments: Record, state: Record) -> None:
    """Guide the aircraft in a row along its plan: write its fly-by-wire-A command.

    Args:
        row: of the aircraft.
        aircraft: (N,) of AIRCRAFT; `control` of the row is written.
        segments: (K,) of SEGMENT.
        state: (1,) of GUIDANCE_STATE; its memory is written.
    """
    own, s, command = aircraft[row].estimate, state[0], aircraft[row].control
    params, held = s.flight_params, s.memory.hold
    acceleration, target, rate = _follow(s, segments, own.position_ned, own.velocity_ned)
    demand = climb_demand(held, -own.position_ned[2], target, rate, params.climb_limit, s.dt)
    command.pitch, command.throttle = hold(
        held,
        s.gains,
        demand,
        -own.velocity_ned[2],
        own.airspeed,
        own.euler[0],
        params.airspeed,
        s.dt,
    )
    command.roll = l1.roll_command(acceleration, params.bank_limit)


@entry
def guide_unicycle(
    row: int, aircraft: Records, segments: Record, state: Record, speed_mps: Array, omega: Array
) -> None:
    """Guide the ideal vehicle in a row: write its u (1,) m/s and ω (3,) rad/s.

    The mission's airspeed is commanded as ground speed. ω is (0, γ̇, σ̇ cos γ) in the zero-roll
    velocity frame; its last component is the lateral acceleration divided by the speed, at most
    that of a coordinated turn at the bank limit. For the log, the command is the flight-path angle,
    the bank and zero throttle. See `guide`.
    """
    own, s, command = aircraft[row].estimate, state[0], aircraft[row].control
    params = s.flight_params
    acceleration, target, rate = _follow(s, segments, own.position_ned, own.velocity_ned)
    north, east, down = own.velocity_ned
    speed = max(math.sqrt(north * north + east * east + down * down), l1.MIN_SPEED)
    demand = climb_demand(
        s.memory.hold, -own.position_ned[2], target, rate, params.climb_limit, s.dt
    )
    gamma_dot = IDEAL_PATH_GAIN * (path_angle(demand, speed) - path_angle(-down, speed))
    limit = GRAVITY * math.tan(params.bank_limit)
    turn_rate = min(max(acceleration, -limit), limit) / speed
    command.pitch = gamma_of(north, east, down)
    command.roll, command.throttle = own.euler[0], 0.0
    speed_mps[0] = params.airspeed
    omega[0], omega[1], omega[2] = 0.0, gamma_dot, turn_rate


@kernel
def _follow(s: Record, segments: Records, position: Vector, velocity: Vector) -> Values:
    """Update progress; return lateral acceleration (m/s²), target altitude and its rate."""
    params, memory = s.flight_params, s.memory
    _pass_waypoint(s, segments, position, velocity)
    segment = segments[memory.segment]
    if not segment.circle:
        acceleration = l1.line_acceleration(
            position, velocity, segment.start, segment.end, params.period, params.damping
        )
        altitude, rate = _leg_altitude(s, position, velocity, segment)
        return acceleration, altitude, rate
    acceleration, captured = l1.circle_acceleration(
        position,
        velocity,
        segment.end,
        segment.radius,
        segment.clockwise,
        params.period,
        params.damping,
    )
    _count_turns(memory, position, segment, captured)
    return acceleration, segments[memory.segment].end[2], 0.0


@kernel
def _pass_waypoint(s: Record, segments: Records, position: Vector, velocity: Vector) -> None:
    """Go to the next segment when the waypoint is reached or the turns are completed."""
    memory = s.memory
    segment = segments[memory.segment]
    following = memory.segment + 1 if memory.segment + 1 < len(segments) else s.repeat_from
    if segment.circle:
        completed = memory.turned >= segment.turns * 2.0 * math.pi
        if not completed or segment.continues or following == memory.segment:
            return
    else:
        along, right, length = l1.track_coordinates(position, segment.start, segment.end)
        if along < length and math.hypot(length - along, right) > _turn_distance(
            s.flight_params, velocity, segment
        ):
            return
    memory.segment, memory.altitude_from = following, memory.hold.altitude
    memory.captured, memory.turned, memory.bearing = False, 0.0, 0.0


@kernel
def _turn_distance(params: Record, velocity: Vector, line: Record) -> float:
    distance: float = l1.turn_distance(
        math.hypot(velocity[0], velocity[1]),
        line.turn,
        params.waypoint_radius,
        params.period,
        params.damping,
    )
    return distance


@kernel
def _leg_altitude(s: Record, position: Vector, velocity: Vector, line: Record) -> Values:
    """Return target altitude (m) and its rate (m/s), linear in the distance along the leg.

    The climb ends where the next turn begins, so that the aircraft passes a corner at its altitude,
    and levels off at the end of the leg.
    """
    altitude_from = s.memory.altitude_from
    along, _, length = l1.track_coordinates(position, line.start, line.end)
    distance = max(length - _turn_distance(s.flight_params, velocity, line), 1.0)
    change = line.end[2] - altitude_from
    steep = abs(change) * (s.flight_params.airspeed / distance) ** 2
    done, slope = climb_profile(along / distance, min(steep / LEVEL_OFF, 1.0))
    north, east = line.end[0] - line.start[0], line.end[1] - line.start[1]
    advance = (velocity[0] * north + velocity[1] * east) / max(length, 1e-3)
    return altitude_from + change * done, change * slope * advance / distance


@kernel
def _count_turns(memory: Record, position: Vector, circle: Record, captured: bool) -> None:
    """Add the angle since the last step; start the next level when due."""
    bearing = math.atan2(position[1] - circle.end[1], position[0] - circle.end[0])
    if memory.captured:
        captured = True
        change = bearing - memory.bearing  # of two angles within ±π
        if abs(change) > math.pi:
            change -= math.copysign(2.0 * math.pi, change)
        memory.turned += change if circle.clockwise else -change
        due = circle.turns * 2.0 * math.pi
        if memory.turned >= due and circle.continues:
            memory.segment += 1
            memory.turned -= due
    memory.captured, memory.bearing = captured, bearing
