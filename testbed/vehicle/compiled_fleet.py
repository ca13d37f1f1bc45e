"""Aircraft on one clock whose flight models are compiled, or JSBSim's where they cannot be."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.core.call_list import Call, Step
from testbed.core.compile import bind_entry, entry, is_interpreted, prepare
from testbed.core.errors import InputError
from testbed.core.records import Array, BoolArray, ByteArray, Indices, NedOrigin, Records, Values
from testbed.vehicle.compiled import CompiledAircraft, NotTranslated
from testbed.vehicle.compiled.columns import START
from testbed.vehicle.compiled.proof import prove_aircraft
from testbed.vehicle.compiled.rows import write_air as write_air_numbers
from testbed.vehicle.compiled.rows import write_motion
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.fleet import FlightModel, JsbsimFleet, place_model
from testbed.vehicle.jsbsim_adapter import VERSION, cache_by_folder, load, trim_aircraft
from testbed.vehicle.jsbsim_io import CONTROLS, lead_controls, write_air, write_truth
from testbed.vehicle.trim import InitialState, TrimResult

_STOPPED = 255  # status of a row that is not advanced any more
_NO_CLEARANCE = -math.inf  # aircraft are lost before they touch the ground: `Airframe`
_INITIAL_CHARGE, _CHARGE = "battery/initial-state-of-charge", "battery/state-of-charge"


class Engine(NamedTuple):
    """What flies an aircraft.

    Attributes:
        compiled: the compiled model; None: JSBSim.
        reason: why, in words.
    """

    compiled: CompiledAircraft | None
    reason: str

    @property
    def name(self) -> str:
        """Name of the engine, as the key `engine` has it."""
        return "jsbsim" if self.compiled is None else "compiled"


@cache_by_folder(maxsize=64)
def find_engine(folder: Path, rate_hz: int, integrators: Integrators = INTEGRATORS, /) -> Engine:
    """Translate the aircraft in a folder, and prove that it equals the installed JSBSim.

    Raises:
        AircraftError: JSBSim cannot load the aircraft.
    """
    try:
        compiled = CompiledAircraft(folder, load(folder, rate_hz, integrators), integrators)
    except NotTranslated as error:
        return Engine(None, str(error))
    prepare([(compiled.run_rows, compiled.example)])
    proof = prove_aircraft(compiled, rate_hz)
    if not proof.equal:
        return Engine(None, f"{folder.name}: compiled, {proof.unequal}; it is flown by JSBSim")
    return Engine(
        compiled, f"equal to JSBSim {VERSION} in all of {proof.compared:,} compared numbers"
    )


def choose_engines(
    folders: Sequence[Path],
    rate_hz: int,
    engine: str,
    integrators: Integrators = INTEGRATORS,
) -> list[Engine]:
    """Return what flies each aircraft.

    Args:
        folders: N of aircraft.
        rate_hz: steps per second.
        engine: "auto", "jsbsim" or "compiled".
        integrators: of the flight models.

    Raises:
        InputError: the engine is "compiled", and an aircraft cannot be.
    """
    if engine == "jsbsim" or (engine == "auto" and is_interpreted()):
        return [Engine(None, "") for _ in folders]
    found = [find_engine(each, rate_hz, integrators) for each in folders]
    for each in found:
        if engine == "compiled" and each.compiled is None:
            raise InputError(f"engine: compiled: {each.reason} (write engine: auto)")
    return found


class _Group(NamedTuple):
    """Rows of a fleet that are of one kind of aircraft.

    Attributes:
        aircraft: the kind.
        rows: (G,) of the fleet.
        state: (M, S) rows of the kind; those of other aircraft are not used.
    """

    aircraft: CompiledAircraft
    rows: Indices
    state: Array


class _Placed(NamedTuple):
    """An aircraft at its start: the state (S,) of its row, and what JSBSim says of it."""

    row: Array
    model: FlightModel


@cache_by_folder(maxsize=256)
def _place_row(
    folder: Path,
    start: InitialState,
    origin: NedOrigin,
    rate_hz: int,
    integrators: Integrators,
    /,
) -> _Placed:
    compiled = find_engine(folder, rate_hz, integrators).compiled
    assert compiled is not None, "only aircraft that are compiled have rows"
    model = place_model(folder, start, origin, rate_hz, integrators, watch=compiled.watch)
    return _Placed(compiled.row_of(model.jsbsim), model._replace(jsbsim=None))


class CompiledFleet(JsbsimFleet):
    """N aircraft on one clock, of which those with a compiled model are rows of arrays.

    Args:
        engines: N, of `choose_engines`.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        base_rate_hz: int,
        integrators: Integrators = INTEGRATORS,
        *,
        engines: Sequence[Engine],
    ) -> None:
        """See `JsbsimFleet`."""
        self._dt, self._rows_of_start = 1.0 / base_rate_hz, list[Array | None]()
        self._engines = engines
        n = len(folders)
        self._status = np.zeros(n, dtype=np.uint8)
        self._steps = np.ones(1, dtype=np.intp)
        self._groups: list[_Group] = []
        self._is_compiled = np.array([each.compiled is not None for each in engines])
        super().__init__(folders, starts, origin, base_rate_hz, integrators)

    def _load_models(
        self,
        folders: Sequence[Path],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        base_rate_hz: int,
        integrators: Integrators,
    ) -> list[FlightModel]:
        models, states = [], dict[int, Array]()
        for i, (folder, start, engine) in enumerate(
            zip(folders, starts, self._engines, strict=True)
        ):
            if engine.compiled is None:
                models.append(place_model(folder, start, origin, base_rate_hz, integrators))
            else:
                placed = _place_row(folder, start, origin, base_rate_hz, integrators)
                models.append(placed.model)
                states[i] = placed.row
        kinds = dict.fromkeys(each.compiled for each in self._engines if each.compiled)
        for kind in kinds:
            rows = [i for i in states if self._engines[i].compiled is kind]
            state = np.zeros((len(folders), len(kind.columns)))
            for i in rows:
                state[i] = states[i]
            self._groups.append(_Group(kind, np.array(rows, dtype=np.intp), state))
        return models

    def bind(self, aircraft: Records, rows: Indices) -> None:
        """See `JsbsimFleet`."""
        inputs = self._wind_numbers, self._controls, self._first_controls, self._changed
        self._run_groups = [
            bind_entry(
                each.aircraft.run_rows,
                *(each.state, *inputs, self._dt),
                like=(1, _NO_CLEARANCE, each.rows, self._status),
            )
            for each in self._groups
        ]
        super().bind(aircraft, rows)

    @property
    def all_compiled(self) -> bool:
        """Whether no aircraft is flown by JSBSim."""
        return bool(self._is_compiled.all())
