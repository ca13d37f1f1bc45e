"""One kind of aircraft as a compiled function of rows of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from testbed.compiled.columns import COLUMN, FRAME, START, WIND
from testbed.compiled.elements import NotTranslated
from testbed.compiled.frame import attitude_rate
from testbed.compiled.model_limits import ABOVE_ATMOSPHERE
from testbed.compiled.rows import write_attitude, write_motion
from testbed.compiled.source import Recalled
from testbed.compiled.translate import Translation, translate
from testbed.core.compile import entry_of_source
from testbed.core.errors import InputError
from testbed.core.geodetic import RADIANS, local_frame
from testbed.core.records import AIRCRAFT, Array, ByteArray, NedOrigin, Records
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.jsbsim_io import (
    AIR_PROPERTIES,
    BATTERY_PROPERTIES,
    MOTION_PROPERTIES,
    write_truth,
)
from testbed.vehicle.jsbsim_io import CONTROLS as CONTROLS_CHANGED
from testbed.vehicle.jsbsim_io import WIND as WIND_CHANGED
from testbed.vehicle.jsbsim_model import INTEGRATOR_STEPS, NO_TIME, JsbsimModel, Placing

_FRAMES = 3  # before an initial condition, that determine the states of components
# of the frame: what the files may read before a frame writes it
_CARRIED = [
    column
    for each in FRAME
    if each.is_output or each.name in ("acceleration", "rates_dot", "uvw_dot")
    for column in each.columns
]
_MASSES = [
    column for each in FRAME if each.name in ("mass", "inertia", "cg") for column in each.columns
]


class CompiledAircraft:
    """The flight model of one aircraft folder for one set of integrators.

    Attributes:
        folder: of the aircraft.
        columns: index of each column of a row by its name, mostly a property of JSBSim, in
            JSBSim's units.
        air_columns: (5,) columns of AIR_PROPERTIES and BATTERY_PROPERTIES; -1: none.
        run_rows: the compiled entry, `run_rows(state, wind, controls, first, changed, dt, ticks,
            which, status)`; see `testbed.compiled`.
        source: of the module with the entry.
    """

    CONSTANT = True

    def __init__(
        self,
        folder: Path,
        model: JsbsimModel | Translation,
        integrators: Integrators = INTEGRATORS,
    ) -> None:
        """Translate the aircraft; the entry is compiled when it is prepared or first called.

        Args:
            folder: of the aircraft.
            model: the aircraft in JSBSim, for sizes and for its centre of gravity; or what
                `translate_model` has made of it.
            integrators: of the flight model.

        Raises:
            NotTranslated: the aircraft has a part that only JSBSim flies.
        """
        self.folder, self.integrators = Path(folder).resolve(), integrators
        if not isinstance(model, Translation):
            model = translate_model(self.folder, model, integrators)
        self._translation = model
        self.columns, self.source = self._translation.columns, self._translation.source
        wanted = (*AIR_PROPERTIES, *BATTERY_PROPERTIES)
        self.air_columns = np.array([self.columns.get(each, -1) for each in wanted])
        self.run_rows: Any = entry_of_source(self._translation.function, self._translation.source)

    def row_of(self, model: JsbsimModel) -> Array:
        """Return the state (S,) of a model that `JsbsimModel.place` has placed.

        JSBSim does not show the older derivatives of its integrators. The initial condition fills
        them from the first of its two evaluations; both are repeated here, and the steps without
        time by which `place` continues in wind.

        Raises:
            RuntimeError: the model was not placed.
            NotTranslated: it was placed where the state of a component is unknown, or above the
                atmosphere of the compiled model.
        """
        if model.placing is None:
            raise RuntimeError("the model has not been placed")
        return _Placement(self, model, model.placing).row()

    def watch(self, model: JsbsimModel) -> None:
        """Let a model keep what `row_of` needs of its placements from now on."""
        recalled = [each.property for each in self._translation.recalled.values()]
        model.watch([*self.columns, *recalled], _FRAMES if recalled else 0)

    def run_row(self, row: Array, dt: float, ticks: int) -> int:
        """Advance one row (S,) by steps of dt, s; return its status."""
        return int(self.advance(row[np.newaxis], dt, ticks)[0])

    def advance(
        self,
        state: Array,
        dt: float,
        ticks: int,
        *,
        controls: Array | None = None,
        wind: Array | None = None,
    ) -> ByteArray:
        """Advance rows by steps of dt, all with the same number of steps.

        Args:
            state: (M, S) rows, float64 in C order; written.
            dt: s, one step.
            ticks: number of steps.
            controls: (M, 4) aileron, elevator, rudder, −1..1, throttle 0..1, with JSBSim's signs;
                None: those in the rows.
            wind: (M, 7) see `jsbsim_io.pack_wind`; None: that in the rows.

        Returns:
            Status of each row (M,): 0, or why it was not advanced to the end, see `model_limits`.

        Raises:
            InputError: an array has another shape, or `state` another type or order.
        """
        count, size = len(state), 1 + max(self.columns.values())
        # compiled code reads and writes beyond the end of an array without a word
        if state.shape != (count, size) or state.dtype != float or not state.flags.c_contiguous:
            raise InputError(
                f"state: has the shape {state.shape} and the type {state.dtype} (write "
                f"np.ascontiguousarray(state, float), with {size} columns)"
            )
        # arrays of another type or order in memory would be compiled for
        held, air = (
            _rows_of(given, name, (count, size))
            for name, given, size in (("controls", controls, 4), ("wind", wind, 7))
        )
        changed, status = np.zeros(2, dtype=bool), np.zeros(count, dtype=np.uint8)
        changed[CONTROLS_CHANGED], changed[WIND_CHANGED] = controls is not None, wind is not None
        which = np.arange(count, dtype=np.intp)
        self.run_rows(state, air, held, held, changed, dt, np.array([ticks]), which, status)
        return status

    @staticmethod
    def motion(state: Array, origin: NedOrigin | None = None) -> Records:
        """Return the motion of rows: position, velocity, acceleration, attitude, rates, airspeed.

        Args:
            state: (M, S) rows.
            origin: of the local frame; None: `NedOrigin()`, that of a scenario without one.

        Returns:
            (M,) with the fields of `truth` in AIRCRAFT, such as `position_ned` (M, 3), m, and
            `euler` (M, 3), rad: roll, pitch, yaw.
        """
        which = np.arange(len(state), dtype=np.intp)
        numbers = np.empty((len(state), len(MOTION_PROPERTIES)))
        found = np.zeros(len(state), AIRCRAFT)
        write_motion(state, which, numbers)
        frame = tuple(local_frame(origin or NedOrigin(), RADIANS))
        write_truth(which, numbers, frame, found, which)
        truth: Records = found["truth"]
        return truth

    @property
    def memories(self) -> dict[str, tuple[tuple[str, ...], ...]]:
        """Columns of older derivatives, by the name of the derivative, the newest first."""
        return self._translation.memories

    @property
    def own(self) -> tuple[str, ...]:
        """Columns of the aircraft's own properties."""
        return self._translation.own

    @property
    def recalled(self) -> dict[str, Recalled]:
        """Columns that JSBSim has no property for; `row_of` needs a placement with spin."""
        return self._translation.recalled


