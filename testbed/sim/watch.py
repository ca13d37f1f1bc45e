"""What the loop tells: broadcasts to the other aircraft, truths to the observers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.formation.flags import Guard
from testbed.formation.geometry import READY_TRUE_SLOTS
from testbed.formation.law import Diagnosis
from testbed.formation.paper_law import PaperLaw
from testbed.frames import write_euler_rates
from testbed.metrics.tally import ENGAGED_HOLD_S, ENGAGED_RADIUS_M
from testbed.sim.control import Group
from testbed.state import (
    Array,
    Broadcast,
    Counts,
    Event,
    Flags,
    FormationState,
    Truths,
    VehicleState,
)

READY_EULER_RATES = ready_of(write_euler_rates, "testbed.vehicle.twin")


class Speaker:
    """Says what every aircraft (N) tells the others: its own estimate."""

    def __init__(self, aircraft: int) -> None:
        """Nobody has said anything."""
        self._stamp_s, self._euler_rates = np.empty(aircraft), np.empty((aircraft, 3))
        self._of: VehicleState | None = None

    def says(self, estimate: VehicleState, now: float) -> Broadcast:
        """The estimate (N), measured and stamped at the time `now` (s), in the speaker's arrays."""
        self._stamp_s.fill(now)
        if estimate is not self._of:
            self._of = estimate
            self._turn = READY_EULER_RATES(estimate.euler, estimate.rates_body, self._euler_rates)
            self._message = Broadcast(
                stamp_s=self._stamp_s,
                position_ned=estimate.position_ned,
                velocity_ned=estimate.velocity_ned,
                acceleration_ned=estimate.acceleration_ned,
                euler=estimate.euler,
                euler_rates=self._euler_rates,
            )
        self._turn()
        return self._message


class Slots:
    """Where n followers should be, as the truth has it."""

    def __init__(self, followers: int) -> None:
        """Nobody has looked."""
        self._true = _room(followers)
        self._believed = _room(followers)
        self._given: tuple[Any, ...] = (None,) * 7

    def state(
        self,
        truth: VehicleState,
        estimate: VehicleState,
        diagnosis: Diagnosis,
        age_s: Array,
        offsets: Array,
        places: Counts,
        altitudes: Array,
    ) -> FormationState:
        """The followers' true slots χ + q_g and errors, beside what their control reported.

        A follower that holds an altitude (n,) has its slot there, in the horizontal frame; the
        others, whose altitude is nan, have it in the leader's velocity frame. The next state is
        written into the same arrays.
        """
        given = truth, estimate, diagnosis, age_s, offsets, places, altitudes
        if any(one is not other for one, other in zip(given, self._given, strict=True)):
            self._given = given
            places_of = [(truth, self._true)]
            if estimate is not truth:
                places_of.append((estimate, self._believed))
            self._find = [
                READY_TRUE_SLOTS(each.position_ned, each.velocity_ned, offsets, altitudes, *room)
                for each, room in places_of
            ]
            self._state = self._written(diagnosis, age_s, places, exact=estimate is truth)
        for find in self._find:
            find()
        return self._state

    def _written(
        self, diagnosis: Diagnosis, age_s: Array, places: Counts, *, exact: bool
    ) -> FormationState:
        slot, error, (speed, course, climb) = self._true
        return FormationState(
            slot_ned=slot,
            error_ned=error,
            speed=speed,
            speed_desired=diagnosis.speed_desired,
            speed_command=diagnosis.speed_command,
            course=course,
            course_desired=diagnosis.course_desired,
            flight_path_angle=climb,
            flight_path_angle_desired=diagnosis.flight_path_angle_desired,
            guards=diagnosis.guards,
            saturations=diagnosis.saturations,
            age_s=age_s,
            place=places,
            believed_ned=error if exact else self._believed[1],
        )


def _room(n: int) -> tuple[Array, Array, Array]:
    return np.empty((n, 3)), np.empty((n, 3)), np.empty((3, n))


class Silence:
    """Watches which followers have stopped or begun to hear their leader."""

    def __init__(self, names: Sequence[str], patience: float) -> None:
        """Nobody is deaf yet; who has heard nothing at all is given this long, s."""
        self._names, self._patience = names, patience
        self._deaf: Truths = np.zeros(len(names), dtype=bool)
        self._waiting: Truths = np.ones(len(names), dtype=bool)
        self._quiet = False  # everybody has heard the leader, and hears it

    def changes(self, now: float, guards: Flags, apart: Truths) -> Iterator[Event]:
        """An event for each follower whose leader fell silent or came back since the last call.

        Args:
            now: s
            guards: (n,)
            apart: (n,) who is lost, or has left: nothing is said of them.
        """
        if self._quiet and not any(guards.tobytes()):
            return
        deaf = ((guards & int(Guard.LEADER_SILENT)) != 0) & ~apart
        self._waiting = self._waiting & deaf & (now < self._patience)
        deaf &= ~self._waiting
        for name, before, after in zip(self._names, self._deaf, deaf, strict=True):
            if after and not before:
                yield Event(now, "warning", name, "does not hear the leader: flies on its own")
            elif before and not after:
                yield Event(now, "info", name, "hears the leader again")
        self._deaf = deaf
        self._quiet = not (deaf.any() or self._waiting.any())


