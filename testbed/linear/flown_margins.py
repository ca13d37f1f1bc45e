"""Damping, settling and margins of the followers in steady flight, as flown.

Each follower's commands get a small kick, one follower at a time: its response then has its own
oscillations, not those of aircraft that it follows. Followers that do not influence each other
share a flight. A margin is the largest factor or latency of one command of one follower, found by
bisection, at which its motion still comes to rest. For settling all followers are displaced at
once, as by a gust. A response is the difference of two copies of the flight, with and without the
kick.

The circle is chosen such that the highest bank of a follower, as flown, is the one that is asked
for. In turns everything is flown clockwise and anticlockwise, and each number is the worse one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from testbed.airframes.forked_trial import run_forked
from testbed.core.errors import InputError
from testbed.core.oscillations import Oscillation, find_oscillations
from testbed.core.records import Array, BoolArray, Indices
from testbed.linear.held_flight import COMMANDS, KICK_S, HeldFlight
from testbed.linear.loop_margins import MAX_GAIN, MAX_LATENCY_S
from testbed.linear.period_map import PeriodMaps
from testbed.linear.predicted_margins import linearise_checked
from testbed.linear.steady_flight import (
    ROLL,
    MarginsError,
    banks_deg,
    fly_steadily,
    look_at_limits,
)
from testbed.scenario import Scenario
from testbed.scenario.control import BUILT_IN

# small, so that nothing is limited and the aircraft are linear
KICK_DEG, KICK_THROTTLE = 0.02, 2e-4
RECORD_S = 12.0  # of the least damped oscillation
# of a margin: slow oscillations of a late command hardly grow in a shorter time
MARGIN_RECORD_S = 24.0
LONG_RECORD_S = 90.0  # of a displacement
FASTEST_HZ = 5.0  # faster oscillations are those of filters, and hardly move an aircraft
SAMPLES_HZ = (
    2.5 * FASTEST_HZ
)  # of a margin's record, at least; more cost time and show nothing more
DISPLACEMENT_M = 1.0  # to the right and down
SETTLED = 0.05  # of the displacement
GAIN_STEP, LATENCY_STEP_S = 0.005, 0.001  # resolution, of a factor as a share of it
LIMIT_CYCLE = 0.98  # of the amplitude a quarter of the record earlier: it does not decay
AT_REST = 0.05  # of the largest amplitude: below it nothing is a limit cycle
EARLY_S = 1.5  # after the kick, before which no oscillation can have reached a limit
GROWN = 2.0  # amplitude of the last quarter of the record over that of EARLY_S


class FlownMargins(NamedTuple):
    """Largest factor and additional latency of one command; inf: beyond what is tried.

    Attributes:
        gain: factor, at most MAX_GAIN; 1: no margin.
        latency_s: at most MAX_LATENCY_S.
    """

    gain: float
    latency_s: float


@dataclass(frozen=True, slots=True)
class FollowerMargins:
    """How one follower responds to small disturbances."""

    name: str
    bank_deg: float  # as flown
    least_damped: Oscillation | None  # None: nothing oscillates
    settling_s: float | None  # until a displacement stays within 5 %; None: more than the record
    commands: Mapping[str, FlownMargins]  # by the name of the command: pitch, roll, throttle


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
    flight, problem, note = _fly(scenario, bank_deg, climb_mps)
    if problem:
        return Margins(bank_deg, (), problem, "")
    copies, n = Copies(flight, independent_groups(scenario, flight)), len(scenario.fleet)
    banks, settling = banks_deg(flight), _settling(copies)
    modes = [_least_damped(each, flight.dt) for each in copies.kicked(RECORD_S)]
    found = [_margins_of(copies, k, n) for k in range(len(COMMANDS))]
    followers = tuple(
        FollowerMargins(
            name=scenario.fleet[i].name,
            bank_deg=float(banks[i]),
            least_damped=modes[i],
            settling_s=_finite(settling[i]),
            commands={name: found[k][i] for k, name in enumerate(COMMANDS)},
        )
        for i in range(n)
    )
    return Margins(bank_deg, followers, "", note)


def _margins_of(copies: Copies, command: int, n: int) -> list[FlownMargins]:
    """Bisect the margins of one of COMMANDS of n followers."""

    def with_gain(logarithms: Array, of: BoolArray) -> Array:
        return copies.dampings(command, np.exp(logarithms), np.zeros(n), of)

    def with_latency(latencies_s: Array, of: BoolArray) -> Array:
        return copies.dampings(command, np.ones(n), latencies_s, of)

    gains = np.exp(_largest(n, math.log(MAX_GAIN), GAIN_STEP, with_gain))
    latencies = _largest(n, MAX_LATENCY_S, LATENCY_STEP_S, with_latency)
    return [FlownMargins(*each) for each in zip(gains.tolist(), latencies.tolist(), strict=True)]


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
    flight, problem, _ = _fly(scenario, bank_deg)
    found: dict[str, Any] = {"problem": problem}
    if problem:
        return found
    copies, n = Copies(flight, independent_groups(scenario, flight)), len(scenario.fleet)
    if required.damping is not None:
        modes = [_least_damped(each, flight.dt) for each in copies.kicked(RECORD_S)]
        found["damping"] = min(1.0 if mode is None else mode.damping for mode in modes)
    for key, gain, latency_s in (
        ("damping_at_roll_gain", required.roll_gain, 0.0),
        ("damping_at_roll_latency", 1.0, required.roll_latency_s),
    ):
        if gain is not None and latency_s is not None:
            changed = np.full(n, gain), np.full(n, latency_s)
            found[key] = float(copies.dampings(ROLL, *changed).min())
    if required.settling_s is not None:
        found["settling_s"] = _finite(_settling(copies).max())
    return found


def independent_groups(scenario: Scenario, flight: HeldFlight | None = None) -> list[Indices]:
    """Return the followers in groups, none of which influences another of its group.

    Args:
        scenario: whose followers they are.
        flight: of it, steady, in which a user's law is linearised. Where it cannot be, or None, it
            may use any message, so each of its followers is a group.
    """
    names = [each.name for each in scenario.fleet]
    n = len(names)
    influences = np.zeros((n, n), dtype=bool)  # [i, j]: i uses j's position
    if scenario.controller.law == BUILT_IN:
        for name, gains in scenario.formation.neighbour_gains.items():
            for other in gains:
                influences[names.index(name), names.index(other)] = True
    elif (maps := _maps_of(flight)) is None:
        return [np.array([i]) for i in range(n)]
    else:
        for i, each in enumerate(maps.followers):
            influences[i, [j - 1 for j in each.b_message if j]] = True
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


def _maps_of(flight: HeldFlight | None) -> PeriodMaps | None:
    """Linearise a flight and return to its present; None: it cannot be linearised."""
    if flight is None:
        return None
    present = flight.save()
    try:
        return linearise_checked(flight)
    except MarginsError:
        return None
    finally:
        flight.inputs.end()
        present.restore()


def _fly(
    scenario: Scenario, bank_deg: float, climb_mps: float = 0.0
) -> tuple[HeldFlight, str, str]:
    """Fly until the highest bank of a follower is the one asked for; clockwise if positive.

    Returns:
        The flight; a problem and a note, "": none.
    """
    flight, problem = fly_steadily(scenario, bank_deg, climb_mps, scenario.scenario.engine)
    return flight, *((problem, "") if problem else look_at_limits(flight))


def _worse_of(pair: Sequence[FollowerMargins]) -> FollowerMargins:
    settling = [each.settling_s for each in pair if each.settling_s is not None]
    modes = [each.least_damped for each in pair if each.least_damped is not None]
    return FollowerMargins(
        name=pair[0].name,
        bank_deg=max((each.bank_deg for each in pair), key=abs),
        least_damped=min(modes, key=lambda mode: mode.damping, default=None),
        settling_s=max(settling) if len(settling) == len(pair) else None,
        commands={
            name: FlownMargins(*map(min, zip(*(each.commands[name] for each in pair), strict=True)))
            for name in COMMANDS
        },
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _largest(
    n: int, highest: float, step: float, dampings: Callable[[Array, BoolArray], Array]
) -> Array:
    """Return the largest values (n,) at which n followers are stable; inf: beyond the highest.

    Args:
        n: followers, all of which are bisected at the same time.
        highest: value that is tried; 0 is returned where nothing above it is stable.
        step: resolution.
        dampings: least damping ratios (n,) with values (n,), of the followers that are true (n,).
    """
    stable, unstable = np.zeros(n), np.full(n, highest)
    beyond = dampings(unstable, np.ones(n, dtype=bool)) > 0.0
    while (searched := ~beyond & (unstable - stable > step)).any():
        middle = 0.5 * (stable + unstable)
        decays = dampings(middle, searched) > 0.0
        stable = np.where(searched & decays, middle, stable)
        unstable = np.where(searched & ~decays, middle, unstable)
    return np.where(beyond, np.inf, stable)


class Copies:
    """Copies of the process in which a steady flight goes on with changes."""

    def __init__(self, flight: HeldFlight, groups: Sequence[Indices]) -> None:
        """See the class.

        Args:
            flight: that is steady.
            groups: of followers that do not influence each other; see `independent_groups`.
        """
        self.flight, self._groups, self._n = flight, groups, len(flight.world.followers)
        self.unchanged = np.ones((self._n, 3)), np.zeros((self._n, 3))

    def respond(
        self,
        record_s: float,
        changes: tuple[Array, Array],
        kicked: BoolArray | None = None,
        displacement_m: float = 0.0,
    ) -> Array:
        """Fly on in a copy.

        Args:
            record_s: length of the record.
            changes: factors and additional latencies (n, 3) of COMMANDS.
            kicked: (n,) followers whose commands are kicked.
            displacement_m: of all followers, to the right and down.

        Returns:
            (K, n, 5): see `HeldFlight.record`.

        Raises:
            InputError: the copy failed.
        """
        work = partial(self._record, record_s, changes, kicked, displacement_m)
        done = run_forked(lambda _: work())()
        if done.value is None:
            raise InputError(f"a copy of the steady flight failed: {done.error or done.end}")
        return np.array(done.value, dtype=float)

    def _record(
        self,
        record_s: float,
        changes: tuple[Array, Array],
        kicked: BoolArray | None,
        displacement_m: float,
    ) -> list[Any]:
        flight, kick = self.flight, None
        flight.inputs.gain[:], flight.inputs.latency_s[:] = changes
        if displacement_m:
            flight.displace(displacement_m)
        if kicked is not None:
            size = math.radians(KICK_DEG), math.radians(KICK_DEG), KICK_THROTTLE
            kick = np.where(kicked[:, np.newaxis], size, 0.0)
        rows = flight.record(round(record_s / flight.dt), kick)
        listed: list[Any] = rows.tolist()
        return listed

    def kicked(
        self,
        record_s: float,
        changes: tuple[Array, Array] | None = None,
        of: BoolArray | None = None,
    ) -> list[Array]:
        """Return the responses (K, 5) of each follower after a kick of it alone.

        Args:
            record_s: length of the record.
            changes: of each follower while it is kicked; see `respond`; None: none.
            of: followers (n,) that are flown, default all; the others' responses are zero.

        Returns:
            Of each roll and pitch, rad, and the velocities north, east and down, m/s.
        """
        begin = round(KICK_S / self.flight.dt) + 1
        found = [np.zeros((2, 5))] * self._n
        still: Array | None = None
        for group in self._groups:
            if of is not None and not of[group].any():
                continue
            kicked = np.isin(np.arange(self._n), group)
            present = self.unchanged
            if changes is not None:
                those = kicked[:, np.newaxis]
                gain, latency_s = changes
                present = np.where(those, gain, 1.0), np.where(those, latency_s, 0.0)
            if still is None or changes is not None:
                still = self.respond(record_s, present)
            difference = self.respond(record_s, present, kicked) - still
            # without the slow return to the slot
            velocity = np.diff(difference[..., 2:], axis=0) / self.flight.dt
            moving = np.concatenate((difference[1:, :, :2], velocity), axis=-1)[begin:]
            for i in group:
                found[i] = moving[:, i]
        return found

    def dampings(
        self, command: int, gain: Array, latency_s: Array, of: BoolArray | None = None
    ) -> Array:
        """Return the least damping ratio (n,) of each follower; see `_damping`.

        Args:
            command: row of COMMANDS that each follower has changed while it is kicked.
            gain: (n,) factors.
            latency_s: (n,) s, additional.
            of: followers (n,) that are flown.
        """
        gains, latencies = (each.copy() for each in self.unchanged)
        gains[:, command], latencies[:, command] = gain, latency_s
        responses = self.kicked(MARGIN_RECORD_S, (gains, latencies), of)
        return np.array([_damping(each, self.flight.dt) for each in responses])


def _least_damped(response: Array, dt: float) -> Oscillation | None:
    """Return the least damped oscillation of bank and pitch in a response (K, 5)."""
    found = find_oscillations(response[:, :2], dt)
    return found[0] if found else None


def _damping(response: Array, dt: float) -> float:
    """Return the least damping ratio in a response (K, 5); 1: no oscillation."""
    if not np.isfinite(response).all():
        return -1.0
    stride = max(1, math.floor(1.0 / (dt * SAMPLES_HZ) + 1e-9))
    found = find_oscillations(response[::stride], stride * dt)
    found = [each for each in found if each.frequency_hz < FASTEST_HZ]
    damping = found[0].damping if found else 1.0
    # limits of the commands turn a growing oscillation into one of constant amplitude, or nearly so
    bank = np.abs(response[:, 0])
    quarters = [each.max() for each in np.array_split(bank, 4) if len(each)]
    rings = quarters[-1] > max(LIMIT_CYCLE * quarters[-2], AT_REST * max(quarters))
    early = bank[: max(1, round(EARLY_S / dt))].max()
    return min(damping, 0.0) if rings or quarters[-1] > GROWN * early else damping


def _settling(copies: Copies) -> Array:
    """Return the times (n,), s, after which a displacement stays within 5 %; inf: never."""
    still = copies.respond(LONG_RECORD_S, copies.unchanged)
    moved = copies.respond(LONG_RECORD_S, copies.unchanged, displacement_m=DISPLACEMENT_M)
    error = np.linalg.norm((moved - still)[..., 2:], axis=-1) / (math.sqrt(2.0) * DISPLACEMENT_M)
    outside = ~(error <= SETTLED)
    after_last = len(error) - np.argmax(outside[::-1], axis=0)
    times = np.where(outside.any(axis=0), after_last, 0) * copies.flight.dt
    return np.where(outside[-1], np.inf, times)
