"""What breaks when: from the faults on the page to what is broken now."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.scenario.faults import (
    AirspeedBlocked,
    AutopilotFrozen,
    BatteryLow,
    EngineOut,
    Fault,
    GpsJump,
    GpsLost,
    RadioMute,
    SurfaceFloating,
    SurfaceStuck,
    ThrustLoss,
)
from testbed.state import AirData, Array, Event, Failing, Truths, VehicleState
from testbed.vehicle.breakage import SURFACES

SIMULTANEOUS_S = 1e-9  # a moment that is a tick's but for its last bits is the tick's


@dataclass(slots=True)
class _Case:
    """A fault of one aircraft: to come, on, or over."""

    row: int
    fault: Fault
    begun_s: float = math.inf
    over_s: float = math.inf

    @property
    def on(self) -> bool:
        return self.begun_s < math.inf and self.over_s == math.inf


class Breakdowns:
    """Watches for the moments and conditions of all faults.

    Args:
        names: N aircraft.
        faults: of each.
        after_s: from the beginning of a fault until its aircraft says that it has failed.
    """

    def __init__(
        self, names: Sequence[str], faults: Sequence[Sequence[Fault]], after_s: float
    ) -> None:
        """Nothing is broken yet."""
        self._names, self._after_s = names, after_s
        self._cases = [_Case(row, one) for row, each in enumerate(faults) for one in each]
        self.failing = nothing_fails(len(names))
        self._discharged = False

    @property
    def broken(self) -> Truths:
        """(N,) of which some part is broken now."""
        out: Truths = np.zeros(len(self._names), dtype=bool)
        out[[case.row for case in self._cases if case.on]] = True
        return out

    @property
    def of_sensors(self) -> bool:
        """Whether a GPS or an airspeed sensor breaks."""
        return any(isinstance(c.fault, AirspeedBlocked | GpsLost | GpsJump) for c in self._cases)

    def changes(
        self, now: float, truth: VehicleState, air: Callable[[], AirData], gone: Truths
    ) -> Iterator[Event]:
        """An event for each fault that began or ended since the last call; `failing` follows.

        Args:
            now: s
            truth: of N aircraft.
            air: what the truth knows of their air and batteries; asked for only if it matters.
            gone: (N,) who is lost, and breaks no more.
        """
        if self._discharged:
            self._rebuild(())
        at = now + SIMULTANEOUS_S
        ended = [c for c in self._cases if c.on and at >= c.begun_s + (c.fault.lasts_s or math.inf)]
        for case in ended:
            case.over_s = now
            yield Event(now, "info", self._names[case.row], f"{words(case.fault)}: over")
        began = [c for c in self._cases if c.begun_s == math.inf and not gone[c.row]]
        began = [c for c in began if at >= (c.fault.at_s or 0.0) and _holds(c, truth, air)]
        for case in began:
            case.begun_s = now
            yield Event(now, "warning", self._names[case.row], words(case.fault))
        if began or ended:
            self._rebuild(began)

    def told(self, measured_s: Array) -> Truths:
        """Whether messages (..., N) with what was true at these times, s, tell of a failure.

        Who has failed once says so for good: nobody knows whether it can be relied on again.
        """
        told: Truths = np.zeros(measured_s.shape, dtype=bool)
        for case in self._cases:
            lasted = case.over_s - case.begun_s > self._after_s  # long enough to be told
            if case.fault.is_declared and case.begun_s < math.inf and lasted:
                at = measured_s[..., case.row]
                told[..., case.row] |= case.begun_s + self._after_s <= at + SIMULTANEOUS_S
        return told

    def _rebuild(self, began: Sequence[_Case]) -> None:
        """What is broken now; batteries drop only at the moment their fault begins."""
        failing = nothing_fails(len(self._names))
        for case in sorted(self._cases, key=lambda each: each.begun_s):  # the last has its way
            if case.on:
                _break(failing, case.row, case.fault)
        self._discharged = False
        for case in began:
            if isinstance(case.fault, BatteryLow):
                failing.charge[case.row] = case.fault.state_of_charge
                self._discharged = True
        self.failing = failing


def nothing_fails(n: int) -> Failing:
    """N aircraft in order."""
    k = len(SURFACES)
    return Failing(
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
        mute=np.zeros(n, dtype=bool),
    )


def words(fault: Fault) -> str:
    """A fault as the log says it."""
    match fault:
        case EngineOut():
            return "engine out"
        case ThrustLoss():
            return f"thrust loss, {100.0 * fault.left:g} % of the throttle is left"
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
        case RadioMute():
            return "radio mute"
        case BatteryLow():
            return f"battery drops to {100.0 * fault.state_of_charge:g} %"


def _break(failing: Failing, row: int, fault: Fault) -> None:
    """Put one fault into what is broken; several of an aircraft add up."""
    match fault:
        case EngineOut():
            failing.power[row] = 0.0
        case ThrustLoss():
            failing.power[row] *= fault.left
        case SurfaceStuck():
            column = SURFACES.index(fault.surface)
            failing.stuck[row, column] = True
            failing.stuck_at[row, column] = np.nan if fault.position is None else fault.position
        case SurfaceFloating():
            column = SURFACES.index(fault.surface)
            failing.floating[row, column] = True
            failing.floats[row, column] = fault.ratio
        case AirspeedBlocked():
            failing.pitot_blocked[row] = True
            failing.pitot_drained[row] |= fault.drain == "open"
        case GpsLost():
            failing.gps_lost[row] = True
        case GpsJump():
            failing.gps_jump[row] += fault.offset_m
        case AutopilotFrozen():
            failing.frozen[row] = True
        case RadioMute():
            failing.mute[row] = True


def _holds(case: _Case, truth: VehicleState, air: Callable[[], AirData]) -> bool:
    """Whether an aircraft is in the state in which its fault begins; not a number is in none."""
    condition, row = case.fault.when, case.row
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
