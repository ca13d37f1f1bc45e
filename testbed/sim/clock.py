"""Integer time: everything happens on a tick of the base rate."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import or_

import numpy as np

from testbed.errors import InputError
from testbed.state import Array, Truths
from testbed.vehicle.legs import Leg


@dataclass(frozen=True, slots=True)
class Due:
    """What happens at a tick, in this order."""

    broadcast: Truths | None  # (N,) who sends; None: nobody
    sent_s: Array | None  # (N,) when they send, at or soon after the tick, s; None: at the tick
    control: tuple[int, ...]  # groups of followers that step
    lead: bool  # the leader's guidance steps
    autopilot: bool  # estimates get new errors, and autopilots fly
    log: bool
    wanted: tuple[bool, ...] | None  # (N,) whose motion is asked for; None: everyone's


@dataclass(frozen=True, slots=True)
class Beat:
    """An aircraft that sends when it likes, whatever the ticks: at phase + k period.

    It sends what it measured at the last tick before.
    """

    row: int  # among the N aircraft
    period_s: float
    phase_s: float


@dataclass(frozen=True, slots=True)
class Clock:
    """Periods in ticks of the base rate; t = k dt, never a sum.

    A phase says by how many ticks an aircraft's own control or messages come after the leader's
    control; synchronous aircraft have none. At tick 0 everything happens once.
    """

    base_rate_hz: int
    autopilot: int
    control: int
    broadcast: int
    log: int
    control_phases: tuple[int, ...]  # n followers
    broadcast_phases: tuple[int | None, ...]  # N aircraft; None: it has a beat of its own
    beats: tuple[Beat, ...] = ()

    @property
    def period(self) -> int:
        """Ticks after which everything repeats."""
        return math.lcm(self.autopilot, self.control, self.broadcast, self.log)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Followers (0..n−1) that step together, by the phase of their control."""
        phases = self.control_phases
        return tuple(
            tuple(i for i, own in enumerate(phases) if own == phase) for phase in self._moments
        )

    @property
    def _moments(self) -> list[int]:
        """The phases of the groups."""
        return sorted(set(self.control_phases))

    def time_s(self, tick: int) -> float:
        """Simulation time of a tick, s."""
        return tick / self.base_rate_hz

    def ticks(self, duration_s: float) -> int:
        """Ticks in a duration, rounded to the nearest."""
        return round(duration_s * self.base_rate_hz)

    def schedule(
        self, duration_s: float, *, everyone: bool = False
    ) -> Iterator[tuple[int, Due, int, tuple[Leg, ...]]]:
        """Every tick up to the duration at which something happens.

        Each comes with what happens, and with the ticks to the next. At those at which flight
        models may be told something or asked for more than their motion there are the legs to the
        next such tick; at others none.

        Args:
            duration_s: of the flight.
            everyone: whoever sends, the motion of everyone is asked for.
        """
        pattern, period, last = self._pattern(), self.period, self.ticks(duration_s)
        first = self._due(0, beginning=True)
        if self.beats:
            laps = (
                (lap * period + tick, due) for lap in itertools.count() for tick, due in pattern
            )
            events = itertools.chain([(0, first)], itertools.islice(laps, 1, None))
            stretches = _stretches(self._with_beats(events), everyone=everyone)
        else:
            repeated = list(_stretches([*pattern, (period, pattern[0][1])], everyone=everyone))
            stretches = (
                (lap * period + tick, due if lap or tick else first, ticks, legs)
                for lap in itertools.count()
                for tick, due, ticks, legs in repeated
            )
        return itertools.takewhile(lambda event: event[0] <= last, stretches)

    def _with_beats(self, events: Iterable[tuple[int, Due]]) -> Iterator[tuple[int, Due]]:
        """The same events, and the sending of those with a beat of their own."""
        sending = itertools.groupby(
            heapq.merge(*(self._moments_of(beat) for beat in self.beats)), key=lambda each: each[0]
        )
        at, group = next(sending)
        for tick, due in events:
            while at < tick:
                yield at, self._sending(NOTHING_DUE, at, group)
                at, group = next(sending)
            if at == tick:
                due = self._sending(due, at, group)
                at, group = next(sending)
            yield tick, due

    def _moments_of(self, beat: Beat) -> Iterator[tuple[int, int, float]]:
        """The last tick before each message, the row, and its time, s."""
        for k in itertools.count():
            time_s = beat.phase_s + k * beat.period_s
            # a time that is a tick's but for its last bits is the tick's
            yield math.floor(time_s * self.base_rate_hz + 1e-6), beat.row, time_s

    def _sending(self, due: Due, tick: int, group: Iterable[tuple[int, int, float]]) -> Due:
        n = len(self.broadcast_phases)
        who = np.zeros(n, dtype=bool) if due.broadcast is None else due.broadcast.copy()
        sent_s = np.full(n, self.time_s(tick))
        for _, row, time_s in group:
            who[row], sent_s[row] = True, time_s
        others = due.wanted if due.wanted != () else (False,) * n
        wanted = None if others is None else tuple(map(or_, others, who.tolist()))
        return replace(due, broadcast=who, sent_s=sent_s, wanted=wanted)

    def _pattern(self) -> list[tuple[int, Due]]:
        """What happens in one period of all the rates; tick 0 is always there."""
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
        return [(tick, self._due(tick)) for tick in sorted(ticks)]

    def _due(self, tick: int, *, beginning: bool = False) -> Due:
        send = np.array(
            [
                phase is not None and (beginning or (tick - phase) % self.broadcast == 0)
                for phase in self.broadcast_phases
            ]
        )
        step = tuple(
            number
            for number, phase in enumerate(self._moments)
            if beginning or (tick - phase) % self.control == 0
        )
        regular = [tick % period == 0 for period in (self.control, self.autopilot, self.log)]
        wanted = send.tolist()
        for number in step:
            for follower in self.groups[number]:
                wanted[follower + 1] = True
        lead, autopilot, log = regular
        return Due(
            broadcast=send if send.any() else None,
            sent_s=None,
            control=step,
            lead=lead,
            autopilot=autopilot,
            log=log,
            wanted=None if any(regular) else tuple(wanted),
        )


