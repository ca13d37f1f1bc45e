"""A page's mission as ground stations have it.

ArduPlane's conventions: item 0 is home, DO_JUMP makes laps, the radius of a circle is negative
where it is flown anticlockwise (https://mavlink.io/en/messages/common.html#mav_commands).
"""

from __future__ import annotations

import numpy as np

from testbed.frames import geodetic_from_ned
from testbed.guidance.mission import LoiterLeg, Mission, Point, WaypointLeg
from testbed.links.cockpit import Item
from testbed.state import Origin

WAYPOINT, UNLIMITED, TURNS, TIME, HOME, TAKEOFF = 16, 17, 18, 19, 20, 22  # MAV_CMD_NAV_
TO_ALTITUDE, JUMP, SPEED = 31, 177, 178
RELATIVE, SEA_LEVEL, NO_PLACE = 6, 5, 2  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, _GLOBAL_INT, _MISSION
FOR_EVER = -1  # times of a jump


def items_of(mission: Mission, origin: Origin) -> tuple[Item, ...]:
    """A page's mission as items, home first; circles of several levels are several items."""
    found = [home(origin)]
    last = len(mission.legs) - 1
    for number, leg in enumerate(mission.legs):
        if isinstance(leg, WaypointLeg):
            first = len(found)
            found += [_place(WAYPOINT, point, origin) for point in leg.points]
            laps = FOR_EVER if number == last else leg.laps - 1
            if laps:
                found.append(Item(JUMP, NO_PLACE, (first, laps, 0.0, 0.0), 0.0, 0.0, 0.0))
            continue
        side = 1.0 if leg.clockwise else -1.0
        for count, level in enumerate(leg.levels):
            ever = number == last and count == len(leg.levels) - 1
            turns = 0.0 if ever else level.turns
            found.append(
                _place(
                    UNLIMITED if ever else TURNS,
                    (*leg.centre, level.altitude),
                    origin,
                    (turns, 0.0, side * leg.radius, 0.0),
                )
            )
    return tuple(found)


def home(origin: Origin) -> Item:
    """Item 0."""
    place = (origin.latitude_deg, origin.longitude_deg, origin.elevation_m)
    return Item(WAYPOINT, SEA_LEVEL, (0.0, 0.0, 0.0, 0.0), *place)


def items_of_parts(mission: Mission) -> tuple[int, ...]:
    """Which item of `items_of` each part of the plan of a page's mission belongs to."""
    numbers: list[int] = []
    item, last = 1, len(mission.legs) - 1
    for number, leg in enumerate(mission.legs):
        if isinstance(leg, LoiterLeg):
            numbers += range(item, item + len(leg.levels))
            item += len(leg.levels)
            continue
        ever = number == last
        numbers += list(range(item, item + len(leg.points))) * (leg.laps + ever)
        item += len(leg.points) + (ever or leg.laps > 1)
    return tuple(numbers)


def _place(
    command: int,
    point: Point,
    origin: Origin,
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> Item:
    north, east, altitude = point
    latitude, longitude, _ = geodetic_from_ned(np.array([north, east, 0.0]), origin).tolist()
    return Item(command, RELATIVE, parameters, latitude, longitude, altitude)
