"""Begin and end the faults of a scenario, and combine those that are active."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isnan, nan, pi
from typing import Any

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import bind_entry, entry, kernel
from testbed.core.records import (
    Array,
    BoolArray,
    Event,
    FaultState,
    Record,
    Records,
    allocate_rows,
)
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

DEGREES = 180.0 / pi
SIMULTANEOUS_S = 1e-9  # tolerance within which a time is that of a tick


NO_CONDITION = -1
QUANTITIES = "altitude_m", "airspeed_mps", "bank_deg", "state_of_charge"  # of conditions
ALTITUDE, AIRSPEED, BANK, CHARGE = range(len(QUANTITIES))
# What is known of one fault; times in s.
FAULT = np.dtype(
    [
        ("row", "i8"),  # of the aircraft
        ("at_s", "f8"),  # from which on it may begin
        ("duration_s", "f8"),  # infinite: to the end of the run
        ("quantity", "i8"),  # number in QUANTITIES, or NO_CONDITION
        ("above", "f8"),  # the quantity, where it begins; NaN: see `below`
        ("below", "f8"),
        ("declared", "?"),  # the aircraft reports it
        ("begin_s", "f8"),  # infinite: not yet
        ("end_s", "f8"),
        ("begins", "?"),  # at the last look at its condition
        ("ends", "?"),
    ],
    align=True,
)


@dataclass(slots=True)
class _FaultRecord:
    """A fault of one aircraft."""

    fault: AnyFault
    has_effect: bool  # if not, its event has a note
    record: Records  # (1,) of FAULT

    def read(self, name: str) -> Any:  # noqa: ANN401 - a number of any type
        return self.record[name][0]

    @property
    def row(self) -> int:
        return int(self.read("row"))

    @property
    def begin_s(self) -> float:
        return float(self.read("begin_s"))

    @property
    def active(self) -> bool:
        return self.begin_s < inf and bool(self.read("end_s") == inf)


class FaultManager:
    """Begin and end the faults of N aircraft at their times and conditions.

    Attributes:
        state: the effect of all active faults.
        records: (K, 1) of FAULT.
        declared_after_s: from the beginning of a fault until the aircraft declares it.
    """

    ADDRESSES = ("records",)  # the records of each fault are taken over one by one

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
        self._names, self.declared_after_s = names, declared_after_s
        # by aircraft, fault, and how many equal ones precede it: those of a flight that begins as
        # another one correspond to equal ones
        self._by_key: dict[tuple[str, AnyFault, int], _FaultRecord] = {}
        self.records, alone = allocate_rows(FAULT, sum(map(len, faults)), 1)
        for row, each in enumerate(faults):
            for k, one in enumerate(each):
                record = alone[len(self._by_key)]
                record[0] = _first_record(row, one)
                key = names[row], one, each[:k].count(one)
                self._by_key[key] = _FaultRecord(one, has_effect(row, one), record)
        self.state = no_faults(len(names))
        # the state empties a battery, which it does at one tick only
        self._discharging: BoolArray = np.zeros(1, dtype=bool)

    @property
    def _faults(self) -> Collection[_FaultRecord]:
        return self._by_key.values()

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

    @property
    def has_floating(self) -> bool:
        """Whether in any fault a surface floats."""
        return any(isinstance(f.fault, SurfaceFloating) for f in self._faults)

    @property
    def reads_batteries(self) -> bool:
        """Whether any condition is of a battery."""
        return bool((self.records["quantity"] == CHARGE).any())

    def battery_call(self, aircraft: Records) -> Call:
        """Return the call after which batteries are to be read where it returns true.

        Args:
            aircraft: (N,) of AIRCRAFT.
        """
        return Call(needs_battery, self.records, aircraft, NOW)

    def bind(self, aircraft: Records) -> Call:
        """Return the call after which `changes` is needed where it returns true.

        Args:
            aircraft: (N,) of AIRCRAFT; of lost aircraft no fault begins.
        """
        return Call(find_fault_changes, self.records, self._discharging, aircraft, NOW)

    def changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each fault that begins or ends now; update `state`.

        Args:
            now: s, of the call of `bind`.
        """
        if self._discharging[0]:
            self._update_state(())
        yield from self._changes(now, [])

    def resume(self, now: float) -> Iterator[Event]:
        """Yield as `changes`, where beginnings up to now, s, are those of another flight."""
        taken = [each for each in self._faults if each.begin_s == now]
        self._update_state(taken)
        yield from self._changes(now, taken)

    def _changes(self, now: float, taken: list[_FaultRecord]) -> Iterator[Event]:
        """Yield as `changes`; `taken` are faults that have begun now already."""
        ended = [each for each in self._faults if each.read("ends")]
        for each in ended:
            each.record["end_s"] = now
            yield Event(now, "info", self._names[each.row], f"{describe_fault(each.fault)}: ended")
        begun = [each for each in self._faults if each.read("begins")]
        for each in begun:
            each.record["begin_s"] = now
            text = describe_fault(each.fault)
            text += "" if each.has_effect else ": no effect, because the estimate uses no GPS"
            yield Event(now, "warning", self._names[each.row], text)
        if begun or ended:
            self._update_state([*taken, *begun])

    def bind_declared(self) -> Callable[[Array], BoolArray]:
        """Return the function that finds which messages (M, N) declare a failure of their sender.

        Its argument are the times of measurement of the messages' contents (M, N), s. An aircraft
        that has failed declares it in all later messages, also after the fault has ended.
        """
        none = np.zeros((1, len(self._names)))
        known = self.records, self.declared_after_s
        write = bind_entry(write_declared, *known, like=(none, none.astype(bool)))

        def find_declared(measured_s: Array) -> BoolArray:
            declared: BoolArray = np.zeros(measured_s.shape, dtype=bool)
            write(np.ascontiguousarray(measured_s), declared)
            return declared

        return find_declared

    def _update_state(self, begun: Sequence[_FaultRecord]) -> None:
        """Combine the active faults; batteries are emptied only when their fault begins."""
        state = no_faults(len(self._names))
        # a later fault overrides an earlier one
        for each in sorted(self._faults, key=lambda each: each.begin_s):
            if each.active:
                _apply(state, each.row, each.fault)
        self._discharging[0] = False
        for each in begun:
            if isinstance(each.fault, BatteryLow):
                state.charge[each.row] = each.fault.state_of_charge
                self._discharging[0] = True
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


