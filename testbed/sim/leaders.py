"""The page's leader: who flies it, how it moves, where it starts, and its path as far as known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY
from testbed.guidance import analytic, curves
from testbed.guidance import leader as guidance
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Level, LoiterLeg, Mission, WaypointLeg, make_plan, polyline
from testbed.guidance.replay import Track, make_track, read_recording
from testbed.scenario import Scenario, find_data, load_guidance
from testbed.scenario.aircraft import Leg, Virtual
from testbed.scenario.aircraft import Mission as MissionOnPage
from testbed.sim.airs import density_ratio
from testbed.sim.clock import Clock
from testbed.sim.pilots import MissionPilot, NoPilot, Pilot
from testbed.sim.vehicles import Replayed
from testbed.state import Array, Origin
from testbed.vehicle.jsbsim_door import trim_aircraft
from testbed.vehicle.params import FbwaParams
from testbed.vehicle.start import Start
from testbed.vehicle.trim import STILL, TrimPoint, Vector, course_through_air


class SpeedLimits(NamedTuple):
    """How a flown leader may move."""

    speed_min: float  # m/s over the ground
    speed_max: float  # m/s
    turn_rate: float  # rad/s, the largest
    climb_angle: float  # rad, the largest


@dataclass(frozen=True, slots=True)
class Led:
    """A leader, ready to go."""

    pilot: Pilot
    moves: Replayed | None  # the leader itself, if nobody flies it
    start: Start
    velocity_ned: tuple[float, float, float]  # m/s over the ground, at the start
    path_ned: Array  # (k, 3) m, for drawing
    track: Track | None  # how it will move, if that is known
    limits: SpeedLimits | None  # how it may move, if that is all that is known
    limits_in_air: SpeedLimits | None  # the same through the air


def make_leader(
    page: Scenario, clock: Clock, tune: FbwaParams, folder: Path, origin: Origin, wind_ned: Vector
) -> Led:
    """Build the leader of a page."""
    path = page.leader.path
    if isinstance(path, MissionOnPage):
        return _mission(page, path, clock, tune, folder, origin, wind_ned)
    ticks = (tick for tick, *_ in clock.schedule(page.scenario.duration_s))
    times = np.fromiter(ticks, dtype=np.float64) / clock.base_rate_hz
    track = (
        analytic.evaluate(_curve(page, path), times, wind_ned)
        if isinstance(path, Virtual)
        else make_track(read_recording(find_data(path.file)), times)
    )
    density = density_ratio(origin.elevation_m - track.position_ned[:, 2])
    moves = Replayed(track, track.airspeed * np.sqrt(density), np.array(wind_ned))
    velocity = track.velocity_ned[0]
    start = Start(
        position_ned=tuple(track.position_ned[0].tolist()),
        course=math.atan2(velocity[1], velocity[0]),
        airspeed=float(track.airspeed[0]),
    )
    every = max(1, len(times) // max(1, round(page.scenario.duration_s)))
    return Led(
        NoPilot(moves),
        moves,
        start,
        tuple(velocity.tolist()),
        track.position_ned[::every],
        track,
        None,
        None,
    )


def _mission(
    page: Scenario,
    path: MissionOnPage,
    clock: Clock,
    tune: FbwaParams,
    folder: Path,
    origin: Origin,
    wind_ned: Vector,
) -> Led:
    where = page.leader.start
    start = Start(
        position_ned=(where.north_m, where.east_m, -where.altitude_m),
        course=math.radians(where.course_deg),
        airspeed=path.airspeed_mps,
    )
    mission = Mission(
        legs=tuple(_leg(leg) for leg in path.legs),
        airspeed=path.airspeed_mps,
        bank_limit=math.radians(path.bank_limit_deg),
        climb_limit=path.climb_limit_mps,
        waypoint_radius=path.waypoint_radius_m,
        period=tune.navl1_period,
        damping=tune.navl1_damping,
    )
    try:
        plan = make_plan(mission, (where.north_m, where.east_m, where.altitude_m))
    except InputError as error:
        raise InputError(f"leader.path: {error}") from error
    altitude = origin.elevation_m + where.altitude_m
    charge = page.leader.battery.state_of_charge
    point = TrimPoint(path.airspeed_mps, 0.0, 0.0, altitude, charge)
    level = trim_aircraft(folder, point, origin)
    memory = guidance.begin(
        altitude=where.altitude_m, pitch=level.placement.pitch, throttle=level.controls.throttle
    )
    pilot = MissionPilot(
        plan,
        memory,
        dt=clock.control / clock.base_rate_hz,
        gains=HoldGains(**load_guidance(folder).model_dump()),
        ideal=page.leader.vehicle == "ideal",
    )
    ideal = page.leader.vehicle == "ideal"
    # an ideal vehicle's speed is over the ground, whatever the wind
    wind = STILL if ideal else wind_ned
    blown = float(np.linalg.norm(wind))
    angle = math.asin(min(path.climb_limit_mps / path.airspeed_mps, 1.0))

    def limits(blown: float) -> SpeedLimits:
        slowest = max(path.airspeed_mps - blown, 1.0)
        turn_rate = GRAVITY * math.tan(mission.bank_limit) / slowest
        return SpeedLimits(slowest, path.airspeed_mps + blown, turn_rate, angle)

    through_air = course_through_air(path.airspeed_mps, start.course, wind)
    velocity = (
        path.airspeed_mps * math.cos(through_air) + wind[0],
        path.airspeed_mps * math.sin(through_air) + wind[1],
        wind[2],
    )
    return Led(pilot, None, start, velocity, polyline(plan), None, limits(blown), limits(0.0))


def _leg(leg: Leg) -> WaypointLeg | LoiterLeg:
    if leg.kind == "waypoints":
        return WaypointLeg(points=leg.points_m, laps=leg.laps)
    return LoiterLeg(
        centre=leg.centre_m,
        radius=leg.radius_m,
        levels=tuple(Level(each.altitude_m, each.turns) for each in leg.levels),
        clockwise=leg.direction == "clockwise",
    )


def _curve(page: Scenario, path: Virtual) -> curves.Curve:
    where, asked, speed = page.leader.start, path.curve, path.speed_mps
    begin: Any = {
        "position_ned": (where.north_m, where.east_m, -where.altitude_m),
        "course": math.radians(where.course_deg),
        "speed": speed,
    }
    try:
        if asked.kind == "straight":
            return curves.Straight(**begin, climb=asked.climb_mps)
        if asked.kind == "circle":
            return curves.Circle(
                **begin,
                radius=asked.radius_m,
                clockwise=asked.direction == "clockwise",
                climb=asked.climb_mps,
            )
        if asked.kind == "figure-eight":
            return curves.FigureEight(
                **begin, radius=asked.radius_m, clockwise=asked.direction == "clockwise"
            )
        if asked.kind == "weave":
            return curves.Weave(**begin, amplitude=asked.amplitude_m, period=asked.period_s)
        return curves.SpeedChange(**begin, amplitude=asked.amplitude_mps, period=asked.period_s)
    except InputError as error:
        raise InputError(f"leader.path.curve.{error}") from error
