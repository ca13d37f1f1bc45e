"""Build the vehicles of a scenario at their initial states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.atmosphere.mean_wind import MeanWind
from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains, read_params
from testbed.core.errors import InputError
from testbed.core.records import Airframe, Event, Origin, Records
from testbed.core.speed_model import speed_model_records
from testbed.scenario import Scenario, find_aircraft, find_tune
from testbed.scenario.aircraft import VirtualAutopilot
from testbed.scenario.checks import LOWEST_START_M
from testbed.sim.arduplane_vehicles import build_jsbsim_vehicles
from testbed.sim.build_air import initial_wind, temperature_offset
from testbed.sim.build_control import agent_value, own_speed_model
from testbed.sim.build_leader import LeaderSetup
from testbed.sim.schedule import Clock
from testbed.sim.vehicles import JsbsimVehicles, UnicycleVehicles, Vehicles
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import airframe, probe_airframes
from testbed.vehicle.trim import InitialState, error_prefix
from testbed.vehicle.unicycle import make_unicycles
from testbed.vehicle.workers import make_fleet


class AircraftModels(NamedTuple):
    """Folders, autopilot parameters and airframes of N aircraft."""

    folders: tuple[Path, ...]
    param_files: tuple[Path, ...]
    params: tuple[FbwaParams, ...]
    airframes: tuple[Airframe, ...]


@dataclass(frozen=True, slots=True)
class BuiltVehicles:
    """The vehicles of N aircraft, at their initial states."""

    vehicles: tuple[Vehicles, ...]
    jsbsim: JsbsimVehicles | None  # None: no aircraft has a JSBSim model
    jsbsim_rows: tuple[int, ...]  # of these among the N aircraft

    @property
    def fleet(self) -> JsbsimFleet | None:
        """The JSBSim models, if there are any."""
        return None if self.jsbsim is None else self.jsbsim.fleet


def read_models(scenario: Scenario) -> AircraftModels:
    """Read the folders of all aircraft.

    Raises:
        ParamError, AircraftError: a folder contains no valid aircraft or autopilot parameters.
    """
    aircraft = scenario.aircraft
    folders = tuple(find_aircraft(each.aircraft) for each in aircraft)
    probe_airframes(folders)
    files = tuple(find_tune(at, each.tune) for at, each in zip(folders, aircraft, strict=True))
    return AircraftModels(
        folders,
        files,
        tuple(read_params(file) for file in files),
        tuple(airframe(folder) for folder in folders),
    )


def build_origin(scenario: Scenario) -> Origin:
    """Return the origin of the local frame."""
    return Origin(**scenario.scenario.origin.model_dump())


def vehicle_kinds(scenario: Scenario, leader: LeaderSetup) -> list[str]:
    """Return the kind of each vehicle: "jsbsim", "unicycle" or, of a leader, "scripted"."""
    kind = "scripted" if leader.vehicle else scenario.leader.vehicle
    return [kind, *(each.vehicle for each in scenario.fleet)]


def build_starts(
    scenario: Scenario, leader: LeaderSetup, mean_wind: MeanWind, kinds: Sequence[str]
) -> list[InitialState]:
    """Return the initial states of all aircraft.

    Raises:
        InputError: an aircraft starts too close to the ground.
    """
    followers = (_follower_start(leader.start, each.start_m) for each in scenario.fleet)
    starts = [
        replace(start, wind_ned=initial_wind(mean_wind, -start.position_ned[2]))
        for start in (leader.start, *followers)
    ]
    for name, kind, start in zip(scenario.aircraft_names, kinds, starts, strict=True):
        if kind != "scripted" and start.position_ned[2] > -LOWEST_START_M:
            side = "above" if start.position_ned[2] <= 0.0 else "below"
            raise InputError(
                f"{name} starts {abs(start.position_ned[2]):g} m {side} the ground: write a start "
                f"at least {LOWEST_START_M:g} m above it"
            )
    return starts


def build_vehicles(
    scenario: Scenario,
    models: AircraftModels,
    leader: LeaderSetup,
    starts: Sequence[InitialState],
    kinds: Sequence[str],
    clock: Clock,
    aircraft: Records,
    *,
    arduplane: Path | None,
    processes: int | None,
) -> BuiltVehicles:
    """Build the vehicles of all aircraft.

    Args:
        scenario: as resolved.
        models: of N aircraft.
        leader: of the scenario.
        starts: N initial states.
        kinds: N, see `vehicle_kinds`.
        clock: of the run.
        aircraft: (N,) of AIRCRAFT, which the vehicles write.
        arduplane: the program for `autopilot: ardupilot` where the scenario names none.
        processes: that step JSBSim models; None: as many as are fastest.

    Raises:
        AircraftError, TrimError, InputError: an aircraft cannot be built.
    """
    vehicles: list[Vehicles] = []
    if leader.vehicle:
        leader.vehicle.bind(aircraft)
        vehicles.append(leader.vehicle)
    rows = tuple(row for row, kind in enumerate(kinds) if kind == "jsbsim")
    jsbsim = None
    if rows:
        fleet = _build_fleet(scenario, models, starts, rows, clock, processes)
        gains = _build_gains(scenario, models, rows, clock)
        # the sensor has ArduPlane's filter of the pressure already
        sensors = [scenario.aircraft[row].sensors.airspeed for row in rows]
        filtered = [sensor is not None and sensor.smoothing_s > 0.0 for sensor in sensors]
        gains["pressure_weight"][filtered] = 1.0
        jsbsim = build_jsbsim_vehicles(
            scenario, fleet, gains, aircraft, rows, models.param_files, arduplane
        )
        vehicles.append(jsbsim)
    ideal = [row for row, kind in enumerate(kinds) if kind == "unicycle"]
    if ideal:
        vehicles.append(_build_unicycles(scenario, ideal, starts, leader, clock, aircraft))
    return BuiltVehicles(tuple(vehicles), jsbsim, rows)


def gust_input_warnings(
    scenario: Scenario, vehicles: BuiltVehicles, *, steady_air: bool
) -> Iterator[Event]:
    """Warn of aircraft whose model has no input for rotations of the air."""
    if vehicles.fleet is None or steady_air:
        return
    missing = zip(vehicles.jsbsim_rows, vehicles.fleet.no_gust_inputs, strict=True)
    for row, no_inputs in missing:
        if no_inputs:
            text = (
                "rotations of the air and rolling moments of wakes have no effect on it: its model "
                "lacks one of the properties air/p-rad_sec, air/q-rad_sec, air/r-rad_sec and "
                "air/roll-coefficient"
            )
            yield Event(0.0, "warning", scenario.aircraft_names[row], text)


def _build_gains(
    scenario: Scenario, models: AircraftModels, rows: Sequence[int], clock: Clock
) -> Records:
    """Return the gains (M,) of the aircraft in these rows."""
    dt = clock.autopilot / clock.base_rate_hz
    gains = make_gains([models.params[row] for row in rows], dt)
    sitl = AutopilotTiming(sitl_physics_hz=scenario.rates.physics_hz)
    for k, row in enumerate(rows):
        autopilot = scenario.aircraft[row].autopilot
        if isinstance(autopilot, VirtualAutopilot) and autopilot.gyro_filter == "sitl":
            gains[k] = make_gains([models.params[row]], dt, sitl)[0]
    return gains


def _build_fleet(
    scenario: Scenario,
    models: AircraftModels,
    starts: Sequence[InitialState],
    rows: Sequence[int],
    clock: Clock,
    processes: int | None,
) -> JsbsimFleet:
    """Build the JSBSim models of the aircraft in these rows, in trim."""
    batteries = [scenario.aircraft[row].battery for row in rows]
    warmer = temperature_offset(scenario)
    with error_prefix("fleet"):
        return make_fleet(
            [models.folders[row] for row in rows],
            [
                replace(
                    starts[row],
                    state_of_charge=battery.state_of_charge,
                    cells=battery.cells or 0,
                    temperature_offset=warmer,
                )
                for row, battery in zip(rows, batteries, strict=True)
            ],
            build_origin(scenario),
            clock.base_rate_hz,
            processes=processes,
        )


def _build_unicycles(
    scenario: Scenario,
    rows: Sequence[int],
    starts: Sequence[InitialState],
    leader: LeaderSetup,
    clock: Clock,
    aircraft: Records,
) -> UnicycleVehicles:
    """Build unicycles at their starts, with the leader's velocity over the ground."""
    names = scenario.aircraft_names
    poles = [
        agent_value(scenario, names[row], "speed_pole_per_s")
        if row
        else scenario.formation.speed_pole_per_s
        for row in rows
    ]
    unicycles = make_unicycles(
        np.array([starts[row].position_ned for row in rows]),
        np.array([leader.velocity_ned for _ in rows]),
        np.array(poles, dtype=np.float64),
        speed_model_records(
            *(own_speed_model(scenario, names[row]) if row else None for row in rows)
        ),
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
