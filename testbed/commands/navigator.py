"""Guidance of an aircraft that flies a mission or a circle under external command."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from testbed.core.call_list import Call
from testbed.core.records import AIRCRAFT, FbwaCommand, NedOrigin, VehicleState, allocate
from testbed.flight.leader_control import MissionController
from testbed.guidance.flight_plan import FlightPlan, GuidanceMission, Point, expand_laps
from testbed.guidance.l1 import track_coordinates
from testbed.guidance.mission_follower import GUIDANCE_STATE, SEGMENT, Hold, guide
from testbed.mavlink.mission_plans import ItemFlightPlan, loiter, loiter_radius, plan_from_items
from testbed.mavlink.vehicle_control import MissionItem, NavigationTarget, Rejection


@dataclass(frozen=True, slots=True)
class NavigatorConfig:
    """Initial position, trim, gains and limits of one aircraft's guidance."""

    row: int  # among the N aircraft
    start: Point  # north, east, altitude above the origin, m
    trim: FbwaCommand[float]  # of the level flight at the start
    hold: Mapping[str, float]
    flight_params: GuidanceMission  # limits and the first airspeed; its legs are not used
    origin: NedOrigin  # home
    dt: float  # s, period of the guidance


class Navigator:
    """Fly one aircraft's mission, or a circle.

    Attributes:
        position: north, east, altitude above the origin at the last update, m.
        items: of the mission, home first.
        notes: what of the mission is flown otherwise than its items say.
        flight_params: limits and airspeed.
        loiter_radius: of circles that have none of their own, m; negative: anticlockwise.
    """

    def __init__(self, config: NavigatorConfig, loiter_radius: float) -> None:
        self._config = config
        self.flight_params, self.loiter_radius = config.flight_params, loiter_radius
        self.position, self._climb_rate = config.start, 0.0
        self.items: Sequence[MissionItem] = ()
        self.notes: tuple[str, ...] = ()
        self._plan: ItemFlightPlan | None = None  # the whole mission
        self._rest: ItemFlightPlan | None = None  # its remaining segments
        self._mission: MissionController | None = None
        self._circle: MissionController | None = None
        self._active: MissionController | None = None  # of the two, in this control period
        self._centre: tuple[Point, float | None] = (config.start, None)  # with its own radius
        self._airspeed: float | None = None  # set by command, m/s
        # of missions and circles that begin during the flight
        records = (allocate(each, 1) for each in (AIRCRAFT, SEGMENT, GUIDANCE_STATE))
        Call(guide, 0, *records)

    @property
    def has_mission(self) -> bool:
        """Whether there is a mission to fly."""
        return self._mission is not None

    @property
    def current_item(self) -> int:
        """The mission item that is flown, or is resumed with."""
        if self._rest is None or self._mission is None:
            return 0
        return self._rest.items[self._mission.segment]

    @property
    def target(self) -> NavigationTarget | None:
        """The target of the mission or circle; None: neither was flown since the last update."""
        return _target(self._active, self.position) if self._active else None

    def update(self, estimate: VehicleState) -> None:
        """Read the aircraft's position and climb rate from the estimates of N aircraft."""
        row = self._config.row
        north, east, down = estimate.position_ned[row].tolist()
        self.position = (north, east, -down)
        self._climb_rate = -float(estimate.velocity_ned[row, 2])
        self._active = None

    def fly_mission(self, estimate: VehicleState) -> FbwaCommand[float]:
        """Step along the mission, which must exist."""
        controller, rest = self._mission, self._rest
        assert controller is not None and rest is not None
        self._active = controller
        before = rest.airspeeds[controller.segment]
        command = controller.command(estimate)
        after = rest.airspeeds[controller.segment]
        if after != before:
            self._airspeed = None
            _set_airspeed(controller, after)
        return command

    def fly_circle(self, estimate: VehicleState) -> FbwaCommand[float]:
        """Step around the circle, which must exist."""
        assert self._circle is not None
        self._active = self._circle
        return self._circle.command(estimate)

    def take_over(
        self, plan: ItemFlightPlan, items: Sequence[MissionItem], controller: MissionController
    ) -> None:
        """Take the mission that this controller flies."""
        self._plan = self._rest = plan
        self.items, self._mission = items, controller

    def set_mission(
        self, items: Sequence[MissionItem], airspeed_limits: tuple[float, float]
    ) -> Rejection | None:
        """Replace the mission and start at its first item.

        Args:
            items: home first.
            airspeed_limits: lowest and highest that an item may ask for, m/s.
        """
        plan = self._plan_items(items, 1, airspeed_limits)
        if isinstance(plan, Rejection):
            return plan
        self._plan, self.items, self._airspeed = plan, tuple(items), None
        self.notes = plan.notes
        self._start(plan)
        return None

    def _plan_items(
        self, items: Sequence[MissionItem], first: int, airspeed_limits: tuple[float, float]
    ) -> ItemFlightPlan | Rejection:
        """Plan items from one on, from the current position; see `set_mission`."""
        params, origin = self.flight_params, self._config.origin
        plan = plan_from_items(items, self.position, params, self.loiter_radius, origin, first)
        if isinstance(plan, Rejection):
            return plan
        low, high = airspeed_limits
        for item, speed in zip(plan.items, plan.airspeeds, strict=True):
            if not low <= speed <= high:
                return Rejection(f"mission: {speed:g} m/s: write {low:g} to {high:g}", item=item)
        return plan

    def clear_mission(self) -> None:
        """Remove the mission."""
        self._plan = self._rest = self._mission = None
        self.items, self.notes = (), ()

    def set_current_item(self, item: int, airspeed_limits: tuple[float, float]) -> Rejection | None:
        """Fly this item next, from the current position; see `set_mission`."""
        if self._plan is None or not 0 <= item < len(self.items):
            return Rejection(f"mission: there is no item {item}", item=item)
        if item == 0 or item in self._plan.items:
            segment = self._plan.segment_of(item)
            assert segment is not None  # a plan is never empty
            self._start(self._plan.resume(segment, self.position))
            return None
        plan = self._plan_items(self.items, item, airspeed_limits)
        if isinstance(plan, Rejection):
            return plan
        self._start(plan)
        return None

    def resume_mission(self) -> None:
        """Resume the mission from the current position, after another mode."""
        if self._rest is None or self._mission is None:
            return
        segment = self._mission.segment
        if self._rest.plan.segments[segment].circle:
            self._mission.held = self._hold()  # its turns still count
        else:
            self._start(self._rest.resume(segment, self.position))

    def circle(self, centre: Point, radius: float | None = None) -> None:
        """Circle a point at this radius, m; None: `loiter_radius`."""
        self._centre = centre, radius
        params, speed = self.flight_params, self.flight_params.airspeed
        leg = loiter(
            centre, radius or loiter_radius(self.loiter_radius, params, speed), params, speed
        )
        self._circle = self._controller(expand_laps(replace(params, legs=(leg,)), self.position))

    def set_loiter_radius(self, radius: float) -> None:
        """Set the radius of circles that have none of their own, m."""
        self.loiter_radius = radius
        self._update_circle()

    def set_flight_params(self, params: GuidanceMission) -> None:
        """Set limits and airspeed; the mission keeps its legs and its airspeed."""
        if params == self.flight_params:
            return
        self.flight_params = params
        if self._mission:
            old = self._mission.plan.mission
            self._mission.set_flight_params(replace(params, legs=old.legs, airspeed=old.airspeed))
        self._update_circle()

    def set_airspeed(self, airspeed: float) -> None:
        """Fly at this true airspeed, m/s, until a mission item changes it."""
        self._airspeed = airspeed
        self.flight_params = replace(self.flight_params, airspeed=airspeed)
        if self._mission:
            _set_airspeed(self._mission, airspeed)
        self._update_circle()

    def _update_circle(self) -> None:
        """Circle the same point with the current parameters."""
        if self._circle:
            held = self._circle.held
            self.circle(*self._centre)
            self._circle.held = held

    def _start(self, rest: ItemFlightPlan) -> None:
        self._rest = rest
        self._mission = self._controller(rest.plan)
        _set_airspeed(self._mission, self._airspeed or rest.airspeeds[0])

    def _controller(self, plan: FlightPlan) -> MissionController:
        config = self._config
        return MissionController(
            plan, self._hold(), dt=config.dt, gains=config.hold, row=config.row
        )

    def _hold(self) -> Hold:
        trim = self._config.trim
        return self.position[2], self._climb_rate, trim.pitch, trim.throttle


def _set_airspeed(controller: MissionController, airspeed: float) -> None:
    controller.set_flight_params(replace(controller.plan.mission, airspeed=airspeed))


def _target(controller: MissionController, here: Point) -> NavigationTarget:
    airspeed = controller.plan.mission.airspeed
    segment = controller.plan.segments[controller.segment]
    north, east, altitude = segment.end
    if segment.circle:
        distance = math.hypot(here[0] - north, here[1] - east)
        course = math.atan2(east - here[1], north - here[0])
        return NavigationTarget(north, east, altitude, airspeed, course, distance - segment.radius)
    course = math.atan2(east - segment.start[1], north - segment.start[0])
    _, right, _ = track_coordinates(here, segment.start, segment.end)
    return NavigationTarget(north, east, altitude, airspeed, course, -right)