def _stretches(
    events: Iterable[tuple[int, Due]], *, everyone: bool
) -> Iterator[tuple[int, Due, int, tuple[Leg, ...]]]:
    """Events with the ticks to the next, and with legs as `schedule` has them."""
    stretch: list[tuple[int, Due]] = []
    for following in events:
        stretch.append(following)
        if len(stretch) == 1 or not (following[1].autopilot or following[1].log):
            continue
        pairs = list(itertools.pairwise(stretch))
        legs = tuple(
            Leg(then - tick, None if everyone else due.wanted) for (tick, _), (then, due) in pairs
        )
        for ((tick, due), _), leg in zip(pairs, legs, strict=True):
            yield tick, due, leg.ticks, legs
            legs = ()
        stretch = [following]


NOTHING_DUE = Due(None, None, control=(), lead=False, autopilot=False, log=False, wanted=())


def make_clock(
    *,
    physics_hz: int,
    autopilot_hz: int,
    control_hz: int,
    broadcast_hz: int,
    log_hz: int,
    aircraft: int = 1,
    phases: Sequence[float] | None = None,
    beats: Mapping[int, tuple[float | None, float | None]] | None = None,
) -> Clock:
    """The clock of these rates for N aircraft.

    Args:
        physics_hz: the base rate, and so on.
        autopilot_hz: autopilots.
        control_hz: formation controllers.
        broadcast_hz: messages of each aircraft.
        log_hz: frames.
        aircraft: N.
        phases: for each aircraft, by which part (0..1) of a period its own control and messages
            come after the leader's control; None: all together.
        beats: by row, period and phase in s of those that send at moments of their own; None:
            as for all others.

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
    parts = phases or (0.0,) * aircraft
    own = [
        Beat(
            row,
            1.0 / broadcast_hz if period is None else period,
            int(parts[row] * broadcast) / physics_hz if phase is None else phase,
        )
        for row, (period, phase) in (beats or {}).items()
    ]
    return Clock(
        physics_hz,
        autopilot,
        control,
        broadcast,
        log,
        control_phases=tuple(int(part * control) for part in parts[1:]),
        broadcast_phases=tuple(
            None if beats and row in beats else int(part * broadcast)
            for row, part in enumerate(parts)
        ),
        beats=tuple(own),
    )