def _first_record(row: int, fault: AnyFault) -> tuple[Any, ...]:
    """Return the values of FAULT of a fault that has not begun, of the aircraft in a row."""
    quantity, above, below = NO_CONDITION, nan, nan
    if (when := fault.when) is not None:
        quantity = QUANTITIES.index(when.quantity)
        above, below = (nan if limit is None else limit for limit in (when.above, when.below))
    times = fault.at_s or 0.0, fault.duration_s or inf
    return row, *times, quantity, above, below, fault.is_declared, inf, inf, False, False


@entry
def find_fault_changes(
    faults: Records, discharging: BoolArray, aircraft: Records, now: float
) -> bool:
    """Write which faults begin and end now.

    Args:
        faults: (K, 1) of FAULT; `begins` and `ends` are written.
        discharging: (1,) a battery is emptied by the present state of the faults.
        aircraft: (N,) of AIRCRAFT.
        now: s.

    Returns:
        Whether any begins or ends, or a battery is no longer emptied.
    """
    at, found = now + SIMULTANEOUS_S, bool(discharging[0])
    for k in range(len(faults)):
        fault = faults[k, 0]
        begun = fault.begin_s < inf
        fault.ends = begun and fault.end_s == inf and at >= fault.begin_s + fault.duration_s
        fault.begins = not begun and _may_begin(fault, aircraft, at)
        fault.begins = fault.begins and _condition_met(fault, aircraft[fault.row])
        if fault.begins or fault.ends:
            found = True
    return found


@entry
def needs_battery(faults: Records, aircraft: Records, now: float) -> bool:
    """Return whether a fault (K, 1) of FAULT may begin now, s, by the state of a battery.

    Args:
        faults: (K, 1) of FAULT.
        aircraft: (N,) of AIRCRAFT.
        now: s.
    """
    for k in range(len(faults)):
        fault = faults[k, 0]
        if fault.quantity == CHARGE and fault.begin_s == inf:
            if _may_begin(fault, aircraft, now + SIMULTANEOUS_S):
                return True
    return False


@kernel
def _may_begin(fault: Record, aircraft: Records, at: float) -> bool:
    """Return whether a fault begins at a time, s, if it has not, and its condition is met."""
    return bool(at >= fault.at_s and not aircraft[fault.row].lost)


@kernel
def _condition_met(fault: Record, aircraft: Record) -> bool:
    """Return whether a fault's condition is met; a quantity that is NaN meets none."""
    value = 0.0
    if fault.quantity == NO_CONDITION:
        return True
    if fault.quantity == ALTITUDE:
        value = -aircraft.truth.position_ned[2]
    elif fault.quantity == AIRSPEED:
        value = aircraft.truth.airspeed
    elif fault.quantity == BANK:
        value = abs(aircraft.truth.euler[0] * DEGREES)
    else:
        value = aircraft.air.state_of_charge
    return bool(value < fault.below if isnan(fault.above) else value > fault.above)


@kernel
def declares(fault: Record, declared_after_s: float, measured_s: float) -> bool:
    """Return whether a message declares a fault of its sender.

    Args:
        fault: record of FAULT.
        declared_after_s: see `FaultManager`.
        measured_s: s, time of measurement of the message's content.
    """
    if not fault.declared or fault.begin_s == inf:
        return False
    if not fault.end_s - fault.begin_s > declared_after_s:
        return False
    return bool(fault.begin_s + declared_after_s <= measured_s + SIMULTANEOUS_S)


@entry
def write_declared(
    faults: Records, declared_after_s: float, measured_s: Array, declared: BoolArray
) -> None:
    """Write which messages (M, N) declare a failure of their sender; see `declares`."""
    for k in range(len(faults)):
        fault = faults[k, 0]
        for m in range(len(measured_s)):
            if declares(fault, declared_after_s, measured_s[m, fault.row]):
                declared[m, fault.row] = True
