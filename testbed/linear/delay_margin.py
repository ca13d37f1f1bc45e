"""The message delay at which followers that receive from each other lose stability.

Without messages from each other the followers are stable. With them, the deviations m of their
messages obey m = G(z) m, where G has the follower of each message as a discrete transfer function
from the messages that it uses, each delayed. By the argument principle the number of unstable
poles is the number of turns of det(I − G(z)) around 0 as z goes once around the unit circle.
In a graph without cycles det(I − G) is 1: no message delay can destabilise it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from testbed.core.records import Array, Indices
from testbed.linear.linear_formation import (
    MESSAGE_SIZE,
    average,
    join,
    received,
    turned_message,
)
from testbed.linear.linear_system import SLOWEST, LinearSystem
from testbed.linear.period_map import PeriodMaps

MAX_DELAY_S = 2.0  # additional, that is tried
SEARCHED = 10  # delays up to it that are flown, where each needs a flight
_FREQUENCIES = 3000
_LOWEST_HZ = 1e-3
_LARGEST_TURN = 0.5  # rad, of the determinant between two frequencies, for a count to be sure
_REFINEMENTS = 20  # halvings of the interval between two frequencies


class DelayMargin(NamedTuple):
    """How much later messages can be among followers that receive from each other.

    Attributes:
        followers: their names.
        delay_s: the largest additional delay of all messages with which they are stable, in whole
            control periods; inf: stable at all delays up to MAX_DELAY_S.
    """

    followers: tuple[str, ...]
    delay_s: float


# Maps with messages these control periods later; None: that flight is not steady.
Later: TypeAlias = Callable[[int], PeriodMaps | None]


def delay_margins(maps: PeriodMaps, later: Later | None = None) -> list[DelayMargin]:
    """Return the margin of each set of followers that receive from each other; [] without cycles.

    Args:
        maps: of their control periods.
        later: linearises the formation anew with later messages, for a law of a user's; None: the
            law extrapolates messages as [HBH23] does.
    """
    names = [each.name for each in maps.followers]
    found = []
    for own in join(maps).coupled_parts():
        if len(own) > 1:
            rows = [names.index(name) for name in own]
            delay_s = _largest_delay(maps, rows) if later is None else _search(later, maps, rows)
            found.append(DelayMargin(own, delay_s))
    return found


def _largest_delay(maps: PeriodMaps, rows: Sequence[int]) -> float:
    """Return the largest stable additional delay of the messages between some followers, s."""
    loop = _MessageLoop(maps, rows)
    for periods in range(round(MAX_DELAY_S / maps.dt) + 1):
        if loop.count_unstable(periods):
            return max(periods - 1, 0) * maps.dt
    return math.inf


def _search(later: Later, maps: PeriodMaps, rows: Sequence[int]) -> float:
    """Return the largest stable additional delay, from maps with several delays, s.

    The first of SEARCHED delays that is unstable is found, then the last stable one before it by
    bisection.
    """

    def is_stable(periods: int) -> bool:
        found = later(periods)
        return found is not None and not _MessageLoop(found, rows).count_unstable(0)

    last = round(MAX_DELAY_S / maps.dt)
    tried = sorted({round(k * last / SEARCHED) for k in range(SEARCHED + 1)})
    unstable = next((periods for periods in tried if not is_stable(periods)), None)
    if unstable is None:
        return math.inf
    stable = max((periods for periods in tried if periods < unstable), default=0)
    while unstable - stable > 1:
        middle = (stable + unstable) // 2
        stable, unstable = (middle, unstable) if is_stable(middle) else (stable, middle)
    return stable * maps.dt


def _answer(maps: PeriodMaps, follower: int, sender: int) -> LinearSystem:
    """Return a follower from the message of another to its own."""
    own, other = maps.followers[follower].name, maps.followers[sender].name
    return average(maps, follower).select(received(own, other), f"{own}.message")


class _MessageLoop:
    """The loop of messages between followers, at frequencies."""

    def __init__(self, maps: PeriodMaps, rows: Sequence[int]) -> None:
        self._maps, self._rows = maps, rows
        self._links = {
            (i, j): _answer(maps, i, j)
            for i in rows
            for j in rows
            if j + 1 in maps.followers[i].b_message
        }
        self._frequency_hz = np.geomspace(_LOWEST_HZ, 0.5 / maps.dt, _FREQUENCIES)
        self._z = self._points(self._frequency_hz)
        self._responses = self._respond(self._z)

    def _points(self, frequency_hz: Array) -> Array:
        # a little outside the unit circle: slow drifts are no instability
        points: Array = np.exp(self._maps.dt * (SLOWEST + 2j * np.pi * frequency_hz))
        return points

    def _respond(self, z: Array) -> dict[tuple[int, int], Array]:
        """Return the responses of each follower to the messages of each other, at points (F,)."""
        return {link: own.response_at(z) for link, own in self._links.items()}

    def count_unstable(self, periods: int) -> int:
        """Return the number of unstable poles with messages these control periods later.

        The sum of the turns is of half the circle: the other half is its mirror image. Where the
        determinant turns far between two frequencies, others are added between them, until a whole
        turn cannot be missed. Next to a pole on the circle it turns by half a turn at one point.
        """
        for _ in range(_REFINEMENTS):
            turns = self._turns(periods)
            far = np.flatnonzero(np.abs(turns) > _LARGEST_TURN)
            if not len(far):
                break
            self._refine(far)
        else:
            turns = self._turns(periods)
        return round(-float(turns.sum()) / math.pi)

    def _turns(self, periods: int) -> Array:
        determinant = self._determinant(periods)
        turns: Array = np.angle(determinant[1:] / determinant[:-1])
        return turns

    def _refine(self, after: Indices) -> None:
        """Add a frequency after each of some (K,)."""
        between = np.sqrt(self._frequency_hz[after] * self._frequency_hz[after + 1])
        new = self._points(between)
        self._frequency_hz = np.insert(self._frequency_hz, after + 1, between)
        self._z = np.insert(self._z, after + 1, new)
        for link, response in self._respond(new).items():
            self._responses[link] = np.insert(self._responses[link], after + 1, response, axis=0)

    def _determinant(self, periods: int) -> Array:
        """Return the determinant of one minus the loop, at the frequencies (F,)."""
        maps, size = self._maps, MESSAGE_SIZE
        width = size * len(self._rows)
        difference = np.zeros((len(self._z), width, width), dtype=complex)
        difference[:, range(width), range(width)] = 1.0
        for (i, j), response in self._responses.items():
            age = maps.periods_late(i, j) + periods
            used = self._extrapolated(i, periods) @ turned_message(age * maps.turn)
            at, of = self._rows.index(i), self._rows.index(j)
            loop = (response.reshape(-1, size) @ used).reshape(response.shape)
            loop *= self._z[:, np.newaxis, np.newaxis] ** -age
            difference[:, size * at : size * (at + 1), size * of : size * (of + 1)] -= loop
        determinant: Array = np.linalg.det(difference)
        return determinant

    def _extrapolated(self, i: int, periods: int) -> Array:
        """Return what a message, as old as in the flight, would have to be for the same effect.

        Args:
            i: row of the follower that extrapolates it.
            periods: by which it is older.
        """
        late = periods * self._maps.dt if self._maps.from_timestamp[i] else 0.0
        curved = late if self._maps.with_acceleration[i] else 0.0
        steps = np.array([[1.0, late, 0.5 * late * curved], [0.0, 1.0, curved], [0.0, 0.0, 1.0]])
        return np.kron(steps, np.eye(3))
