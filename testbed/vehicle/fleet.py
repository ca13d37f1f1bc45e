"""N JSBSim aircraft that are placed in trim, stepped and read.

Feet and JSBSim's signs stop in `jsbsim_model` and `instruments`. Aircraft open no sockets, write no
files and print nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from testbed.frames import FOOT, metres_per_radian
from testbed.state import AirData, AirFelt, Array, Origin, Surfaces, Truths, VehicleState
from testbed.steady import Steady
from testbed.vehicle.breakage import Rig, check_faults, stacked
from testbed.vehicle.instruments import (
    AIR,
    BATTERY,
    MOTION,
    READY_BLOW,
    READY_COMMAND,
    READY_LOOK,
    READY_NOTE,
    READY_SENSE_AIR,
)
from testbed.vehicle.jsbsim_door import load, rig_of, trim_aircraft
from testbed.vehicle.legs import LONGEST, Leg, Parts, parts_of, wanted_of
from testbed.vehicle.motion import READY_LOST, state_of
from testbed.vehicle.properties import joined, sane
from testbed.vehicle.start import Start
from testbed.vehicle.trim import TrimPoint, TrimResult, course_through_air

_AHEAD = "aircraft that have flown on already are told or asked something that comes before"
LOWEST = 1.0  # m above the terrain: an aircraft below counts as on the ground


class JsbsimFleet:
    """N JSBSim aircraft on one clock."""

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[Start],
        origin: Origin,
        base_rate_hz: int,
    ) -> None:
        """Load, trim and place the aircraft.

        Args:
            folders: N aircraft folders, each holding `<folder name>.xml`.
            starts: N starts.
            origin: of the local frame; its elevation is the terrain's.
            base_rate_hz: steps per second.

        Raises:
            AircraftError, TrimError: an aircraft cannot be loaded, has no steady flight at its
                start, or the wind lets it keep no course.
        """
        models, trims = [], []
        for folder, start in zip(folders, starts, strict=True):
            altitude = origin.elevation_m - start.position_ned[2]
            point = TrimPoint(
                start.airspeed,
                start.flight_path_angle,
                start.bank,
                altitude,
                start.state_of_charge,
            )
            trimmed = trim_aircraft(folder, point, origin)
            model = load(folder, base_rate_hz)
            model.locate(start.position_ned, origin)
            model.charge(start.state_of_charge)
            level = start.airspeed * math.cos(start.flight_path_angle)
            model.place(
                trimmed.placement,
                trimmed.controls,
                course=course_through_air(level, start.course, start.wind_ned),
                wind_ned=start.wind_ned,
                spin=True,
            )
            model.fly()
            models.append(model)
            trims.append(trimmed)
        n = len(models)
        self.trims: tuple[TrimResult, ...] = tuple(trims)
        self._folders = [Path(folder).resolve() for folder in folders]
        self._models = models
        # what steps each; None: it is lost
        self._runs: list[Callable[[], bool] | None] = list(self.bare_runs())
        self._deaf = np.array([not model.turns for model in models])
        self._broken = np.zeros(n, dtype=bool)
        # properties: None where an aircraft has none, or another number stands for it
        self._motion = [[model.node(name) for name in MOTION] for model in models]
        self._of_air = [
            [*map(model.node, AIR), *(model.find(name) for name in BATTERY)] for model in models
        ]
        self._blown = [[*m.winds, *(m.turns or (None,) * 4)] for m in models]
        self._controls = [list(model.controls) for model in models]
        # their numbers, in JSBSim's units
        self._numbers, self._raw_air = np.empty((n, len(MOTION))), np.full(8 * n, np.nan)
        self._told, self._commanded = np.empty(7 * n), np.empty(4 * n)
        # the motion after each of the legs that are flown at once, and whose is written down
        self._notes = np.zeros((LONGEST, n, len(MOTION)))
        self._wanted = np.ones((LONGEST, n), dtype=bool)
        self._rows = tuple(range(n))
        # those that are flown, and which of them is looked at
        self._legs: tuple[Leg, ...] = (Leg(0),)
        self._leg = 0
        north, east = metres_per_radian(origin)
        place = *np.radians([origin.latitude_deg, origin.longitude_deg]), origin.elevation_m / FOOT
        self._zero = np.array([*place, *[0.0] * 14])
        self._scale = np.array([north, east, -FOOT, *[FOOT] * 6, *[1.0] * 6, FOOT, FOOT])
        self._flat = np.empty(17 * n)
        self._state = state_of(self._flat)
        self._felt = AirFelt(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n))
        alpha, beta, rps, *others = np.empty((6, n))
        self._in_air = AirData(alpha, beta, rps, *np.empty((2, n, 3)), *others)
        self._lost, self._looked_at = np.zeros(n, dtype=bool), cast(VehicleState | None, None)
        self._surfaces, self._airs, self._orders = self.trimmed, Steady(), Steady()
        self._bind()
        for note in self._note:
            note(0)
        self._first = self._numbers.copy()

    def _bind(self) -> None:
        """Bind what reads and sets to the properties that there are now, and their numbers."""
        self._note = [self._noting(i) for i in range(len(self._models))]
        self._look = READY_LOOK(self._notes, self._wanted, self._zero, self._scale, self._flat)
        self._bind_to_air()
        self._bind_to_controls()

    def _bind_to_air(self) -> None:
        nodes, told = joined(self._of_air), joined(self._blown)
        self._look_at_air = READY_SENSE_AIR(nodes, self._raw_air, self._felt, self._in_air)
        self._blow = READY_BLOW(told, self._felt, self._told)

    def _bind_to_controls(self) -> None:
        self._command = READY_COMMAND(joined(self._controls), self._surfaces, self._commanded)

    def _noting(self, i: int) -> Callable[[int], None]:
        return READY_NOTE(self._motion[i], self._numbers[i], self._notes, i)

    @property
    def trimmed(self) -> Surfaces:
        """The surfaces that hold the aircraft in trim at their starts."""
        held = (trimmed.controls for trimmed in self.trims)
        each = [(one.aileron, one.elevator, one.rudder, one.throttle) for one in held]
        return Surfaces(*np.array(each).T.copy())

    def read(self) -> VehicleState:
        """The truth now, as fresh contiguous arrays."""
        self._look(self._leg)
        return state_of(self._flat.copy())

    def look(self) -> VehicleState:
        """The truth now, in arrays that are the fleet's own: the next look changes them."""
        self._look(self._leg)
        return self._state

    def air(self) -> AirData:
        """What is known of the air now; for observers, until the next call; not amid legs."""
        self._stands()
        self._look_at_air()
        return self._in_air

    @property
    def deaf(self) -> Truths:
        """Which aircraft (N,) lack a property that would tell them of turns of the air."""
        return self._deaf

    def blow(self, felt: AirFelt) -> None:
        """Say what the air does to the aircraft from now on."""
        self._stands()
        felt = self._airs(felt)
        if felt is not self._felt:
            self._felt = felt
            self._bind_to_air()
        self._blow()

    def step(self, surfaces: Surfaces | None, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """Run every aircraft for `ticks` steps of the base rate.

        Args:
            surfaces: the commands from now on; None: as they are.
            ticks: how many.
            legs: that are to be flown without a word, the first with these ticks. The aircraft
                run through them at once, and steps that follow only turn to what they were at the
                end of the next: no surfaces are taken there, nor a look at the air.

        Raises:
            RuntimeError: surfaces, other legs or other ticks in the midst of legs.
        """
        if self._amid:
            self._leg += 1
            if surfaces is not None or legs or ticks != self._legs[self._leg].ticks:
                raise RuntimeError(_AHEAD)
            return
        if surfaces is not None:
            self._take(surfaces)
        self._legs, self._leg = legs[:LONGEST] or (Leg(ticks),), 0
        self._wanted[: len(self._legs)] = wanted_of(self._legs, len(self._models))
        self._run(self._legs)

    @property
    def _amid(self) -> bool:
        """Whether the aircraft have flown on beyond what is looked at."""
        return self._leg + 1 < len(self._legs)

    def _stands(self) -> None:
        if self._amid:
            raise RuntimeError(_AHEAD)

    def _take(self, surfaces: Surfaces) -> None:
        """Command them."""
        surfaces = self._orders(surfaces)
        if surfaces is not self._surfaces:
            self._surfaces = surfaces
            self._bind_to_controls()
        self._command()

    def _run(self, legs: tuple[Leg, ...]) -> None:
        """Run everyone through legs."""
        self._run_through(self._rows, parts_of(legs, self._rows))

    def _run_through(self, rows: Sequence[int], parts: Sequence[Parts]) -> None:
        """Run these aircraft through their parts, and write down what is wanted."""
        for i, theirs in zip(rows, parts, strict=True):
            run = self._runs[i]
            for ticks, leg in theirs:
                if run is not None:
                    on = True
                    try:
                        for _ in range(ticks):
                            on = on and run()
                    except Exception:  # JSBSim's own, of many types: beyond its models
                        on = False
                    if not on:
                        self._remove(i)
                        run = None
                self._note[i](leg)

    def discharge(self, charge: Array) -> None:
        """Empty batteries to a state of charge (N,) 0..1 at once; not a number: as they are.

        Raises:
            AircraftError: if an aircraft that is to have less has no battery.
        """
        self._stands()
        for i in np.flatnonzero(~np.isnan(charge)).tolist():
            self._models[i].discharge(float(charge[i]))

    def remove(self, rows: Truths) -> None:
        """Step these aircraft (N,) no more: they are lost, and read as now from now on."""
        self._stands()
        for i in np.flatnonzero(rows & ~self._broken).tolist():
            self._remove(i)

    def _remove(self, i: int) -> None:
        """Stop one; where JSBSim has lost its numbers it reads as at the start, in air of zero."""
        self._broken[i], self._runs[i] = True, None
        if not all(sane(self._motion[i], self._numbers[i])):
            self._motion[i], self._numbers[i] = [None] * len(MOTION), self._first[i]
        air = self._raw_air.reshape(len(self._models), -1)[i, : len(AIR)]
        for k, said in enumerate(sane(self._of_air[i][: len(AIR)], air)):
            if not said:
                self._of_air[i][k], air[k] = None, 0.0
        self._controls[i] = [None] * 4
        self._note[i] = self._noting(i)
        self._bind_to_air()
        self._bind_to_controls()

    @cached_property
    def rig(self) -> Rig:
        """The surfaces of the aircraft, for those that break."""
        return stacked([rig_of(folder) for folder in self._folders])

    def check_faults(self, row: int, name: str, faults: Iterable[Any]) -> None:
        """As `breakage.check_faults`, of the aircraft in a row of this fleet."""
        kind = self._folders[row].name
        battery = self._models[row].find(BATTERY[0]) is not None
        check_faults(name, kind, self.rig, row, battery=battery, faults=faults)

    def bare_runs(self) -> list[Callable[[], bool]]:
        """Each aircraft's own step, for measuring what everything else costs."""
        return [model.fdm.run for model in self._models]

    def lost(self, state: VehicleState) -> Truths:
        """Which aircraft (N,) are on the ground, broken or not finite; until the next call."""
        if state is not self._looked_at:
            self._looked_at = state
            self._look_down = READY_LOST(state.position_ned, self._broken, LOWEST, self._lost)
        self._look_down()
        return self._lost
