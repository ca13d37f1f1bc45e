"""Begin and end the faults of a scenario, and combine those that are active."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import AirData, Array, BoolArray, Event, FaultState, VehicleState
from testbed.scenario.faults import (
    AirspeedBlocked,
    AnyFault,
    AutopilotFrozen,
    BatteryLow,
    EngineOut,
    GpsJump,
    GpsLost,
    SurfaceFloating,
    SurfaceStuck,
    ThrustLoss,
    TransmitterOff,
)
from testbed.vehicle.control_surfaces import SURFACES

SIMULTANEOUS_S = 1e-9  # tolerance within which a time is that of a tick


@dataclass(slots=True)
class _FaultRecord:
    """A fault of one aircraft, with the times at which it began and ended."""

    row: int
    fault: AnyFault
    has_effect: bool = True  # if not, its event has a note
    begin_s: float = math.inf  # infinite: not yet
    end_s: float = math.inf

    @property
    def active(self) -> bool:
        return self.begin_s < math.inf and self.end_s == math.inf


class FaultManager:
    """Begin and end the faults of N aircraft at their times and conditions.

    Attributes:
        state: the effect of all active faults.
    """

    def __init__(
        self,
        names: Sequence[str],
        faults: Sequence[Sequence[AnyFault]],
        declared_after_s: float,
        has_effect: Callable[[int, AnyFault], bool] = lambda row, fault: True,
    ) -> None:
        """Start without active faults.

        Args:
            names: N aircraft.
            faults: of each.
            declared_after_s: from the beginning of a fault until the aircraft declares it.
            has_effect: whether a fault affects the aircraft of a row.
        """
        self._names, self._declared_after_s = names, declared_after_s
        # by aircraft, fault, and how many equal ones precede it: those of a flight that begins as
        # another one correspond to equal ones
        self._records: dict[tuple[str, AnyFault, int], _FaultRecord] = {}
        for row, each in enumerate(faults):
            for k, one in enumerate(each):
                record = _FaultRecord(row, one, has_effect(row, one))
                self._records[names[row], one, each[:k].count(one)] = record
        self.state = no_faults(len(names))
        self._discharging = False  # the state empties a battery, which it does at one tick only

    @property
    def _faults(self) -> Collection[_FaultRecord]:
        return self._records.values()

    @property
    def active(self) -> BoolArray:
        """(N,) aircraft with an active fault that has an effect."""
        out: BoolArray = np.zeros(len(self._names), dtype=bool)
        out[[each.row for each in self._faults if each.active and each.has_effect]] = True
        return out

    @property
    def affects_sensors(self) -> bool:
        """Whether any fault is of a GPS or an airspeed sensor."""
        return any(isinstance(f.fault, AirspeedBlocked | GpsLost | GpsJump) for f in self._faults)

    def changes(
        self, now: float, truth: VehicleState, air: Callable[[], AirData], lost: BoolArray
    ) -> Iterator[Event]:
        """Yield an event for each fault that begins or ends now; update `state`.

        Args:
            now: s.
            truth: of N aircraft.
            air: returns air data and batteries; called only where a condition needs them.
            lost: (N,) aircraft whose faults no longer begin.
        """
        if self._discharging:
            self._update_state(())
        yield from self._changes(now, truth, air, lost, [])

    def resume(
        self, now: float, truth: VehicleState, air: Callable[[], AirData], lost: BoolArray
    ) -> Iterator[Event]:
        """Yield as `changes`, where beginnings up to now are those of another flight.

        Args:
            now: s.
            truth: see `changes`, as what follows.
            air: see there.
            lost: see there.
        """
        taken = [each for each in self._faults if each.begin_s == now]
        self._update_state(taken)
        yield from self._changes(now, truth, air, lost, taken)

    def _changes(
        self,
        now: float,
        truth: VehicleState,
        air: Callable[[], AirData],
        lost: BoolArray,
        taken: list[_FaultRecord],
    ) -> Iterator[Event]:
        """Yield as `changes`; `taken` are faults that have begun now already."""
        at = now + SIMULTANEOUS_S
        ended = [
            f
            for f in self._faults
            if f.active and at >= f.begin_s + (f.fault.duration_s or math.inf)
        ]
        for each in ended:
            each.end_s = now
            yield Event(now, "info", self._names[each.row], f"{describe_fault(each.fault)}: ended")
        begun = [f for f in self._faults if f.begin_s == math.inf and not lost[f.row]]
        begun = [f for f in begun if at >= (f.fault.at_s or 0.0) and _condition_met(f, truth, air)]
        for each in begun:
            each.begin_s = now
            text = describe_fault(each.fault)
            text += "" if each.has_effect else ": no effect, because the estimate uses no GPS"
            yield Event(now, "warning", self._names[each.row], text)
        if begun or ended:
            self._update_state([*taken, *begun])

    def declared(self, measured_s: Array) -> BoolArray:
        """Return which messages (..., N) declare a failure of their sender.

        An aircraft that has failed declares it in all later messages, also after the fault has
        ended.

        Args:
            measured_s: (..., N) s, times of measurement of the messages' contents.
        """
        declared: BoolArray = np.zeros(measured_s.shape, dtype=bool)
        for each in self._faults:
            long_enough = each.end_s - each.begin_s > self._declared_after_s
            if each.fault.is_declared and each.begin_s < math.inf and long_enough:
                time_s = measured_s[..., each.row]
                since_s = each.begin_s + self._declared_after_s
                declared[..., each.row] |= since_s <= time_s + SIMULTANEOUS_S
        return declared

    def _update_state(self, begun: Sequence[_FaultRecord]) -> None:
        """Combine the active faults; batteries are emptied only when their fault begins."""
        state = no_faults(len(self._names))
        # a later fault overrides an earlier one
        for each in sorted(self._faults, key=lambda each: each.begin_s):
            if each.active:
                _apply(state, each.row, each.fault)
        self._discharging = False
        for each in begun:
            if isinstance(each.fault, BatteryLow):
                state.charge[each.row] = each.fault.state_of_charge
                self._discharging = True
        self.state = state


def no_faults(n: int) -> FaultState:
    """Return the state of N aircraft without faults."""
    k = len(SURFACES)
    return FaultState(
        power=np.ones(n),
        stuck=np.zeros((n, k), dtype=bool),
        stuck_at=np.full((n, k), np.nan),
        floating=np.zeros((n, k), dtype=bool),
        floats=np.zeros((n, k)),
        frozen=np.zeros(n, dtype=bool),
        charge=np.full(n, np.nan),
        pitot_blocked=np.zeros(n, dtype=bool),
        pitot_drained=np.zeros(n, dtype=bool),
        gps_lost=np.zeros(n, dtype=bool),
        gps_jump=np.zeros((n, 3)),
        transmitter_off=np.zeros(n, dtype=bool),
    )


def describe_fault(fault: AnyFault) -> str:
    """Return the text of a fault's event."""
    match fault:
        case EngineOut():
            return "engine out"
        case ThrustLoss():
            return f"thrust loss, {100.0 * fault.remaining:g} % of the throttle remains"
        case SurfaceStuck(position=None):
            return f"{fault.surface} stuck"
        case SurfaceStuck():
            return f"{fault.surface} stuck at {fault.position:g}"
        case SurfaceFloating():
            return f"{fault.surface} floating"
        case AirspeedBlocked():
            return f"pitot tube blocked, drain {fault.drain}"
        case GpsLost():
            return "GPS lost"
        case GpsJump():
            north, east, down = fault.offset_m
            return f"GPS off by {north:g}, {east:g}, {down:g} m north, east, down"
        case AutopilotFrozen():
            return "autopilot frozen"
        case TransmitterOff():
            return "transmitter off"
        case BatteryLow():
            return f"battery drops to {100.0 * fault.state_of_charge:g} %"


