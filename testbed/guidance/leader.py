"""The leader's guidance: one step from what its autopilot believes to its commands.

`step` flies an aircraft by its sticks, `unicycle_step` an ideal vehicle; the way is the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from testbed.frames import GRAVITY
from testbed.guidance import l1
from testbed.guidance.longitudinal import HoldGains, HoldMemory, hold, hold_path
from testbed.guidance.mission import LEVEL_OFF, LoiterLeg, Plan, Segment, climbed


class LeaderMemory(NamedTuple):
    """Where the leader is in its plan, and what its hold remembers."""

    part: int  # index into the plan's parts
    altitude_from: float  # m, where the altitude reference was when this part began
    level: int  # of a circle
    captured: bool  # the circle has been met; turns count from then on
    turned: float  # rad around the circle on this level, the right way round
    bearing: float  # rad, of the aircraft seen from the centre
    hold: HoldMemory


def begin(*, altitude: float, pitch: float = 0.0, throttle: float = 0.0) -> LeaderMemory:
    """The memory before the first step, from the trimmed flight the run starts in.

    Altitude in m above the origin, pitch in rad and throttle (0..1) of level trim; an ideal vehicle
    has neither.
    """
    memory = HoldMemory(altitude=altitude, climb=0.0, pitch=pitch, throttle=throttle)
    return LeaderMemory(0, altitude, 0, False, 0.0, 0.0, memory)


def step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    roll: float,
    airspeed: float,
    *,
    plan: Plan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, float, float, LeaderMemory]:
    """Pitch (rad), roll (rad), throttle (0..1) commands and the new memory; called every `dt` s.

    Takes the leader's own estimate as Python floats (`row.tolist()`): m, m/s, rad, true airspeed.
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
    return pitch, bank, throttle, memory._replace(hold=held)


def unicycle_step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    *,
    plan: Plan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, tuple[float, float, float], LeaderMemory]:
    """Speed command u (m/s), turn ω (rad/s) and the new memory; called every `dt` s.

    For an ideal vehicle whose motion over the ground is given as Python floats, m and m/s. The
    mission's airspeed is commanded as ground speed. ω is resolved in the zero-roll velocity frame:
    (0, γ̇, σ̇ cos γ), the last the lateral acceleration over the speed, no more than the bank limit
    would give in a coordinated turn.
    """
    mission = plan.mission
    memory, acceleration, target, rate = _follow(memory, position_ned, velocity_ned, plan)
    speed = max(math.hypot(*velocity_ned), l1.SLOWEST)
    climbing, held = hold_path(
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
    most = GRAVITY * math.tan(mission.bank_limit)
    turning = min(max(acceleration, -most), most) / speed
    return mission.airspeed, (0.0, climbing, turning), memory._replace(hold=held)


def _follow(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: Plan
) -> tuple[LeaderMemory, float, float, float]:
    """The memory after this step's progress; lateral acceleration (m/s²); altitude and its rate."""
    mission = plan.mission
    memory = _pass_waypoint(memory, position, velocity, plan)
    part = plan.parts[memory.part]
    if isinstance(part, Segment):
        acceleration = l1.line_acceleration(
            position,
            velocity,
            part.start,
            part.end,
            period=mission.period,
            damping=mission.damping,
        )
        return memory, acceleration, *_leg_altitude(memory, position, velocity, part, plan)
    acceleration, captured = l1.circle_acceleration(
        position,
        velocity,
        part.centre,
        radius=part.radius,
        clockwise=part.clockwise,
        period=mission.period,
        damping=mission.damping,
    )
    memory = _count_turns(memory, position, part, captured)
    return memory, acceleration, part.levels[memory.level].altitude, 0.0


def _pass_waypoint(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: Plan
) -> LeaderMemory:
    """Go on to the next part when this one's waypoint is reached or its turns are flown."""
    part = plan.parts[memory.part]
    following = memory.part + 1 if memory.part + 1 < len(plan.parts) else plan.repeat_from
    if isinstance(part, LoiterLeg):
        last_level = memory.level == len(part.levels) - 1
        flown = memory.turned >= part.levels[memory.level].turns * 2.0 * math.pi
        if not (flown and last_level) or following == memory.part:
            return memory
    else:
        along, right, length = l1.track_coordinates(position, part.start, part.end)
        if along < length and math.hypot(length - along, right) > _turn_distance(
            velocity, part, plan
        ):
            return memory
    return LeaderMemory(following, memory.hold.altitude, 0, False, 0.0, 0.0, memory.hold)


def _turn_distance(velocity: Sequence[float], segment: Segment, plan: Plan) -> float:
    return l1.turn_distance(
        math.hypot(velocity[0], velocity[1]),
        segment.turn,
        waypoint_radius=plan.mission.waypoint_radius,
        period=plan.mission.period,
        damping=plan.mission.damping,
    )


def _leg_altitude(
    memory: LeaderMemory,
    position: Sequence[float],
    velocity: Sequence[float],
    segment: Segment,
    plan: Plan,
) -> tuple[float, float]:
    """Altitude target (m) and its rate (m/s): linear in the distance flown along the leg.

    The climb ends where the next turn begins, so that a corner is passed at the corner's own
    altitude, and levels off over the last part of the leg.
    """
    along, _, length = l1.track_coordinates(position, segment.start, segment.end)
    distance = max(length - _turn_distance(velocity, segment, plan), 1.0)
    change = segment.end[2] - memory.altitude_from
    steep = abs(change) * (plan.mission.airspeed / distance) ** 2
    part, slope = climbed(along / distance, level_off=min(steep / LEVEL_OFF, 1.0))
    north, east = segment.end[0] - segment.start[0], segment.end[1] - segment.start[1]
    advance = (velocity[0] * north + velocity[1] * east) / max(length, 1e-3)
    return memory.altitude_from + change * part, change * slope * advance / distance


def _count_turns(
    memory: LeaderMemory, position: Sequence[float], leg: LoiterLeg, captured: bool
) -> LeaderMemory:
    """Add the angle flown around the centre since the last call; begin the next level when due."""
    bearing = math.atan2(position[1] - leg.centre[1], position[0] - leg.centre[0])
    if not memory.captured:
        return memory._replace(captured=captured, bearing=bearing)
    side = 1.0 if leg.clockwise else -1.0
    turned = memory.turned + side * math.remainder(bearing - memory.bearing, 2.0 * math.pi)
    level = memory.level
    due = leg.levels[level].turns * 2.0 * math.pi
    if turned >= due and level < len(leg.levels) - 1:
        turned, level = turned - due, level + 1
    return memory._replace(bearing=bearing, turned=turned, level=level)
