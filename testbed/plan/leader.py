"""Build the leader of a scenario: controller, vehicle, initial state and path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from typing import Any, TypeAlias

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, NedOrigin
from testbed.core.saved_state import Replayed
from testbed.core.standard_atmosphere import density_ratio
from testbed.flight.leader_control import MissionController, ScriptedController
from testbed.flight.schedule import Clock
from testbed.flight.vehicles import ScriptedVehicle
from testbed.flight.world import LeaderSetup, SpeedLimits
from testbed.guidance import analytic_paths as paths
from testbed.guidance.flight_plan import (
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    WaypointLeg,
    make_plan,
    polyline,
)
from testbed.guidance.recorded_path import SampledTrajectory, read_recording, sample_recording
from testbed.plan.fleet import PlannedLeader
from testbed.scenario import find_data
from testbed.scenario.aircraft import Circle, Leg, Replay, Start, Virtual
from testbed.scenario.aircraft import Mission as MissionSection
from testbed.vehicle.jsbsim_adapter import trim_aircraft
from testbed.vehicle.trim import (
    STILL,
    InitialState,
    TrimPoint,
    Vector,
    course_through_air,
    error_prefix,
)

Motion: TypeAlias = Callable[[Array], SampledTrajectory]  # of times (T,), s
MAX_CHECKED = 60_000  # times at which the motion of a scripted leader is checked
MAX_DRAWN = 10_000  # points of its path in a view
_BLOCK = 2048  # ticks whose motion is computed at once


def build_leader(
    leader: PlannedLeader,
    clock: Clock,
    origin: NedOrigin,
    *,
    duration_s: float,
    warmer: float,
    wind_ned: Vector,
    wind_speed: float,
) -> LeaderSetup:
    """Build a leader.

    Args:
        leader: the leader's row of the fleet.
        clock: of the run.
        origin: of the local frame.
        duration_s: of the run.
        warmer: how much warmer the air is than the standard atmosphere, K.
        wind_ned: at its start, m/s.
        wind_speed: the largest of the run, m/s.

    Raises:
        InputError, TrimError: its path cannot be flown.
    """
    path = leader.section.path
    if isinstance(path, MissionSection):
        return _mission_leader(leader, path, clock, origin, warmer, wind_ned, wind_speed)
    if isinstance(path, Virtual):
        curve = _curve(leader.section.start, path)
        motion: Motion = partial(paths.evaluate, curve, wind_ned=wind_ned)
    else:
        motion = _recorded_motion(path)
    blocks = Replayed(partial(_blocks, motion, clock, duration_s, origin, warmer))
    vehicle = ScriptedVehicle(blocks, np.array(wind_ned))
    first = motion(np.zeros(1))
    velocity = first.velocity_ned[0]
    start = InitialState(
        position_ned=tuple(first.position_ned[0].tolist()),
        course=math.atan2(velocity[1], velocity[0]),
        airspeed=float(first.airspeed[0]),
    )
    drawn = motion(np.arange(0.0, duration_s + 1e-9, max(1.0, duration_s / MAX_DRAWN)))
    return LeaderSetup(
        controller=ScriptedController(),
        vehicle=vehicle,
        start=start,
        velocity_ned=tuple(velocity.tolist()),
        path_ned=drawn.position_ned,
        motion=_sample_motion(motion, clock, duration_s),
        limits=None,
        limits_in_air=None,
    )


def _mission_leader(
    leader: PlannedLeader,
    path: MissionSection,
    clock: Clock,
    origin: NedOrigin,
    warmer: float,
    wind_ned: Vector,
    wind_speed: float,
) -> LeaderSetup:
    """Build a leader that flies a mission, as an aircraft or as an ideal vehicle."""
    section, airspeed, params = leader.section.start, path.airspeed_mps, leader.params
    start = InitialState(
        position_ned=(section.north_m, section.east_m, -section.altitude_m),
        course=math.radians(section.course_deg),
        airspeed=airspeed,
    )
    mission = GuidanceMission(
        legs=tuple(_leg(leg) for leg in path.legs),
        airspeed=airspeed,
        bank_limit=math.radians(path.bank_limit_deg),
        climb_limit=path.climb_limit_mps,
        waypoint_radius=path.waypoint_radius_m,
        period=params.navl1_period,
        damping=params.navl1_damping,
    )
    try:
        plan = make_plan(mission, (section.north_m, section.east_m, section.altitude_m))
    except InputError as error:
        # the key of a leg, or what is wrong with the path
        joined = "." if str(error).startswith("legs") else ": "
        raise InputError(f"leader.path{joined}{error}") from error
    altitude = origin.elevation_m + section.altitude_m
    battery = leader.section.battery
    charge, cells = battery.state_of_charge, battery.cells or 0
    with error_prefix("leader.path.airspeed_mps"):
        point = TrimPoint(airspeed, 0.0, 0.0, altitude, charge, cells, warmer)
        level = trim_aircraft(leader.folder, point, origin)
    held = section.altitude_m, 0.0, level.placement.pitch, level.controls.throttle
    controller = MissionController(
        plan,
        held,
        dt=clock.control / clock.base_rate_hz,
        gains=leader.guidance.model_dump(),
        ideal=leader.is_ideal,
    )
    # the speed of an ideal vehicle is over the ground, whatever the wind
    wind = STILL if leader.is_ideal else wind_ned
    gamma = math.asin(min(path.climb_limit_mps / airspeed, 1.0))
    # the autopilot of an aircraft may limit the bank further
    bank = (
        mission.bank_limit
        if leader.is_ideal
        else min(mission.bank_limit, math.radians(params.roll_limit_deg))
    )

    def limits(wind_speed: float) -> SpeedLimits:
        slowest = max(airspeed - wind_speed, 1.0)
        turn_rate = GRAVITY * math.tan(bank) / slowest
        return SpeedLimits(slowest, airspeed + wind_speed, turn_rate, gamma)

    with error_prefix("air.wind"):
        through_air = course_through_air(airspeed, start.course, wind)
    velocity = (
        airspeed * math.cos(through_air) + wind[0],
        airspeed * math.sin(through_air) + wind[1],
        wind[2],
    )
    return LeaderSetup(
        controller=controller,
        vehicle=None,
        start=start,
        velocity_ned=velocity,
        path_ned=polyline(plan),
        motion=None,
        limits=limits(0.0 if leader.is_ideal else wind_speed),
        limits_in_air=limits(0.0),
    )


def _recorded_motion(path: Replay) -> Motion:
    """Read the recording of a leader, and return its motion; both refuse with the key."""
    try:
        recording = read_recording(find_data(path.file))
    except InputError as error:
        raise InputError(f"leader.path.file: {error}") from error

    def motion(times: Array) -> SampledTrajectory:
        try:
            return sample_recording(recording, times)
        except InputError as error:
            raise InputError(f"leader.path.file: {error}") from error

    return motion


def _sample_motion(
    motion: Motion, clock: Clock, duration_s: float
) -> tuple[tuple[Array, Array], ...]:
    """Sample velocity and acceleration at the autopilot ticks, or at `MAX_CHECKED` times."""
    count = min(clock.ticks(duration_s) // clock.autopilot, MAX_CHECKED)
    times = np.linspace(0.0, duration_s, count + 1)
    blocks = (motion(times[i : i + _BLOCK]) for i in range(0, len(times), _BLOCK))
    return tuple((block.velocity_ned, block.acceleration_ned) for block in blocks)


def _blocks(
    motion: Motion, clock: Clock, duration_s: float, origin: NedOrigin, warmer: float
) -> Iterator[tuple[SampledTrajectory, Array]]:
    """Yield motion and equivalent airspeed at the ticks of a run, block by block.

    Air is warmer than the standard atmosphere by `warmer`, K.
    """
    ticks = (tick for tick, *_ in clock.schedule(duration_s))
    while block := list(islice(ticks, _BLOCK)):
        track = motion(np.array(block) / clock.base_rate_hz)
        density = density_ratio(origin.elevation_m - track.position_ned[:, 2], warmer)
        yield track, track.airspeed * np.sqrt(density)


def _leg(leg: Leg) -> WaypointLeg | LoiterLeg:
    if leg.kind == "waypoints":
        return WaypointLeg(points=leg.points_m, laps=leg.laps)
    return LoiterLeg(
        centre=leg.centre_m,
        radius=leg.radius_m,
        levels=tuple(LoiterLevel(each.altitude_m, each.turns) for each in leg.levels),
        clockwise=leg.direction == "clockwise",
    )


def _curve(section: Start, path: Virtual) -> paths.Curve:
    curve = path.curve
    begin: Any = {
        "position_ned": (section.north_m, section.east_m, -section.altitude_m),
        "course": math.radians(section.course_deg),
        "speed": path.speed_mps,
    }
    try:
        if curve.kind == "straight":
            return paths.StraightPath(**begin, climb=curve.climb_mps)
        if curve.kind == "circle":
            return paths.CirclePath(
                **begin,
                radius=_circle_radius(curve, path.speed_mps),
                clockwise=curve.direction == "clockwise",
                climb=curve.climb_mps,
            )
        if curve.kind == "figure-eight":
            return paths.FigureEightPath(
                **begin, radius=curve.radius_m, clockwise=curve.direction == "clockwise"
            )
        if curve.kind == "weave":
            return paths.SinusoidalPath(**begin, amplitude=curve.amplitude_m, period=curve.period_s)
        return paths.SpeedChangePath(**begin, amplitude=curve.amplitude_mps, period=curve.period_s)
    except InputError as error:
        raise InputError(f"leader.path.curve.{error}") from error


def _circle_radius(curve: Circle, speed: float) -> float:
    """Return the radius of a circle, m, also of one that is given by its bank."""
    if curve.radius_m is not None:
        return curve.radius_m
    assert curve.bank_deg is not None
    return paths.turn_radius(math.radians(curve.bank_deg), speed, curve.climb_mps)