def translate_model(
    folder: Path, model: JsbsimModel, integrators: Integrators = INTEGRATORS
) -> Translation:
    """Translate an aircraft, as `CompiledAircraft` does.

    Raises:
        NotTranslated: the aircraft has a part that only JSBSim flies.
    """
    return translate(folder, _reader(model), integrators)


def _reader(model: JsbsimModel) -> Callable[[str], float | None]:
    def read(name: str) -> float | None:
        node = model.find(name)
        return None if node is None else float(node.get_double_value())

    return read


def _rows_of(given: Array | None, name: str, shape: tuple[int, int]) -> Array:
    """Return numbers as compiled code takes them; None: zeros."""
    rows = np.zeros(shape) if given is None else np.ascontiguousarray(given, dtype=float)
    if rows.shape != shape:
        raise InputError(f"{name}: has the shape {rows.shape} (write {shape})")
    return rows


class _Placement:
    """Repeats what JSBSim's initial condition does, as a row."""

    def __init__(self, aircraft: CompiledAircraft, model: JsbsimModel, placing: Placing) -> None:
        self._aircraft, self._model, self._placing = aircraft, model, placing
        self._columns = aircraft.columns

    def row(self) -> Array:
        aircraft, columns = self._aircraft, self._columns
        row = np.zeros(len(columns))
        placing = self._placing
        # JSBSim adds the tanks a frame late
        if any(placing.before[name] != placing.after[name] for name in _MASSES):
            raise RuntimeError("the mass changed when placed: place the model with spin")
        for name, index in columns.items():
            if (value := placing.after.get(name)) is not None:
                row[index] = value
        row[columns["terrain-elevation-ft"]] = placing.terrain
        for name, recalled in aircraft.recalled.items():
            row[columns[name]] = self._recall(recalled)
        # the first evaluation begins with what the frame before has left
        for name in (*_CARRIED, *aircraft.own):
            if (value := placing.before.get(name)) is not None:
                row[columns[name]] = value
        write_attitude(row.reshape(1, -1), 0, _quaternion(*placing.angles))
        self._evaluate(row)
        for derivative, olds in aircraft.memories.items():
            for old in olds:
                self._copy(row, derivative, old)
        memory = row.copy()
        self._evaluate(row)
        for olds in aircraft.memories.values():
            for name in (name for old in olds for name in old):
                row[columns[name]] = memory[columns[name]]
        return self._in_wind(row)

    def _recall(self, state: Recalled) -> float:
        """Return the state of a component before the initial condition.

        Raises:
            NotTranslated: it is unknown.
        """
        recent = self._placing.recent
        if state.frames >= len(recent):
            raise NotTranslated(
                f"{self._aircraft.folder.name}: placed without spin, so the state of "
                f"{state.property} is unknown"
            )
        value = recent[state.frames][state.property]
        change = 0.0
        if state.step < math.inf:
            change = value - recent[state.frames + 1][state.property]
        if not (state.low < value < state.high and abs(change) < state.step):
            raise NotTranslated(
                f"{self._aircraft.folder.name}: {state.property} is placed at a limit, so its "
                "state is unknown"
            )
        return state.sign * value

    def _evaluate(self, row: Array) -> None:
        if self._aircraft.run_row(row, 0.0, 1) == ABOVE_ATMOSPHERE:
            raise NotTranslated(
                f"{self._aircraft.folder.name}: starts above 20 km, where the compiled atmosphere "
                "ends"
            )

    def _copy(self, row: Array, derivative: str, old: tuple[str, ...]) -> None:
        """Copy a newest derivative to the columns of an older one."""
        for k, name in enumerate(old):
            row[self._columns[name]] = self._newest(row, derivative)[k]

    def _newest(self, row: Array, derivative: str) -> Array:
        if derivative in START:
            first = START[derivative]
            return row[first : first + 4]
        q = row[START["attitude"] :]
        x, y, z = row[START["rates"] : START["rates"] + 3]
        return np.array(attitude_rate((q[0], q[1], q[2], q[3]), (x, y, z)))

    def _in_wind(self, row: Array) -> Array:
        """Continue with the wind of the placement, as `JsbsimModel.place` does."""
        wind = [node.get_double_value() for node in self._model.winds]
        row[[COLUMN[name] for name in WIND.columns]] = wind
        if any(wind):
            self._aircraft.run_row(row, NO_TIME, INTEGRATOR_STEPS)
        return row


def _quaternion(roll: float, pitch: float, yaw: float) -> Array:
    """Return the quaternion (4,) of Euler angles, L to B."""
    cr, cp, cy = math.cos(0.5 * roll), math.cos(0.5 * pitch), math.cos(0.5 * yaw)
    sr, sp, sy = math.sin(0.5 * roll), math.sin(0.5 * pitch), math.sin(0.5 * yaw)
    q = np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q if abs(length - 1.0) < 1e-10 else q * (1.0 / length)
