"""From the page to a world: every object of a run, checked while it is built."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed import __version__
from testbed.air.air import Air
from testbed.compiled import load_engine
from testbed.errors import InputError
from testbed.network.radio import Radio
from testbed.network.scripts import Scripts
from testbed.scenario import SCHEMA_VERSION, Scenario, dump, find_aircraft, find_tune
from testbed.sensing.estimators import Estimators
from testbed.sim.airs import make_air, make_mean, standing, start_wind
from testbed.sim.arduplanes import ArduPlanes, make_flown
from testbed.sim.breakdowns import Breakdowns
from testbed.sim.clock import Clock, make_clock
from testbed.sim.control import Group
from testbed.sim.deck import Deck, make_deck
from testbed.sim.failures import make_breakdowns, make_roster, unfelt
from testbed.sim.formations import barriers_of, make_groups, roll_limits
from testbed.sim.hypotheses import warnings
from testbed.sim.leaders import Led, make_leader
from testbed.sim.limits import Proximity, make_proximity
from testbed.sim.mixed import Mixed
from testbed.sim.own_law import with_its_law
from testbed.sim.partners import Partner
from testbed.sim.pilots import Pilot
from testbed.sim.radios import beats, make_radio
from testbed.sim.roster import Roster
from testbed.sim.sizes import check_memory
from testbed.sim.teams import agent_value, make_altitudes, make_offsets
from testbed.sim.upsets import Upsets, make_upsets
from testbed.sim.vehicles import Flown, Ideal, Vehicles
from testbed.state import Array, Event, Origin, RunInfo
from testbed.streams import stream
from testbed.vehicle.crew import make_fleet
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.ideal import IdealFleet
from testbed.vehicle.jsbsim_door import VERSION as JSBSIM_VERSION
from testbed.vehicle.jsbsim_door import airframe, explore
from testbed.vehicle.params import read_params, stack
from testbed.vehicle.start import Start
from testbed.vehicle.trim import STILL, said_of

LOWEST_START_M = 5.0  # above the ground; an aircraft starts in trimmed flight


@dataclass(frozen=True, slots=True)
class World:
    """What the loop steps."""

    clock: Clock
    duration_s: float
    names: tuple[str, ...]
    air: Air | None  # None: it stays what it is at the start
    gusts: tuple[str, ...]  # names of the discrete gusts in it
    vehicles: Vehicles
    partners: tuple[Partner, ...]  # programs outside that take part
    fleet: JsbsimFleet | None  # the flight models among them, if there are any
    ideal: bool  # whether there are ideal vehicles among them
    estimators: Estimators
    breakdowns: Breakdowns | None  # None: nothing breaks
    roster: Roster | None  # None: nobody heeds that somebody failed
    proximity: Proximity
    upsets: Upsets
    fly_on: bool  # when an aircraft is lost; or stop
    pilot: Pilot
    deck: Deck | None  # None: nobody outside commands anything
    radio: Radio
    scripts: Scripts  # what is written down to go wrong on it
    groups: tuple[Group, ...]
    offsets: Array  # (n + 1, 3) m, in the leader's frame
    altitudes: Array  # (n,) m, of followers that hold one; nan for the rest
    notes: tuple[Event, ...]  # what is to be said before the flight
    info: RunInfo


def build(
    page: Scenario,
    *,
    commanded: bool = False,
    arduplane: Path | None = None,
    processes: int | None = 1,
) -> World:
    """Build the world of a page.

    Args:
        page: the scenario.
        commanded: whether programs outside may command the aircraft; they may without, too, where
            the page says so.
        arduplane: the program for `autopilot: ardupilot` where the page names none; None: that of
            the environment.
        processes: that step flight models; None: as many as are best here.

    Raises:
        ScenarioError, ParamError, AircraftError, TrimError, ValueError: what cannot be built, with
            what to write instead.
    """
    names = page.aircraft_names
    clock = clock_of(page)
    check_memory(page, clock)
    origin = Origin(**page.scenario.origin.model_dump())
    folders = [find_aircraft(each.aircraft) for each in page.aircraft]
    explore(folders, meanwhile=load_engine)
    files = [find_tune(at, each.tune) for at, each in zip(folders, page.aircraft, strict=True)]
    tunes = [read_params(file) for file in files]
    mean = make_mean(page)
    wind = start_wind(mean, page.leader.start.altitude_m)
    with said_of("leader"):
        led = make_leader(page, clock, tunes[0], folders[0], origin, wind)
    starts = [led.start, *(_start(led.start, each.start_m) for each in page.fleet)]
    starts = [replace(s, wind_ned=start_wind(mean, -s.position_ned[2])) for s in starts]
    kinds = ["moves" if led.moves else page.leader.vehicle, *(f.vehicle for f in page.fleet)]
    for name, kind, start in zip(names, kinds, starts, strict=True):
        if kind != "moves" and start.position_ned[2] > -LOWEST_START_M:
            raise InputError(
                f"{name} starts {-start.position_ned[2]:g} m above the ground: write a start at "
                f"least {LOWEST_START_M:g} m above it"
            )
    parts: list[tuple[Sequence[int], Vehicles]] = [((0,), led.moves)] if led.moves else []
    virtual: Flown | None = None
    airframes = [airframe(folder) for folder in folders]
    air = make_air(
        page,
        mean,
        names,
        airframes,
        dt=clock.autopilot / clock.base_rate_hz,
        sheds=[kind == "jsbsim" for kind in kinds],
    )
    fleet = None
    jsbsim = [row for row, kind in enumerate(kinds) if kind == "jsbsim"]
    if jsbsim:
        charges = [page.aircraft[row].battery.state_of_charge for row in jsbsim]
        charged = [
            replace(starts[row], state_of_charge=c) for row, c in zip(jsbsim, charges, strict=True)
        ]
        flown, rate = [folders[row] for row in jsbsim], clock.base_rate_hz
        with said_of("fleet"):
            fleet = make_fleet(flown, charged, origin, rate, processes=processes)
        period = clock.autopilot / clock.base_rate_hz
        gains = stack([tunes[row] for row in jsbsim], period)
        virtual = make_flown(page, fleet, gains, jsbsim, files, arduplane)
        parts.append((jsbsim, virtual))
    ideal = [row for row, kind in enumerate(kinds) if kind == "ideal"]
    if ideal:
        parts.append((ideal, _ideal(page, ideal, starts, led, clock)))
    groups, said = make_groups(page, folders[1:], clock)
    kept, code = with_its_law(page)
    radio, scripts = make_radio(page)
    vehicles = parts[0][1] if len(parts) == 1 else Mixed(parts)
    breakdowns = make_breakdowns(page, fleet, jsbsim)
    deck = None
    if commanded or any(each.commanded_by.kind == "external" for each in page.aircraft):
        deck = make_deck(page, clock, led, starts, tunes, folders, virtual, jsbsim)
    estimators = Estimators(
        names,
        [each.sensors for each in page.aircraft],
        seed=page.scenario.seed,
        rate_hz=page.rates.autopilot_hz,
        start=vehicles.read(),
        breakable=breakdowns is not None and breakdowns.of_sensors,
    )
    return World(
        clock=clock,
        duration_s=page.scenario.duration_s,
        names=names,
        air=None if air.steady else air,
        gusts=tuple(gust.name for gust in page.air.gusts),
        vehicles=vehicles,
        partners=(virtual,) if isinstance(virtual, ArduPlanes) else (),
        fleet=fleet,
        ideal=bool(ideal),
        estimators=estimators,
        breakdowns=breakdowns,
        roster=make_roster(page, breakdowns),
        proximity=make_proximity(page),
        upsets=make_upsets(page, tunes, airframes, jsbsim, breakdowns),
        fly_on=page.limits.when_lost == "fly-on",
        pilot=deck if deck and deck.leads else led.pilot,
        deck=deck,
        radio=radio,
        scripts=scripts,
        groups=groups,
        offsets=make_offsets(page),
        altitudes=make_altitudes(page),
        notes=(
            *(Event(0.0, "info", "run", text) for text in said),
            *_deaf(fleet, air, [names[row] for row in jsbsim]),
            *standing(page),
            *unfelt(page),
            *warnings(page, groups, led, wind),
        ),
        info=RunInfo(
            scenario_name=page.name,
            scenario_yaml=dump(kept),
            code=code,
            names=names,
            aircraft=tuple(folder.name for folder in folders),
            wingspan_m=tuple(each.span for each in airframes),
            origin=origin,
            base_rate_hz=clock.base_rate_hz,
            frame_rate_hz=page.rates.log_hz,
            duration_s=page.scenario.duration_s,
            seed=page.scenario.seed,
            speed_bounds_mps=tuple(agent_value(page, name, "speed_mps") for name in names[1:]),
            bounded_in_ned=wind if page.controller.bounds_of == "airspeed" else STILL,
            kappa_mps=tuple(agent_value(page, name, "kappa_mps") for name in names[1:]),
            roll_limit_rad=roll_limits(groups),
            barriers=barriers_of(groups),
            estimated=not estimators.exact,
            leader_path_ned=led.path_ned,
            portions=dict(page.scenario.portions),
            versions=versions(),
        ),
    )


def versions() -> dict[str, str]:
    """What decides the numbers of a run beside its page."""
    return {
        "testbed": __version__,
        "schema": str(SCHEMA_VERSION),
        "jsbsim": JSBSIM_VERSION,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def clock_of(page: Scenario) -> Clock:
    """The clock of a page: rates, phases drawn from the seed, and moments of sending."""
    rates = page.rates.model_dump()
    together = rates.pop("synchronous")
    names, seed = page.aircraft_names, page.scenario.seed
    phases = None if together else [float(stream(seed, f"phase/{name}").random()) for name in names]
    return make_clock(**rates, aircraft=len(names), phases=phases, beats=beats(page))


def _ideal(
    page: Scenario,
    rows: Sequence[int],
    starts: Sequence[Start],
    led: Led,
    clock: Clock,
) -> Ideal:
    """Extended unicycles at their starts, with the leader's velocity over the ground."""
    names = page.aircraft_names
    poles = [
        agent_value(page, names[row], "speed_pole_per_s")
        if row
        else page.formation.speed_pole_per_s
        for row in rows
    ]
    return Ideal(
        IdealFleet(
            np.array([starts[row].position_ned for row in rows]),
            np.array([led.velocity_ned for _ in rows]),
            np.array(poles, dtype=np.float64),
            clock.base_rate_hz,
            np.array([starts[row].wind_ned for row in rows]),
        )
    )


def _deaf(fleet: JsbsimFleet | None, air: Air, names: Sequence[str]) -> Iterator[Event]:
    """A warning for each aircraft whose model has no way to feel that the air turns."""
    if fleet is None or air.steady:
        return
    for name, deaf in zip(names, fleet.deaf, strict=True):
        if deaf:
            text = (
                "feels no turn of the air and no wake's rolling moment: its model lacks one of the "
                "properties air/p-rad_sec, air/q-rad_sec, air/r-rad_sec and air/roll-coefficient"
            )
            yield Event(0.0, "warning", name, text)


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
