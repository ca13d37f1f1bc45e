"""Build the vehicles of a scenario at their initial states."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.atmosphere.mean_wind import MeanWind
from testbed.autopilot.parameters import AutopilotTiming, make_gains
from testbed.compiled.compiled_fleet import make_compiled_fleet
from testbed.core.errors import InputError
from testbed.core.records import (
    Event,
    NedOrigin,
    Records,
)
from testbed.core.speed_model import speed_model_records
from testbed.flight.arduplane_vehicles import ArduPlaneVehicles
from testbed.flight.schedule import Clock
from testbed.flight.vehicles import JsbsimVehicles, UnicycleVehicles, Vehicles
from testbed.flight.world import LeaderSetup
from testbed.plan.air import initial_wind
from testbed.plan.control import own_speed_model
from testbed.plan.fleet import Fleet, FormationPlan, PlannedAircraft
from testbed.scenario import SingleAircraft
from testbed.scenario.aircraft import VirtualAutopilot
from testbed.scenario.checks import LOWEST_START_M
from testbed.scenario.control import Controller
from testbed.scenario.sections import Rates
from testbed.vehicle.fleet import FlightModels
from testbed.vehicle.jsbsim_adapter import airframe_warnings
from testbed.vehicle.trim import InitialState, error_prefix
from testbed.vehicle.unicycle import make_unicycles
from testbed.vehicle.workers import make_fleet


@dataclass(frozen=True, slots=True)
class BuiltVehicles:
    """The vehicles of N aircraft, at their initial states."""

    vehicles: tuple[Vehicles, ...]
    jsbsim: JsbsimVehicles | None  # None: no aircraft has a JSBSim model

    @property
    def fleet(self) -> FlightModels | None:
        """The JSBSim models, if there are any."""
        return None if self.jsbsim is None else self.jsbsim.fleet


def build_starts(
    fleet: FormationPlan, leader: LeaderSetup, mean_wind: MeanWind
) -> list[InitialState]:
    """Return the initial states of all aircraft.

    Raises:
        InputError: an aircraft starts too close to the ground.
    """
    followers = (_follower_start(leader.start, each.section.start_m) for each in fleet.followers)
    return place_in_wind(fleet, (leader.start, *followers), mean_wind)


def build_single_start(
    fleet: Fleet, flight: SingleAircraft, mean_wind: MeanWind
) -> list[InitialState]:
    """Return the initial state of one aircraft, above the origin.

    Raises:
        InputError: it starts too close to the ground.
    """
    start = InitialState(
        position_ned=(0.0, 0.0, -flight.start.altitude_m),
        course=math.radians(flight.start.course_deg),
        airspeed=flight.airspeed_mps,
    )
    return place_in_wind(fleet, (start,), mean_wind)


def place_in_wind(
    fleet: Fleet, still: Iterable[InitialState], mean_wind: MeanWind
) -> list[InitialState]:
    """Return the initial states of all aircraft in the wind at their heights.

    Raises:
        InputError: an aircraft starts too close to the ground.
    """
    starts = [
        replace(start, wind_ned=initial_wind(mean_wind, -start.position_ned[2])) for start in still
    ]
    for each, start in zip(fleet.aircraft, starts, strict=True):
        if not each.is_scripted and start.position_ned[2] > -LOWEST_START_M:
            side = "above" if start.position_ned[2] <= 0.0 else "below"
            raise InputError(
                f"{each.name} starts {abs(start.position_ned[2]):g} m {side} the ground: write a "
                f"start at least {LOWEST_START_M:g} m above it"
            )
    return starts


def build_vehicles(
    fleet: FormationPlan,
    leader: LeaderSetup,
    starts: Sequence[InitialState],
    rates: Rates,
    clock: Clock,
    aircraft: Records,
    *,
    controller: Controller,
    leader_pole: float,
    warmer: float,
    arduplane: Path | None,
    processes: int | None,
    engine: str,
) -> BuiltVehicles:
    """Build the vehicles of all aircraft.

    Args:
        fleet: the N aircraft.
        leader: of the scenario.
        starts: N initial states.
        rates: of the run.
        clock: with these rates.
        aircraft: (N,) of AIRCRAFT, which the vehicles write.
        controller: whose law ideal vehicles fly.
        leader_pole: of the speed of an ideal leader, 1/s.
        warmer: how much warmer the air is than the standard atmosphere, K.
        arduplane: the program for `autopilot: ardupilot`; None: that of the environment.
        processes: that step JSBSim models; None: as many as are fastest.
        engine: of the flight models, see `Header`.

    Raises:
        AircraftError, TrimError, InputError: an aircraft cannot be built.
    """
    vehicles: list[Vehicles] = []
    if leader.vehicle:
        leader.vehicle.bind(aircraft)
        vehicles.append(leader.vehicle)
    jsbsim = None
    if fleet.model_rows:
        jsbsim = build_jsbsim_vehicles(
            fleet,
            starts,
            rates,
            clock,
            aircraft,
            warmer=warmer,
            arduplane=arduplane,
            processes=processes,
            engine=engine,
        )
        vehicles.append(jsbsim)
    if any(each.is_ideal for each in fleet.aircraft):
        vehicles.append(
            _build_unicycles(fleet, controller, leader_pole, starts, leader, clock, aircraft)
        )
    return BuiltVehicles(tuple(vehicles), jsbsim)


def gust_input_warnings(
    fleet: Fleet, models: FlightModels | None, *, steady_air: bool
) -> Iterator[Event]:
    """Warn of aircraft whose model has no input for rotations of the air."""
    if models is None or steady_air:
        return
    rows: dict[str, list[str]] = {}  # names by model
    for row, no_inputs in zip(fleet.model_rows, models.no_gust_inputs, strict=True):
        if no_inputs:
            rows.setdefault(fleet.aircraft[row].folder.name, []).append(fleet.names[row])
    for model, names in rows.items():
        text = (
            "rotations of the air and rolling moments of wakes have no effect on "
            f"{', '.join(names)}: {model} lacks one of the properties air/p-rad_sec, "
            "air/q-rad_sec, air/r-rad_sec and air/roll-coefficient"
        )
        yield Event(0.0, "warning", names[0], text)


def airframe_notes(fleet: Fleet) -> Iterator[Event]:
    """Warn of what is unlikely about an aircraft, or what it lacks."""
    for each in fleet.aircraft:
        if each.has_model:
            for text in airframe_warnings(each.folder):
                yield Event(0.0, "warning", each.name, text)


def engine_notes(models: FlightModels | None) -> Iterator[Event]:
    """Say why JSBSim steps the flight models, where the choice is open."""
    if models is not None and models.engine == "jsbsim" and models.engine_reason:
        yield Event(0.0, "info", "run", models.engine_reason)


def _build_gains(modelled: Sequence[PlannedAircraft], rates: Rates, clock: Clock) -> Records:
    """Return the gains (M,) of the autopilots of aircraft with flight models."""
    dt = clock.autopilot / clock.base_rate_hz
    gains = make_gains([each.params for each in modelled], dt)
    sitl = AutopilotTiming(sitl_physics_hz=rates.physics_hz)
    for k, each in enumerate(modelled):
        autopilot, sensor = each.section.autopilot, each.section.sensors.airspeed
        if isinstance(autopilot, VirtualAutopilot) and autopilot.gyro_filter == "sitl":
            gains[k] = make_gains([each.params], dt, sitl)[0]
        if sensor is not None and sensor.smoothing_s > 0.0:
            # the sensor has ArduPlane's filter of the pressure already
            gains["pressure_weight"][k] = 1.0
    return gains


def _build_models(
    modelled: Sequence[PlannedAircraft],
    starts: Sequence[InitialState],
    origin: NedOrigin,
    clock: Clock,
    warmer: float,
    processes: int | None,
    engine: str,
) -> FlightModels:
    """Build the flight models of M aircraft, in trim."""
    folders = [each.folder for each in modelled]
    starts = [
        replace(
            start,
            state_of_charge=each.section.battery.state_of_charge,
            cells=each.section.battery.cells or 0,
            fuel_burn=each.section.fuel_burn,
            temperature_offset=warmer,
        )
        for each, start in zip(modelled, starts, strict=True)
    ]
    with error_prefix("fleet"):
        rate = clock.base_rate_hz
        compiled, reason = make_compiled_fleet(folders, starts, origin, rate, engine)
        models: FlightModels = compiled or make_fleet(
            folders, starts, origin, rate, processes=processes
        )
        models.engine_reason = reason
        return models


def _build_unicycles(
    fleet: FormationPlan,
    controller: Controller,
    leader_pole: float,
    starts: Sequence[InitialState],
    leader: LeaderSetup,
    clock: Clock,
    aircraft: Records,
) -> UnicycleVehicles:
    """Build unicycles at their starts, with the leader's velocity over the ground."""
    followers = [each for each in fleet.followers if each.is_ideal]
    poles = [each.agent.speed_pole_per_s for each in followers]
    models = [own_speed_model(each, controller) for each in followers]
    rows = [each.row for each in followers]
    if fleet.leader.is_ideal:
        poles, models, rows = [leader_pole, *poles], [None, *models], [0, *rows]
    unicycles = make_unicycles(
        np.array([starts[row].position_ned for row in rows]),
        np.array([leader.velocity_ned for _ in rows]),
        np.array(poles, dtype=np.float64),
        speed_model_records(*models),
    )
    indices = np.array(rows, dtype=np.intp)
    aircraft["wind"]["wind_ned"][indices] = [starts[row].wind_ned for row in rows]
    return UnicycleVehicles(unicycles, clock.base_rate_hz, aircraft, indices)


