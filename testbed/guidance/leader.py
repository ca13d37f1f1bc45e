"""The leader's guidance: one step from what its autopilot believes to its commands.

`step` flies an aircraft by its sticks, `unicycle_step` an ideal vehicle; the way is the same.
`helm` calls them in flight, where numba compiles this source as it stands, with records in place of
a plan's parts, its mission and the gains. So no argument is keyword-only and no tuple is replaced
in part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from testbed.frames import GRAVITY
from testbed.guidance import l1
from testbed.guidance.longitudinal import HoldGains, HoldMemory, hold, hold_path
from testbed.guidance.mission import LEVEL_OFF, Part, Plan, climbed


class LeaderMemory(NamedTuple):
    """Where the leader is in its plan, and what its hold remembers."""

    part: int  # index into the plan's parts
    altitude_from: float  # m, where the altitude reference was when this part began
    captured: bool  # the circle has been met; turns count from then on
    turned: float  # rad around the circle in this part, the right way round
    bearing: float  # rad, of the aircraft seen from the centre
    hold: HoldMemory


def begin(*, altitude: float, pitch: float = 0.0, throttle: float = 0.0) -> LeaderMemory:
    """The memory before the first step, from the trimmed flight the run starts in.

    Altitude in m above the origin, pitch in rad and throttle (0..1) of level trim; an ideal vehicle
    has neither.
    """
    memory = HoldMemory(altitude=altitude, climb=0.0, pitch=pitch, throttle=throttle)
    return LeaderMemory(0, altitude, False, 0.0, 0.0, memory)


def step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    roll: float,
    airspeed: float,
    plan: Plan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, float, float, LeaderMemory]:
    """Pitch (rad), roll (rad), throttle (0..1) commands and the new memory; called every `dt` s.

    Takes the leader's own estimate: m, m/s, rad, true airspeed in m/s.
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
    return pitch, bank, throttle, _holding(memory, held)


def unicycle_step(
    memory: LeaderMemory,
    position_ned: Sequence[float],
    velocity_ned: Sequence[float],
    plan: Plan,
    dt: float,
    gains: HoldGains,
) -> tuple[float, tuple[float, float, float], LeaderMemory]:
    """Speed command u (m/s), turn ω (rad/s) and the new memory; called every `dt` s.

    For an ideal vehicle whose motion over the ground is given, m and m/s. The
    mission's airspeed is commanded as ground speed. ω is resolved in the zero-roll velocity frame:
    (0, γ̇, σ̇ cos γ), the last the lateral acceleration over the speed, no more than the bank limit
    would give in a coordinated turn.
    """
    mission = plan.mission
    memory, acceleration, target, rate = _follow(memory, position_ned, velocity_ned, plan)
    north, east, down = velocity_ned
    speed = max(math.sqrt(north * north + east * east + down * down), l1.SLOWEST)
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
    return mission.airspeed, (0.0, climbing, turning), _holding(memory, held)


def _follow(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: Plan
) -> tuple[LeaderMemory, float, float, float]:
    """The memory after this step's progress; lateral acceleration (m/s²); altitude and its rate."""
    mission = plan.mission
    memory = _pass_waypoint(memory, position, velocity, plan)
    part = plan.parts[memory.part]
    if not part.circle:
        acceleration = l1.line_acceleration(
            position,
            velocity,
            part.start,
            part.end,
            period=mission.period,
            damping=mission.damping,
        )
        altitude, rate = _leg_altitude(memory, position, velocity, part, plan)
        return memory, acceleration, altitude, rate
    acceleration, captured = l1.circle_acceleration(
        position,
        velocity,
        part.end,
        radius=part.radius,
        clockwise=part.clockwise,
        period=mission.period,
        damping=mission.damping,
    )
    memory = _count_turns(memory, position, part, captured)
    return memory, acceleration, plan.parts[memory.part].end[2], 0.0


def _pass_waypoint(
    memory: LeaderMemory, position: Sequence[float], velocity: Sequence[float], plan: Plan
) -> LeaderMemory:
    """Go on to the next part when this one's waypoint is reached or its turns are flown."""
    part = plan.parts[memory.part]
    following = memory.part + 1 if memory.part + 1 < len(plan.parts) else plan.repeat_from
    if part.circle:
        flown = memory.turned >= part.turns * 2.0 * math.pi
        if not flown or part.onward or following == memory.part:
            return memory
    else:
        along, right, length = l1.track_coordinates(position, part.start, part.end)
        if along < length and math.hypot(length - along, right) > _turn_distance(
            velocity, part, plan
        ):
            return memory
    return LeaderMemory(following, memory.hold.altitude, False, 0.0, 0.0, memory.hold)


def _turn_distance(velocity: Sequence[float], line: Part, plan: Plan) -> float:
    return l1.turn_distance(
        math.hypot(velocity[0], velocity[1]),
        line.turn,
        waypoint_radius=plan.mission.waypoint_radius,
        period=plan.mission.period,
        damping=plan.mission.damping,
    )


def _leg_altitude(
    memory: LeaderMemory,
    position: Sequence[float],
    velocity: Sequence[float],
    line: Part,
    plan: Plan,
) -> tuple[float, float]:
    """Altitude target (m) and its rate (m/s): linear in the distance flown along the leg.

    The climb ends where the next turn begins, so that a corner is passed at the corner's own
    altitude, and levels off over the last part of the leg.
    """
    along, _, length = l1.track_coordinates(position, line.start, line.end)
    distance = max(length - _turn_distance(velocity, line, plan), 1.0)
    change = line.end[2] - memory.altitude_from
    steep = abs(change) * (plan.mission.airspeed / distance) ** 2
    part, slope = climbed(along / distance, level_off=min(steep / LEVEL_OFF, 1.0))
    north, east = line.end[0] - line.start[0], line.end[1] - line.start[1]
    advance = (velocity[0] * north + velocity[1] * east) / max(length, 1e-3)
    return memory.altitude_from + change * part, change * slope * advance / distance


def _count_turns(
    memory: LeaderMemory, position: Sequence[float], circle: Part, captured: bool
) -> LeaderMemory:
    """Add the angle flown around the centre since the last call; begin the next level when due."""
    bearing = math.atan2(position[1] - circle.end[1], position[0] - circle.end[0])
    part, begun, turned = memory.part, captured, memory.turned
    if memory.captured:
        begun = True
        change = bearing - memory.bearing  # of two angles within ±π
        if abs(change) > math.pi:
            change -= math.copysign(2.0 * math.pi, change)
        turned += change if circle.clockwise else -change
        due = circle.turns * 2.0 * math.pi
        if turned >= due and circle.onward:
            part, turned = part + 1, turned - due
    return LeaderMemory(part, memory.altitude_from, begun, turned, bearing, memory.hold)


def _holding(memory: LeaderMemory, held: HoldMemory) -> LeaderMemory:
    return LeaderMemory(
        memory.part,
        memory.altitude_from,
        memory.captured,
        memory.turned,
        memory.bearing,
        held,
    )
