"""Build the world of a scenario: every object of a run, checked before the flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from testbed.atmosphere.air import Atmosphere
from testbed.atmosphere.mean_wind import MeanWind
from testbed.core.compile import registered, registering
from testbed.core.reads import unrecorded
from testbed.core.records import (
    AIRCRAFT,
    COMMAND,
    FOLLOWER,
    LINK,
    Array,
    Event,
    Records,
    RunInfo,
    allocate,
    write_fields,
)
from testbed.core.samples import LastSample
from testbed.core.start_time import start_unix_ns
from testbed.flight.arduplane_vehicles import ArduPlaneVehicles
from testbed.flight.control import BuiltControl, Control, LawSurroundings
from testbed.flight.faults import FaultManager, no_faults
from testbed.flight.law_inputs import declared_faults, wind_estimates
from testbed.flight.law_reports import LawReports
from testbed.flight.limits import ProximityMonitor
from testbed.flight.loop import Flight
from testbed.flight.schedule import Clock
from testbed.flight.world import FormationParts, LeaderSetup, World
from testbed.formation.law import FormationConfig
from testbed.plan.air import (
    build_air,
    build_mean_wind,
    initial_wind,
    still_field_warnings,
    strongest_wind,
    temperature_offset,
    temperature_warnings,
)
from testbed.plan.begin import make_begin
from testbed.plan.clock import build_clock, versions_without_jsbsim
from testbed.plan.command_sessions import build_array_commands, build_external_control
from testbed.plan.companions import build_companions
from testbed.plan.control import build_control
from testbed.plan.faults import build_faults, build_membership, fault_warnings
from testbed.plan.fleet import Fleet, FormationPlan
from testbed.plan.leader import build_leader
from testbed.plan.limits import build_envelope_monitor, build_proximity, separation_warnings
from testbed.plan.measured_fleet import resolve, resolve_single
from testbed.plan.radio import build_radio, check_payload, received_weights
from testbed.plan.resources import check_memory
from testbed.plan.user_code import with_stored_code
from testbed.plan.vehicles import (
    airframe_notes,
    build_jsbsim_vehicles,
    build_single_start,
    build_starts,
    build_vehicles,
    engine_notes,
    gust_input_warnings,
)
from testbed.plan.warnings import (
    assumption_warnings,
    leader_warnings,
    limit_warnings,
    sensor_warnings,
    sitl_gyro_warnings,
    step_warnings,
    tune_warnings,
    unusual_warnings,
)
from testbed.scenario import (
    Scenario,
    ScenarioError,
    ScenarioText,
    SingleAircraft,
)
from testbed.scenario.aircraft import External
from testbed.scenario.set_keys import KeyUse, read_all, recorded_reads, unused_keys
from testbed.sensors.estimators import StateEstimators
from testbed.vehicle.environment import describe_integrators
from testbed.vehicle.fleet import LOWEST, FlightModels
from testbed.vehicle.folder_results import unchanging_folders
from testbed.vehicle.jsbsim_adapter import VERSION as JSBSIM_VERSION
from testbed.vehicle.trim import STILL, Vector


class RowRecords(NamedTuple):
    """Records of a flight that belong to its builder.

    Attributes:
        aircraft: (N,) of AIRCRAFT.
        followers: (n,) of FOLLOWER.
        links: (n, N) of LINK.
        commands: (N,) of COMMAND, of a program in this process.
    """

    aircraft: Records
    followers: Records
    links: Records
    commands: Records


Unused = Literal["refuse", "list"]


def build(
    scenario: Scenario,
    *,
    commanded: bool = False,
    in_process: bool = False,
    records: RowRecords | None = None,
    arduplane: Path | None = None,
    processes: int | None = 1,
    companions: External | None = None,
    unused: Unused = "refuse",
) -> World:
    """Build the world of a scenario.

    Args:
        scenario: as resolved.
        commanded: external programs may command the aircraft, also where the scenario does not set
            so.
        in_process: aircraft that external programs command take the commands of this one.
        records: to be used, of zeros; None: new ones.
        arduplane: the program for `autopilot: ardupilot` where the scenario names none; None: that
            of the environment.
        processes: that step JSBSim models; None: as many as are fastest on this machine.
        companions: how companion computers that the run starts command the followers; None: it
            starts none.
        unused: what to do with keys that the user has set and that no part of the flight uses.

    Raises:
        ScenarioError, ParamError, AircraftError, TrimError, ValueError: something cannot be built,
            or a key has no effect; the message has what to write instead.
    """
    with recorded_reads(scenario, (FormationConfig,)) as reads:
        world = _build(scenario, commanded, in_process, records, arduplane, processes, companions)
    found = unused_keys(scenario, scenario.set_keys, reads)
    uncut = scenario.set_keys.uncut
    if found and isinstance(uncut, Scenario):  # they may act with a fault that is left out
        with recorded_reads(uncut, (FormationConfig,)) as whole:
            _build(uncut, commanded, in_process, None, arduplane, processes, companions)
        unread = {each.key.group for each in unused_keys(uncut, uncut.set_keys, whole)}
        found = [each for each in found if each.key.group in unread]
    use = KeyUse()
    use.add(scenario.set_keys, found)
    if use.refused and unused == "refuse":
        raise ScenarioError([each.problem for each in use.refused])
    events = (Event(0.0, "warning", "run", str(each.problem)) for each in use.warned)
    return replace(
        world,
        initial_events=(*world.initial_events, *events),
        unused=tuple(found),
        consumers=reads.found,
    )


@registering()
@unchanging_folders()
def _build(
    scenario: Scenario,
    commanded: bool,
    in_process: bool,
    records: RowRecords | None,
    arduplane: Path | None,
    processes: int | None,
    by_companions: External | None,
) -> World:
    """Build the world of a scenario; see `build`."""
    clock = build_clock(scenario)
    with unrecorded():
        check_memory(scenario)
    fleet = resolve(scenario)
    names, origin, rates = fleet.names, fleet.origin, scenario.rates
    seed, duration_s = scenario.scenario.seed, scenario.scenario.duration_s
    height = scenario.leader.start.altitude_m
    warmer = temperature_offset(scenario.air, origin.elevation_m)
    mean_wind = build_mean_wind(scenario.air.wind, height_m=height, duration_s=duration_s)
    wind = initial_wind(mean_wind, height)
    leader = build_leader(
        fleet.leader,
        clock,
        origin,
        duration_s=duration_s,
        warmer=warmer,
        wind_ned=wind,
        wind_speed=strongest_wind(scenario.air, mean_wind, height, duration_s),
    )
    starts = build_starts(fleet, leader, mean_wind)
    n = len(names)
    if records is None:
        own = allocate(AIRCRAFT, n), allocate(FOLLOWER, n - 1), allocate(LINK, n - 1, n)
        records = RowRecords(*own, allocate(COMMAND, n))
    aircraft, followers, links, commands = records
    write_fields(aircraft["faults"], no_faults(len(names)))
    air = _build_air(scenario, fleet, mean_wind, height, clock, seed)
    if not air.steady:
        air.bind(aircraft)
    vehicles = build_vehicles(
        fleet,
        leader,
        starts,
        rates,
        clock,
        aircraft,
        controller=scenario.controller,
        leader_pole=scenario.formation.speed_pole_per_s if fleet.leader.is_ideal else 0.0,
        warmer=warmer,
        arduplane=arduplane,
        processes=processes,
        engine=scenario.scenario.engine,
    )
    jsbsim, on_failure = vehicles.jsbsim, scenario.formation.on_failure
    control = build_control(fleet, scenario.controller, clock)
    outputs, weights = control.outputs, received_weights(fleet, scenario.network)
    sent = outputs.sent_numbers
    if sent:
        check_payload(names, scenario.network, rates.broadcast_hz)
    radio, outages = build_radio(names, scenario.network, weights, origin, seed, links, sent)
    faults = build_faults(fleet, vehicles.fleet, on_failure)
    external, array = None, None
    for each in fleet.aircraft:
        if each.takes_commands:  # how they come is not known before the flight
            read_all(each.section.commanded_by)
    if in_process:
        array = build_array_commands(fleet, jsbsim, commands)
    elif commanded or any(each.commanded_by.kind == "external" for each in scenario.aircraft):
        external = build_external_control(
            fleet, clock, leader.controller, starts, jsbsim, by_companions
        )
    estimators = _build_estimators(scenario, seed, faults)

    def make_of_seed(other: int) -> tuple[object, ...]:
        other_air = None
        if not air.steady:
            other_air = _build_air(scenario, fleet, mean_wind, height, clock, other)
            other_air.bind(aircraft.copy())
        other_radio, _ = build_radio(names, scenario.network, weights, origin, other, payload=sent)
        return other_air, _build_estimators(scenario, other, faults), other_radio

    companions = build_companions(scenario, fleet, clock, aircraft, jsbsim)
    with unrecorded():
        events = (
            *(Event(0.0, "info", "run", text) for text in control.messages),
            *engine_notes(vehicles.fleet),
            *gust_input_warnings(fleet, vehicles.fleet, steady_air=air.steady),
            *airframe_notes(fleet),
            *still_field_warnings(scenario.air),
            *temperature_warnings(fleet, warmer, height),
            *unusual_warnings(scenario),
            *fault_warnings(fleet, on_failure),
            *step_warnings(fleet, rates, vehicles.fleet),
            *limit_warnings(fleet),
            *tune_warnings(fleet),
            *sitl_gyro_warnings(fleet, rates.physics_hz),
            *leader_warnings(fleet, control.config, leader, duration_s, wind),
            *sensor_warnings(fleet, rates.autopilot_hz),
            *separation_warnings(fleet, scenario.limits),
            *assumption_warnings(scenario, fleet, control, leader, wind),
        )
    return World(
        clock=clock,
        duration_s=duration_s,
        names=names,
        aircraft=aircraft,
        followers=followers,
        links=radio.links,
        parts=FormationParts(
            scripted_leader=leader.vehicle is not None,
            leader_controller=next(
                (each for each in (external, array) if each and each.commands_leader),
                leader.controller,
            ),
            built_control=control,
            control=Control(
                control.groups,
                control.controllers,
                control.neighbours,
                fleet.offsets,
                build_membership(fleet, on_failure, scenario.controller.law, faults),
                (aircraft, followers, radio.links),
                LawSurroundings(
                    wind_estimates(estimators, aircraft),
                    declared_faults(faults),
                    radio.payloads.received,
                    LawReports(names[1:], outputs, radio.payloads.sent),
                ),
                companions,
                extrapolates=control.extrapolates,
            ),
            companions=companions,
            radio=radio,
            outages=outages,
            altitudes=fleet.altitudes,
        ),
        air=None if air.steady else air,
        gusts=tuple(gust.name for gust in scenario.air.gusts),
        vehicles=vehicles.vehicles,
        external_processes=(jsbsim,) if isinstance(jsbsim, ArduPlaneVehicles) else (),
        fleet=vehicles.fleet,
        estimators=estimators,
        faults=faults,
        proximity=build_proximity(fleet, scenario.limits),
        envelope=build_envelope_monitor(fleet, scenario.limits, faults),
        lowest_m=_lowest_heights(fleet, vehicles.fleet),
        fly_on=scenario.limits.on_loss == "continue",
        external_control=external,
        array_commands=array,
        initial_events=events,
        info=_formation_info(
            scenario,
            fleet,
            clock,
            leader,
            control,
            wind,
            exact=estimators.exact,
            models=vehicles.fleet,
        ),
        entries=registered(),
        make_of_seed=make_of_seed if rates.synchronous else None,
        begin=make_begin(scenario, vehicles.fleet, _build_prior),
        is_random=air.is_random or radio.is_random or not (estimators.exact and rates.synchronous),
    )


def _build_prior(scenario: Scenario, *, blank: bool) -> Flight:
    """Return the flight of a scenario before its first tick.

    Args:
        scenario: that is flown.
        blank: as at 0 s, also where it begins as another one.
    """
    world = build(scenario, in_process=True)
    flight = Flight(replace(world, begin=None) if blank else world, [LastSample()])
    flight.prepare()
    return flight


@registering()
@unchanging_folders()
def build_single(flight: SingleAircraft) -> World:
    """Build the world of one aircraft that a program commands: no leader, law, slot or radio.

    Raises:
        ScenarioError, ParamError, AircraftError, TrimError, ValueError: see `build`.
    """
    clock = build_clock(flight)
    check_memory(flight)
    fleet = resolve_single(flight)
    duration_s, height = flight.scenario.duration_s, flight.start.altitude_m
    warmer = temperature_offset(flight.air, fleet.origin.elevation_m)
    mean_wind = build_mean_wind(flight.air.wind, height_m=height, duration_s=duration_s)
    starts = build_single_start(fleet, flight, mean_wind)
    aircraft = allocate(AIRCRAFT, 1)
    write_fields(aircraft["faults"], no_faults(1))
    air = _build_air(flight, fleet, mean_wind, height, clock, flight.scenario.seed)
    if not air.steady:
        air.bind(aircraft)
    jsbsim = build_jsbsim_vehicles(
        fleet, starts, flight.rates, clock, aircraft, warmer=warmer, engine=flight.scenario.engine
    )
    estimators = _build_estimators(flight, flight.scenario.seed)
    return World(
        clock=clock,
        duration_s=duration_s,
        names=fleet.names,
        aircraft=aircraft,
        followers=allocate(FOLLOWER, 0),
        links=allocate(LINK, 0, 1),
        parts=None,
        air=None if air.steady else air,
        gusts=tuple(gust.name for gust in flight.air.gusts),
        vehicles=(jsbsim,),
        external_processes=(),
        fleet=jsbsim.fleet,
        estimators=estimators,
        faults=None,
        proximity=ProximityMonitor(fleet.names),
        envelope=build_envelope_monitor(fleet, flight.limits, None),
        lowest_m=jsbsim.fleet.lowest_m,
        fly_on=False,
        external_control=None,
        array_commands=build_array_commands(fleet, jsbsim, allocate(COMMAND, 1)),
        initial_events=(
            *engine_notes(jsbsim.fleet),
            *gust_input_warnings(fleet, jsbsim.fleet, steady_air=air.steady),
            *airframe_notes(fleet),
            *still_field_warnings(flight.air),
            *unusual_warnings(flight),
            *step_warnings(fleet, flight.rates, jsbsim.fleet),
            *tune_warnings(fleet),
            *sensor_warnings(fleet, flight.rates.autopilot_hz),
        ),
        info=RunInfo(
            **_run_info(flight, fleet, clock, exact=estimators.exact, models=jsbsim.fleet),
            make_yaml=ScenarioText(flight),
            speed_bounds_mps=(),
            kappa_mps=(),
            roll_limit_rad=(),
            leader_path_ned=np.zeros((0, 3)),
        ),
        entries=registered(),
    )


def versions() -> dict[str, str]:
    """Return the versions that determine the numbers of a run beside its scenario."""
    own = versions_without_jsbsim()
    first = {name: own[name] for name in ("testbed", "schema")}
    return {**first, "jsbsim": JSBSIM_VERSION, **own}


def _lowest_heights(fleet: Fleet, models: FlightModels | None) -> Array:
    """Return the heights (N,) below which aircraft count as on the ground, m."""
    heights = np.full(len(fleet.names), LOWEST)
    if models is not None:
        heights[list(fleet.model_rows)] = models.lowest_m
    return heights


def _build_air(
    scenario: Scenario | SingleAircraft,
    fleet: Fleet,
    mean_wind: MeanWind,
    height: float,
    clock: Clock,
    seed: int,
) -> Atmosphere:
    return build_air(
        scenario.air,
        mean_wind,
        fleet.names,
        [each.airframe for each in fleet.aircraft],
        seed=seed,
        height_m=height,
        elevation_m=fleet.origin.elevation_m,
        dt=clock.autopilot / clock.base_rate_hz,
        sheds=[each.has_model for each in fleet.aircraft],
    )


def _build_estimators(
    scenario: Scenario | SingleAircraft, seed: int, faults: FaultManager | None = None
) -> StateEstimators:
    return StateEstimators(
        [each.name for each in scenario.aircraft],
        [each.sensors for each in scenario.aircraft],
        seed=seed,
        rate_hz=scenario.rates.autopilot_hz,
        sensor_faults=faults is not None and faults.affects_sensors,
    )


def _run_info(
    scenario: Scenario | SingleAircraft,
    fleet: Fleet,
    clock: Clock,
    *,
    exact: bool,
    models: FlightModels | None,
) -> dict[str, Any]:
    """Return the fields of `RunInfo` that every flight has; `exact`: estimates are the truth."""
    return {
        "scenario_name": scenario.name,
        "names": fleet.names,
        "aircraft": tuple(each.folder.name for each in fleet.aircraft),
        "wingspan_m": tuple(each.airframe.span for each in fleet.aircraft),
        "origin": fleet.origin,
        "base_rate_hz": clock.base_rate_hz,
        "sample_rate_hz": scenario.rates.log_hz,
        "duration_s": scenario.scenario.duration_s,
        "seed": scenario.scenario.seed,
        "estimated": not exact,
        "windows": dict(scenario.scenario.windows),
        "versions": versions(),
        "engine": models.engine if models else "",
        "integrators": describe_integrators() if models else {},
    }


def _formation_info(
    scenario: Scenario,
    fleet: FormationPlan,
    clock: Clock,
    leader: LeaderSetup,
    control: BuiltControl,
    wind: Vector,
    *,
    exact: bool,
    models: FlightModels | None,
) -> RunInfo:
    """Describe the run of a formation for its observers; see `_run_info`."""
    with unrecorded():
        stored, code = with_stored_code(scenario)
    agents = [each.agent for each in fleet.followers]
    return RunInfo(
        **_run_info(scenario, fleet, clock, exact=exact, models=models),
        make_yaml=ScenarioText(stored),
        code=code,
        speed_bounds_mps=tuple(each.speed_mps for each in agents),
        bounded_in_ned=wind if scenario.controller.bounded_speed == "airspeed" else STILL,
        kappa_mps=tuple(each.kappa_mps for each in agents),
        roll_limit_rad=tuple(control.config.roll_limit.tolist()),
        barriers=control.barriers,
        barrier_samples=control.barrier_samples,
        law_numbers=control.outputs.logged_names,
        start_unix_ns=start_unix_ns(scenario.log.start_time) if scenario.log.start_time else 0,
        leader_path_ned=leader.path_ned,
    )
