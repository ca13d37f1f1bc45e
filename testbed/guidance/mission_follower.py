"""Guide an aircraft along a flight plan, from its estimate to its commands.

`step` is for aircraft with an autopilot, `unicycle_step` for ideal vehicles; both follow the same
path. `guidance_step` compiles them, with records in place of the plan's segments and mission and of
the gains. numba therefore allows no keyword-only arguments here, and no `_replace`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from testbed.core.compile import jitable
from testbed.core.frames import GRAVITY
from testbed.guidance import l1
from testbed.guidance.altitude_airspeed_hold import HoldGains, HoldMemory, hold, hold_path
from testbed.guidance.flight_plan import LEVEL_OFF, FlightPlan, Segment, climb_profile


class LeaderMemory(NamedTuple):
    """Progress of an aircraft in its flight plan, and the memory of its hold."""

    segment: int  # index into the segments of the plan
    altitude_from: float  # m, altitude reference at the start of this segment
    captured: bool  # the aircraft has reached the circle, and its turns are counted
    turned: float  # rad around the circle in this segment, positive in its direction
    bearing: float  # rad, from the centre to the aircraft
    hold: HoldMemory


def initial_memory(*, altitude: float, pitch: float = 0.0, throttle: float = 0.0) -> LeaderMemory:
    """Return the memory before the first step, in trimmed flight.

    Args:
        altitude: m above the origin.
        pitch: rad, of level trim; zero for an ideal vehicle.
        throttle: 0..1, of level trim; zero for an ideal vehicle.
    """
    memory = HoldMemory(altitude=altitude, climb=0.0, pitch=pitch, throttle=throttle)
    return LeaderMemory(0, altitude, False, 0.0, 0.0, memory)


@jitable
def step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    roll: float,
    airspeed: float,
    plan: FlightPlan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, float, float, LeaderMemory]:
    """Compute the fly-by-wire-A command of an aircraft from its own estimate.

    Args:
        memory: of the last step.
        position_ned: (3,) m.
        velocity_ned: (3,) m/s over the ground.
        roll: rad.
        airspeed: true, m/s.
        plan: flight plan.
        dt: s, between two steps.
        gains: of altitude and airspeed hold.

    Returns:
        Pitch, rad; roll, rad; throttle, 0..1; the new memory.
    """
    mission = plan.mission
    memory, acceleration, target, rate = _follow(memory, position_ned, velocity_ned, plan)
    pitch, throttle, held = hold(
        memory.hold,
        altitude=-position_ned[2],
        climb=-velocity_ned[2],
        airspeed=airspeed,
        roll=roll,
        altitude_target=target,
        climb_target=rate,
        airspeed_target=mission.airspeed,
        climb_limit=mission.climb_limit,
        dt=dt,
        gains=gains,
    )
    bank = l1.roll_command(acceleration, bank_limit=mission.bank_limit)
    return pitch, bank, throttle, _with_hold(memory, held)


@jitable
def unicycle_step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    plan: FlightPlan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, tuple[float, float, float], LeaderMemory]:
    """Compute the command of an ideal vehicle from its own estimate.

    The mission's airspeed is commanded as ground speed. ω is (0, γ̇, σ̇ cos γ) in the zero-roll
    velocity frame; its last component is the lateral acceleration divided by the speed, at most
    that of a coordinated turn at the bank limit.

    Args:
        memory: of the last step.
        position_ned: (3,) m.
        velocity_ned: (3,) m/s over the ground.
        plan: flight plan.
        dt: s, between two steps.
        gains: of the altitude hold.

    Returns:
        u, m/s; ω, rad/s; the new memory.
    """
    mission = plan.mission
    memory, acceleration, target, rate = _follow(memory, position_ned, velocity_ned, plan)
    north, east, down = velocity_ned
    speed = max(math.sqrt(north * north + east * east + down * down), l1.MIN_SPEED)
    gamma_dot, held = hold_path(
        memory.hold,
        altitude=-position_ned[2],
        climb=-velocity_ned[2],
        speed=speed,
        altitude_target=target,
        climb_target=rate,
        climb_limit=mission.climb_limit,
        dt=dt,
        gains=gains,
    )
    limit = GRAVITY * math.tan(mission.bank_limit)
    turn_rate = min(max(acceleration, -limit), limit) / speed
    return mission.airspeed, (0.0, gamma_dot, turn_rate), _with_hold(memory, held)


@jitable
def _follow(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: FlightPlan
) -> tuple[LeaderMemory, float, float, float]:
    """Update progress; return memory, lateral acceleration (m/s²), target altitude and its rate."""
    mission = plan.mission
    memory = _pass_waypoint(memory, position, velocity, plan)
    segment = plan.segments[memory.segment]
    if not segment.circle:
        acceleration = l1.line_acceleration(
            position,
            velocity,
            segment.start,
            segment.end,
            period=mission.period,
            damping=mission.damping,
        )
        altitude, rate = _leg_altitude(memory, position, velocity, segment, plan)
        return memory, acceleration, altitude, rate
    acceleration, captured = l1.circle_acceleration(
        position,
        velocity,
        segment.end,
        radius=segment.radius,
        clockwise=segment.clockwise,
        period=mission.period,
        damping=mission.damping,
    )
    memory = _count_turns(memory, position, segment, captured)
    return memory, acceleration, plan.segments[memory.segment].end[2], 0.0


@jitable
def _pass_waypoint(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: FlightPlan
) -> LeaderMemory:
    """Go to the next segment when the waypoint is reached or the turns are completed."""
    segment = plan.segments[memory.segment]
    following = memory.segment + 1 if memory.segment + 1 < len(plan.segments) else plan.repeat_from
    if segment.circle:
        completed = memory.turned >= segment.turns * 2.0 * math.pi
        if not completed or segment.continues or following == memory.segment:
            return memory
    else:
        along, right, length = l1.track_coordinates(position, segment.start, segment.end)
        if along < length and math.hypot(length - along, right) > _turn_distance(
            velocity, segment, plan
        ):
            return memory
    return LeaderMemory(following, memory.hold.altitude, False, 0.0, 0.0, memory.hold)


@jitable
def _turn_distance(velocity: Sequence[float], line: Segment, plan: FlightPlan) -> float:
    return l1.turn_distance(
        math.hypot(velocity[0], velocity[1]),
        line.turn,
        waypoint_radius=plan.mission.waypoint_radius,
        period=plan.mission.period,
        damping=plan.mission.damping,
    )


@jitable
def _leg_altitude(
    memory: LeaderMemory,
    position: Sequence[float],
    velocity: Sequence[float],
    line: Segment,
    plan: FlightPlan,
) -> tuple[float, float]:
    """Return target altitude (m) and its rate (m/s), linear in the distance along the leg.

    The climb ends where the next turn begins, so that the aircraft passes a corner at its altitude,
    and levels off at the end of the leg.
    """
    along, _, length = l1.track_coordinates(position, line.start, line.end)
    distance = max(length - _turn_distance(velocity, line, plan), 1.0)
    change = line.end[2] - memory.altitude_from
    steep = abs(change) * (plan.mission.airspeed / distance) ** 2
    done, slope = climb_profile(along / distance, level_off=min(steep / LEVEL_OFF, 1.0))
    north, east = line.end[0] - line.start[0], line.end[1] - line.start[1]
    advance = (velocity[0] * north + velocity[1] * east) / max(length, 1e-3)
    return memory.altitude_from + change * done, change * slope * advance / distance


@jitable
def _count_turns(
    memory: LeaderMemory, position: Sequence[float], circle: Segment, captured: bool
) -> LeaderMemory:
    """Add the angle since the last step; start the next level when due."""
    bearing = math.atan2(position[1] - circle.end[1], position[0] - circle.end[0])
    number, turned = memory.segment, memory.turned
    if memory.captured:
        captured = True
        change = bearing - memory.bearing  # of two angles within ±π
        if abs(change) > math.pi:
            change -= math.copysign(2.0 * math.pi, change)
        turned += change if circle.clockwise else -change
        due = circle.turns * 2.0 * math.pi
        if turned >= due and circle.continues:
            number, turned = number + 1, turned - due
    return LeaderMemory(number, memory.altitude_from, captured, turned, bearing, memory.hold)


@jitable
def _with_hold(memory: LeaderMemory, held: HoldMemory) -> LeaderMemory:
    return LeaderMemory(
        memory.segment,
        memory.altitude_from,
        memory.captured,
        memory.turned,
        memory.bearing,
        held,
    )
