"""Aircraft on one clock whose flight models are compiled."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.airframes.powerplant import AircraftError
from testbed.compiled import CompiledAircraft, NotTranslated
from testbed.compiled.columns import AIR_INPUTS, START
from testbed.compiled.compiled_aircraft import translate_model
from testbed.compiled.proof import Proof, prove_aircraft
from testbed.compiled.rows import write_air as write_air_numbers
from testbed.compiled.rows import write_motion
from testbed.compiled.translate import Translation
from testbed.core.call_list import Call, Step
from testbed.core.compile import Progress, current_progress, entry, is_interpreted, prepare
from testbed.core.errors import InputError, raise_memory_shortage
from testbed.core.frames import FOOT
from testbed.core.records import Array, BoolArray, ByteArray, Indices, NedOrigin, Records, Values
from testbed.vehicle.fleet import FlightModels, Move, place_model
from testbed.vehicle.folder_results import cache_by_folder
from testbed.vehicle.jsbsim_adapter import VERSION, load
from testbed.vehicle.jsbsim_io import BATTERY_PROPERTIES, CONTROLS, lead_controls, write_truth
from testbed.vehicle.trim import InitialState, TrimResult

_MOST_REASONS = 20  # in an error
_MAX_REASON = 300  # characters of another library's error
_LEFT = 255  # status of a row that is not advanced any more
_PROOFS: dict[tuple[str, int], Proof] = {}  # by source and rate
_INITIAL_CHARGE, _CHARGE = "battery/initial-state-of-charge", BATTERY_PROPERTIES[0]


ENGINE_REMEDY = " (write engine: auto, and JSBSim flies the aircraft)"


class NotCompiledError(InputError):
    """An aircraft is not compiled where the engine is "compiled"; the text ends with the remedy."""


class Engine(NamedTuple):
    """What can fly an aircraft.

    Attributes:
        compiled: the compiled model; None: only JSBSim.
        reasons: why, one or more.
    """

    compiled: CompiledAircraft | None
    reasons: tuple[str, ...]


@cache_by_folder(64)
def find_engine(folder: Path, rate_hz: int) -> Engine:
    """Translate the aircraft in a folder, and prove that it equals the installed JSBSim.

    Whatever cannot be translated, compiled or proved is a reason for JSBSim.

    Raises:
        AircraftError: JSBSim cannot load the aircraft.
    """
    try:
        with _as_reasons(f"{folder.name}: cannot be translated"):
            compiled = CompiledAircraft(folder, _translation(folder, rate_hz))
        with _as_reasons(f"{folder.name}: cannot be compiled"):
            prepare([(compiled.run_rows, _example(compiled))], _guarded(current_progress()))
        with _as_reasons(f"{folder.name}: cannot be compared with JSBSim {VERSION}"):
            # another mass or another value of a property is another row of the same function
            key = compiled.source, rate_hz
            proof = _PROOFS.get(key) or prove_aircraft(compiled, rate_hz)
            if not proof.equal:
                raise NotTranslated(f"{folder.name}: compiled, {proof.unequal}")
    except NotTranslated as error:
        return Engine(None, tuple(str(error).splitlines()))
    _PROOFS[key] = proof
    compared = f"{proof.compared:,} compared numbers"
    return Engine(compiled, (f"{folder.name} equals JSBSim {VERSION} in {compared}",))


@cache_by_folder(64, kept=Translation)
def _translation(folder: Path, rate_hz: int) -> Translation:
    return translate_model(folder, load(folder, rate_hz))


def untranslated(folder: Path, rate_hz: int) -> tuple[str, ...]:
    """Return why the aircraft in a folder cannot be translated; none: it can.

    Such an aircraft is still compared with JSBSim before it flies compiled.

    Raises:
        AircraftError: JSBSim cannot load the aircraft.
    """
    try:
        with _as_reasons(f"{folder.name}: cannot be translated"):
            _translation(folder, rate_hz)
    except NotTranslated as error:
        return tuple(str(error).splitlines())
    return ()


class _ProgressFailed(Exception):  # noqa: N818 - carries the error of a user's function
    """An error of the function that shows progress, which is no fault of an aircraft."""


def _guarded(progress: Progress | None) -> Progress | None:
    """Return a progress function whose errors differ from those of compiling."""
    if progress is None:
        return None

    def show(done: int, total: int) -> None:
        try:
            progress(done, total)
        except Exception as error:
            raise _ProgressFailed from error

    return show


@contextmanager
def _as_reasons(where: str) -> Iterator[None]:
    """Turn any error in the block into NotTranslated.

    Raises:
        NotTranslated: the block has failed.
        AircraftError: JSBSim cannot load the aircraft.
        MemoryError: for lack of memory, which JSBSim needs, too.
    """
    try:
        yield
    except (NotTranslated, AircraftError):
        raise
    except _ProgressFailed as error:
        assert error.__cause__ is not None, "it has the error that was raised"
        raise error.__cause__ from None
    except Exception as error:
        raise_memory_shortage(error)
        text = " ".join(str(error).split())[:_MAX_REASON]
        raise NotTranslated(f"{where} ({type(error).__name__}: {text})") from error


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
    missing = [why for each in engines if each.compiled is None for why in each.reasons]
    if missing:
        return (), _fall_back(missing, engine)
    compiled = tuple(each.compiled for each in engines if each.compiled is not None)
    return compiled, "; ".join(dict.fromkeys(why for each in engines for why in each.reasons))


def _fall_back(reasons: Sequence[str], engine: str) -> str:
    """Return why JSBSim flies the aircraft, in a line.

    Raises:
        NotCompiledError: the engine is "compiled".
    """
    reasons = list(dict.fromkeys(reasons))
    if engine == "compiled":
        shown = "\n".join(reasons[:_MOST_REASONS])
        more = len(reasons) - _MOST_REASONS
        last = f"\nand {more} more" if more > 0 else ""
        raise NotCompiledError(f"engine: compiled: {shown}{last}{ENGINE_REMEDY}")
    return f"{'; '.join(reasons)}; the aircraft is flown by JSBSim"


def make_compiled_fleet(
    folders: Sequence[Path],
    starts: Sequence[InitialState],
    origin: NedOrigin,
    rate_hz: int,
    engine: str,
) -> tuple[CompiledFleet | None, str]:
    """Make a fleet of compiled aircraft, or none where JSBSim flies all, and the reason in words.

    Args:
        folders: N of aircraft.
        starts: N initial states.
        origin: of the local frame; its elevation is the terrain's.
        rate_hz: steps per second.
        engine: "auto", "jsbsim" or "compiled".

    Raises:
        InputError: the engine is "compiled", and an aircraft cannot be, or not from its start.
        AircraftError, TrimError: of an aircraft and its start.
    """
    compiled, reason = find_engines(folders, rate_hz, engine)
    if not compiled:
        return None, reason
    try:
        return CompiledFleet(compiled, starts, origin, rate_hz), reason
    except NotTranslated as error:  # as of a filter that starts at its limit
        return None, _fall_back(str(error).splitlines(), engine)


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


@cache_by_folder(256, kept=PlacedRow)
def place_row(folder: Path, start: InitialState, origin: NedOrigin, rate_hz: int) -> PlacedRow:
    """Trim an aircraft in JSBSim, and take over its state as a row; it is cached.

    Args:
        folder: of the aircraft.
        start: initial state.
        origin: of the local frame; its elevation is the terrain's.
        rate_hz: steps per second.

    Raises:
        TrimError: see `place_model`.
        NotTranslated: only JSBSim flies the aircraft, or from its start; with the reasons.
    """
    aircraft, reasons = find_engine(folder, rate_hz)
    if aircraft is None:
        raise NotTranslated("\n".join(reasons))
    placed = place_model(folder, start, origin, rate_hz, watch=aircraft.watch)
    with _as_reasons(f"{folder.name}: its start cannot be compiled"):
        row = aircraft.row_of(placed.model)
    return PlacedRow(row, placed.trim, placed.leads)


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
            NotTranslated: only JSBSim flies an aircraft from its start.
        """
        folders, n = [each.folder for each in aircraft], len(aircraft)
        placed = [
            place_row(each.folder, start, origin, base_rate_hz)
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
        for each, own in self._among(which):
            write_motion(each.state, own, self._numbers)

    def _read_air_numbers(self, which: Iterable[int]) -> None:
        for each, own in self._among(which):
            write_air_numbers(each.state, own, each.aircraft.air_columns, self._air_numbers)

    def _among(self, which: Iterable[int]) -> Iterator[tuple[CompiledRows, Indices]]:
        """Yield each kind, with those of its rows that are wanted and have not left."""
        # np.intersect1d takes ten times as long for a few rows
        wanted = {int(i) for i in which if self._status[i] != _LEFT}
        for each in self._kinds:
            yield each, np.array([i for i in each.which.tolist() if i in wanted], dtype=np.intp)

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
