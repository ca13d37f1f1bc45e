"""What moves: aircraft behind their autopilots, ideal vehicles, and leaders that are not flown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from testbed.guidance.replay import Track
from testbed.state import (
    AirData,
    AirFelt,
    Array,
    Failing,
    FbwaCommand,
    Surfaces,
    Truths,
    UnicycleCommand,
    VehicleState,
)
from testbed.vehicle.breakage import Servos, broken, resting
from testbed.vehicle.fbwa import READY_FLY, settled, standing
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.ideal import IdealFleet
from testbed.vehicle.legs import Leg
from testbed.vehicle.params import FbwaParams, stack
from testbed.vehicle.tables import FbwaGains


class Vehicles(Protocol):
    """Some of the aircraft of a run, on one clock."""

    @property
    def surfaces(self) -> Surfaces:
        """What their servos are told now."""

    def read(self) -> VehicleState:
        """The truth now, in arrays that may be changed by the next call."""

    def air(self) -> AirData:
        """What the truth knows of the air now; not amid legs, see `step`."""

    def lost(self, state: VehicleState) -> Truths:
        """Which of them are on the ground, broken or not finite; until the next call."""

    def blow(self, felt: AirFelt) -> None:
        """Feel this air from now on; at the autopilot rate."""

    def steer(self, told: UnicycleCommand) -> None:
        """Hand over what a formation law decided; at the control rate."""

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """Let the autopilots fly what they are told; at the autopilot rate."""

    def fail(self, failing: Failing) -> None:
        """Let what is broken have its way; right after `act`, only in runs that have faults."""

    def remove(self, rows: Truths) -> None:
        """Stop moving these (N,), which are lost; they read as now from now on."""

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """Move on by ticks of the base rate.

        Args:
            ticks: how many.
            legs: all that come, the first with these ticks, until anybody tells them anything or
                asks for more than their motion: they may fly all of them at once. None are given
                while those from before last, or where nothing is known.
        """


class Flown:
    """JSBSim aircraft behind their virtual autopilots."""

    def __init__(self, fleet: JsbsimFleet, gains: FbwaGains) -> None:
        """Autopilots begin as if they had long held the trim."""
        self.fleet, self._gains = fleet, gains
        self._memory = standing(settled(fleet.trimmed, gains), gains)
        self._told = np.array(fleet.trimmed)
        self.surfaces = self._autopilots = Surfaces(*self._told)
        self._fly: Callable[[], None] | None = None  # bound to the records of the last period
        self._estimate: VehicleState | None = None
        self._command: FbwaCommand | None = None
        self.read, self.air, self.lost = fleet.look, fleet.air, fleet.lost
        self.blow = fleet.blow
        self._memory_before = standing(self._memory, self._gains)
        self._failing: Failing | None = None
        self._servos: Servos | None = None
        self._tunes: dict[int, FbwaParams] = {}  # not heeded yet
        self._servos_before: Servos | None = None
        self._still = self._flow = np.zeros((len(fleet.trims), 2))
        self._moved = True  # the surfaces, since the last step

    def retune(self, row: int, tune: FbwaParams) -> None:
        """Give the autopilot in this row of the fleet other parameters; its memory stays."""
        self._tunes[row] = tune

    def steer(self, told: UnicycleCommand) -> None:
        """An autopilot takes attitudes, not turns."""

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """One period of the autopilots."""
        if self._tunes:
            # all at once, for a ground station may set many from one period to the next
            rows, tunes = list(self._tunes), list(self._tunes.values())
            each = self._gains.each.copy()
            each[rows] = stack(tunes, self._gains.dt).each
            self._gains, self._tunes, self._fly = self._gains._replace(each=each), {}, None
        if self._fly is None or estimate is not self._estimate or told is not self._command:
            self._estimate, self._command = estimate, told
            self._fly = READY_FLY(estimate, told, self._memory, self._gains, self._told)
        self._fly()
        self.surfaces, self._moved = self._autopilots, True
        if not self._memory.begun:
            self._memory, self._fly = self._memory._replace(begun=True), None

    def fail(self, failing: Failing) -> None:
        """Break what the autopilots said, and hold the memory of those that hang."""
        fleet, frozen, before = self.fleet, failing.frozen, self._memory_before
        # one that hangs from the start has been switched on, and hangs in its first period
        if before.begun and frozen.any():
            self._memory.each[frozen] = before.each[frozen]
            self._memory.commands[:, :, frozen] = before.commands[:, :, frozen]
        self._memory_before = standing(self._memory, self._gains)
        self._failing = failing
        self._servos_before = self._servos or resting(fleet.trimmed, fleet.rig)
        self._flow = self._still
        if failing.floating.any():
            air = fleet.air()
            self._flow = np.stack((air.alpha, air.beta), axis=1)
        self.surfaces = self._reached(self.surfaces)
        fleet.discharge(failing.charge)

    def _reached(self, surfaces: Surfaces) -> Surfaces:
        """What of this reaches surfaces and motors, after what `fail` was told last."""
        failing, before = self._failing, self._servos_before
        if failing is None or before is None:
            return surfaces
        reached, self._servos = broken(surfaces, before, failing, self._flow, self.fleet.rig)
        return reached

    def remove(self, rows: Truths) -> None:
        """Fly them no more."""
        self.fleet.remove(rows)

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """Run the flight models."""
        self.fleet.step(self.surfaces if self._moved else None, ticks, legs)
        self._moved = False


class Ideal:
    """Extended unicycles, which do at once what the law decided."""

    def __init__(self, fleet: IdealFleet) -> None:
        """They have no surfaces."""
        self.fleet = fleet
        nothing = np.zeros(len(fleet.read().airspeed))
        self.surfaces = Surfaces(nothing, nothing, nothing, nothing)
        self.read, self.air, self.lost = fleet.read, fleet.air, fleet.lost
        self.blow, self.remove = fleet.blow, fleet.remove

    def steer(self, told: UnicycleCommand) -> None:
        """Fly with this u and ω."""
        self.fleet.command(told.speed, told.turn)

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """There is no autopilot."""

    def fail(self, failing: Failing) -> None:
        """There is nothing that could break."""

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """All of them fly."""
        self.fleet.step(ticks)


class Replayed:
    """One leader that moves by itself: a recorded flight, or a formula."""

    def __init__(self, track: Track, equivalent_airspeed: Array, wind_ned: Array) -> None:
        """Begin the track, which has one row for every event of the clock."""
        self._track, self._row = track, 0
        vectors = track.position_ned, track.velocity_ned, track.acceleration_ned
        moves = *vectors, track.euler, track.rates_body, track.airspeed, equivalent_airspeed
        self._state = VehicleState(*np.empty((5, 1, 3)), *np.empty((2, 1)))
        self._fields = tuple(zip(self._state, moves, strict=True))
        still, zero, nothing = np.zeros((1, 3)), np.zeros(1), np.full(1, np.nan)
        self._throttle, self._wind = np.empty(1), wind_ned[np.newaxis].copy()
        self._surfaces = Surfaces(zero, zero, zero, self._throttle)
        self._air = AirData(zero, zero, zero, self._wind, still, zero, nothing, nothing)

    @property
    def command(self) -> tuple[float, float, float]:
        """Pitch, roll, throttle: what it does stands for what it was told."""
        roll, pitch, _ = self._track.euler[self._row].tolist()
        return pitch, roll, float(self._track.throttle[self._row])

    @property
    def surfaces(self) -> Surfaces:
        """A track has none but the throttle; until the next call."""
        self._throttle[0] = self._track.throttle[self._row]
        return self._surfaces

    def read(self) -> VehicleState:
        """The row of now, until the next call."""
        row = self._row
        for now, moves in self._fields:
            now[0] = moves[row]
        return self._state

    def air(self) -> AirData:
        """A track tells nothing of its own: zero."""
        return self._air

    def lost(self, state: VehicleState) -> Truths:
        """It flies on whatever happens."""
        return np.zeros(1, dtype=bool)

    def blow(self, felt: AirFelt) -> None:
        """It moves as it does; only the log knows what wind there is."""
        np.copyto(self._wind, felt.wind_ned)

    def steer(self, told: UnicycleCommand) -> None:
        """Nobody steers it."""

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """It has no autopilot."""

    def fail(self, failing: Failing) -> None:
        """It moves as it does."""

    def remove(self, rows: Truths) -> None:
        """It flies on whatever happens."""

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """On to the next event."""
        self._row += 1


def choose(record: Any, rows: Any) -> Any:  # noqa: ANN401 - any record of arrays, any index
    """The record with these rows of every array, contiguous."""
    return type(record)(*(each[rows] for each in record))
