"""Convert a scenario's mission to MAVLink mission items, and mission items to flight plans.

ArduPlane's conventions: item 0 is home, DO_JUMP makes laps, a circle with a negative radius is
flown anticlockwise (https://mavlink.io/en/messages/common.html#mav_commands).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError, Portable
from testbed.core.frames import GRAVITY
from testbed.core.geodetic import geodetic_from_ned, ned_from_geodetic, origin_geodetic
from testbed.core.records import NedOrigin
from testbed.guidance.flight_plan import (
    MAX_SEGMENTS,
    FlightPlan,
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    Point,
    WaypointLeg,
    expand_laps,
    with_turn,
)
from testbed.mavlink.altitude_frames import (
    ABOVE_TERRAIN,
    MISSION_FRAME,
    TERRAIN_NOTE,
    altitude_above_home,
    frame_error,
)
from testbed.mavlink.vehicle_control import MissionItem, Rejection

# MAV_CMD: NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TURNS, NAV_LOITER_TIME, NAV_LOITER_TO_ALT
WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE = 16, 17, 18, 19, 31
RETURN_TO_LAUNCH, LAND, TAKEOFF, DO_JUMP, DO_CHANGE_SPEED = 20, 21, 22, 177, 178
RELATIVE, SEA_LEVEL = 6, 5  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, MAV_FRAME_GLOBAL_INT
# Items that change no flight here: relays and servos (181 to 184), the start of a landing (189),
# regions of interest, cameras and mounts, the fence (207), gripper (211) and gimbal.
_NO_EFFECT = frozenset(
    (181, 182, 183, 184, 189, 195, 197, 201, 202, 203, 205, 206, 207, 211)
    + (530, 531, 1000, 2000, 2001, 2500, 2501)
)
FOREVER = -1  # repetitions of a jump
MIN_ALTITUDE_M, MAX_ALTITUDE_M, MAX_DISTANCE_M = 5.0, 20e3, 100e3

_LOITERS = (LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE, RETURN_TO_LAUNCH)
_MAX_STEPS = 2 * MAX_SEGMENTS  # items until a mission ends or repeats
_MAX_LAPS = 1000
_RADIUS_MARGIN = 1.25  # of a circle over the smallest, so that bank is left to steer with
_SETTLING_TURNS = 0.5  # after a change of altitude


def items_from_mission(mission: GuidanceMission, origin: NedOrigin) -> tuple[MissionItem, ...]:
    """Convert a scenario's mission to items; a circle of several levels becomes several items."""
    items = [home_item(origin)]
    last = len(mission.legs) - 1
    for number, leg in enumerate(mission.legs):
        if isinstance(leg, WaypointLeg):
            first = len(items)
            items += [_item(WAYPOINT, point, origin) for point in leg.points]
            laps = FOREVER if number == last else leg.laps - 1
            if laps:
                items.append(
                    MissionItem(DO_JUMP, MISSION_FRAME, (first, laps, 0.0, 0.0), 0.0, 0.0, 0.0)
                )
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


def home_item(origin: NedOrigin) -> MissionItem:
    """Return item 0."""
    return MissionItem(WAYPOINT, SEA_LEVEL, (0.0, 0.0, 0.0, 0.0), *origin_geodetic(origin))


def items_of_segments(mission: GuidanceMission) -> tuple[int, ...]:
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
    origin: NedOrigin,
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
    notes: tuple[str, ...] = ()  # what is flown otherwise than the items say

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
        if segments[first].circle and first == again == count - 1:
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


class _ItemLeg(NamedTuple):
    """A leg with one point or circle, its item and airspeed."""

    leg: WaypointLeg | LoiterLeg
    item: int
    airspeed: float


class _Course(NamedTuple):
    """Legs in the order of flight."""

    legs: list[_ItemLeg]
    repeat_leg: int | None  # the leg after the last one; None: the mission ends


class _ItemError(Portable):
    """An item that cannot be flown."""

    def __init__(self, item: int, text: str, *, supported: bool = True) -> None:
        super().__init__(text)
        self.rejection = Rejection(f"mission item {item}: {text}", supported, item)


