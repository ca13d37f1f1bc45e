"""Build the world of a scenario: every object of a run, checked before the flight."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed import __version__
from testbed.atmosphere.air import Air
from testbed.core.random import named_stream
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    Array,
    Event,
    Records,
    RunInfo,
    allocate,
    write_fields,
)
from testbed.core.start_time import start_unix_ns
from testbed.network.outages import Outages
from testbed.network.radio import Radio
from testbed.scenario import SCHEMA_VERSION, Scenario, dump
from testbed.sensors.estimators import Estimators
from testbed.sim.arduplane_vehicles import ArduPlaneVehicles
from testbed.sim.build_air import (
    build_air,
    build_mean_wind,
    initial_wind,
    still_field_warnings,
    strongest_wind,
    temperature_warnings,
)
from testbed.sim.build_control import (
    BuiltControl,
    agent_value,
    build_altitudes,
    build_control,
    build_offsets,
)
from testbed.sim.build_faults import build_faults, build_membership, fault_warnings
from testbed.sim.build_leader import LeaderSetup, build_leader
from testbed.sim.build_radio import build_radio, transmit_times
from testbed.sim.build_vehicles import (
    AircraftModels,
    build_origin,
    build_starts,
    build_vehicles,
    gust_input_warnings,
    read_models,
    vehicle_kinds,
)
from testbed.sim.companion import Companions, build_companions
from testbed.sim.control import Control
from testbed.sim.external_control import ExternalControl, build_external_control
from testbed.sim.faults import FaultManager, no_faults
from testbed.sim.leader_control import LeaderController
from testbed.sim.limits import (
    EnvelopeMonitor,
    ProximityMonitor,
    build_envelope_monitor,
    build_proximity,
    separation_warnings,
)
from testbed.sim.preflight import (
    assumption_warnings,
    leader_warnings,
    limit_warnings,
    sensor_warnings,
    sitl_gyro_warnings,
    step_warnings,
    tune_warnings,
)
from testbed.sim.resources import check_memory
from testbed.sim.schedule import Clock, make_clock
from testbed.sim.user_code import with_stored_code
from testbed.sim.vehicles import Vehicles
from testbed.vehicle.environment import describe_integrators
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import VERSION as JSBSIM_VERSION
from testbed.vehicle.trim import STILL, Vector


@dataclass(frozen=True, slots=True)
class World:
    """The records of a run, and the objects that step them."""

    clock: Clock
    duration_s: float
    names: tuple[str, ...]
    aircraft: Records  # (N,) of AIRCRAFT
    followers: Records  # (n,) of FOLLOWER
    links: Records  # (n, N) of LINK
    air: Air | None  # None: it is steady
    gusts: tuple[str, ...]  # names of its discrete gusts
    vehicles: tuple[Vehicles, ...]
    scripted_leader: bool  # it follows a recording or a formula
    external_processes: tuple[ArduPlaneVehicles, ...]
    fleet: JsbsimFleet | None  # the JSBSim models, if there are any
    estimators: Estimators
    faults: FaultManager | None  # None: the scenario has none
    proximity: ProximityMonitor
    envelope: EnvelopeMonitor
    fly_on: bool  # the run continues without lost aircraft
    leader_controller: LeaderController
    external_control: ExternalControl | None  # None: no external commands
    built_control: BuiltControl  # what `control` steps
    control: Control
    companions: Companions | None  # None: controllers have no latency
    radio: Radio
    outages: Outages
    altitudes: Array  # (n,) m, of followers that hold an altitude; NaN for the others
    initial_events: tuple[Event, ...]  # from before the flight
    info: RunInfo


def build(
    scenario: Scenario,
    *,
    commanded: bool = False,
    arduplane: Path | None = None,
    processes: int | None = 1,
) -> World:
    """Build the world of a scenario.

    Args:
        scenario: as resolved.
        commanded: external programs may command the aircraft, also where the scenario does not set
            so.
        arduplane: the program for `autopilot: ardupilot` where the scenario names none; None: that
            of the environment.
        processes: that step JSBSim models; None: as many as are fastest on this machine.

    Raises:
        ScenarioError, ParamError, AircraftError, TrimError, ValueError: something cannot be built;
            the message has what to write instead.
    """
    names = scenario.aircraft_names
    clock = build_clock(scenario)
    check_memory(scenario)
    models = read_models(scenario)
    mean_wind = build_mean_wind(scenario)
    height = scenario.leader.start.altitude_m
    wind = initial_wind(mean_wind, height)
    wind_speed = strongest_wind(scenario, mean_wind, height)
    origin = build_origin(scenario)
    leader = build_leader(
        scenario, clock, models.params[0], models.folders[0], origin, wind, wind_speed
    )
    kinds = vehicle_kinds(scenario, leader)
    starts = build_starts(scenario, leader, mean_wind, kinds)
    aircraft, followers = allocate(AIRCRAFT, len(names)), allocate(FOLLOWER, len(names) - 1)
    write_fields(aircraft["faults"], no_faults(len(names)))
    air = build_air(
        scenario,
        mean_wind,
        names,
        models.airframes,
        dt=clock.autopilot / clock.base_rate_hz,
        sheds=[kind == "jsbsim" for kind in kinds],
    )
    air.bind(aircraft)
    vehicles = build_vehicles(
        scenario,
        models,
        leader,
        starts,
        kinds,
        clock,
        aircraft,
        arduplane=arduplane,
        processes=processes,
    )
    jsbsim, jsbsim_rows = vehicles.jsbsim, vehicles.jsbsim_rows
    control = build_control(scenario, models.folders[1:], clock)
    radio, outages = build_radio(scenario)
    faults = build_faults(scenario, vehicles.fleet, jsbsim_rows)
    external = None
    if commanded or any(each.commanded_by.kind == "external" for each in scenario.aircraft):
        external = build_external_control(
            scenario, clock, leader, starts, models.params, models.folders, jsbsim, jsbsim_rows
        )
    estimators = _build_estimators(scenario, faults)
    companions = build_companions(scenario, clock, aircraft)
    return World(
        clock=clock,
        duration_s=scenario.scenario.duration_s,
        names=names,
        aircraft=aircraft,
        followers=followers,
        links=radio.links,
        air=None if air.steady else air,
        gusts=tuple(gust.name for gust in scenario.air.gusts),
        vehicles=vehicles.vehicles,
        scripted_leader=leader.vehicle is not None,
        external_processes=(jsbsim,) if isinstance(jsbsim, ArduPlaneVehicles) else (),
        fleet=vehicles.fleet,
        estimators=estimators,
        faults=faults,
        proximity=build_proximity(scenario, models.airframes),
        envelope=build_envelope_monitor(
            scenario, models.params, models.airframes, jsbsim_rows, faults
        ),
        fly_on=scenario.limits.on_loss == "continue",
        leader_controller=external if external and external.commands_leader else leader.controller,
        external_control=external,
        built_control=control,
        control=Control(
            control.groups,
            control.controllers,
            control.neighbours,
            build_offsets(scenario),
            build_membership(scenario, faults),
            (aircraft, followers, radio.links),
            companions,
        ),
        companions=companions,
        radio=radio,
        outages=outages,
        altitudes=build_altitudes(scenario),
        initial_events=(
            *(Event(0.0, "info", "run", text) for text in control.messages),
            *gust_input_warnings(scenario, vehicles, steady_air=air.steady),
            *still_field_warnings(scenario),
            *temperature_warnings(scenario, kinds),
            *fault_warnings(scenario),
            *step_warnings(scenario, models, vehicles),
            *limit_warnings(scenario, models.params, kinds),
            *tune_warnings(scenario, models.param_files, models.params, kinds),
            *sitl_gyro_warnings(scenario, models.params, kinds),
            *leader_warnings(scenario, control.config, leader, models.params, kinds, wind),
            *sensor_warnings(scenario),
            *separation_warnings(scenario, models.airframes),
            *assumption_warnings(scenario, control, leader, wind),
        ),
        info=_run_info(
            scenario,
            clock,
            models,
            leader,
            control,
            wind,
            exact=estimators.exact,
            integrators={} if vehicles.fleet is None else describe_integrators(),
        ),
    )


def build_clock(scenario: Scenario) -> Clock:
    """Build the clock of a scenario, with random phases of unsynchronised aircraft."""
    rates = scenario.rates.model_dump()
    synchronous = rates.pop("synchronous")
    names, seed = scenario.aircraft_names, scenario.scenario.seed
    phases = None
    if not synchronous:
        phases = [float(named_stream(seed, f"phase/{name}").random()) for name in names]
    times = transmit_times(scenario)
    return make_clock(**rates, aircraft=len(names), phases=phases, transmit_times=times)


def versions() -> dict[str, str]:
    """Return the versions that determine the numbers of a run beside its scenario."""
    return {
        "testbed": __version__,
        "schema": str(SCHEMA_VERSION),
        "jsbsim": JSBSIM_VERSION,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def _build_estimators(scenario: Scenario, faults: FaultManager | None) -> Estimators:
    return Estimators(
        scenario.aircraft_names,
        [each.sensors for each in scenario.aircraft],
        seed=scenario.scenario.seed,
        rate_hz=scenario.rates.autopilot_hz,
        sensor_faults=faults is not None and faults.affects_sensors,
    )


def _run_info(
    scenario: Scenario,
    clock: Clock,
    models: AircraftModels,
    leader: LeaderSetup,
    control: BuiltControl,
    wind: Vector,
    *,
    exact: bool,
    integrators: Mapping[str, str],
) -> RunInfo:
    """Describe the run for its observers; `exact`: estimates are the truth."""
    stored, code = with_stored_code(scenario)
    followers = scenario.aircraft_names[1:]
    return RunInfo(
        scenario_name=scenario.name,
        scenario_yaml=dump(stored),
        code=code,
        names=scenario.aircraft_names,
        aircraft=tuple(folder.name for folder in models.folders),
        wingspan_m=tuple(each.span for each in models.airframes),
        origin=build_origin(scenario),
        base_rate_hz=clock.base_rate_hz,
        sample_rate_hz=scenario.rates.log_hz,
        duration_s=scenario.scenario.duration_s,
        seed=scenario.scenario.seed,
        speed_bounds_mps=tuple(agent_value(scenario, name, "speed_mps") for name in followers),
        bounded_in_ned=wind if scenario.controller.bounded_speed == "airspeed" else STILL,
        kappa_mps=tuple(agent_value(scenario, name, "kappa_mps") for name in followers),
        roll_limit_rad=tuple(control.config.roll_limit.tolist()),
        barriers=control.barriers,
        barrier_samples=control.barrier_samples,
        estimated=not exact,
        start_unix_ns=start_unix_ns(scenario.log.start_time) if scenario.log.start_time else 0,
        leader_path_ned=leader.path_ned,
        windows=dict(scenario.scenario.windows),
        versions=versions(),
        integrators=integrators,
    )
