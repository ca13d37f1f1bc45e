"""What the leader is to fly, as data: legs of waypoints and circles, unrolled into a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY
from testbed.guidance import l1
from testbed.state import Array

LEVEL_OFF = 0.6  # m/s², about the deceleration with which a climb ends
STEEPEST = 0.25  # climb per distance along a leg

Point = tuple[float, float, float]  # north m, east m, altitude m above the origin (up)


@dataclass(frozen=True, slots=True)
class WaypointLeg:
    """Points flown in order, `laps` times; as the last leg of a mission, for ever."""

    points: tuple[Point, ...]
    laps: int = 1


@dataclass(frozen=True, slots=True)
class Level:
    """An altitude (m above the origin) and how many turns to count from setting out for it."""

    altitude: float
    turns: float


@dataclass(frozen=True, slots=True)
class LoiterLeg:
    """A circle flown at one level after the other; as the last leg, the last level for ever."""

    centre: tuple[float, float]  # north, east, m
    radius: float  # m
    levels: tuple[Level, ...]
    clockwise: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """A mission and how it is flown. SI units, radians."""

    legs: tuple[WaypointLeg | LoiterLeg, ...]
    airspeed: float  # true, m/s
    bank_limit: float = math.radians(30.0)
    climb_limit: float = 1.5  # m/s up and down, between the levels of a circle
    waypoint_radius: float = 90.0  # m, acceptance: a turn begins no farther from its waypoint
    period: float = 15.0  # s, as ArduPlane's NAVL1_PERIOD
    damping: float = 0.75  # as NAVL1_DAMPING


class Part(NamedTuple):
    """A straight line to a waypoint, or one level of a circle.

    What only a line or only a circle has is zero in the other.
    """

    circle: bool
    start: Point
    end: Point  # the waypoint; the centre and the altitude of a circle
    turn: float  # rad, between this line and the next part
    radius: float  # m
    clockwise: bool
    turns: float  # of a circle, from setting out for this level
    onward: bool  # the next part is another level of this circle


class Plan(NamedTuple):
    """A mission unrolled: every lap and level written out, checked, and never empty."""

    mission: Mission
    parts: tuple[Part, ...]
    repeat_from: int  # the part that follows the last one


def line(start: Point, end: Point) -> Part:
    """A line, as if the next went straight on."""
    return Part(False, start, end, 0.0, 0.0, False, 0.0, False)


def circle(start: Point, leg: LoiterLeg) -> list[Part]:
    """The levels of a circle, the first of them flown from `start`."""
    parts = []
    last = len(leg.levels) - 1
    for number, level in enumerate(leg.levels):
        end = (*leg.centre, level.altitude)
        parts.append(
            Part(True, start, end, 0.0, leg.radius, leg.clockwise, level.turns, number < last)
        )
        start = end
    return parts


def make_plan(mission: Mission, start: Point) -> Plan:
    """Unroll a mission flown from `start`, if each of its legs can be flown as it is meant.

    Raises:
        InputError: A mission that cannot be flown; the message names the leg and what to write.
    """
    plan = unroll(mission, start)
    _check_segments(mission, plan.parts)
    return plan


def unroll(mission: Mission, start: Point) -> Plan:
    """The plan of a mission whose legs may be too short or too steep to be met.

    Raises:
        InputError: A mission that makes no sense; the message names the leg and what to write.
    """
    _check_limits(mission)
    parts: list[Part] = []
    here = start
    repeat_from = 0
    for number, leg in enumerate(mission.legs):
        last = number == len(mission.legs) - 1
        if isinstance(leg, LoiterLeg):
            _check_loiter(leg, f"legs[{number}]", mission)
            parts += circle(here, leg)
            here = parts[-1].end
            repeat_from = len(parts) - 1
            continue
        _check_waypoints(leg, f"legs[{number}]", last=last)
        lap_starts = []
        for _ in range(leg.laps + last):  # the last leg's extra lap is the one that repeats
            lap_starts.append(len(parts))
            for point in leg.points:
                parts.append(line(here, point))
                here = point
        repeat_from = lap_starts[-1]
    for index in range(len(parts)):
        following = parts[index + 1] if index + 1 < len(parts) else parts[repeat_from]
        parts[index] = with_turn(parts[index], following)
    return Plan(mission, tuple(parts), repeat_from)


def climbed(part: float, level_off: float) -> tuple[float, float]:
    """How much of a leg's climb is done after this part of it (0..1), and the derivative.

    A straight line, bent to level over the last `level_off` (0..1) of the leg.
    """
    left = 1.0 - part
    if part <= 0.0 or left <= 0.0 or level_off <= 0.0:
        return min(max(part, 0.0), 1.0), 0.0
    steepness = 1.0 / (1.0 - 0.5 * level_off)
    if left >= level_off:
        return steepness * part, steepness
    return 1.0 - 0.5 * steepness * left * left / level_off, steepness * left / level_off


def polyline(plan: Plan) -> Array:
    """The path as commanded, for drawing: (k, 3) m, NED. Corners are sharp; a circle per level."""
    points: list[tuple[float, float, float]] = []
    for part in plan.parts:
        if not part.circle:
            ends = (part.start, part.end) if not points else (part.end,)
            points += [(north, east, -altitude) for north, east, altitude in ends]
            continue
        side = 1.0 if part.clockwise else -1.0
        for angle in np.linspace(0.0, side * 2.0 * math.pi, 73):
            north = part.end[0] + part.radius * math.cos(angle)
            east = part.end[1] + part.radius * math.sin(angle)
            points.append((north, east, -part.end[2]))
    return np.array(points, dtype=np.float64).reshape(-1, 3)


def with_turn(part: Part, following: Part) -> Part:
    """The part with its turn onto the one that follows; a circle as it is."""
    if part.circle:
        return part
    target = following.end
    inbound = math.atan2(part.end[1] - part.start[1], part.end[0] - part.start[0])
    outbound = math.atan2(target[1] - part.end[1], target[0] - part.end[0])
    return part._replace(turn=math.remainder(outbound - inbound, 2.0 * math.pi))


def _check_limits(mission: Mission) -> None:
    if not mission.legs:
        raise InputError("legs: a mission needs at least one leg, of kind waypoints or loiter")
    for name in ("airspeed", "climb_limit", "waypoint_radius", "period", "damping"):
        if not getattr(mission, name) > 0.0:
            raise InputError(f"{name}: must be positive, not {getattr(mission, name)}")
    if not 0.0 < mission.bank_limit < 0.5 * math.pi:
        bank = math.degrees(mission.bank_limit)
        raise InputError(f"bank_limit: must lie between 0 and 90 degrees, not {bank:g}")


def _check_waypoints(leg: WaypointLeg, where: str, *, last: bool) -> None:
    if leg.laps < 1:
        raise InputError(f"{where}.laps: must be 1 or more, not {leg.laps}")
    if not leg.points:
        raise InputError(f"{where}.points_m: needs at least one point [north, east, altitude]")
    if last and len(leg.points) < 2:
        raise InputError(
            f"{where}.points_m: the last leg goes on until the end of the run, so one point is "
            "not enough; add points or end the mission with a leg of kind loiter"
        )


def _check_loiter(leg: LoiterLeg, where: str, mission: Mission) -> None:
    if not leg.levels:
        raise InputError(f"{where}.levels: needs at least one {{altitude_m, turns}}")
    for number, level in enumerate(leg.levels):
        if not level.turns > 0.0:
            raise InputError(f"{where}.levels[{number}].turns: must be positive")
    tightest = mission.airspeed**2 / (GRAVITY * math.tan(mission.bank_limit))
    if leg.radius < tightest:
        raise InputError(
            f"{where}.radius_m: {leg.radius:g} m is tighter than {tightest:.1f} m, the circle at "
            f"{mission.airspeed:g} m/s and {math.degrees(mission.bank_limit):g} deg of bank; "
            "widen the circle or raise bank_limit_deg"
        )


def _check_segments(mission: Mission, parts: Sequence[Part]) -> None:
    before = 0.0  # where the turn onto the segment ends, at the soonest
    for part in parts:
        if part.circle:
            before = 0.0
            continue
        after = l1.turn_distance(
            mission.airspeed,
            part.turn,
            waypoint_radius=mission.waypoint_radius,
            period=mission.period,
            damping=mission.damping,
        )
        _, _, length = l1.track_coordinates(part.start, part.start, part.end)
        name = f"from {_text(part.start)} to {_text(part.end)}"
        if length <= before + after:
            raise InputError(
                f"the leg {name} is {length:.0f} m long, its turns at {mission.airspeed:g} m/s "
                f"need {before + after:.0f} m; move the points apart or set a smaller "
                "waypoint_radius_m"
            )
        slope = abs(part.end[2] - part.start[2]) / (length - after)
        if slope > STEEPEST:
            raise InputError(
                f"the leg {name} climbs or sinks {100.0 * slope:.0f} %, more than "
                f"{100.0 * STEEPEST:.0f} %; flatten it or make it longer"
            )
        before = after


def _text(point: Point) -> str:
    return "[" + ", ".join(f"{value:g}" for value in point) + "]"
