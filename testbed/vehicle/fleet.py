"""N JSBSim aircraft that are placed in trim, stepped and read.

Feet and JSBSim's signs (elevator positive nose down, rudder positive nose left) stop here and in
`jsbsim_model`. Aircraft open no sockets, write no files and print nothing.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from testbed.frames import FOOT, metres_per_radian
from testbed.state import AirData, AirFelt, Array, Origin, Surfaces, Truths, VehicleState
from testbed.vehicle.breakage import Rig, check_faults, stacked
from testbed.vehicle.jsbsim_door import load, rig_of, trim_aircraft
from testbed.vehicle.motion import READY_LOST, READY_MOTION, state_of
from testbed.vehicle.trim import STILL, TrimPoint, TrimResult, Vector, course_through_air

LOWEST = 1.0  # m above the terrain: an aircraft below counts as on the ground
_ABSURD = 1e9  # ft, ft/s², rad, rpm: nothing that flies reads this

# Three numbers per aircraft, then one per aircraft: rows of the flat vector that `read` fills.
_TRIPLES = (
    ("position/lat-geod-rad", "position/long-gc-rad", "position/geod-alt-ft"),
    ("velocities/v-north-fps", "velocities/v-east-fps", "velocities/v-down-fps"),
    ("accelerations/udot-ft_sec2", "accelerations/vdot-ft_sec2", "accelerations/wdot-ft_sec2"),
    ("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
)
_SINGLES = ("velocities/vt-fps", "velocities/ve-fps")
# What `air` fills: one number per aircraft, then three.
_AIR_SINGLES = ("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm")
# And of those that have a battery.
_BATTERY = ("battery/state-of-charge", "battery/voltage-v")
_DEAF = (lambda _: None,) * 4  # in the place of setters of properties that are not there
_WIND = tuple(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down"))


@dataclass(frozen=True, slots=True)
class Start:
    """Where and how an aircraft begins, in trim in the air that carries it.

    In wind the nose is turned so that the track over the ground has the course asked for; airspeed
    and flight-path angle are those of the motion through the air.
    """

    position_ned: Vector  # m from the origin
    course: float = 0.0  # rad, over the ground
    airspeed: float = 22.0  # true, m/s
    flight_path_angle: float = 0.0  # rad, through the air
    bank: float = 0.0  # rad
    wind_ned: Vector = STILL  # m/s, velocity of the air, which stays so until `blow`
    state_of_charge: float = 1.0  # 0..1 of its battery, where it has one


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
        self._runs = [model.fdm.run for model in models]
        # what steps each, and takes its commands; None: it is lost
        self._flying: list[tuple[Any, ...] | None] = [
            (i, model.fdm.run, *model.setters) for i, model in enumerate(models)
        ]
        self._deaf = np.array([not model.turns for model in models])
        self._blown = [setter for m in models for setter in (*m.winds, *(m.turns or _DEAF))]
        self._felt: AirFelt | None = None  # nothing yet
        self._told = np.empty((n, 7))  # of the air
        self._broken = np.zeros(n, dtype=bool)
        self._getters = [
            model.node(name).get_double_value
            for names in _TRIPLES
            for model in models
            for name in names
        ] + [model.node(name).get_double_value for name in _SINGLES for model in models]
        self._air = [
            model.node(name).get_double_value for name in _AIR_SINGLES for model in models
        ] + [model.node(name).get_double_value for model in models for name in _WIND]
        self._first = [get() for get in self._getters]
        # whose each number is, in the order of the getters
        each, three = np.arange(n), np.arange(n).repeat(3)
        self._of_motion = np.concatenate((np.tile(three, 5), each, each)).tolist()
        self._of_air = np.concatenate((each, each, each, three)).tolist()
        self._batteries = np.full((len(_BATTERY), n), np.nan)
        self._battery = [
            (row, i, node.get_double_value)
            for i, model in enumerate(models)
            for row, name in enumerate(_BATTERY)
            if (node := model.find(name)) is not None
        ]
        north, east = metres_per_radian(origin)
        place = *np.radians([origin.latitude_deg, origin.longitude_deg]), origin.elevation_m / FOOT
        self._zero = np.zeros(17 * n)
        self._zero[: 3 * n] = np.tile(place, n)
        self._scale = np.concatenate(
            [
                np.tile([north, east, -FOOT], n),
                np.full(6 * n, FOOT),
                np.ones(6 * n),
                np.full(2 * n, FOOT),
            ]
        )
        self._raw, self._flat = np.empty(17 * n), np.empty(17 * n)
        # of the ways to put numbers into an array the cheapest by far
        self._pack, self._pack_air = (struct.Struct(f"{k * n}d").pack_into for k in (17, 6))
        self._state = state_of(self._flat)
        self._move = READY_MOTION(self._raw, self._zero, self._scale, self._flat)
        self._raw_air, self._flat_air = np.empty((2, 6 * n))
        self._per_air = np.repeat([1.0, 1.0, 60.0], n)  # revolutions per minute
        (raw, winds), (flat, winds_si) = (
            (each[: 3 * n], each[3 * n :]) for each in (self._raw_air, self._flat_air)
        )
        self._air_views = raw, winds, flat, winds_si
        alpha, beta, rps = flat.reshape(3, n)
        wind, turn, roll = winds_si.reshape(n, 3), np.zeros((n, 3)), np.zeros(n)
        self._in_air = AirData(alpha, beta, rps, wind, turn, roll, *self._batteries)
        self._lost, self._looked_at = np.zeros(n, dtype=bool), cast(VehicleState | None, None)

    @property
    def trimmed(self) -> Surfaces:
        """The surfaces that hold the aircraft in trim at their starts."""
        held = (trimmed.controls for trimmed in self.trims)
        each = [(one.aileron, one.elevator, one.rudder, one.throttle) for one in held]
        return Surfaces(*np.array(each).T.copy())

    def read(self) -> VehicleState:
        """The truth now, as fresh contiguous arrays."""
        self.look()
        return state_of(self._flat.copy())

    def look(self) -> VehicleState:
        """The truth now, in arrays that are the fleet's own: the next look changes them."""
        self._pack(self._raw.data, 0, *[get() for get in self._getters])
        self._move()
        return self._state

    def air(self) -> AirData:
        """What the truth knows of the air now; for observers, until the next call."""
        raw, winds, flat, winds_si = self._air_views
        self._pack_air(self._raw_air.data, 0, *[get() for get in self._air])
        np.divide(raw, self._per_air, out=flat)
        np.multiply(winds, FOOT, out=winds_si)
        if self._felt is not None:
            self._in_air.rates_body[:] = self._felt.rates_body
            self._in_air.roll_coefficient[:] = self._felt.roll_coefficient
        for row, i, get in self._battery:
            self._batteries[row, i] = get()
        return self._in_air

    @property
    def deaf(self) -> Truths:
        """Which aircraft (N,) lack a property that would tell them of turns of the air."""
        return self._deaf

    def blow(self, felt: AirFelt) -> None:
        """Say what the air does to the aircraft from now on."""
        self._felt = felt
        told = self._told
        np.divide(felt.wind_ned, FOOT, out=told[:, :3])
        told[:, 3:6] = felt.rates_body
        told[:, 6] = felt.roll_coefficient
        for set_value, value in zip(self._blown, told.ravel().tolist(), strict=True):
            set_value(value)

    def _command(self, surfaces: Surfaces) -> None:
        told = zip(self._flying, *(each.tolist() for each in surfaces), strict=True)
        for flying, aileron, elevator, rudder, throttle in told:
            if flying is not None:
                _, _, set_aileron, set_elevator, set_rudder, set_throttle = flying
                set_aileron(aileron)
                set_elevator(-elevator)
                set_rudder(-rudder)
                set_throttle(throttle)

    def step(self, surfaces: Surfaces | None, ticks: int) -> None:
        """Run every aircraft for `ticks` steps of the base rate.

        Args:
            surfaces: the commands from now on; None: as they are.
            ticks: how many.
        """
        if surfaces is not None:
            self._command(surfaces)
        steps = range(ticks)
        for flying in self._flying:
            if flying is None:
                continue
            run = flying[1]
            try:
                for _ in steps:
                    if not run():
                        self._remove(flying[0])
                        break
            except Exception:  # JSBSim's own, of many types: the state is beyond its models
                self._remove(flying[0])

    def discharge(self, charge: Array) -> None:
        """Empty batteries to a state of charge (N,) 0..1 at once; not a number: as they are.

        Raises:
            AircraftError: if an aircraft that is to have less has no battery.
        """
        for i in np.flatnonzero(~np.isnan(charge)).tolist():
            self._models[i].discharge(float(charge[i]))

    def remove(self, rows: Truths) -> None:
        """Step these aircraft (N,) no more: they are lost, and read as now from now on."""
        for i in np.flatnonzero(rows).tolist():
            self._remove(i)

    def _remove(self, i: int) -> None:
        """Stop one; where JSBSim has lost its numbers it reads as at the start, in air of zero."""
        self._broken[i] = True
        self._flying[i] = None
        own = [k for k, of in enumerate(self._of_motion) if of == i]
        if not all(abs(self._getters[k]()) < _ABSURD for k in own):
            for k in own:
                self._getters[k] = partial(float, self._first[k])
        for k, of in enumerate(self._of_air):
            if of == i and not abs(self._air[k]()) < _ABSURD:
                self._air[k] = float

    @cached_property
    def rig(self) -> Rig:
        """The surfaces of the aircraft, for those that break."""
        return stacked([rig_of(folder) for folder in self._folders])

    def check_faults(self, row: int, name: str, faults: Iterable[Any]) -> None:
        """As `breakage.check_faults`, of the aircraft in a row of this fleet."""
        kind = self._folders[row].name
        battery = self._models[row].find(_BATTERY[0]) is not None
        check_faults(name, kind, self.rig, row, battery=battery, faults=faults)

    def bare_runs(self) -> list[Callable[[], bool]]:
        """Each aircraft's own step, for measuring what everything else costs."""
        return list(self._runs)

    def lost(self, state: VehicleState) -> Truths:
        """Which aircraft (N,) are on the ground, broken or not finite; until the next call."""
        if state is not self._looked_at:
            self._looked_at = state
            self._look_down = READY_LOST(state.position_ned, self._broken, LOWEST, self._lost)
        self._look_down()
        return self._lost
