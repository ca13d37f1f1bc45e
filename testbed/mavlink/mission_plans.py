"""Convert a scenario's mission to MAVLink mission items, and mission items to flight plans.

ArduPlane's conventions: item 0 is home, DO_JUMP makes laps, a circle with a negative radius is
flown anticlockwise (https://mavlink.io/en/messages/common.html#mav_commands).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.geodetic import geodetic_from_ned, ned_from_geodetic, origin_geodetic
from testbed.core.records import Origin
from testbed.guidance.flight_plan import (
    MAX_SEGMENTS,
    FlightPlan,
    Level,
    LoiterLeg,
    Mission,
    Point,
    WaypointLeg,
    expand_laps,
    with_turn,
)
from testbed.mavlink.vehicle_control import MissionItem, Rejection

# MAV_CMD: NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TURNS, NAV_LOITER_TIME, NAV_LOITER_TO_ALT
WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE = 16, 17, 18, 19, 31
RETURN_TO_LAUNCH, TAKEOFF, DO_JUMP, DO_CHANGE_SPEED = 20, 22, 177, 178
RELATIVE, SEA_LEVEL, NO_FRAME = 6, 5, 2  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, _GLOBAL_INT, _MISSION
FOREVER = -1  # repetitions of a jump
MIN_ALTITUDE_M, MAX_ALTITUDE_M, MAX_DISTANCE_M = 5.0, 20e3, 100e3

_LOITERS = (LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE, RETURN_TO_LAUNCH)
_RELATIVE_FRAMES, _SEA_LEVEL_FRAMES = (3, 6, 10, 11), (0, 5)  # terrain is flat, at home's height
_MAX_LAPS = 1000
_RADIUS_MARGIN = 1.25  # of a circle over the smallest, so that bank is left to steer with
_SETTLING_TURNS = 0.5  # after a change of altitude


def items_from_mission(mission: Mission, origin: Origin) -> tuple[MissionItem, ...]:
    """Convert a scenario's mission to items; a circle of several levels becomes several items."""
    items = [home_item(origin)]
    last = len(mission.legs) - 1
    for number, leg in enumerate(mission.legs):
        if isinstance(leg, WaypointLeg):
            first = len(items)
            items += [_item(WAYPOINT, point, origin) for point in leg.points]
            laps = FOREVER if number == last else leg.laps - 1
            if laps:
                items.append(MissionItem(DO_JUMP, NO_FRAME, (first, laps, 0.0, 0.0), 0.0, 0.0, 0.0))
            continue
        sign = 1.0 if leg.clockwise else -1.0
        for count, level in enumerate(leg.levels):
            endless = number == last and count == len(leg.levels) - 1
            turns = 0.0 if endless else level.turns
            items.append(
                _item(
                    LOITER_UNLIMITED if endless else LOITER_TURNS,
                    (*leg.centre, level.altitude),
                    origin,
                    (turns, 0.0, sign * leg.radius, 0.0),
                )
            )
    return tuple(items)


def home_item(origin: Origin) -> MissionItem:
    """Return item 0."""
    return MissionItem(WAYPOINT, SEA_LEVEL, (0.0, 0.0, 0.0, 0.0), *origin_geodetic(origin))


def items_of_segments(mission: Mission) -> tuple[int, ...]:
    """Return the item of `items_from_mission` of each segment of the mission's plan."""
    numbers: list[int] = []
    item, last = 1, len(mission.legs) - 1
    for number, leg in enumerate(mission.legs):
        if isinstance(leg, LoiterLeg):
            numbers += range(item, item + len(leg.levels))
            item += len(leg.levels)
            continue
        endless = number == last
        numbers += list(range(item, item + len(leg.points))) * (leg.laps + endless)
        item += len(leg.points) + (endless or leg.laps > 1)
    return tuple(numbers)


