"""Where an aircraft goes when nobody holds its sticks: its mission, and circles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from testbed.guidance import leader as guidance
from testbed.guidance.l1 import track_coordinates
from testbed.guidance.longitudinal import HoldGains, HoldMemory
from testbed.guidance.mission import Mission, Plan, Point, unroll
from testbed.links.cockpit import Item, Refusal, Target
from testbed.sim.missions import Flyable, around, easy, flyable
from testbed.sim.pilots import MissionPilot, Sticks
from testbed.state import Origin, VehicleState


@dataclass(frozen=True, slots=True)
class Course:
    """How an aircraft flies what it is told, and from where it begins."""

    row: int  # among the N aircraft
    start: Point  # north, east, altitude above the origin, m
    trim: Sticks  # of the level flight it starts in
    hold: HoldGains
    manner: Mission  # limits and the airspeed; its legs are not flown
    origin: Origin  # home
    dt: float  # s, from one step of guidance to the next


class Navigator:
    """Flies one aircraft's mission, or circles; knows where it was at the last control period."""

    def __init__(self, course: Course, radius: float) -> None:
        """Without a mission.

        Args:
            course: of this aircraft.
            radius: of circles that have none of their own, m; negative: anticlockwise.
        """
        self._course, self.manner, self.radius = course, course.manner, radius
        self.here, self._climb = course.start, 0.0
        self.items: Sequence[Item] = ()
        self._whole: Flyable | None = None  # the mission, and what is left of it
        self._left: Flyable | None = None
        self._mission: MissionPilot | None = None
        self._circle: MissionPilot | None = None
        self._flown: MissionPilot | None = None  # of the two, in this control period
        self._circled: tuple[Point, float | None] = (course.start, None)  # place and own radius
        self._asked: float | None = None  # airspeed that was asked for by hand, m/s

    @property
    def has_mission(self) -> bool:
        """Whether there is one to fly."""
        return self._mission is not None

    @property
    def item(self) -> int:
        """Of the mission, that is flown or will be gone on with."""
        if self._left is None or self._mission is None:
            return 0
        return self._left.items[self._mission.memory.part]

    @property
    def target(self) -> Target | None:
        """Where its mission or circle takes it; None: it has flown neither since it looked."""
        return _target(self._flown, self.here) if self._flown else None

    def look(self, estimate: VehicleState) -> None:
        """Take in where the aircraft is."""
        row = self._course.row
        north, east, down = estimate.position_ned[row].tolist()
        self.here = (north, east, -down)
        self._climb = -float(estimate.velocity_ned[row, 2])
        self._flown = None

    def fly_mission(self, estimate: VehicleState) -> Sticks:
        """A step along the mission; there is one."""
        pilot, left = self._mission, self._left
        assert pilot is not None and left is not None
        self._flown = pilot
        before = left.airspeeds[pilot.memory.part]
        sticks, _ = pilot.command(estimate)
        after = left.airspeeds[pilot.memory.part]
        if after != before:
            self._asked = None
            _fly_at(pilot, after)
        return sticks

    def fly_circle(self, estimate: VehicleState) -> Sticks:
        """A step around the circle; there is one."""
        assert self._circle is not None
        self._flown = self._circle
        return self._circle.command(estimate)[0]

    def take_over(self, mission: Flyable, items: Sequence[Item], pilot: MissionPilot) -> None:
        """Have this mission, which this pilot flies."""
        self._whole = self._left = mission
        self.items, self._mission = items, pilot

    def change_mission(self, items: Sequence[Item], slow: float, fast: float) -> Refusal | None:
        """Have this mission, home as its item 0, from its first item on; or say what is wrong.

        Args:
            items: home first.
            slow: the airspeeds it may ask for, m/s.
            fast: m/s
        """
        found = flyable(items, self.here, self.manner, self.radius, self._course.origin)
        if isinstance(found, Refusal):
            return found
        for item, speed in zip(found.items, found.airspeeds, strict=True):
            if not slow <= speed <= fast:
                return Refusal(f"mission: {speed:g} m/s: write {slow:g} to {fast:g}", item=item)
        self._whole, self.items, self._asked = found, tuple(items), None
        self._begin(found)
        return None

    def clear_mission(self) -> None:
        """Have none."""
        self._whole = self._left = self._mission = None
        self.items = ()

    def go_on_at(self, item: int) -> bool:
        """Fly this item of the mission next, from here; false: it is no place in it."""
        found = self._whole.part_of(item) if self._whole else None
        if self._whole is None or found is None or not 0 <= item < len(self.items):
            return False
        self._begin(self._whole.going_on(found, self.here))
        return True

    def resume(self) -> None:
        """Go on with the mission from here, after something else was flown."""
        if self._left is None or self._mission is None:
            return
        memory = self._mission.memory
        if self._left.plan.parts[memory.part].circle:
            self._mission.memory = memory._replace(hold=self._hold())  # its turns still count
        else:
            self._begin(self._left.going_on(memory.part, self.here))

    def circle(self, place: Point, radius: float | None = None) -> None:
        """Circle a place, at the radius that all circles have or at this one, m."""
        self._circled = place, radius
        speed = self.manner.airspeed
        leg = around(place, radius or easy(self.radius, self.manner, speed), self.manner, speed)
        self._circle = self._pilot(unroll(replace(self.manner, legs=(leg,)), self.here))

    def change_radius(self, radius: float) -> None:
        """The radius of circles that have none of their own, m."""
        self.radius = radius
        self._circle_anew()

    def behave(self, manner: Mission) -> None:
        """Fly in this manner, along the legs and at the airspeed that the mission has."""
        if manner == self.manner:
            return
        self.manner = manner
        if self._mission:
            old = self._mission.plan.mission
            self._mission.change_manner(replace(manner, legs=old.legs, airspeed=old.airspeed))
        self._circle_anew()

    def fly_at(self, airspeed: float) -> None:
        """Fly everything at this true airspeed, m/s, until the mission says otherwise."""
        self._asked = airspeed
        self.manner = replace(self.manner, airspeed=airspeed)
        if self._mission:
            _fly_at(self._mission, airspeed)
        self._circle_anew()

    def _circle_anew(self) -> None:
        """Circle the same place as the manner now allows."""
        if self._circle:
            hold = self._circle.memory.hold
            self.circle(*self._circled)
            self._circle.memory = self._circle.memory._replace(hold=hold)

    def _begin(self, left: Flyable) -> None:
        self._left = left
        self._mission = self._pilot(left.plan)
        _fly_at(self._mission, self._asked or left.airspeeds[0])

    def _pilot(self, plan: Plan) -> MissionPilot:
        course = self._course
        memory = guidance.begin(altitude=self.here[2])._replace(hold=self._hold())
        return MissionPilot(plan, memory, dt=course.dt, gains=course.hold, row=course.row)

    def _hold(self) -> HoldMemory:
        pitch, _, throttle = self._course.trim
        return HoldMemory(self.here[2], self._climb, pitch, throttle)


def _fly_at(pilot: MissionPilot, airspeed: float) -> None:
    pilot.change_manner(replace(pilot.plan.mission, airspeed=airspeed))


def _target(pilot: MissionPilot, here: Point) -> Target:
    memory, airspeed = pilot.memory, pilot.plan.mission.airspeed
    part = pilot.plan.parts[memory.part]
    north, east, altitude = part.end
    if part.circle:
        away = math.hypot(here[0] - north, here[1] - east)
        course = math.atan2(east - here[1], north - here[0])
        return Target(north, east, altitude, airspeed, course, away - part.radius)
    course = math.atan2(east - part.start[1], north - part.start[0])
    _, right, _ = track_coordinates(here, part.start, part.end)
    return Target(north, east, altitude, airspeed, course, -right)
