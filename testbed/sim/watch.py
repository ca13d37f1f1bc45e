"""What the loop tells: broadcasts to the other aircraft, truths to the observers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import is_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.formation.geometry import READY_TRUE_SLOTS
from testbed.formation.law import Diagnosis
from testbed.frames import write_euler_rates
from testbed.metrics.tally import ENGAGED_HOLD_S, ENGAGED_RADIUS_M
from testbed.state import (
    Array,
    Broadcast,
    Counts,
    Event,
    FormationState,
    Truths,
    VehicleState,
)

Ticks = NDArray[np.int64]
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
        if not all(map(is_, given, self._given)):
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


def held(
    error_ned: Array, gone: Truths, awaited: Truths, since: Ticks, long: float, tick: int
) -> bool:
    """Whether anybody that is awaited has been in its slot for long enough; `since` follows.

    Args:
        error_ned: (n, 3) m
        gone: (N,) who is lost.
        awaited: (n,)
        since: (n,) tick, inside without a break; -1: outside.
        long: enough, ticks.
        tick: now.
    """
    inside = (np.linalg.norm(error_ned, axis=-1) <= ENGAGED_RADIUS_M) & ~(gone[1:] | gone[0])
    since[:] = np.where(inside, np.where(since < 0, tick, since), -1)
    return bool((awaited & inside & (tick - since >= long)).any())


READY_HELD = ready_of(held, "testbed.sim.watch_twin")


class Engagement:
    """Watches which followers have taken their slots, by the rule of the metrics."""

    def __init__(self, names: Sequence[str], base_rate_hz: int) -> None:
        """Nobody has."""
        self._names, self._rate = names, base_rate_hz
        self._long = ENGAGED_HOLD_S * base_rate_hz
        self._since: Ticks = np.full(len(names), -1)  # see `held`
        self._awaited: Truths = np.ones(len(names), dtype=bool)
        self._waits = True  # for somebody
        self._given: tuple[Any, ...] = (None, None)

    def changes(self, tick: int, error_ned: Array, gone: Truths) -> Iterator[Event]:
        """An event for each follower that has held its slot for long enough, once in a run.

        Args:
            tick: of the base rate.
            error_ned: (n, 3) m
            gone: (N,) who is lost.
        """
        if not self._waits:
            return
        if not all(map(is_, (error_ned, gone), self._given)):
            self._given = error_ned, gone
            self._held = READY_HELD(*self._given, self._awaited, self._since, self._long)
        if not self._held(tick):
            return
        inside = self._since >= 0
        engaged = self._awaited & inside & (tick - self._since >= self._long)
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
