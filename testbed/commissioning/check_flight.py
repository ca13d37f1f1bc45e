"""A minute of fly-by-wire A: whether an aircraft follows bank and pitch without ringing.

The aircraft begins in trim with the throttle of the trim, and is commanded to bank right, left and
level, then to pitch up, down and back. There is no formation and no wind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.autopilot.fbwa import settled_autopilots, step_autopilots
from testbed.autopilot.parameters import FbwaParams, make_gains
from testbed.commissioning.first_gains import softened
from testbed.commissioning.step_responses import RATE_HZ, start_of
from testbed.core.records import Array, FbwaCommand
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.trim import TrimPoint

DURATION_S = 60.0
BANK_DEG, PITCH_DEG = 30.0, 4.0
# Bank and pitch, degrees, of the pitch relative to the trim's, from a time on, s.
_COMMANDS = (
    (0.0, 0.0, 0.0),
    (2.0, BANK_DEG, 0.0),
    (14.0, -BANK_DEG, 0.0),
    (28.0, 0.0, 0.0),
    (36.0, 0.0, PITCH_DEG),
    (44.0, 0.0, -PITCH_DEG),
    (52.0, 0.0, 0.0),
)
MAX_OVERSHOOT = 0.15  # of a step
MAX_RIPPLE_DEG = {"roll": 1.0, "pitch": 0.5}  # between the peaks
MAX_BANK_ERROR_DEG = 3.0  # at the end of a turn
SOFTENINGS = 4
_LAST_S = 4.0  # of a command, in which ripple is looked for
_AXES = ("roll", "pitch")


class AxisResponse(NamedTuple):
    """How an axis follows its steps; the worst of them.

    Attributes:
        rise_s: to 63 % of a step; NaN: not reached.
        overshoot: beyond the command, share of the step; negative: it is not reached.
        ripple_deg: between the peaks of an oscillation that goes on.
    """

    rise_s: float
    overshoot: float
    ripple_deg: float


@dataclass(frozen=True, slots=True)
class CheckFlight:
    """A flight under fly-by-wire A.

    Attributes:
        params: with which it was flown.
        softenings: how often gains were softened before.
        roll: response to the steps of bank.
        pitch: response to the steps of pitch.
        bank_error_deg: the largest at the end of a command.
        sideslip_deg: the largest.
        elevator: the largest deflection, 0..1.
        flown_s: until the end, or until the aircraft was lost.
    """

    params: FbwaParams
    softenings: int
    roll: AxisResponse
    pitch: AxisResponse
    bank_error_deg: float
    sideslip_deg: float
    elevator: float
    flown_s: float

    @property
    def ringing(self) -> tuple[str, ...]:
        """Axes that overshoot or oscillate."""
        responses = self.roll, self.pitch
        return tuple(
            axis
            for axis, each in zip(_AXES, responses, strict=True)
            if not each.overshoot <= MAX_OVERSHOOT or not each.ripple_deg <= MAX_RIPPLE_DEG[axis]
        )

    @property
    def problem(self) -> str:
        """Why the flight is no success; "": it is one."""
        if self.flown_s < DURATION_S:
            return f"lost after {self.flown_s:.1f} s of fly-by-wire A"
        if ringing := self.ringing:
            each = self.roll if ringing[0] == "roll" else self.pitch
            return (
                f"{ringing[0]} rings: {100.0 * each.overshoot:.0f} % of overshoot, "
                f"{each.ripple_deg:.1f}° of ripple"
            )
        if self.bank_error_deg > MAX_BANK_ERROR_DEG:
            return f"bank is {self.bank_error_deg:.0f}° off its command at the end of a turn"
        return ""


def check_and_soften(
    folder: Path,
    point: TrimPoint,
    params: FbwaParams,
    report: Callable[[CheckFlight], None] = lambda flight: None,
) -> CheckFlight:
    """Fly with parameters, and soften the axes that ring, at most `SOFTENINGS` times.

    Args:
        folder: of the aircraft.
        point: of the trim that the flight begins in.
        params: first parameters.
        report: called with each flight.

    Returns:
        The last flight, with its parameters.

    Raises:
        AircraftError, TrimError: the aircraft cannot be loaded or trimmed.
    """
    for softenings in range(SOFTENINGS + 1):
        flight = fly_check(folder, point, params, softenings)
        report(flight)
        axes = flight.ringing if flight.flown_s >= DURATION_S else _AXES
        if not axes:
            break
        for axis in axes:
            params = softened(params, axis)
    return flight


def fly_check(
    folder: Path, point: TrimPoint, params: FbwaParams, softenings: int = 0
) -> CheckFlight:
    """Fly a minute of commands, and measure how bank and pitch follow them.

    Raises:
        AircraftError, TrimError: the aircraft cannot be loaded or trimmed.
    """
    start, origin = start_of(point)
    fleet = JsbsimFleet([folder], [start], origin, RATE_HZ)
    period = round(RATE_HZ / params.sched_loop_rate)
    autopilots = settled_autopilots(make_gains([params], period / RATE_HZ), fleet.trimmed)
    level = fleet.read().euler[0, 1]
    offset = level - math.radians(params.ptch_trim_deg)  # of a command that holds the trim
    rows: list[tuple[float, ...]] = []
    for tick in range(0, round(DURATION_S * RATE_HZ), period):
        state, air = fleet.read(), fleet.air()
        if rows and fleet.lost(state)[0]:
            break
        bank_deg, change_deg = _command(tick / RATE_HZ)
        command = FbwaCommand(
            pitch=np.array([offset + math.radians(change_deg)]),
            roll=np.array([math.radians(bank_deg)]),
            throttle=fleet.trimmed.throttle,
        )
        surfaces = step_autopilots(autopilots, state, command)
        roll, pitch = state.euler[0, :2]
        rows.append(
            (
                tick / RATE_HZ,
                math.degrees(roll),
                math.degrees(pitch - level),
                math.degrees(air.beta[0]),
                surfaces.elevator[0],
            )
        )
        fleet.step(surfaces, period)
    time, bank, change, beta, elevator = np.array(rows).T
    complete = time[-1] >= DURATION_S - 2.0 * period / RATE_HZ
    return CheckFlight(
        params=params,
        softenings=softenings,
        roll=_response(time, bank, 1),
        pitch=_response(time, change, 2),
        bank_error_deg=_bank_error(time, bank),
        sideslip_deg=float(np.abs(beta).max()),
        elevator=float(np.abs(elevator).max()),
        flown_s=DURATION_S if complete else float(time[-1]),
    )


def _command(time_s: float) -> tuple[float, float]:
    """Return bank and change of pitch at a time, degrees."""
    return next((bank, pitch) for at, bank, pitch in reversed(_COMMANDS) if at <= time_s + 1e-9)


def _ends() -> list[float]:
    return [*(at for at, _, _ in _COMMANDS[1:]), DURATION_S]


def _response(time: Array, angle: Array, column: int) -> AxisResponse:
    """Measure how an angle (k,), degrees, follows the steps of a column of the commands."""
    rise, overshoot, ripple = [], [], [0.0]
    for k, (begin, end) in enumerate(zip((at for at, _, _ in _COMMANDS), _ends(), strict=True)):
        if time[-1] < end - 0.1:
            break
        during = (time >= begin) & (time < end)
        ripple.append(_oscillation(time, angle, end))
        step = _COMMANDS[k][column] - _COMMANDS[k - 1][column] if k else 0.0
        if not step:
            continue
        share = 1.0 - (_COMMANDS[k][column] - angle[during]) / step
        reached = np.flatnonzero(share >= 1.0 - math.exp(-1.0))
        rise.append(time[during][reached[0]] - begin if reached.size else math.nan)
        overshoot.append(float(share.max()) - 1.0)
    return AxisResponse(
        float(np.max(rise, initial=0.0)) if rise else math.nan,
        max(overshoot, default=math.nan),
        max(ripple),
    )


def _oscillation(time: Array, angle: Array, end: float) -> float:
    """Return the height of an oscillation in the last seconds before a time, degrees.

    A parabola is subtracted: speed and attitude may still change slowly.
    """
    last = (time >= end - _LAST_S) & (time < end)
    if last.sum() < 10:
        return 0.0
    rest = angle[last] - np.polyval(np.polyfit(time[last], angle[last], 2), time[last])
    return float(np.ptp(rest))


def _bank_error(time: Array, roll: Array) -> float:
    """Return the largest error of the bank at the end of a command, degrees."""
    errors = [
        abs(float(roll[(time >= end - 0.5) & (time < end)].mean()) - _COMMANDS[k][1])
        for k, end in enumerate(_ends())
        if time[-1] >= end - 0.1
    ]
    return max(errors, default=math.inf)