def _apply(state: FaultState, row: int, fault: AnyFault) -> None:
    """Add the effect of one fault; those of several faults of an aircraft combine."""
    match fault:
        case EngineOut():
            state.power[row] = 0.0
        case ThrustLoss():
            state.power[row] *= fault.remaining
        case SurfaceStuck():
            column = SURFACES.index(fault.surface)
            state.stuck[row, column] = True
            state.stuck_at[row, column] = np.nan if fault.position is None else fault.position
        case SurfaceFloating():
            column = SURFACES.index(fault.surface)
            state.floating[row, column] = True
            state.floats[row, column] = fault.ratio
        case AirspeedBlocked():
            state.pitot_blocked[row] = True
            state.pitot_drained[row] |= fault.drain == "open"
        case GpsLost():
            state.gps_lost[row] = True
        case GpsJump():
            state.gps_jump[row] += fault.offset_m
        case AutopilotFrozen():
            state.frozen[row] = True
        case TransmitterOff():
            state.transmitter_off[row] = True


def _condition_met(record: _FaultRecord, truth: VehicleState, air: Callable[[], AirData]) -> bool:
    """Return whether a fault's condition is met; a quantity that is NaN meets none."""
    condition, row = record.fault.when, record.row
    if condition is None:
        return True
    value: float
    match condition.quantity:
        case "altitude_m":
            value = -float(truth.position_ned[row, 2])
        case "airspeed_mps":
            value = float(truth.airspeed[row])
        case "bank_deg":
            value = abs(math.degrees(float(truth.euler[row, 0])))
        case "state_of_charge":
            value = float(air().state_of_charge[row])
    if condition.above is not None:
        return value > condition.above
    assert condition.below is not None
    return value < condition.below
