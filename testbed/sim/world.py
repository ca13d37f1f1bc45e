"""From the page to a world: every object of a run, checked while it is built."""

from __future__ import annotations

import math
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed import __version__
from testbed.errors import InputError
from testbed.formation.law import PaperLaw
from testbed.guidance import leader as guidance
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Level, LoiterLeg, Mission, WaypointLeg, make_plan, polyline
from testbed.guidance.replay import make_track, read_recording
from testbed.network.channel import Channel
from testbed.scenario import (
    SCHEMA_VERSION,
    Scenario,
    dump,
    find_aircraft,
    find_data,
    find_tune,
)
from testbed.scenario.aircraft import Follower, Leader, Leg
from testbed.scenario.aircraft import Mission as MissionOnPage
from testbed.scenario.sensors import Sensors
from testbed.sim.clock import Clock, make_clock
from testbed.sim.formations import make_law, make_offsets
from testbed.sim.pilots import MissionPilot, Recorded
from testbed.state import Array, Origin, RunInfo
from testbed.vehicle.jsbsim_door import VERSION as JSBSIM_VERSION
from testbed.vehicle.jsbsim_door import JsbsimFleet, Start, trim_aircraft
from testbed.vehicle.params import FbwaParams, read_params, stack
from testbed.vehicle.sensors import Estimators, NoiseLevel, SensorErrors
from testbed.vehicle.tables import FbwaGains
from testbed.vehicle.trim import TrimPoint

LOWEST_START_M = 5.0  # above the ground; an aircraft starts in trimmed flight


@dataclass(frozen=True, slots=True)
class World:
    """What the loop steps."""

    clock: Clock
    duration_s: float
    names: tuple[str, ...]
    fleet: JsbsimFleet  # all aircraft, or the followers alone behind a recorded leader
    gains: FbwaGains  # of the fleet
    estimators: Estimators
    pilot: MissionPilot | Recorded
    channel: Channel
    law: PaperLaw
    offsets: Array  # (n + 1, 3) m, in the leader's frame
    info: RunInfo


def build(page: Scenario) -> World:
    """Build the world of a page.

    Raises:
        ScenarioError, ParamError, AircraftError, TrimError, ValueError: what cannot be built, with
            what to write instead.
    """
    clock = make_clock(**page.rates.model_dump())
    names = page.aircraft_names
    duration = page.scenario.duration_s
    origin = Origin(**page.scenario.origin.model_dump())
    flown: list[Leader | Follower] = [page.leader, *page.fleet]
    folders = [find_aircraft(each.aircraft) for each in flown]
    tunes = [
        read_params(find_tune(folder, each.tune))
        for folder, each in zip(folders, flown, strict=True)
    ]
    pilot, leader_start, path = _leader(page, clock, tunes[0], folders[0], origin)
    starts = [leader_start, *(_start(leader_start, each.start_m) for each in page.fleet)]
    first = 0 if isinstance(pilot, MissionPilot) else 1
    for name, start in zip(names[first:], starts[first:], strict=True):
        if start.position_ned[2] > -LOWEST_START_M:
            raise InputError(
                f"{name} starts {-start.position_ned[2]:g} m above the ground: write a start at "
                f"least {LOWEST_START_M:g} m above it"
            )
    fleet = JsbsimFleet(folders[first:], starts[first:], origin, clock.base_rate_hz)
    law = make_law(page, folders[1:], dt=clock.control / clock.base_rate_hz)
    spans = fleet.wingspan_m if first == 0 else (fleet.wingspan_m[0], *fleet.wingspan_m)
    return World(
        clock=clock,
        duration_s=duration,
        names=names,
        fleet=fleet,
        gains=stack(tunes[first:], clock.autopilot / clock.base_rate_hz),
        estimators=Estimators(
            names,
            [_errors(each.sensors) for each in flown],
            seed=page.scenario.seed,
            dt=clock.stride / clock.base_rate_hz,
        ),
        pilot=pilot,
        channel=Channel(np.full((len(names) - 1, len(names)), page.network.delay_s)),
        law=law,
        offsets=make_offsets(page),
        info=RunInfo(
            scenario_name=page.name,
            scenario_yaml=dump(page),
            names=names,
            aircraft=tuple(folder.name for folder in folders),
            wingspan_m=spans,
            origin=origin,
            base_rate_hz=clock.base_rate_hz,
            frame_rate_hz=page.rates.log_hz,
            duration_s=duration,
            seed=page.scenario.seed,
            speed_bounds_mps=(page.formation.speed_mps,) * len(page.fleet),
            roll_limit_rad=tuple(law.middle.roll_limit.tolist()),
            leader_path_ned=path,
            portions=dict(page.scenario.portions),
            versions={
                "testbed": __version__,
                "schema": str(SCHEMA_VERSION),
                "jsbsim": JSBSIM_VERSION,
                "numpy": np.__version__,
                "python": platform.python_version(),
            },
        ),
    )


