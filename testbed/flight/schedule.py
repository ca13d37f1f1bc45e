"""Schedule of a run: actions at each tick of the base rate."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import or_
from typing import TypeAlias

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array, BoolArray

BLOCK = 64  # rows of an irregular schedule at once
_ROUNDING = 1e-6  # of a tick
PHASE_HZ = 100  # phases of unsynchronised aircraft are multiples of its period


@dataclass(frozen=True, slots=True)
class TickActions:
    """What happens at a tick, in this order."""

    broadcast: BoolArray | None  # (N,) aircraft that transmit; None: none
    sent_s: Array | None  # (N,) s, transmission times, at or after the tick; None: at the tick
    control: tuple[int, ...]  # groups of followers whose controllers step
    guidance: bool  # the leader's guidance steps
    autopilot: bool  # wind, sensor errors and autopilots step
    log: bool  # observers receive a sample
    needed: tuple[bool, ...] | None  # (N,) aircraft whose motion is read; None: all


# A tick, its actions, the number of ticks to the next, and the rows read there; None: all.
Scheduled: TypeAlias = tuple[int, TickActions, int, tuple[int, ...] | None]


@dataclass(frozen=True, slots=True)
class TransmitSchedule:
    """Times at which an aircraft transmits, independent of the ticks: phase + k period.

    A message contains the estimate of the last tick before, extrapolated to the transmission.
    """

    row: int  # of the aircraft
    period_s: float
    phase_s: float


@dataclass(frozen=True, slots=True)
class Clock:
    """Periods in ticks of the base rate.

    The time of tick k is k / base rate, never a sum of steps. A phase is the number of ticks by
    which an aircraft's control or transmission follows the leader's control; it is 0 for
    synchronous aircraft. At tick 0 everything happens once.
    """

    base_rate_hz: int
    autopilot: int
    control: int
    broadcast: int
    log: int
    control_phases: tuple[int, ...]  # n followers
    broadcast_phases: tuple[int | None, ...]  # N aircraft; None: has a TransmitSchedule
    transmit_schedules: tuple[TransmitSchedule, ...] = ()

    @property
    def period(self) -> int:
        """Ticks after which the pattern of actions repeats."""
        return math.lcm(self.autopilot, self.control, self.broadcast, self.log)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Followers (0..n−1) whose controllers step together, by their phase."""
        phases = self.control_phases
        return tuple(
            tuple(i for i, own in enumerate(phases) if own == phase) for phase in self._group_phases
        )

    @property
    def _group_phases(self) -> list[int]:
        """Phases of the groups, ticks."""
        return sorted(set(self.control_phases))

    def time_s(self, tick: int) -> float:
        """Return the simulation time of a tick, s."""
        return tick / self.base_rate_hz

    def ticks(self, duration_s: float) -> int:
        """Return the number of ticks in a duration, rounded to the nearest."""
        return round(duration_s * self.base_rate_hz)

    def first_tick(self, time_s: float) -> int:
        """Return the first tick at or after a time, s, of which rounding makes none later."""
        return math.ceil(time_s * self.base_rate_hz - _ROUNDING)

    def pause_s(self, until_s: float, last: int) -> float:
        """Return the time of a pause at the first tick at or after a time, s.

        Infinite: none, because a flight to the tick `last` ends within a period of the autopilots
        after it, before a command could act.
        """
        if not math.isfinite(until_s):
            return until_s
        tick = self.first_tick(until_s)
        return math.inf if tick + self.autopilot > last else self.time_s(tick)

    def schedule(self, duration_s: float, *, all_motions: bool = False) -> Iterator[Scheduled]:
        """Yield the ticks up to the duration at which something happens.

        Each is yielded with its actions, the number of ticks to the next, and the rows of the
        aircraft whose motion is read at the next; None: all.

        Args:
            duration_s: of the flight.
            all_motions: read the motion of all aircraft at each tick.
        """
        last = self.ticks(duration_s)
        blocks = self.blocks(all_motions=all_motions)
        rows = (
            (repetition * period + tick, due, ticks, needed)
            for block, period in blocks
            for repetition in (itertools.count() if period else (0,))
            for tick, due, ticks, needed in block
        )
        return itertools.takewhile(lambda event: event[0] <= last, rows)

    def blocks(self, *, all_motions: bool = False) -> Iterator[tuple[list[Scheduled], int]]:
        """Yield the rows of `schedule` without an end, in blocks.

        Each is yielded with the period, in ticks, at which it repeats from then on, or 0 if it does
        not: then others follow.
        """
        pattern, period = self._pattern(), self.period
        first = self._actions(0, start=True)
        if not self.transmit_schedules:
            repeated = [*pattern, (period, pattern[0][1])]
            rows = list(_intervals(repeated, all_motions=all_motions))
            _, _, ticks, needed = rows[0]
            yield [(0, first, ticks, needed), *rows[1:]], 0
            yield [(period + tick, due, ticks, needed) for tick, due, ticks, needed in rows], period
            return
        repetitions = (
            (repetition * period + tick, due)
            for repetition in itertools.count()
            for tick, due in pattern
        )
        events = itertools.chain([(0, first)], itertools.islice(repetitions, 1, None))
        intervals = _intervals(self._add_transmissions(events), all_motions=all_motions)
        while True:
            yield list(itertools.islice(intervals, BLOCK)), 0

    def _add_transmissions(
        self, events: Iterable[tuple[int, TickActions]]
    ) -> Iterator[tuple[int, TickActions]]:
        """Yield the events, merged with those of the transmit schedules."""
        transmissions = itertools.groupby(
            heapq.merge(*(self._transmissions(each) for each in self.transmit_schedules)),
            key=lambda each: each[0],
        )
        at, group = next(transmissions)
        for tick, due in events:
            while at < tick:
                yield at, self._with_transmissions(NO_ACTIONS, at, group)
                at, group = next(transmissions)
            if at == tick:
                due = self._with_transmissions(due, at, group)
                at, group = next(transmissions)
            yield tick, due

    def _transmissions(self, schedule: TransmitSchedule) -> Iterator[tuple[int, int, float]]:
        """Yield the last tick before each transmission, the aircraft's row, and the time, s."""
        for k in itertools.count():
            time_s = schedule.phase_s + k * schedule.period_s
            # the tolerance keeps rounding from moving a transmission to the tick before
            yield math.floor(time_s * self.base_rate_hz + 1e-6), schedule.row, time_s

    def _with_transmissions(
        self, due: TickActions, tick: int, group: Iterable[tuple[int, int, float]]
    ) -> TickActions:
        n = len(self.broadcast_phases)
        broadcast = np.zeros(n, dtype=bool) if due.broadcast is None else due.broadcast.copy()
        sent_s = np.full(n, self.time_s(tick))
        for _, row, time_s in group:
            broadcast[row], sent_s[row] = True, time_s
        others = due.needed if due.needed != () else (False,) * n
        needed = None if others is None else tuple(map(or_, others, broadcast.tolist()))
        return replace(due, broadcast=broadcast, sent_s=sent_s, needed=needed)

    def _pattern(self) -> list[tuple[int, TickActions]]:
        """Return the actions of one period of all rates; tick 0 is always included."""
        period = self.period
        ticks: set[int] = set()
        for step, phases in (
            (self.autopilot, (0,)),
            (self.log, (0,)),
            (self.control, (0,)),  # of the leader
            (self.control, self.control_phases),
            (self.broadcast, self.broadcast_phases),
        ):
            ticks |= {
                t for phase in phases if phase is not None for t in range(phase, period, step)
            }
        return [(tick, self._actions(tick)) for tick in sorted(ticks)]

    def _actions(self, tick: int, *, start: bool = False) -> TickActions:
        transmits = np.array(
            [
                phase is not None and (start or (tick - phase) % self.broadcast == 0)
                for phase in self.broadcast_phases
            ]
        )
        step = tuple(
            number
            for number, phase in enumerate(self._group_phases)
            if start or (tick - phase) % self.control == 0
        )
        regular = [tick % period == 0 for period in (self.control, self.autopilot, self.log)]
        needed = transmits.tolist()
        for number in step:
            for follower in self.groups[number]:
                needed[follower + 1] = True
        guidance, autopilot, log = regular
        return TickActions(
            broadcast=transmits if transmits.any() else None,
            sent_s=None,
            control=step,
            guidance=guidance,
            autopilot=autopilot,
            log=log,
            needed=None if any(regular) else tuple(needed),
        )