class Staleness:
    """Watches which followers have stopped or begun to hear the neighbours that they heed."""

    def __init__(self, names: Sequence[str], groups: Sequence[Group]) -> None:
        """Of N names, the leader's first: nobody is missed; news is given time from 0 s on."""
        self._names = names
        self._heeded = _heeded(len(names), groups)
        law = groups[0].law
        self._limit = groups[0].team.stale_after
        self._leaders_limit = groups[0].team.silent_after
        self._paper = isinstance(law, PaperLaw)  # of a law of the user's own nobody knows
        self._hold = isinstance(law, PaperLaw) and law.hold
        self._missed: Truths = np.zeros_like(self._heeded)
        # Whom a law that holds places has none for yet: it takes them while the leader is heard.
        self._nowhere: Truths = self._heeded & self._hold
        self._placing = self._hold
        # When the oldest news that anybody uses arrived: before it is too old no other is.
        self._oldest = 0.0

    def changes(self, now: float, rows: NDArray[np.intp], received_s: Array) -> Iterator[Event]:
        """An event for each neighbour whose news became too old, or new, since the last call.

        Args:
            now: s, when the followers of these rows stepped.
            rows: (m,) among the n followers.
            received_s: (n, N) as in the inboxes then; nan: nothing heard yet.
        """
        if self._placing:
            age = now - received_s[rows]
            self._nowhere[rows] &= ~((age <= self._limit) & (age[:, :1] <= self._leaders_limit))
            self._placing = bool(self._nowhere.any())
        if now - self._oldest <= self._limit:
            return
        heard = np.where(self._heeded, np.fmax(received_s, 0.0), np.inf)
        missed = self._missed.copy()
        missed[rows] = now - heard[rows] > self._limit
        for i, m in np.argwhere(missed != self._missed):
            name, other = self._names[i + 1], self._names[m]
            if missed[i, m]:
                what = self._consequence(bool(self._nowhere[i, m]))
                yield Event(now, "warning", name, f"does not hear {other}{what}")
            else:
                yield Event(now, "info", name, f"hears {other} again")
        self._missed = missed
        self._oldest = -np.inf if missed.any() else float(heard.min())

    def heed(self, groups: Sequence[Group], apart: Truths) -> None:
        """Miss no one from now on but those that these groups reckon with.

        Args:
            groups: of the followers.
            apart: (n,) who misses nobody: who is lost, or has left.
        """
        self._heeded = _heeded(len(self._names), groups) & ~apart[:, np.newaxis]
        self._missed = self._missed & self._heeded
        self._nowhere = self._nowhere & self._heeded
        self._oldest = -np.inf

    def _consequence(self, nowhere: bool) -> str:
        if not self._paper:
            return ""
        return ": takes it to hold its place" if self._hold and not nowhere else ": leaves it out"


def _heeded(aircraft: int, groups: Sequence[Group]) -> Truths:
    """Whose messages each follower uses (n, N), the leader's aside."""
    out: Truths = np.zeros((aircraft - 1, aircraft), dtype=bool)
    for group in groups:
        out[group.rows] = ~group.unheeded
    out[:, 0] = False
    np.fill_diagonal(out[:, 1:], False)
    return out


class Engagement:
    """Watches which followers have taken their slots, by the rule of the metrics."""

    def __init__(self, names: Sequence[str], base_rate_hz: int) -> None:
        """Nobody has."""
        self._names, self._rate = names, base_rate_hz
        self._since = np.full(len(names), -1)  # tick, inside without a break; -1: outside
        self._awaited: Truths = np.ones(len(names), dtype=bool)
        self._waits = True  # for somebody

    def changes(self, tick: int, error_ned: Array, gone: Truths) -> Iterator[Event]:
        """An event for each follower that has held its slot for long enough, once in a run.

        Args:
            tick: of the base rate.
            error_ned: (n, 3) m
            gone: (N,) who is lost.
        """
        if not self._waits:
            return
        gone = gone[1:] | gone[0]
        inside = (np.linalg.norm(error_ned, axis=-1) <= ENGAGED_RADIUS_M) & ~gone
        self._since = np.where(inside, np.where(self._since < 0, tick, self._since), -1)
        held = tick - self._since >= ENGAGED_HOLD_S * self._rate
        engaged = self._awaited & inside & held
        for name, since, now_engaged in zip(self._names, self._since, engaged, strict=True):
            if now_engaged:
                began = f"{since / self._rate:.1f} s"
                text = f"engaged: within {ENGAGED_RADIUS_M:g} m of its slot since {began}"
                yield Event(tick / self._rate, "info", name, text)
        self._awaited &= ~engaged
        self._waits = bool(self._awaited.any())


class Arrivals:
    """Watches which aircraft a discrete gust has reached."""

    def __init__(self, gusts: Sequence[str], names: Sequence[str]) -> None:
        """Nobody is in any of the gusts yet."""
        self._gusts, self._names = gusts, names
        self._inside: Truths = np.zeros((len(gusts), len(names)), dtype=bool)

    def changes(self, now: float, inside: Truths) -> Iterator[Event]:
        """An event for each gust that reached an aircraft since the last call; (G, N) as of now."""
        for gust, reached in zip(self._gusts, inside & ~self._inside, strict=True):
            if reached.all():
                yield Event(now, "info", "run", f"gust {gust} reaches everyone")
                continue
            for name, now_in_it in zip(self._names, reached, strict=True):
                if now_in_it:
                    yield Event(now, "info", name, f"gust {gust} reaches it")
        self._inside = inside
