"""Missions of waypoints and circles, and their expansion to flight plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from testbed.core.compile import jitable
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Array
from testbed.guidance import l1

LEVEL_OFF = 0.6  # m/s², approximate vertical deceleration at the end of a climb
MAX_SEGMENTS = 10_000  # of a mission with all its laps
MAX_GRADIENT = 0.25  # climb per distance along a leg

Point = tuple[float, float, float]  # north m, east m, altitude m above the origin (up)


@dataclass(frozen=True, slots=True)
class WaypointLeg:
    """Waypoints in order, `laps` times; as the last leg of a mission, without end."""

    points: tuple[Point, ...]
    laps: int = 1


@dataclass(frozen=True, slots=True)
class LoiterLevel:
    """Altitude of a circle, m above the origin, and number of turns.

    Turns count from the start of its climb.
    """

    altitude: float
    turns: float


@dataclass(frozen=True, slots=True)
class LoiterLeg:
    """A circle at one level after the other.

    As the last leg, the last level without end.
    """

    centre: tuple[float, float]  # north, east, m
    radius: float  # m
    levels: tuple[LoiterLevel, ...]
    clockwise: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidanceMission:
    """Legs of a mission, with speed, limits and L1 parameters. SI units, radians."""

    legs: tuple[WaypointLeg | LoiterLeg, ...]
    airspeed: float  # true, m/s
    bank_limit: float = math.radians(30.0)
    climb_limit: float = 1.5  # m/s up and down, between the levels of a circle
    waypoint_radius: float = 90.0  # m, largest distance from the waypoint at which a turn begins
    period: float = 15.0  # s, as ArduPlane's NAVL1_PERIOD
    damping: float = 0.75  # as NAVL1_DAMPING


class Segment(NamedTuple):
    """A straight line to a waypoint, or one level of a circle.

    Fields of the other kind are 0.
    """

    circle: bool
    start: Annotated[Point, 3]
    end: Annotated[Point, 3]  # the waypoint; the centre and the altitude of a circle
    turn: float  # rad, course change from this line to the next segment
    radius: float  # m
    clockwise: bool
    turns: float  # of a circle, from the start of the climb to this level
    continues: bool  # the next segment is another level of this circle


class FlightPlan(NamedTuple):
    """A mission with one segment for every lap, waypoint and level; never empty."""

    mission: GuidanceMission
    segments: tuple[Segment, ...]
    repeat_from: int  # the segment after the last one


def line(start: Point, end: Point) -> Segment:
    """Make a line without a turn at its end."""
    return Segment(False, start, end, 0.0, 0.0, False, 0.0, False)


def circle(start: Point, leg: LoiterLeg) -> list[Segment]:
    """Make the segments of a circle; the first one begins at `start`."""
    segments = []
    last = len(leg.levels) - 1
    for number, level in enumerate(leg.levels):
        end = (*leg.centre, level.altitude)
        segments.append(
            Segment(True, start, end, 0.0, leg.radius, leg.clockwise, level.turns, number < last)
        )
        start = end
    return segments


def make_plan(mission: GuidanceMission, start: Point) -> FlightPlan:
    """Expand a mission from `start`, and check that each leg can be flown.

    Raises:
        InputError: a leg cannot be flown; the message names it and what to write.
    """
    plan = expand_laps(mission, start)
    _check_segments(mission, plan.segments)
    return plan


def expand_laps(
    mission: GuidanceMission, start: Point, repeat_leg: int | None = None
) -> FlightPlan:
    """Expand a mission from `start`; legs may be too short or too steep.

    Args:
        mission: its legs, with laps.
        start: north, east, altitude above the origin, m.
        repeat_leg: the leg after the last one; None: the last one.

    Raises:
        InputError: the mission is invalid; the message names the leg and what to write.
    """
    _check_limits(mission)
    count = sum(len(leg.points) * leg.laps for leg in mission.legs if isinstance(leg, WaypointLeg))
    if count > MAX_SEGMENTS:
        raise InputError(f"legs: {count:,} with all laps; write {MAX_SEGMENTS:,} or fewer")
    segments: list[Segment] = []
    here = start
    repeat_from = 0
    first_segments: list[int] = []  # of each leg
    for number, leg in enumerate(mission.legs):
        last = repeat_leg is None and number == len(mission.legs) - 1
        first_segments.append(len(segments))
        if isinstance(leg, LoiterLeg):
            _check_loiter(leg, f"legs[{number}]", mission)
            segments += circle(here, leg)
            here = segments[-1].end
            repeat_from = len(segments) - 1
            continue
        _check_waypoints(leg, f"legs[{number}]", last=last)
        lap_starts = []
        for _ in range(leg.laps + last):  # the extra lap of the last leg repeats
            lap_starts.append(len(segments))
            for point in leg.points:
                segments.append(line(here, point))
                here = point
        repeat_from = lap_starts[-1]
    if repeat_leg is not None:
        repeat_from = first_segments[repeat_leg]
    for index in range(len(segments)):
        following = segments[index + 1 if index + 1 < len(segments) else repeat_from]
        segments[index] = with_turn(segments[index], following)
    return FlightPlan(mission, tuple(segments), repeat_from)


@jitable
def climb_profile(share: float, level_off: float) -> tuple[float, float]:
    """Return the completed share of a leg's climb, and its slope.

    The argument is the share (0..1) of the leg.

    A straight line that levels off over the last `level_off` (0..1) of the leg.
    """
    left = 1.0 - share
    if share <= 0.0 or left <= 0.0 or level_off <= 0.0:
        return min(max(share, 0.0), 1.0), 0.0
    steepness = 1.0 / (1.0 - 0.5 * level_off)
    if left >= level_off:
        return steepness * share, steepness
    return 1.0 - 0.5 * steepness * left * left / level_off, steepness * left / level_off


def polyline(plan: FlightPlan) -> Array:
    """Return the commanded path for drawing, (k, 3) m, NED, without the radii of turns."""
    points: list[tuple[float, float, float]] = []
    for segment in plan.segments:
        if not segment.circle:
            ends = (segment.start, segment.end) if not points else (segment.end,)
            points += [(north, east, -altitude) for north, east, altitude in ends]
            continue
        side = 1.0 if segment.clockwise else -1.0
        for angle in np.linspace(0.0, side * 2.0 * math.pi, 73):
            north = segment.end[0] + segment.radius * math.cos(angle)
            east = segment.end[1] + segment.radius * math.sin(angle)
            points.append((north, east, -segment.end[2]))
    return np.array(points, dtype=np.float64).reshape(-1, 3)


def with_turn(segment: Segment, following: Segment) -> Segment:
    """Set the turn of a line onto the following segment; return a circle unchanged."""
    if segment.circle:
        return segment
    target = following.end
    end = segment.end
    inbound = math.atan2(end[1] - segment.start[1], end[0] - segment.start[0])
    outbound = math.atan2(target[1] - end[1], target[0] - end[0])
    return segment._replace(turn=math.remainder(outbound - inbound, 2.0 * math.pi))


def _check_limits(mission: GuidanceMission) -> None:
    if not mission.legs:
        raise InputError("legs: a mission needs at least one leg, of kind waypoints or loiter")
    for name in ("airspeed", "climb_limit", "waypoint_radius", "period", "damping"):
        if not getattr(mission, name) > 0.0:
            raise InputError(f"{name}: must be positive, not {getattr(mission, name)}")
    if not 0.0 < mission.bank_limit < 0.5 * math.pi:
        bank = math.degrees(mission.bank_limit)
        raise InputError(f"bank_limit: must be between 0 and 90 degrees, not {bank:g}")


def _check_waypoints(leg: WaypointLeg, where: str, *, last: bool) -> None:
    if leg.laps < 1:
        raise InputError(f"{where}.laps: must be 1 or more, not {leg.laps}")
    if not leg.points:
        raise InputError(f"{where}.points_m: needs at least one point [north, east, altitude]")
    if last and len(leg.points) < 2:
        raise InputError(
            f"{where}.points_m: the last leg repeats until the end of the run, so one point is "
            "not enough; add points or end the mission with a leg of kind loiter"
        )


def _check_loiter(leg: LoiterLeg, where: str, mission: GuidanceMission) -> None:
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


def _check_segments(mission: GuidanceMission, segments: Sequence[Segment]) -> None:
    before = 0.0  # m, shortest length of the turn onto the segment
    for segment in segments:
        if segment.circle:
            before = 0.0
            continue
        after = l1.turn_distance(
            mission.airspeed,
            segment.turn,
            waypoint_radius=mission.waypoint_radius,
            period=mission.period,
            damping=mission.damping,
        )
        _, _, length = l1.track_coordinates(segment.start, segment.start, segment.end)
        name = f"from {_text(segment.start)} to {_text(segment.end)}"
        if length <= before + after:
            raise InputError(
                f"the leg {name} is {length:.0f} m long, its turns at {mission.airspeed:g} m/s "
                f"need {before + after:.0f} m; move the points apart or set a smaller "
                "waypoint_radius_m"
            )
        slope = abs(segment.end[2] - segment.start[2]) / (length - after)
        if slope > MAX_GRADIENT:
            raise InputError(
                f"the leg {name} climbs or sinks {100.0 * slope:.0f} %, more than "
                f"{100.0 * MAX_GRADIENT:.0f} %; flatten it or make it longer"
            )
        before = after


def _text(point: Point) -> str:
    return "[" + ", ".join(f"{value:g}" for value in point) + "]"
