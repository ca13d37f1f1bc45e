"""The world of a flight: the records of a run, and the objects that step them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from testbed.atmosphere.air import Atmosphere
from testbed.core.compile import Arguments
from testbed.core.records import (
    Array,
    Event,
    Records,
    RunInfo,
)
from testbed.core.saved_state import copy_state
from testbed.flight.arduplane_vehicles import ArduPlaneVehicles
from testbed.flight.array_commands import ArrayCommands
from testbed.flight.companion import Companions
from testbed.flight.control import BuiltControl, Control
from testbed.flight.external_control import ExternalControl
from testbed.flight.faults import FaultManager
from testbed.flight.leader_control import LeaderController
from testbed.flight.limits import (
    EnvelopeMonitor,
    ProximityMonitor,
)
from testbed.flight.schedule import Clock
from testbed.flight.vehicles import ScriptedVehicle, Vehicles
from testbed.network.outages import Outages
from testbed.network.radio import Radio
from testbed.scenario.set_keys import UnusedKey
from testbed.sensors.estimators import StateEstimators
from testbed.vehicle.fleet import FlightModels
from testbed.vehicle.trim import (
    InitialState,
)


class SpeedLimits(NamedTuple):
    """Limits of a leader's motion on a mission."""

    speed_min: float  # m/s over the ground
    speed_max: float  # m/s
    turn_rate: float  # rad/s, the largest
    gamma: float  # rad, the largest


@dataclass(frozen=True, slots=True)
class LeaderSetup:
    """A leader before the flight."""

    controller: LeaderController
    vehicle: ScriptedVehicle | None  # the leader, where it follows a recording or a formula
    start: InitialState
    velocity_ned: tuple[float, float, float]  # m/s over the ground, at the start
    path_ned: Array  # (k, 3) m, for drawing
    # velocity (m/s) and acceleration (m/s²), (T, 3) each, in blocks; None: not known in advance
    motion: tuple[tuple[Array, Array], ...] | None
    limits: SpeedLimits | None  # of its motion over the ground, where that is not known
    limits_in_air: SpeedLimits | None  # the same through the air


@dataclass(frozen=True, slots=True)
class FormationParts:
    """What flies the followers of a leader in their slots."""

    scripted_leader: bool  # it follows a recording or a formula
    leader_controller: LeaderController
    built_control: BuiltControl  # what `control` steps
    control: Control
    companions: Companions | None  # None: controllers have no latency
    radio: Radio
    outages: Outages
    altitudes: Array  # (n,) m, of followers that hold an altitude; NaN for the others


@dataclass(frozen=True, slots=True)
class World:
    """The records of a run, and the objects that step them."""

    clock: Clock
    duration_s: float
    names: tuple[str, ...]
    aircraft: Records  # (N,) of AIRCRAFT
    followers: Records  # (n,) of FOLLOWER
    links: Records  # (n, N) of LINK
    parts: FormationParts | None  # None: a single aircraft without a formation
    air: Atmosphere | None  # None: it is steady
    gusts: tuple[str, ...]  # names of its discrete gusts
    vehicles: tuple[Vehicles, ...]
    external_processes: tuple[ArduPlaneVehicles, ...]
    fleet: FlightModels | None  # the flight models, if there are any
    estimators: StateEstimators
    faults: FaultManager | None  # None: the scenario has none
    proximity: ProximityMonitor
    envelope: EnvelopeMonitor
    lowest_m: Array  # (N,) m above the terrain; an aircraft below counts as on the ground
    fly_on: bool  # the run continues without lost aircraft
    external_control: ExternalControl | None  # None: no external programs command aircraft
    array_commands: ArrayCommands | None  # None: no program in this process commands any
    initial_events: tuple[Event, ...]  # from before the flight
    info: RunInfo
    entries: tuple[Arguments, ...]  # that step them
    is_random: bool = True  # numbers may depend on the seed
    # Makes what depends on the seed alone, for another seed; in the order of `of_seed`
    make_of_seed: Callable[[int], tuple[object, ...]] | None = None  # None: more depends on it

    begin: Callable[[Any], None] | None = None  # lets a flight take over another; None: at 0 s
    unused: tuple[UnusedKey, ...] = ()  # keys that the user has set, and that nothing reads
    # the function that has read each key first, by the key's path
    consumers: Mapping[tuple[str | int, ...], str] = field(default_factory=dict)

    UNSAVED: ClassVar[tuple[str, ...]] = (
        *("entries", "make_of_seed", "begin"),
        *("unused", "consumers"),
    )

    @property
    def of_seed(self) -> tuple[object, ...]:
        """What depends on the seed."""
        return self.air, self.estimators, self.formation.radio

    def reseed(self, seed: int) -> None:
        """Let a world that has not flown yet fly with another seed; with `make_of_seed` only."""
        assert self.make_of_seed is not None, "more depends on the seed"
        for made, own in zip(self.make_of_seed(seed), self.of_seed, strict=True):
            copy_state(made, own)

    @property
    def formation(self) -> FormationParts:
        """What flies the followers, of a flight that has some."""
        assert self.parts is not None, "a single aircraft has no formation"
        return self.parts