def _item(
    command: int,
    point: Point,
    origin: Origin,
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> MissionItem:
    north, east, altitude = point
    latitude, longitude, _ = geodetic_from_ned(np.array([north, east, 0.0]), origin).tolist()
    return MissionItem(command, RELATIVE, parameters, latitude, longitude, altitude)


@dataclass(frozen=True, slots=True)
class ItemFlightPlan:
    """A flight plan with the mission item and the airspeed of each of its segments."""

    plan: FlightPlan
    items: tuple[int, ...]
    airspeeds: tuple[float, ...]  # true, m/s

    def segment_of(self, item: int) -> int | None:
        """Return the first segment of an item, or of the next with a position."""
        candidates = [(own, segment) for segment, own in enumerate(self.items) if own >= item]
        return min(candidates)[1] if candidates else None

    def resume(self, first: int, here: Point) -> ItemFlightPlan:
        """Return the plan from a segment on, starting at the current position.

        Args:
            first: the segment.
            here: north, east, altitude above the origin, m.
        """
        segments, again = self.plan.segments, self.plan.repeat_from
        count = len(segments)
        # only the first pass starts here; repetitions of the segment start as in the plan
        order = [*range(first, count), *(range(again, count) if first >= again else ())]
        if segments[first].circle and first == again:
            order = [first]  # an endless circle
        rest = [segments[k] for k in order]
        following = rest[1] if len(rest) > 1 else segments[again]
        rest[0] = with_turn(rest[0]._replace(start=here), following)
        repeat = again - first if first < again else count - first
        return ItemFlightPlan(
            FlightPlan(self.plan.mission, tuple(rest), repeat if len(rest) > 1 else 0),
            tuple(self.items[k] for k in order),
            tuple(self.airspeeds[k] for k in order),
        )


@dataclass(slots=True)
class _ItemLeg:
    """A leg and the items that its points, or its circle, come from."""

    leg: WaypointLeg | LoiterLeg
    items: tuple[int, ...]
    airspeed: float


class _ItemError(Exception):
    """An item that cannot be flown."""

    def __init__(self, item: int, text: str, *, supported: bool = True) -> None:
        super().__init__(text)
        self.rejection = Rejection(f"mission item {item}: {text}", supported, item)


def plan_from_items(
    items: Sequence[MissionItem], start: Point, params: Mission, radius: float, origin: Origin
) -> ItemFlightPlan | Rejection:
    """Plan the flight of mission items from the aircraft's position.

    Args:
        items: home first.
        start: north, east, altitude above the origin, m.
        params: limits, L1 period and damping, and the airspeed until an item changes it.
        radius: of circles whose item has none, m; negative: anticlockwise.
        origin: position and elevation of home.

    Returns:
        The plan, or the reason why an item cannot be flown.
    """
    try:
        legs = _legs(items, start, params, radius, origin)
    except _ItemError as error:
        return error.rejection
    count = sum(len(each.items) * (_laps(each) + 1) for each in legs)
    if count > MAX_SEGMENTS:
        return Rejection(f"mission: {count} legs with all its laps: write {MAX_SEGMENTS} or fewer")
    # the lowest airspeed, as circles are checked against it and have the radii of their own
    slowest = min(each.airspeed for each in legs)
    mission = replace(params, legs=tuple(each.leg for each in legs), airspeed=slowest)
    try:
        plan = expand_laps(mission, start)
    except InputError as error:
        return Rejection(f"mission: {error}")
    plan = plan._replace(mission=replace(mission, airspeed=legs[0].airspeed))
    numbers: list[int] = []
    airspeeds: list[float] = []
    for number, each in enumerate(legs):
        laps = _laps(each)
        endless = number == len(legs) - 1 and isinstance(each.leg, WaypointLeg)
        numbers += each.items * (laps + endless)
        airspeeds += [each.airspeed] * (len(each.items) * (laps + endless))
    return ItemFlightPlan(plan, tuple(numbers), tuple(airspeeds))


def _laps(leg: _ItemLeg) -> int:
    return leg.leg.laps if isinstance(leg.leg, WaypointLeg) else 1


def _legs(
    items: Sequence[MissionItem], start: Point, params: Mission, radius: float, origin: Origin
) -> list[_ItemLeg]:
    legs: list[_ItemLeg] = []
    airspeed = params.airspeed
    here = start
    ended = False
    for number, item in enumerate(items[1:], start=1):
        if ended:
            raise _ItemError(number, "is never reached: the item before it has no end")
        if item.command == DO_CHANGE_SPEED:
            airspeed = _airspeed(number, item, airspeed)
        elif item.command == DO_JUMP:
            ended = _apply_jump(number, item, legs)
        elif item.command in (WAYPOINT, TAKEOFF):
            here = _point(number, item, here, origin)
            legs.append(_ItemLeg(WaypointLeg((here,)), (number,), airspeed))
        elif item.command in _LOITERS:
            leg, ended = _loiter(number, item, here, airspeed, radius, params, origin)
            here = (*leg.centre, leg.levels[-1].altitude)
            legs.append(_ItemLeg(leg, (number,), airspeed))
        else:
            raise _ItemError(number, f"MAV_CMD {item.command} is not supported", supported=False)
    if not legs:
        raise _ItemError(len(items) - 1, "write an item with a position")
    if not ended and isinstance(legs[-1].leg, WaypointLeg):
        # ArduPlane would return to home at the end of a mission; here it circles the last waypoint
        leg = loiter(here, loiter_radius(radius, params, airspeed), params, airspeed)
        legs.append(_ItemLeg(leg, legs[-1].items[-1:], airspeed))
    return legs


def _airspeed(number: int, item: MissionItem, airspeed: float) -> float:
    kind, speed = item.parameters[:2]
    if kind not in (0.0, 1.0) or not math.isfinite(speed):
        raise _ItemError(number, "DO_CHANGE_SPEED: write an airspeed in m/s")
    return speed if speed > 0.0 else airspeed


def _apply_jump(number: int, item: MissionItem, legs: list[_ItemLeg]) -> bool:
    """Turn the waypoints jumped over into laps; return whether they have no end."""
    target, times = item.parameters[:2]
    own = [k for k, leg in enumerate(legs) if leg.items[0] >= target]
    over = [legs[k] for k in own]
    single = all(isinstance(each.leg, WaypointLeg) and each.leg.laps == 1 for each in over)
    if not (over and over[0].items[0] == target and single and over == legs[own[0] :]):
        raise _ItemError(number, "DO_JUMP: write an item before it with only waypoints between")
    if times != FOREVER and not 0 <= times <= _MAX_LAPS:
        raise _ItemError(number, f"DO_JUMP: write -1 or 0 to {_MAX_LAPS} times")
    if len({each.airspeed for each in over}) > 1:
        raise _ItemError(number, "DO_JUMP over a change of speed: write laps of one airspeed")
    points = tuple(point for each in over for point in each.leg.points)  # type: ignore[union-attr]
    numbers = tuple(own for each in over for own in each.items)
    if times == FOREVER and len(points) < 2:
        raise _ItemError(number, "DO_JUMP without end: write two waypoints or more before it")
    laps = 1 if times == FOREVER else int(times) + 1
    legs[own[0] :] = [_ItemLeg(WaypointLeg(points, laps), numbers, over[0].airspeed)]
    return times == FOREVER


def _loiter(
    number: int,
    item: MissionItem,
    here: Point,
    airspeed: float,
    radius: float,
    params: Mission,
    origin: Origin,
) -> tuple[LoiterLeg, bool]:
    """Return the circle of an item, and whether it has no end."""
    if item.command == RETURN_TO_LAUNCH:
        own_radius = loiter_radius(radius, params, airspeed)
        return loiter((0.0, 0.0, here[2]), own_radius, params, airspeed), True
    point = _point(number, item, here, origin)
    own_radius = item.parameters[1 if item.command == LOITER_TO_ALTITUDE else 2]
    if not (math.isfinite(own_radius) and own_radius):
        own_radius = loiter_radius(radius, params, airspeed)
    leg = loiter(point, own_radius, params, airspeed)
    if item.command == LOITER_UNLIMITED:
        return leg, True
    if item.command == LOITER_TO_ALTITUDE:
        climb_s = abs(point[2] - here[2]) / params.climb_limit
        turns = max(1.0, climb_s * airspeed / (2.0 * math.pi * leg.radius) + _SETTLING_TURNS)
    elif item.command == LOITER_TURNS:
        turns = item.parameters[0]
    else:
        turns = item.parameters[0] * airspeed / (2.0 * math.pi * leg.radius)
    if not 0.0 < turns <= _MAX_LAPS:
        raise _ItemError(
            number, f"write more than 0 and at most {_MAX_LAPS} turns, or their time in s"
        )
    return replace(leg, levels=(Level(leg.levels[0].altitude, turns),)), False


def loiter(point: Point, radius: float, params: Mission, airspeed: float) -> LoiterLeg:
    """Return one turn about a point, widened to the smallest circle of the bank limit."""
    return LoiterLeg(
        centre=point[:2],
        radius=max(abs(radius), smallest_radius(params, airspeed)),
        levels=(Level(point[2], 1.0),),
        clockwise=radius >= 0.0,
    )


def smallest_radius(params: Mission, airspeed: float) -> float:
    """Return the radius of a circle at the bank limit, m: V²/(g tan φ)."""
    # slightly wider: rounding must not make the flight plan reject it
    return (1.0 + 1e-9) * airspeed**2 / (GRAVITY * math.tan(params.bank_limit))


def loiter_radius(radius: float, params: Mission, airspeed: float) -> float:
    """Widen a signed radius, m, to leave some bank to steer with."""
    return math.copysign(
        max(abs(radius), _RADIUS_MARGIN * smallest_radius(params, airspeed)), radius
    )


def _point(number: int, item: MissionItem, here: Point, origin: Origin) -> Point:
    """Return north, east, altitude above the origin, m; latitude and longitude 0, 0 mean here."""
    if not all(map(math.isfinite, (item.x, item.y, item.z))):
        raise _ItemError(number, "a position that is not finite")
    north, east = here[:2]
    if item.x or item.y:
        position = np.array([item.x, item.y, 0.0])
        north, east, _ = ned_from_geodetic(position, origin).tolist()
    if item.frame in _RELATIVE_FRAMES:
        altitude = item.z
    elif item.frame in _SEA_LEVEL_FRAMES:
        altitude = item.z - origin.elevation_m
    else:
        raise _ItemError(
            number, f"MAV_FRAME {item.frame}: write altitudes above home (6) or sea level (5)"
        )
    if not MIN_ALTITUDE_M <= altitude <= MAX_ALTITUDE_M:
        raise _ItemError(
            number,
            f"{altitude:g} m above the ground: write {MIN_ALTITUDE_M:g} to {MAX_ALTITUDE_M:g} m",
        )
    if math.hypot(north - here[0], east - here[1]) > MAX_DISTANCE_M:
        raise _ItemError(number, f"is more than {1e-3 * MAX_DISTANCE_M:g} km away")
    return north, east, altitude