def _leader(
    page: Scenario, clock: Clock, tune: FbwaParams, folder: Path, origin: Origin
) -> tuple[MissionPilot | Recorded, Start, Array]:
    """Who flies the leader, where it starts, and its path (k, 3) m as far as it is known."""
    path = page.leader.path
    if not isinstance(path, MissionOnPage):
        times = np.arange(clock.ticks(page.scenario.duration_s) // clock.stride + 1.0)
        recording = read_recording(find_data(path.file))
        track = make_track(recording, times * (clock.stride / clock.base_rate_hz))
        density = _density_ratio(origin.elevation_m - track.position_ned[:, 2])
        recorded = Recorded(track, track.airspeed * np.sqrt(density))
        velocity = track.velocity_ned[0]
        start = Start(
            position_ned=tuple(track.position_ned[0].tolist()),
            course=math.atan2(velocity[1], velocity[0]),
            airspeed=float(track.airspeed[0]),
        )
        return recorded, start, track.position_ned[:: max(1, clock.base_rate_hz // clock.stride)]
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
    level = trim_aircraft(folder, TrimPoint(path.airspeed_mps, 0.0, 0.0, altitude), origin)
    memory = guidance.begin(
        altitude=where.altitude_m, pitch=level.placement.pitch, throttle=level.controls.throttle
    )
    dt = clock.control / clock.base_rate_hz
    return MissionPilot(plan, memory, dt=dt, gains=HoldGains()), start, polyline(plan)


def _leg(leg: Leg) -> WaypointLeg | LoiterLeg:
    if leg.kind == "waypoints":
        return WaypointLeg(points=leg.points_m, laps=leg.laps)
    return LoiterLeg(
        centre=leg.centre_m,
        radius=leg.radius_m,
        levels=tuple(Level(each.altitude_m, each.turns) for each in leg.levels),
        clockwise=leg.direction == "clockwise",
    )


def _start(leader: Start, offset_m: tuple[float, float, float]) -> Start:
    """A follower's start: forward, right, down of the leader's, at its course and airspeed."""
    forward, right, down = offset_m
    cosine, sine = math.cos(leader.course), math.sin(leader.course)
    north, east, depth = leader.position_ned
    return Start(
        position_ned=(
            north + forward * cosine - right * sine,
            east + forward * sine + right * cosine,
            depth + down,
        ),
        course=leader.course,
        airspeed=leader.airspeed,
    )


def _errors(sensors: Sensors) -> SensorErrors:
    return SensorErrors(
        position=NoiseLevel(sensors.position.sigma_m, sensors.position.time_constant_s),
        velocity=NoiseLevel(sensors.velocity.sigma_mps, sensors.velocity.time_constant_s),
        attitude=NoiseLevel(
            math.radians(sensors.attitude.sigma_deg), sensors.attitude.time_constant_s
        ),
    )


def _density_ratio(altitude: Array) -> Array:
    """Air density over its value at sea level, ISA troposphere, (T,) from altitudes in m."""
    return (1.0 - 2.25577e-5 * altitude) ** 4.25588
