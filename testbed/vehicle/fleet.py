"""JSBSim aircraft on one clock: placed in trim, stepped and read.

`jsbsim_model` and `jsbsim_io` convert JSBSim's units and signs. Aircraft open no sockets, write no
files and print nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from testbed.core.call_list import Call, Step
from testbed.core.compile import bind_entry
from testbed.core.errors import raise_memory_shortage
from testbed.core.geodetic import RADIANS, local_frame
from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    AirData,
    Array,
    BoolArray,
    Indices,
    NedOrigin,
    Records,
    VehicleState,
    WindInput,
    air_data,
    allocate,
    fields_of,
)
from testbed.vehicle.control_surfaces import ControlGeometry, check_faults, stack_geometry
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.jsbsim_adapter import airframe, control_geometry, load, trim_aircraft
from testbed.vehicle.jsbsim_io import (
    AIR_PROPERTIES,
    BATTERY_PROPERTIES,
    CONTROLS,
    MOTION_PROPERTIES,
    WIND,
    control_leads,
    lead_controls,
    pack_surfaces,
    pack_wind,
    write_air,
    write_truth,
)
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.trim import InitialState, TrimPoint, TrimResult, course_through_air

LOWEST = 1.0  # m above the terrain: an aircraft without flight model counts as on the ground
_GROUND_MARGIN = 2.0  # m, more than an aircraft descends between two ticks of the autopilots
_IMPLAUSIBLE = 1e9  # ft, ft/s², rad, rpm: no aircraft in flight reads this
_WIND = 7  # numbers of `pack_wind`
_PACK_MOTION = Struct(f"{len(MOTION_PROPERTIES)}d").pack_into  # numpy converts a list slower

Setter = Callable[[float], None]
Getter = Callable[[], float]


def lowest_height(folder: Path) -> float:
    """Return the height above the terrain below which the ground may touch an aircraft, m.

    Aircraft are lost there: the forces of the ground are no part of a flight.
    """
    return airframe(folder).contact_radius + _GROUND_MARGIN


class Move(NamedTuple):
    """How far vehicles move at a tick.

    Attributes:
        steps: (1,) of the base rate.
        needed: (N,) aircraft of the run whose `truth` is then written.
    """

    steps: Indices
    needed: BoolArray


class PlacedModel(NamedTuple):
    """An aircraft in JSBSim at its start.

    Attributes:
        model: of JSBSim.
        trim: the flight that it is in.
        leads: (4,) of `control_leads`.
    """

    model: JsbsimModel
    trim: TrimResult
    leads: Array


def place_model(
    folder: Path,
    start: InitialState,
    origin: NedOrigin,
    base_rate_hz: int,
    integrators: Integrators = INTEGRATORS,
    watch: Callable[[JsbsimModel], None] = lambda model: None,
) -> PlacedModel:
    """Load the aircraft in a folder, trim it and place it.

    Args:
        folder: holding `<folder name>.xml`.
        start: initial state.
        origin: of the local frame; its elevation is the terrain's.
        base_rate_hz: steps per second.
        integrators: of the flight model.
        watch: called with the model before it is placed.

    Raises:
        AircraftError, TrimError: the aircraft cannot be loaded, has no steady flight at its start,
            or cannot hold its course in the wind.
    """
    altitude = origin.elevation_m - start.position_ned[2]
    point = TrimPoint(
        start.airspeed,
        start.flight_path_angle,
        start.bank,
        altitude,
        start.state_of_charge,
        start.cells,
        start.temperature_offset,
    )
    trimmed = trim_aircraft(folder, point, origin)
    model = load(folder, base_rate_hz, integrators)
    model.locate(start.position_ned, origin)
    model.warm(start.temperature_offset)
    model.power.set_cells(start.cells)
    model.power.charge(start.state_of_charge)
    watch(model)
    level = start.airspeed * math.cos(trimmed.flight_path_angle)
    model.place(
        trimmed.placement,
        trimmed.controls,
        course=course_through_air(level, start.course, start.wind_ned),
        wind_ned=start.wind_ned,
        spin=True,
    )
    if start.fuel_burn:
        model.power.check_fuel()
    model.fly(burn=start.fuel_burn)
    leads = control_leads(integrators.control_lead, surfaces_lag=model.lags_by_step)
    return PlacedModel(model, trimmed, leads)


class FlightModels:
    """N aircraft on one clock, each with a flight model.

    They read and write records: their own ones, or those of a run after `bind`.

    Attributes:
        engine: name of what steps them, see the key `engine` of a scenario.
        engine_reason: why, where the scenario leaves it open.
        trims: N, of their starts.
        write_wind: gives the wind of the records to the flight models, for their next run.
        write_surfaces: gives the surfaces of the records to the flight models, the same.
    """

    engine: str
    engine_reason = ""

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        trims: Sequence[TrimResult],
        leads: Sequence[Array],
    ) -> None:
        """Start in trim.

        Args:
            folders: N aircraft folders.
            starts: N initial states.
            origin: of the local frame.
            trims: N, of the starts.
            leads: N of (4,), of `control_leads`.
        """
        n = len(folders)
        self._start_winds = [start.wind_ned for start in starts]
        self.trims = tuple(trims)
        self._folders = [Path(folder).resolve() for folder in folders]
        self._origin, self._frame = origin, tuple(local_frame(origin, RADIANS))
        # in JSBSim's units
        self._numbers = np.empty((n, len(MOTION_PROPERTIES)))
        self._air_numbers = np.full((n, len(AIR_PROPERTIES) + len(BATTERY_PROPERTIES)), np.nan)
        self._wind_numbers, self._controls = np.zeros((n, _WIND)), np.zeros((n, 4))
        self._first_controls, self.last_controls = np.zeros((n, 4)), np.zeros((n, 4))
        self._lead = np.stack(leads)
        self.all_rows = np.arange(n)
        self._stopped: BoolArray = np.zeros(n, dtype=bool)
        self._changed: BoolArray = np.zeros(2, dtype=bool)  # inputs, since the models ran
        self._read_numbers(range(n))
        self._first = self._numbers.copy()
        self.bind(allocate(AIRCRAFT, n), self.all_rows)
        self._without_air = np.isnan(self._air_numbers)  # as of aircraft without a propeller
        self.write_surfaces(0.0)
        self._changed[:] = False
        self.last_controls[:] = self._controls

    def describe_engine(self) -> str:
        """Describe what steps the flight models, and why, in a line."""
        return f"{self.engine} ({self.engine_reason})" if self.engine_reason else self.engine

    def bind(self, aircraft: Records, rows: Indices) -> None:
        """Read and write these rows (N,) of AIRCRAFT from now on; they begin in trim."""
        self.aircraft, self.rows = aircraft, rows
        self._write_truth = bind_entry(
            write_truth, rows, self._numbers, self._frame, aircraft, like=(self.all_rows,)
        )
        self._write_air_call = Call(write_air, rows, self._air_numbers, aircraft)
        changed = self._changed
        self.write_wind = Call(pack_wind, rows, aircraft, self._wind_numbers, changed)
        self.write_surfaces = Call(pack_surfaces, rows, aircraft, self._controls, changed)
        controls = self._controls, self._lead, self.last_controls, self._first_controls
        self._lead_controls = bind_entry(lead_controls, *controls, like=(self.all_rows,))
        write_fields_at(aircraft, rows, "surfaces", self.trimmed)
        aircraft["wind"]["wind_ned"][rows] = self._start_winds
        self._write_truth(self.all_rows)
        self.read_air()

    @property
    def trimmed(self) -> ActuatorCommand:
        """Return the controls that hold the aircraft in trim at their starts."""
        held = (trimmed.controls for trimmed in self.trims)
        each = [(one.aileron, one.elevator, one.rudder, one.throttle) for one in held]
        return ActuatorCommand(*np.array(each).T.copy())

    @property
    def no_gust_inputs(self) -> BoolArray:
        """Which aircraft (N,) lack an input for rotations of the air."""
        raise NotImplementedError

    def read(self) -> VehicleState:
        """Copy the truth."""
        return VehicleState(
            *(each[self.rows] for each in fields_of(VehicleState, self.aircraft["truth"]))
        )

    def write_motion(self) -> None:
        """Write the present motion of all models that have not stopped into the records."""
        self._read_numbers(range(len(self._numbers)))
        self._write_truth(self.all_rows)

    def read_air(self) -> None:
        """Write flow angles, propeller speeds and battery states of the models to the records."""
        self._read_air_numbers(range(len(self._numbers)))
        self._write_air_call(0.0)

    def air(self) -> AirData:
        """Read the flight models, and copy the air data."""
        self.read_air()
        return AirData(*(each[self.rows] for each in air_data(self.aircraft)))

    @property
    def air_steps(self) -> tuple[Step, ...]:
        """Return the steps of `read_air`."""
        return (lambda now: self.read_air(),)

    def move_steps(self, move: Move) -> tuple[Step, ...]:
        """Return the steps that run every aircraft, and write the motion that is needed."""
        rows: dict[bytes, Indices] = {}

        def run(now: float) -> None:
            key = move.needed.tobytes()
            if key not in rows:
                rows[key] = np.flatnonzero(move.needed[self.rows])
            self.run(int(move.steps[0]), rows[key])

        return (run,)

    def set_wind(self, wind: WindInput) -> None:
        """Set the wind (N) that acts on the aircraft from now on."""
        write_fields_at(self.aircraft, self.rows, "wind", wind)
        self.write_wind(0.0)

    def step(self, surfaces: ActuatorCommand | None, ticks: int) -> None:
        """Command surfaces (N), if any, run every aircraft for some ticks, and read them."""
        if surfaces is not None:
            write_fields_at(self.aircraft, self.rows, "surfaces", surfaces)
            self.write_surfaces(0.0)
        self.run(ticks, self.all_rows)

    def run(self, ticks: int, read: Indices) -> None:
        """Run every aircraft for some ticks of the base rate.

        Args:
            ticks: how many.
            read: (K,) aircraft whose motion is then written into the records.
        """
        self._run_all(ticks, read)
        self._write_truth(read)

    def run_some(self, which: Indices, ticks: int) -> None:
        """Run some aircraft (K,) in this process, and write their motion into the records."""
        wind_changed = self._changed[WIND]
        self._run_models(which, ticks, self.all_rows)
        self._changed[WIND] = wind_changed  # of those that have not run yet
        self._write_truth(which)

    def discharge(self, charge: Array) -> None:
        """Empty batteries to a state of charge (N,) 0..1; NaN: no change.

        Raises:
            AircraftError: an aircraft to be discharged has no battery.
        """
        raise NotImplementedError

    def displace(self, shift_ned: Array) -> None:
        """Move all aircraft by (N, 3) m, without a change of their velocities."""
        raise NotImplementedError

    def remove(self, rows: BoolArray) -> None:
        """Stop stepping lost aircraft (N,); they keep their last motion."""
        for i in np.flatnonzero(rows & ~self._stopped).tolist():
            self._stop(i)

    def _run_all(self, ticks: int, read: Indices) -> None:
        self._run_models(self.all_rows, ticks, read)

    def _run_models(self, which: Indices, ticks: int, read: Indices) -> None:
        """Run models (K,) with their inputs for some ticks; read the motion of some aircraft."""
        raise NotImplementedError

    def _read_numbers(self, which: Iterable[int]) -> None:
        """Read the motion of some aircraft that have not stopped."""
        raise NotImplementedError

    def _read_air_numbers(self, which: Iterable[int]) -> None:
        """Read the air data and batteries of some aircraft that have not stopped."""
        raise NotImplementedError

    def _leave(self, which: Iterable[int]) -> None:
        """Neither step nor read these aircraft any more."""
        raise NotImplementedError

    def _stop(self, i: int) -> None:
        """Stop an aircraft; implausible numbers of its model are replaced by those of the start."""
        self._stopped[i] = True
        self._read_numbers([i])
        if not (np.abs(self._numbers[i]) < _IMPLAUSIBLE).all():
            self._numbers[i] = self._first[i]
        self._read_air_numbers([i])
        flow = slice(len(AIR_PROPERTIES))
        air, without = self._air_numbers[i, flow], self._without_air[i, flow]
        air[~((np.abs(air) < _IMPLAUSIBLE) | without)] = 0.0
        self._leave([i])
        self.aircraft[self.rows[i]]["stopped"] = True

    @cached_property
    def lowest_m(self) -> Array:
        """Return the height (N,) above the terrain below which each counts as on the ground, m."""
        return np.array([lowest_height(folder) for folder in self._folders])

    @cached_property
    def geometry(self) -> ControlGeometry:
        """Return the control surfaces of the aircraft."""
        return stack_geometry([control_geometry(folder) for folder in self._folders])

    def check_faults(self, row: int, name: str, faults: Iterable[Any]) -> None:
        """Check faults as `control_surfaces.check_faults` does, for one aircraft of this fleet."""
        kind = self._folders[row].name
        battery = not np.isnan(self._air_numbers[row, -1])
        engine = self.trims[row].has_engine
        check_faults(name, kind, self.geometry, row, engine=engine, battery=battery, faults=faults)

    def lost(self, state: VehicleState) -> BoolArray:
        """Return which aircraft (N,) are on the ground or have stopped."""
        lost: BoolArray = self._stopped | ~(-state.position_ned[:, 2] >= self.lowest_m)
        return lost


class JsbsimFleet(FlightModels):
    """N aircraft that JSBSim steps."""

    engine = "jsbsim"

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        base_rate_hz: int,
        integrators: Integrators = INTEGRATORS,
    ) -> None:
        """Load, trim and place the aircraft; see `place_model` and `FlightModels`."""
        placed = [
            place_model(folder, start, origin, base_rate_hz, integrators)
            for folder, start in zip(folders, starts, strict=True)
        ]
        self._models = models = [each.model for each in placed]
        # None: the aircraft is lost, or another process steps it
        self._runs: list[Callable[[], bool] | None] = list(self.bare_runs())
        self._getters: list[list[Getter]] = [
            [model.node(name).get_double_value for name in MOTION_PROPERTIES] for model in models
        ]
        self._air_getters: list[list[Getter | None]] = [
            [_getter(model.find(name)) for name in (*AIR_PROPERTIES, *BATTERY_PROPERTIES)]
            for model in models
        ]
        self._wind_setters: list[list[Setter]] = [
            [node.set_double_value for node in (*model.winds, *(model.turns or ()))]
            for model in models
        ]
        self._setters: list[list[Setter]] = [list(model.controls) for model in models]
        trims, leads = [each.trim for each in placed], [each.leads for each in placed]
        super().__init__(folders, starts, origin, trims, leads)

    @property
    def no_gust_inputs(self) -> BoolArray:
        """See `FlightModels`."""
        return np.array([not model.turns for model in self._models])

    def bare_runs(self) -> list[Callable[[], bool]]:
        """Return each aircraft's own step, for measuring what everything else costs."""
        return [model.fdm.run for model in self._models]

    def discharge(self, charge: Array) -> None:
        """See `FlightModels`."""
        for i in np.flatnonzero(~np.isnan(charge)).tolist():
            self._models[i].power.discharge(float(charge[i]))

    def displace(self, shift_ned: Array) -> None:
        """See `FlightModels`."""
        for model, shift in zip(self._models, shift_ned.tolist(), strict=True):
            model.displace(shift, self._origin)
        self.write_motion()

    def _run_models(self, which: Indices, ticks: int, read: Indices) -> None:
        """See `FlightModels`.

        One model after the other, each from end to end: its memory is then in the cache.
        """
        numbers, getters, pack = self._numbers, self._getters, _PACK_MOTION
        needed = None if len(read) == len(numbers) else set(read.tolist())
        winds = self._wind_numbers.tolist() if self._changed[WIND] else None
        controls = first = None
        if self._changed[CONTROLS]:
            self._lead_controls(which)
            controls, first = self._controls.tolist(), self._first_controls.tolist()
        self._changed[:] = False
        for i in which.tolist():
            run, setters = self._runs[i], self._setters[i]
            if run is None:
                continue
            if winds is not None:
                for set_value, value in zip(self._wind_setters[i], winds[i], strict=False):
                    set_value(value)
            if first is not None:
                _set_all(setters, first[i])
            try:
                for tick in range(ticks):
                    if not run():
                        self._stop(i)
                        break
                    if controls is not None and tick == 0:
                        _set_all(setters, controls[i])
            except Exception as error:  # JSBSim's own, of many types: beyond its models
                raise_memory_shortage(error)
                self._stop(i)
            if (needed is None or i in needed) and (of_model := getters[i]):
                pack(numbers[i], 0, *[get() for get in of_model])

    def _read_numbers(self, which: Iterable[int]) -> None:
        numbers = self._numbers
        for i in which:
            if getters := self._getters[i]:
                numbers[i] = [get() for get in getters]

    def _read_air_numbers(self, which: Iterable[int]) -> None:
        numbers = self._air_numbers
        for i in which:
            if getters := self._air_getters[i]:
                numbers[i] = [math.nan if get is None else get() for get in getters]

    def _leave(self, which: Iterable[int]) -> None:
        for i in which:
            self._runs[i] = None
            for nodes in (self._getters, self._air_getters, self._setters, self._wind_setters):
                nodes[i] = []


def _set_all(setters: Sequence[Setter], values: Sequence[float]) -> None:
    aileron, elevator, rudder, throttle = setters  # faster than a loop
    aileron(values[0])
    elevator(values[1])
    rudder(values[2])
    throttle(values[3])


def write_fields_at(records: Records, rows: Indices, name: str, values: Any) -> None:  # noqa: ANN401
    """Copy the arrays (M) of a named tuple into a nested record of these rows."""
    for field, array in zip(values._fields, values, strict=True):
        records[name][field][rows] = array


def _getter(node: Any) -> Getter | None:  # noqa: ANN401 - JSBSim's
    return None if node is None else node.get_double_value
