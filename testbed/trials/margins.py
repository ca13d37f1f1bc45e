"""Damping, settling and margins of the followers in steady flight, as flown.

Each follower's roll and pitch commands get a kick of 1° for 0.2 s, one follower at a time: its
response then has its own oscillations, not those of aircraft that it follows. Followers that do
not influence each other share a flight. A margin is the largest factor or latency of one
follower's roll command, found by bisection, at which its bank and pitch still come to rest. For
settling all followers are displaced at once, as by a gust.

The circle is chosen such that the highest bank of a follower, as flown, is the one that is asked
for. In turns everything is flown clockwise and anticlockwise, and each number is the worse one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.oscillations import Oscillation, find_oscillations
from testbed.core.records import Array, BoolArray, Indices
from testbed.scenario import Scenario
from testbed.trials.steady_flight import (
    KICK_S,
    LONG_RECORD_S,
    Change,
    SteadyFlight,
    check_measurable,
)

KICK_DEG = 1.0
DISPLACEMENT_M = 1.0  # to the right and down
SETTLED = 0.05  # of the displacement
BANK_TOLERANCE_DEG = 0.5  # between the bank that is asked for and the highest one flown
MAX_ROLL_GAIN, MAX_ROLL_LATENCY_S = 6.0, 0.5  # largest that are tried
GAIN_STEP, LATENCY_STEP_S = 0.05, 0.005  # resolution
LIMIT_CYCLE = 0.98  # of the amplitude a quarter of the record earlier: it does not decay
AT_REST = 0.05  # of the largest amplitude: below it nothing is a limit cycle


@dataclass(frozen=True, slots=True)
class FollowerMargins:
    """How one follower responds to small disturbances."""

    name: str
    bank_deg: float  # as flown
    least_damped: Oscillation | None  # None: nothing oscillates
    settling_s: float | None  # until a displacement stays within 5 %; None: more than the record
    roll_gain: float | None  # largest factor of the roll command; 1: none; None: above the largest
    roll_latency_s: float | None  # largest additional latency of it; None: above the largest


@dataclass(frozen=True, slots=True)
class Margins:
    """The followers at one bank."""

    bank_deg: float  # asked for, of the follower with the highest; clockwise if positive
    followers: tuple[FollowerMargins, ...]  # empty where there is a problem
    problem: str  # why there are no numbers; "": there are
    note: str  # a limit at which a follower flies; "": none


@dataclass(frozen=True, slots=True)
class Requirement:
    """What all followers need at a bank; None: nothing."""

    bank_deg: float
    damping: float | None = None  # ratio
    settling_s: float | None = None
    roll_gain: float | None = None
    roll_latency_s: float | None = None


def directions(bank_deg: float) -> tuple[float, ...]:
    """Return the banks of both directions of turn, clockwise first; one if it is straight."""
    return (bank_deg, -bank_deg) if bank_deg else (0.0,)


def measure_margins(scenario: Scenario, bank_deg: float, climb_mps: float = 0.0) -> Margins:
    """Measure damping, settling and margins of all followers in one direction.

    Args:
        scenario: whose formation, network and controller they have.
        bank_deg: the highest of a follower; clockwise if positive.
        climb_mps: of the leader, m/s.

    Raises:
        MarginsError: the scenario or the bank cannot be measured.
    """
    flight = _fly_steadily(scenario, bank_deg, climb_mps)
    if flight.problem:
        return Margins(bank_deg, (), flight.problem, "")
    kicks, n = _Kicks(flight, scenario), len(flight.names)
    modes = [_least_damped(each, flight.dt) for each in kicks.responses(1.0, 0.0)]
    settling = _settling(flight)
    gains = _largest(n, (1.0, MAX_ROLL_GAIN), GAIN_STEP, lambda x, of: kicks.dampings(x, 0.0, of))
    latencies = _largest(
        n, (0.0, MAX_ROLL_LATENCY_S), LATENCY_STEP_S, lambda x, of: kicks.dampings(1.0, x, of)
    )
    followers = tuple(
        FollowerMargins(
            name=flight.names[i],
            bank_deg=float(flight.bank_deg[i]),
            least_damped=modes[i],
            settling_s=_finite(settling[i]),
            roll_gain=_finite(gains[i]),
            roll_latency_s=_finite(latencies[i]),
        )
        for i in range(n)
    )
    return Margins(bank_deg, followers, "", flight.note)


def worse_of(turns: Sequence[Margins]) -> Margins:
    """Return the worse numbers of each follower in both directions, and its higher bank."""
    names = {
        turn.bank_deg: "clockwise" if turn.bank_deg > 0.0 else "anticlockwise" for turn in turns
    }

    def join(texts: Mapping[float, str]) -> str:
        different = dict.fromkeys(text for text in texts.values() if text)
        if len(texts) == 1 or len(different) == 1 and all(texts.values()):
            return "; ".join(different)
        return "; ".join(f"{names[bank]}: {text}" for bank, text in texts.items() if text)

    problem = join({turn.bank_deg: turn.problem for turn in turns})
    note = join({turn.bank_deg: turn.note for turn in turns})
    pairs = zip(*(turn.followers for turn in turns), strict=True) if not problem else ()
    worse = tuple(_worse_of(pair) for pair in pairs)
    return Margins(abs(turns[0].bank_deg), worse, problem, note)


def measure_required(scenario: Scenario, required: Requirement, bank_deg: float) -> dict[str, Any]:
    """Measure what a requirement needs in one direction, as plain data.

    Args:
        scenario: see `measure_margins`.
        required: what is measured; margins by one flight with the factor or latency required.
        bank_deg: of the requirement, or the other direction.

    Returns:
        `problem`, and if that is empty the least `damping` of a follower, the least with the factor
        and with the latency required, `damping_at_roll_gain` and `damping_at_roll_latency`, and the
        longest `settling_s` (None: longer than the record); what is not required is left out.

    Raises:
        MarginsError: see `measure_margins`.
    """
    flight = _fly_steadily(scenario, bank_deg)
    found: dict[str, Any] = {"problem": flight.problem}
    if flight.problem:
        return found
    kicks = _Kicks(flight, scenario)
    for key, needed, gain, latency_s in (
        ("damping", required.damping, 1.0, 0.0),
        ("damping_at_roll_gain", required.roll_gain, required.roll_gain, 0.0),
        ("damping_at_roll_latency", required.roll_latency_s, 1.0, required.roll_latency_s),
    ):
        if needed is not None and gain is not None and latency_s is not None:
            found[key] = float(kicks.dampings(gain, latency_s).min())
    if required.settling_s is not None:
        found["settling_s"] = _finite(_settling(flight).max())
    return found


def independent_groups(scenario: Scenario) -> list[Indices]:
    """Return the followers in groups, none of which influences another of its group.

    A law of one's own may use any message, so each of its followers is a group.
    """
    names = [each.name for each in scenario.fleet]
    n = len(names)
    if scenario.controller.law != "hbh23":
        return [np.array([i]) for i in range(n)]
    influences = np.zeros((n, n), dtype=bool)  # [i, j]: i has a gain for j's position
    for name, gains in scenario.formation.neighbour_gains.items():
        for other in gains:
            influences[names.index(name), names.index(other)] = True
    for k in range(n):  # and indirectly
        influences |= influences[:, k : k + 1] & influences[k]
    either = influences | influences.T
    groups: list[list[int]] = []
    for i in range(n):
        for group in groups:
            if not either[i, group].any():
                group.append(i)
                break
        else:
            groups.append([i])
    return [np.array(group) for group in groups]


def _fly_steadily(scenario: Scenario, bank_deg: float, climb_mps: float = 0.0) -> SteadyFlight:
    """Fly until the highest bank of a follower is the one asked for; clockwise if positive."""
    check_measurable(scenario)
    flight = SteadyFlight(scenario, bank_deg, climb_mps)
    if not bank_deg:
        return flight
    # with sideslip an aircraft banks more than in a coordinated turn
    excess = np.abs(flight.bank_deg).max() - abs(bank_deg)
    if abs(excess) > BANK_TOLERANCE_DEG and math.isfinite(excess):
        corrected = max(abs(bank_deg) - excess, 1.0)
        flight = SteadyFlight(scenario, math.copysign(corrected, bank_deg), climb_mps)
    return flight


def _worse_of(pair: Sequence[FollowerMargins]) -> FollowerMargins:
    settling = [each.settling_s for each in pair if each.settling_s is not None]
    modes = [each.least_damped for each in pair if each.least_damped is not None]
    gains = [each.roll_gain for each in pair if each.roll_gain is not None]
    latencies = [each.roll_latency_s for each in pair if each.roll_latency_s is not None]
    return FollowerMargins(
        name=pair[0].name,
        bank_deg=max((each.bank_deg for each in pair), key=abs),
        least_damped=min(modes, key=lambda mode: mode.damping, default=None),
        settling_s=max(settling) if len(settling) == len(pair) else None,
        roll_gain=min(gains, default=None),
        roll_latency_s=min(latencies, default=None),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _largest(
    n: int,
    between: tuple[float, float],
    step: float,
    dampings: Callable[[Array, BoolArray], Array],
) -> Array:
    """Return the largest values (n,) at which n followers are stable; inf: beyond the highest.

    Args:
        n: followers, all of which are bisected at the same time.
        between: the lowest value, returned where nothing above it is stable, and the highest.
        step: resolution.
        dampings: least damping ratios (n,) with values (n,), of the followers that are true (n,).
    """
    stable, unstable = (np.full(n, each) for each in between)
    beyond = dampings(unstable, np.ones(n, dtype=bool)) > 0.0
    while (searched := ~beyond & (unstable - stable > step)).any():
        middle = 0.5 * (stable + unstable)
        decays = dampings(middle, searched) > 0.0
        stable = np.where(searched & decays, middle, stable)
        unstable = np.where(searched & ~decays, middle, unstable)
    return np.where(beyond, np.inf, stable)


class _Kicks:
    """Kicks of each follower by itself, with a factor and a latency of its roll command."""

    def __init__(self, flight: SteadyFlight, scenario: Scenario) -> None:
        self._flight, self._groups = flight, independent_groups(scenario)
        self._still = flight.respond(Change())

    def responses(
        self, roll_gain: float | Array, roll_latency_s: float | Array, of: BoolArray | None = None
    ) -> list[Array]:
        """Return the responses (K, 2) of bank and pitch after the kick, rad, of each follower.

        Args:
            roll_gain: of each follower by itself.
            roll_latency_s: the same, s.
            of: followers (n,) that are flown, default all; the others' responses are zero.
        """
        n = len(self._flight.names)
        begin = round(KICK_S / self._flight.dt) + 1
        found = [np.zeros((2, 2))] * n
        for group in self._groups:
            if of is not None and not of[group].any():
                continue
            kicked = np.isin(np.arange(n), group)
            change = Change(
                kick_deg=np.where(kicked, KICK_DEG, 0.0),
                roll_gain=np.where(kicked, roll_gain, 1.0),
                roll_latency_s=np.where(kicked, roll_latency_s, 0.0),
            )
            difference = (self._flight.respond(change) - self._still)[begin:, :2]
            for i in group:
                found[i] = difference[..., i]
        return found

    def dampings(
        self, roll_gain: float | Array, roll_latency_s: float | Array, of: BoolArray | None = None
    ) -> Array:
        """Return the least damping ratio (n,) of each of these responses; see `_damping`."""
        responses = self.responses(roll_gain, roll_latency_s, of)
        return np.array([_damping(each, self._flight.dt) for each in responses])


def _least_damped(response: Array, dt: float) -> Oscillation | None:
    found = find_oscillations(response, dt)
    return found[0] if found else None


def _damping(response: Array, dt: float) -> float:
    """Return the least damping ratio in a response (K, 2) of bank and pitch; 1: no oscillation."""
    if not np.isfinite(response).all():
        return -1.0
    least = _least_damped(response, dt)
    damping = 1.0 if least is None else least.damping
    # limits of the commands turn a growing oscillation into one of constant amplitude
    quarters = [np.abs(each).max() for each in np.array_split(response[:, 0], 4) if len(each)]
    rings = quarters[-1] > max(LIMIT_CYCLE * quarters[-2], AT_REST * max(quarters))
    return min(damping, 0.0) if rings else damping


def _settling(flight: SteadyFlight) -> Array:
    """Return the times (n,), s, after which a displacement stays within 5 %; inf: never."""
    still = flight.respond(Change(record_s=LONG_RECORD_S))
    moved = flight.respond(Change(displacement_m=DISPLACEMENT_M, record_s=LONG_RECORD_S))
    error = np.linalg.norm((moved - still)[:, 2:], axis=1) / (math.sqrt(2.0) * DISPLACEMENT_M)
    outside = ~(error <= SETTLED)
    after_last = len(error) - np.argmax(outside[::-1], axis=0)
    times = np.where(outside.any(axis=0), after_last, 0) * flight.dt
    return np.where(outside[-1], np.inf, times)