def plan_from_items(
    items: Sequence[MissionItem],
    start: Point,
    params: GuidanceMission,
    radius: float,
    origin: NedOrigin,
    first: int = 1,
) -> ItemFlightPlan | Rejection:
    """Plan the flight of mission items from the aircraft's position.

    Items that are not reached in order, for example behind one without end, are checked too, as
    they can be flown by MISSION_SET_CURRENT.

    Args:
        items: home first.
        start: north, east, altitude above the origin, m.
        params: limits, L1 period and damping, and the airspeed until an item changes it.
        radius: of circles whose item has none, m; negative: anticlockwise.
        origin: position and elevation of home.
        first: the item to begin with.

    Returns:
        The plan, or the reason why an item cannot be flown.
    """
    reader = _ItemReader(items, params, radius, origin)
    try:
        course = reader.course(first, start)
        if not course.legs:
            raise _ItemError(len(items) - 1, "write an item with a position")
        notes = reader.notes(_unreached(reader, start))
    except _ItemError as error:
        return error.rejection
    legs, repeat_leg = course
    last, airspeed = legs[-1], legs[-1].airspeed
    if repeat_leg is None and isinstance(last.leg, WaypointLeg):
        # ArduPlane would return to home at the end of a mission; here it circles the last waypoint
        leg = loiter(_end(last.leg), loiter_radius(radius, params, airspeed), params, airspeed)
        legs.append(_ItemLeg(leg, last.item, airspeed))
    if repeat_leg is None:
        repeat_leg = len(legs) - 1
    # the lowest airspeed, as circles are checked against it and have the radii of their own
    slowest = min(each.airspeed for each in legs)
    mission = replace(params, legs=tuple(each.leg for each in legs), airspeed=slowest)
    try:
        plan = expand_laps(mission, start, repeat_leg)
    except InputError as error:
        return Rejection(f"mission: {error}")
    return ItemFlightPlan(
        plan._replace(mission=replace(mission, airspeed=legs[0].airspeed)),
        tuple(each.item for each in legs),
        tuple(each.airspeed for each in legs),
        notes,
    )


def _unreached(reader: _ItemReader, start: Point) -> list[int]:
    """Check the items that are not reached in order; return those with a leg."""
    reached = set(reader.reached)
    found: set[int] = set()
    for number in range(1, len(reader.items)):
        if number not in reader.reached:
            found |= {each.item for each in reader.course(number, start).legs}
    return sorted(found - reached)


def _end(leg: WaypointLeg | LoiterLeg) -> Point:
    if isinstance(leg, WaypointLeg):
        return leg.points[-1]
    return (*leg.centre, leg.levels[-1].altitude)


class _ItemReader:
    """Execute the items of a mission as an autopilot would, without flying.

    Attributes:
        items: home first.
        reached: numbers of the items that were executed.
    """

    def __init__(
        self,
        items: Sequence[MissionItem],
        params: GuidanceMission,
        radius: float,
        origin: NedOrigin,
    ) -> None:
        self.items, self.reached = items, set[int]()
        self._params, self._radius, self._origin = params, radius, origin
        self._steps = 0
        self._places: dict[tuple[float, float], list[float]] = {}  # NED of latitude and longitude

    def course(self, first: int, here: Point) -> _Course:
        """Execute the items from one on, until they end or repeat.

        Raises:
            _ItemError: an item cannot be flown.
        """
        legs: list[_ItemLeg] = []
        airspeed = self._params.airspeed
        left: dict[int, int] = {}  # jumps that an item still makes
        jumps = 0  # made of those
        arrivals: dict[tuple[int, float, int], int] = {}  # legs at an endless jump, by state
        number = first
        while number < len(self.items):
            self._steps += 1
            if self._steps > _MAX_STEPS or len(legs) > MAX_SEGMENTS:
                text = f"write {MAX_SEGMENTS} or fewer legs, and {_MAX_STEPS} or fewer items"
                raise _ItemError(number, f"too many with all laps: {text}")
            self.reached.add(number)
            item = self.items[number]
            if item.command == DO_JUMP:
                target, times = self._jump(number, item)
                if times == FOREVER:
                    state = number, airspeed, jumps
                    if state in arrivals:
                        _check_loop(number, legs[arrivals[state] :])
                        return _Course(legs, arrivals[state])
                    arrivals[state] = len(legs)
                elif left.setdefault(number, times) == 0:
                    number += 1
                    continue
                else:
                    left[number] -= 1
                    jumps += 1
                number = target
                continue
            ended = False
            if item.command == DO_CHANGE_SPEED:
                airspeed = _airspeed(number, item, airspeed)
            elif item.command not in _NO_EFFECT:
                leg, ended = self._leg(number, item, here, airspeed)
                here = _end(leg)
                legs.append(_ItemLeg(leg, number, airspeed))
            if ended:
                return _Course(legs, len(legs) - 1)
            number += 1
        return _Course(legs, None)

    def notes(self, unreached: Sequence[int]) -> tuple[str, ...]:
        """Return what is flown otherwise than the items say."""
        found = []
        if any(item.frame in ABOVE_TERRAIN for item in self.items[1:]):
            found.append(f"mission: {TERRAIN_NOTE}")
        idle = [n for n, item in enumerate(self.items) if n and item.command in _NO_EFFECT]
        if idle:
            found.append(f"mission: no effect here: {_numbers(idle)}")
        found += [
            f"mission item {n}: does not land, circles there at the altitude before it"
            for n, item in enumerate(self.items)
            if n and item.command == LAND
        ]
        if unreached:
            found.append(f"mission: only reached by MISSION_SET_CURRENT: {_numbers(unreached)}")
        return tuple(found)

    def _jump(self, number: int, item: MissionItem) -> tuple[int, int]:
        """Return the item to jump to, and how often."""
        target, times = item.parameters[:2]
        if not (1.0 <= target < len(self.items) and target == int(target)):
            raise _ItemError(number, f"DO_JUMP to {target:g}: write an item of the mission")
        if times != FOREVER and not (0 <= times <= _MAX_LAPS and times == int(times)):
            raise _ItemError(number, f"DO_JUMP: write -1 or 0 to {_MAX_LAPS} times")
        return int(target), int(times)

    def _leg(
        self, number: int, item: MissionItem, here: Point, airspeed: float
    ) -> tuple[WaypointLeg | LoiterLeg, bool]:
        """Return the leg of an item, and whether it has no end."""
        if item.command in (WAYPOINT, TAKEOFF):
            return WaypointLeg((self._point(number, item, here),)), False
        if item.command == LAND:
            # its altitude is that of the ground
            above = item._replace(frame=RELATIVE, z=here[2])
            point = self._point(number, above, here)
            radius = loiter_radius(self._radius, self._params, airspeed)
            return loiter(point, radius, self._params, airspeed), True
        if item.command in _LOITERS:
            return self._loiter(number, item, here, airspeed)
        raise _ItemError(number, f"MAV_CMD {item.command} is not supported", supported=False)

    def _loiter(
        self, number: int, item: MissionItem, here: Point, airspeed: float
    ) -> tuple[LoiterLeg, bool]:
        """Return the circle of an item, and whether it has no end."""
        radius, params = self._radius, self._params
        if item.command == RETURN_TO_LAUNCH:
            own_radius = loiter_radius(radius, params, airspeed)
            return loiter((0.0, 0.0, here[2]), own_radius, params, airspeed), True
        point = self._point(number, item, here)
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
        return replace(leg, levels=(LoiterLevel(leg.levels[0].altitude, turns),)), False

    def _point(self, number: int, item: MissionItem, here: Point) -> Point:
        """Return north, east, altitude above the origin, m; 0, 0 degrees mean here."""
        if not all(map(math.isfinite, (item.x, item.y, item.z))):
            raise _ItemError(number, "a position that is not finite")
        north, east = here[:2]
        if item.x or item.y:
            if (item.x, item.y) not in self._places:
                position = np.array([item.x, item.y, 0.0])
                self._places[item.x, item.y] = ned_from_geodetic(position, self._origin).tolist()
            north, east, _ = self._places[item.x, item.y]
        altitude = altitude_above_home(item.frame, item.z, self._origin)
        if altitude is None:
            raise _ItemError(number, frame_error(item.frame))
        if not MIN_ALTITUDE_M <= altitude <= MAX_ALTITUDE_M:
            raise _ItemError(
                number,
                f"{altitude:g} m above the ground: "
                f"write {MIN_ALTITUDE_M:g} to {MAX_ALTITUDE_M:g} m",
            )
        if math.hypot(north - here[0], east - here[1]) > MAX_DISTANCE_M:
            raise _ItemError(number, f"is more than {1e-3 * MAX_DISTANCE_M:g} km away")
        return north, east, altitude