def _follower_start(leader: InitialState, offset_m: tuple[float, float, float]) -> InitialState:
    """Return the start at an offset forward, right, down of the leader's."""
    forward, right, down = offset_m
    cosine, sine = math.cos(leader.course), math.sin(leader.course)
    north, east, depth = leader.position_ned
    return InitialState(
        position_ned=(
            north + forward * cosine - right * sine,
            east + forward * sine + right * cosine,
            depth + down,
        ),
        course=leader.course,
        airspeed=leader.airspeed,
    )


def _instances(row: int, fixed: Mapping[int, int | None]) -> Sequence[int]:
    """Return the instances that an aircraft may have, the preferred one first."""
    from testbed.ardupilot.ardupilot_sitl import INSTANCES

    own = fixed[row]
    if own is not None:
        return (own,)
    others = set(fixed.values())
    return [each for each in (*INSTANCES[row:], *INSTANCES[:row]) if each not in others]


def build_jsbsim_vehicles(
    fleet: Fleet,
    starts: Sequence[InitialState],
    rates: Rates,
    clock: Clock,
    aircraft: Records,
    *,
    warmer: float,
    arduplane: Path | None = None,
    processes: int | None = 1,
    engine: str = "auto",
) -> JsbsimVehicles:
    """Build the vehicles of the M aircraft with flight models, of which there is one or more.

    See `build_vehicles`.
    """
    modelled, origin = [each for each in fleet.aircraft if each.has_model], fleet.origin
    own_starts = [starts[each.row] for each in modelled]
    models = _build_models(modelled, own_starts, origin, clock, warmer, processes, engine)
    gains = _build_gains(modelled, rates, clock)
    rows = np.array(fleet.model_rows, dtype=np.intp)
    if not any(each.arduplane for each in modelled):
        return JsbsimVehicles(models, gains, aircraft, rows)
    # imported here, as few scenarios need them
    from testbed.ardupilot.ardupilot_sitl import SitlConfig, SitlVehicle

    yaw = models.read().euler[:, 2]
    fixed = {
        each.row: each.arduplane.fixed_instance(each.row) for each in modelled if each.arduplane
    }
    planes = {}
    for k, each in enumerate(modelled):
        autopilot = each.arduplane
        if autopilot is None:
            continue
        config = SitlConfig(
            name=each.name,
            instances=_instances(each.row, fixed),
            start=autopilot.start,
            tune=each.tune_file,
            timeout_s=autopilot.timeout_s,
            heading_deg=math.degrees(float(yaw[k])) % 360.0,
            elevon_mixing=float(models.geometry.mixing[k]),
        )
        planes[k] = SitlVehicle(
            config,
            origin,
            physics_hz=rates.physics_hz,
            autopilot_hz=rates.autopilot_hz,
        )
    return ArduPlaneVehicles(models, gains, aircraft, rows, planes, arduplane)