def _intervals(
    events: Iterable[tuple[int, TickActions]], *, all_motions: bool
) -> Iterator[Scheduled]:
    """Yield events, each with the ticks to the next and the rows read there."""
    for (tick, due), (next_tick, following) in itertools.pairwise(events):
        needed = None if all_motions else following.needed
        rows = None if needed is None else tuple(np.flatnonzero(needed).tolist())
        yield tick, due, next_tick - tick, rows


NO_ACTIONS = TickActions(
    None, None, control=(), guidance=False, autopilot=False, log=False, needed=()
)


def make_clock(
    *,
    physics_hz: int,
    autopilot_hz: int,
    control_hz: int,
    broadcast_hz: int,
    log_hz: int,
    aircraft: int = 1,
    phases: Sequence[float] | None = None,
    transmit_times: Mapping[int, tuple[float | None, float | None]] | None = None,
) -> Clock:
    """Return the clock of these rates for N aircraft.

    Args:
        physics_hz: base rate.
        autopilot_hz: rate of autopilots, wind and sensor errors.
        control_hz: rate of the formation controllers.
        broadcast_hz: rate of each aircraft's messages.
        log_hz: rate of samples.
        aircraft: N.
        phases: of each aircraft, the fraction (0..1) of a period by which its control and
            messages follow the leader's control, rounded down to whole periods of PHASE_HZ;
            None: all are synchronous.
        transmit_times: by row, period and phase (s) of aircraft that transmit independently of
            the ticks; None in place of a number: as for the other aircraft.

    Raises:
        InputError: a rate does not divide the base rate.
    """
    rates = {
        "autopilot_hz": autopilot_hz,
        "control_hz": control_hz,
        "broadcast_hz": broadcast_hz,
        "log_hz": log_hz,
    }
    for name, rate in rates.items():
        if rate <= 0 or physics_hz % rate:
            raise InputError(f"rates.{name}: {rate} does not divide physics_hz {physics_hz}")
    autopilot, control, broadcast, log = (physics_hz // rate for rate in rates.values())
    # of the physics rates that PHASE_HZ divides, all have the same phases
    grid = physics_hz // PHASE_HZ if physics_hz % PHASE_HZ == 0 else 1

    def ticks(fraction: float, period: int) -> int:
        return int(fraction * period / grid) * grid

    fractions = phases or (0.0,) * aircraft
    transmit_times = transmit_times or {}
    transmit_schedules = [
        TransmitSchedule(
            row,
            1.0 / broadcast_hz if period is None else period,
            ticks(fractions[row], broadcast) / physics_hz if phase is None else phase,
        )
        for row, (period, phase) in transmit_times.items()
    ]
    return Clock(
        physics_hz,
        autopilot,
        control,
        broadcast,
        log,
        control_phases=tuple(ticks(fraction, control) for fraction in fractions[1:]),
        broadcast_phases=tuple(
            None if row in transmit_times else ticks(fraction, broadcast)
            for row, fraction in enumerate(fractions)
        ),
        transmit_schedules=tuple(transmit_schedules),
    )