def _check_loop(number: int, legs: Sequence[_ItemLeg]) -> None:
    if not legs or (len(legs) == 1 and isinstance(legs[0].leg, WaypointLeg)):
        raise _ItemError(number, "DO_JUMP without end: write two waypoints or more before it")


def _numbers(items: Sequence[int]) -> str:
    """Return "item 3", or "items 3, 4, 5, …"."""
    some = ", ".join(map(str, items[:5])) + (", …" if len(items) > 5 else "")
    return f"item{'s' * (len(items) > 1)} {some}"


def _airspeed(number: int, item: MissionItem, airspeed: float) -> float:
    kind, speed = item.parameters[:2]
    if kind not in (0.0, 1.0) or not math.isfinite(speed):
        raise _ItemError(number, "DO_CHANGE_SPEED: write an airspeed in m/s")
    return speed if speed > 0.0 else airspeed


def loiter(point: Point, radius: float, params: GuidanceMission, airspeed: float) -> LoiterLeg:
    """Return one turn about a point, widened to the smallest circle of the bank limit."""
    return LoiterLeg(
        centre=point[:2],
        radius=max(abs(radius), smallest_radius(params, airspeed)),
        levels=(LoiterLevel(point[2], 1.0),),
        clockwise=radius >= 0.0,
    )


def smallest_radius(params: GuidanceMission, airspeed: float) -> float:
    """Return the radius of a circle at the bank limit, m: V²/(g tan φ)."""
    # slightly wider: rounding must not make the flight plan reject it
    return (1.0 + 1e-9) * airspeed**2 / (GRAVITY * math.tan(params.bank_limit))


def loiter_radius(radius: float, params: GuidanceMission, airspeed: float) -> float:
    """Widen a signed radius, m, to leave some bank to steer with."""
    return math.copysign(
        max(abs(radius), _RADIUS_MARGIN * smallest_radius(params, airspeed)), radius
    )
