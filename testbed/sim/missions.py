"""Missions as ground stations have them, made ready for guidance; see `mission_items`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY, ned_from_geodetic
from testbed.guidance.mission import (
    Level,
    LoiterLeg,
    Mission,
    Plan,
    Point,
    WaypointLeg,
    unroll,
    with_turn,
)
from testbed.links.cockpit import Item, Refusal
from testbed.sim.mission_items import (
    FOR_EVER,
    HOME,
    JUMP,
    SPEED,
    TAKEOFF,
    TIME,
    TO_ALTITUDE,
    TURNS,
    UNLIMITED,
    WAYPOINT,
)
from testbed.state import Origin

_ABOVE_HOME, _ABOVE_SEA = (3, 6, 10, 11), (0, 5)  # the ground is flat: terrain is home's
LOWEST_M, HIGHEST_M, FARTHEST_M = 5.0, 20e3, 100e3
_MOST_LAPS = 1000
_MOST_PARTS = 10_000
_EASE = 1.25
_SETTLING = 0.5  # turns after a change of altitude


@dataclass(frozen=True, slots=True)
class Flyable:
    """Items as a plan, with the item that each part belongs to and its airspeed."""

    plan: Plan
    items: tuple[int, ...]
    airspeeds: tuple[float, ...]  # true, m/s

    def part_of(self, item: int) -> int | None:
        """The first part of an item, or of the next that has a place."""
        every = [(own, part) for part, own in enumerate(self.items) if own >= item]
        return min(every)[1] if every else None

    def going_on(self, part: int, here: Point) -> Flyable:
        """What is left from a part on, which begins here."""
        parts, again = self.plan.parts, self.plan.repeat_from
        # what has been begun elsewhere is not flown again as it was begun
        order = [*range(part, len(parts)), *(range(again, len(parts)) if part >= again else ())]
        if parts[part].circle and part == again:
            order = [part]  # which never ends
        begun = [parts[k] for k in order]
        following = begun[1] if len(begun) > 1 else parts[again]
        begun[0] = with_turn(begun[0]._replace(start=here), following)
        repeat = again - part if part < again else len(parts) - part
        return Flyable(
            Plan(self.plan.mission, tuple(begun), repeat if len(begun) > 1 else 0),
            tuple(self.items[k] for k in order),
            tuple(self.airspeeds[k] for k in order),
        )


@dataclass(slots=True)
class _Leg:
    """A leg and the items that its points, or its circle, come from."""

    leg: WaypointLeg | LoiterLeg
    items: tuple[int, ...]
    airspeed: float


class _Wrong(Exception):
    """An item that cannot be flown."""

    def __init__(self, item: int, text: str, *, supported: bool = True) -> None:
        super().__init__(text)
        self.refusal = Refusal(f"mission item {item}: {text}", supported, item)


def flyable(
    items: Sequence[Item], start: Point, manner: Mission, radius: float, origin: Origin
) -> Flyable | Refusal:
    """A mission from where the aircraft is.

    Args:
        items: with home as item 0.
        start: north, east, altitude above the origin, m.
        manner: how it is flown: limits, period, damping and the airspeed it begins with.
        radius: of circles whose item has none, m; negative: anticlockwise.
        origin: home's place and elevation.

    Returns:
        The plan, or the item that is to blame.
    """
    try:
        legs = _legs(items, start, manner, radius, origin)
    except _Wrong as wrong:
        return wrong.refusal
    count = sum(len(each.items) * (_laps(each) + 1) for each in legs)
    if count > _MOST_PARTS:
        return Refusal(f"mission: {count} legs with all its laps: write {_MOST_PARTS} or fewer")
    # circles are as wide as their own airspeeds need, which unrolling does not know of
    slowest = min(each.airspeed for each in legs)
    mission = replace(manner, legs=tuple(each.leg for each in legs), airspeed=slowest)
    try:
        plan = unroll(mission, start)
    except InputError as error:
        return Refusal(f"mission: {error}")
    plan = plan._replace(mission=replace(mission, airspeed=legs[0].airspeed))
    numbers: list[int] = []
    speeds: list[float] = []
    for number, each in enumerate(legs):
        laps = _laps(each)
        ever = number == len(legs) - 1 and isinstance(each.leg, WaypointLeg)
        numbers += each.items * (laps + ever)
        speeds += [each.airspeed] * (len(each.items) * (laps + ever))
    return Flyable(plan, tuple(numbers), tuple(speeds))


def _laps(leg: _Leg) -> int:
    return leg.leg.laps if isinstance(leg.leg, WaypointLeg) else 1


def _legs(
    items: Sequence[Item], start: Point, manner: Mission, radius: float, origin: Origin
) -> list[_Leg]:
    legs: list[_Leg] = []
    airspeed = manner.airspeed
    here = start
    ended = False
    for number, item in enumerate(items[1:], start=1):
        if ended:
            raise _Wrong(number, "is never reached: the item before it goes on for ever")
        if item.command == SPEED:
            airspeed = _airspeed(number, item, airspeed)
        elif item.command == JUMP:
            ended = _jump(number, item, legs)
        elif item.command in (WAYPOINT, TAKEOFF):
            here = _point(number, item, here, origin)
            legs.append(_Leg(WaypointLeg((here,)), (number,), airspeed))
        elif item.command in (UNLIMITED, TURNS, TIME, TO_ALTITUDE, HOME):
            leg, ended = _circle(number, item, here, airspeed, radius, manner, origin)
            here = (*leg.centre, leg.levels[-1].altitude)
            legs.append(_Leg(leg, (number,), airspeed))
        else:
            raise _Wrong(number, f"MAV_CMD {item.command} cannot be flown here", supported=False)
    if not legs:
        raise _Wrong(len(items) - 1, "there is nowhere to fly")
    if not ended and isinstance(legs[-1].leg, WaypointLeg):
        # ArduPlane's end of a mission would be to return; here the last place is kept
        wide = easy(radius, manner, airspeed)
        legs.append(_Leg(around(here, wide, manner, airspeed), legs[-1].items[-1:], airspeed))
    return legs


def _airspeed(number: int, item: Item, airspeed: float) -> float:
    kind, speed = item.parameters[:2]
    if kind not in (0.0, 1.0) or not math.isfinite(speed):
        raise _Wrong(number, "DO_CHANGE_SPEED: write an airspeed in m/s")
    return speed if speed > 0.0 else airspeed


def _jump(number: int, item: Item, legs: list[_Leg]) -> bool:
    """Make laps of the waypoints jumped over; true if they are flown for ever."""
    target, times = item.parameters[:2]
    own = [k for k, leg in enumerate(legs) if leg.items[0] >= target]
    over = [legs[k] for k in own]
    plain = all(isinstance(each.leg, WaypointLeg) and each.leg.laps == 1 for each in over)
    if not (over and over[0].items[0] == target and plain and over == legs[own[0] :]):
        raise _Wrong(number, "DO_JUMP: write an item before it with only waypoints between")
    if times != FOR_EVER and not 0 <= times <= _MOST_LAPS:
        raise _Wrong(number, f"DO_JUMP: write -1 or 0 to {_MOST_LAPS} times")
    if len({each.airspeed for each in over}) > 1:
        raise _Wrong(number, "DO_JUMP over a change of speed: write laps of one airspeed")
    points = tuple(point for each in over for point in each.leg.points)  # type: ignore[union-attr]
    numbers = tuple(own for each in over for own in each.items)
    if times == FOR_EVER and len(points) < 2:
        raise _Wrong(number, "DO_JUMP for ever: write two waypoints or more before it")
    laps = 1 if times == FOR_EVER else int(times) + 1
    legs[own[0] :] = [_Leg(WaypointLeg(points, laps), numbers, over[0].airspeed)]
    return times == FOR_EVER


def _circle(
    number: int,
    item: Item,
    here: Point,
    airspeed: float,
    radius: float,
    manner: Mission,
    origin: Origin,
) -> tuple[LoiterLeg, bool]:
    """A circle, and whether it is the last."""
    if item.command == HOME:
        wide = easy(radius, manner, airspeed)
        return around((0.0, 0.0, here[2]), wide, manner, airspeed), True
    point = _point(number, item, here, origin)
    asked = {TURNS: item.parameters[2], UNLIMITED: item.parameters[2], TIME: item.parameters[2]}
    wide = asked.get(item.command, item.parameters[1])
    wide = wide if math.isfinite(wide) and wide else easy(radius, manner, airspeed)
    leg = around(point, wide, manner, airspeed)
    if item.command == UNLIMITED:
        return leg, True
    if item.command == TO_ALTITUDE:
        climb_s = abs(point[2] - here[2]) / manner.climb_limit
        turns = max(1.0, climb_s * airspeed / (2.0 * math.pi * leg.radius) + _SETTLING)
    elif item.command == TURNS:
        turns = item.parameters[0]
    else:
        turns = item.parameters[0] * airspeed / (2.0 * math.pi * leg.radius)
    if not 0.0 < turns <= _MOST_LAPS:
        raise _Wrong(
            number, f"write more than 0 and at most {_MOST_LAPS} turns, or their time in s"
        )
    return replace(leg, levels=(Level(leg.levels[0].altitude, turns),)), False


def around(point: Point, radius: float, manner: Mission, airspeed: float) -> LoiterLeg:
    """A circle about a point, widened to what the bank limit allows."""
    return LoiterLeg(
        centre=point[:2],
        radius=max(abs(radius), tightest(manner, airspeed)),
        levels=(Level(point[2], 1.0),),
        clockwise=radius >= 0.0,
    )


def tightest(manner: Mission, airspeed: float) -> float:
    """Radius, m, of a circle at the bank limit, as `guidance.mission` has it."""
    # a little wider, that rounding does not make it too tight again
    return (1.0 + 1e-9) * airspeed**2 / (GRAVITY * math.tan(manner.bank_limit))


def easy(radius: float, manner: Mission, airspeed: float) -> float:
    """The radius, signed as it was, m; widened so that some bank is left to steer with."""
    return math.copysign(max(abs(radius), _EASE * tightest(manner, airspeed)), radius)


def _point(number: int, item: Item, here: Point, origin: Origin) -> Point:
    """North, east and altitude above the origin, m; a latitude and longitude of zero are here's."""
    if not all(map(math.isfinite, (item.x, item.y, item.z))):
        raise _Wrong(number, "a place that is not a number")
    north, east = here[:2]
    if item.x or item.y:
        place = np.array([item.x, item.y, 0.0])
        north, east, _ = ned_from_geodetic(place, origin).tolist()
    if item.frame in _ABOVE_HOME:
        altitude = item.z
    elif item.frame in _ABOVE_SEA:
        altitude = item.z - origin.elevation_m
    else:
        raise _Wrong(
            number, f"MAV_FRAME {item.frame}: write altitudes above home (6) or sea level (5)"
        )
    if not LOWEST_M <= altitude <= HIGHEST_M:
        raise _Wrong(
            number, f"{altitude:g} m above the ground: write {LOWEST_M:g} to {HIGHEST_M:g} m"
        )
    if math.hypot(north - here[0], east - here[1]) > FARTHEST_M:
        raise _Wrong(number, f"is more than {1e-3 * FARTHEST_M:g} km away")
    return north, east, altitude
