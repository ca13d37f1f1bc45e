"""Aircraft on one clock whose flight models are compiled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.core.call_list import Call, Step
from testbed.core.compile import entry, is_interpreted, prepare
from testbed.core.errors import InputError
from testbed.core.frames import FOOT
from testbed.core.records import Array, BoolArray, ByteArray, Indices, NedOrigin, Records, Values
from testbed.vehicle.compiled import CompiledAircraft, NotTranslated
from testbed.vehicle.compiled.columns import AIR_INPUTS, START
from testbed.vehicle.compiled.proof import Proof, prove_aircraft
from testbed.vehicle.compiled.rows import write_air as write_air_numbers
from testbed.vehicle.compiled.rows import write_motion
from testbed.vehicle.fleet import FlightModels, Move, place_model
from testbed.vehicle.jsbsim_adapter import VERSION, cache_by_folder, load
from testbed.vehicle.jsbsim_io import BATTERY_PROPERTIES, CONTROLS, lead_controls, write_truth
from testbed.vehicle.trim import InitialState, TrimResult

_LEFT = 255  # status of a row that is not advanced any more
_PROOFS: dict[tuple[str, int], Proof] = {}  # by source and rate
_INITIAL_CHARGE, _CHARGE = "battery/initial-state-of-charge", BATTERY_PROPERTIES[0]


class Engine(NamedTuple):
    """What can fly an aircraft.

    Attributes:
        compiled: the compiled model; None: only JSBSim.
        reason: why, in words.
    """

    compiled: CompiledAircraft | None
    reason: str


@cache_by_folder(maxsize=64)
def find_engine(folder: Path, rate_hz: int) -> Engine:
    """Translate the aircraft in a folder, and prove that it equals the installed JSBSim.

    Raises:
        AircraftError: JSBSim cannot load the aircraft.
    """
    try:
        compiled = CompiledAircraft(folder, load(folder, rate_hz))
    except NotTranslated as error:
        return Engine(None, str(error))
    prepare([(compiled.run_rows, _example(compiled))])
    # another mass or another value of a property is another row of the same function
    key = compiled.source, rate_hz
    proof = _PROOFS.get(key) or prove_aircraft(compiled, rate_hz)
    if proof.equal:
        _PROOFS[key] = proof
    else:
        return Engine(None, f"{folder.name}: compiled, {proof.unequal}: it is flown by JSBSim")
    return Engine(
        compiled, f"{folder.name} equals JSBSim {VERSION} in {proof.compared:,} compared numbers"
    )


def _example(aircraft: CompiledAircraft) -> tuple[object, ...]:
    """Return arguments of `run_rows`, for their types."""
    numbers = (np.zeros((1, width)) for width in (len(aircraft.columns), 7, 4, 4))
    one = np.zeros(1, dtype=np.intp)
    rest = 0.1, one, one, np.zeros(1, dtype=np.uint8)
    return *numbers, np.zeros(2, dtype=bool), *rest


def find_engines(
    folders: Sequence[Path], rate_hz: int, engine: str
) -> tuple[tuple[CompiledAircraft, ...], str]:
    """Return the compiled model of each aircraft, or none where JSBSim flies all, and why.

    Args:
        folders: N of aircraft.
        rate_hz: steps per second.
        engine: "auto", "jsbsim" or "compiled".

    Raises:
        InputError: the engine is "compiled", and an aircraft cannot be.
        AircraftError: JSBSim cannot load an aircraft.
    """
    if engine == "jsbsim" or (engine == "auto" and is_interpreted()):
        return (), ""
    engines = [find_engine(each, rate_hz) for each in folders]
    for each in engines:
        if each.compiled is None:
            if engine == "compiled":
                raise InputError(f"engine: compiled: {each.reason} (write engine: auto)")
            return (), each.reason
    compiled = tuple(each.compiled for each in engines if each.compiled is not None)
    return compiled, "; ".join(dict.fromkeys(each.reason for each in engines))


class PlacedRow(NamedTuple):
    """A compiled aircraft at its start.

    Attributes:
        row: (S,) its state.
        trim: the flight that it is in.
        leads: (4,) of `control_leads`.
    """

    row: Array
    trim: TrimResult
    leads: Array


@cache_by_folder(maxsize=256)
def _place_row(folder: Path, start: InitialState, origin: NedOrigin, rate_hz: int) -> PlacedRow:
    aircraft = find_engine(folder, rate_hz).compiled
    assert aircraft is not None, "`find_engines` has returned it"
    placed = place_model(folder, start, origin, rate_hz, watch=aircraft.watch)
    return PlacedRow(aircraft.row_of(placed.model), placed.trim, placed.leads)


class CompiledRows(NamedTuple):
    """The aircraft of one kind.

    Attributes:
        aircraft: the kind.
        which: (K,) of the N.
        state: (N, S) rows; those of other kinds are not used.
    """

    aircraft: CompiledAircraft
    which: Indices
    state: Array


class CompiledFleet(FlightModels):
    """N aircraft that are rows of arrays, which compiled functions step."""

    engine = "compiled"

    def __init__(
        self,
        aircraft: Sequence[CompiledAircraft],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        base_rate_hz: int,
    ) -> None:
        """Trim and place the aircraft in JSBSim, and take over their states.

        Args:
            aircraft: N, of `find_engines`.
            starts: N initial states.
            origin: of the local frame; its elevation is the terrain's.
            base_rate_hz: steps per second.

        Raises:
            TrimError: see `place_model`.
        """
        folders, n = [each.folder for each in aircraft], len(aircraft)
        placed = [
            _place_row(each.folder, start, origin, base_rate_hz)
            for each, start in zip(aircraft, starts, strict=True)
        ]
        self._dt, self._kinds = 1.0 / base_rate_hz, list[CompiledRows]()
        for kind in dict.fromkeys(aircraft):
            which = np.array([i for i, each in enumerate(aircraft) if each is kind])
            state = np.zeros((n, len(kind.columns)))
            state[which] = [placed[i].row for i in which.tolist()]
            self._kinds.append(CompiledRows(kind, which, state))
        self._status = np.zeros(n, dtype=np.uint8)
        self._steps = np.ones(1, dtype=np.intp)
        trims, leads = [each.trim for each in placed], [each.leads for each in placed]
        super().__init__(folders, starts, origin, trims, leads)

    @property
    def kinds(self) -> tuple[CompiledRows, ...]:
        """The aircraft of each kind, with the rows of their states."""
        return tuple(self._kinds)

    def _run_arguments(self, kind: CompiledRows, which: Indices, steps: Indices) -> tuple[Any, ...]:
        """Return the arguments of `run_rows` for some aircraft (K,) of a kind."""
        inputs = self._wind_numbers, self._controls, self._first_controls, self._changed
        return (kind.state, *inputs, self._dt, steps, which, self._status)

    def move_steps(self, move: Move) -> tuple[Step, ...]:
        """See `FlightModels`."""
        leads = self._controls, self._lead, self.last_controls, self._first_controls
        motion = self._numbers, self._frame, self.aircraft
        run, write = list[Call](), list[Call]()
        for each in self._kinds:
            arguments = self._run_arguments(each, each.which, move.steps)
            run.append(Call(each.aircraft.run_rows, *arguments))
            rows = each.state, each.which, self.rows, move.needed
            write.append(Call(_write_needed, *rows, *motion))
        lead = Call(_lead_changed, *leads, self.all_rows, self._changed)
        end = Call(_end_steps, self._changed, self._status)
        return (lead, *run, *write, (end, lambda now: self._stop_ended()))

    @property
    def air_steps(self) -> tuple[Step, ...]:
        """See `FlightModels`."""
        read = []
        for each in self._kinds:
            rows = each.state, each.which, self._status
            read.append(Call(_read_air, *rows, each.aircraft.air_columns, self._air_numbers))
        return (*read, self._write_air_call)

    @property
    def no_gust_inputs(self) -> BoolArray:
        """See `FlightModels`."""
        missing = np.zeros(len(self.all_rows), dtype=bool)
        for each in self._kinds:
            missing[each.which] = any(name not in each.aircraft.columns for name in AIR_INPUTS)
        return missing

    def discharge(self, charge: Array) -> None:
        """See `FlightModels`."""
        for each in self._kinds:
            columns = each.aircraft.columns
            for i in each.which[~np.isnan(charge[each.which])].tolist():
                row = each.state[i]
                more = float(charge[i]) - row[columns[_CHARGE]]
                row[columns[_INITIAL_CHARGE]] += min(more, 0.0)

    def displace(self, shift_ned: Array) -> None:
        """See `FlightModels`."""
        at = START["position"]
        for each in self._kinds:
            for i in each.which.tolist():
                row = each.state[i]
                to_inertial = _inertial_from_ned(self._origin, float(row[START["earth_angle"]]))
                row[at : at + 3] += to_inertial @ shift_ned[i] / FOOT
        self.write_motion()

    def _run_models(self, which: Indices, ticks: int, read: Indices) -> None:
        if self._changed[CONTROLS]:
            self._lead_controls(which)
        self._steps[0] = ticks
        for each in self._kinds:
            own = np.intersect1d(each.which, which)
            each.aircraft.run_rows(*self._run_arguments(each, own, self._steps))
        self._changed[:] = False
        self._stop_ended()
        self._read_numbers(read)

    def _stop_ended(self) -> None:
        """Stop the aircraft that have left the range of their models."""
        for i in np.flatnonzero((self._status != 0) & ~self._stopped).tolist():
            self._stop(i)

    def _read_numbers(self, which: Iterable[int]) -> None:
        wanted = np.array([i for i in which if self._status[i] != _LEFT], dtype=np.intp)
        for each in self._kinds:
            write_motion(each.state, np.intersect1d(each.which, wanted), self._numbers)

    def _read_air_numbers(self, which: Iterable[int]) -> None:
        wanted = np.array([i for i in which if self._status[i] != _LEFT], dtype=np.intp)
        for each in self._kinds:
            own = np.intersect1d(each.which, wanted)
            write_air_numbers(each.state, own, each.aircraft.air_columns, self._air_numbers)

    def _leave(self, which: Iterable[int]) -> None:
        self._status[list(which)] = _LEFT


def _inertial_from_ned(origin: NedOrigin, earth_angle: float) -> Array:
    """Return the rotation (3, 3) of vectors at the origin to inertial axes."""
    lat, lon = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg) + earth_angle
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-co * sl, -so, -co * cl], [-so * sl, co, -so * cl], [cl, 0.0, -sl]])


@entry
def _lead_changed(
    controls: Array, lead: Array, last: Array, first: Array, which: Indices, changed: BoolArray
) -> None:
    """Write the controls of the first step where controls have changed; see `lead_controls`."""
    if changed[CONTROLS]:
        lead_controls(controls, lead, last, first, which)


@entry
def _write_needed(
    state: Array,
    which: Indices,
    rows: Indices,
    needed: BoolArray,
    numbers: Array,
    frame: Values,
    aircraft: Records,
) -> None:
    """Write the motion of those of the aircraft (K,) that is needed.

    Args:
        state: (M, S) rows.
        which: (K,) of the M rows.
        rows: (M,) of the flight models among the aircraft.
        needed: (N,) aircraft.
        numbers: (M, 17) see `write_truth`; written.
        frame: see there.
        aircraft: (N,) of AIRCRAFT; `truth` is written.
    """
    one = np.empty(1, dtype=np.intp)
    for i in which:
        if needed[rows[i]] and not aircraft[rows[i]].stopped:
            one[0] = i
            write_motion(state, one, numbers)
            write_truth(rows, numbers, frame, aircraft, one)


@entry
def _end_steps(changed: BoolArray, status: ByteArray) -> bool:
    """Set the inputs as used; return whether a row has left the range of its model."""
    changed[:] = False
    for i in range(len(status)):
        if status[i] != 0 and status[i] != _LEFT:
            return True
    return False


@entry
def _read_air(
    state: Array, which: Indices, status: ByteArray, columns: Indices, numbers: Array
) -> None:
    """Write the air data and batteries of the aircraft (K,) that fly; see `rows.write_air`."""
    one = np.empty(1, dtype=np.intp)
    for i in which:
        if status[i] != _LEFT:
            one[0] = i
            write_air_numbers(state, one, columns, numbers)
