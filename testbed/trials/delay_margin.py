"""The message delay at which followers that receive from each other lose stability.

Without messages from each other the followers are stable. With them, the deviations m of their
messages obey m = G(z) m, where G has the follower of each message as a discrete transfer function
from the messages that it uses, each delayed. By the argument principle the number of unstable
poles is the number of turns of det(I − G(z)) around 0 as z goes once around the unit circle.
In a graph without cycles det(I − G) is 1: no message delay can destabilise it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array, Indices
from testbed.trials.follower_state import about_vertical
from testbed.trials.linear_formation import (
    MESSAGE_SIZE,
    SLOWEST,
    LinearFollower,
    average,
    loops_of,
    transfer,
)
from testbed.trials.period_map import PeriodMaps

MAX_DELAY_S = 2.0  # additional, that is tried
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


def delay_margins(maps: PeriodMaps) -> list[DelayMargin]:
    """Return the margin of each set of followers that receive from each other; [] without cycles.

    Args:
        maps: of their control periods.
    """
    followers = [average(each) for each in maps.followers]
    number = loops_of(followers)
    found = []
    for loop in dict.fromkeys(number.tolist()):
        rows = np.flatnonzero(number == loop).tolist()
        if len(rows) > 1:
            names = tuple(followers[i].name for i in rows)
            found.append(DelayMargin(names, _largest_delay(maps, followers, rows)))
    return found


def _largest_delay(
    maps: PeriodMaps, followers: Sequence[LinearFollower], rows: Sequence[int]
) -> float:
    """Return the largest stable additional delay of the messages between some followers, s."""
    loop = _MessageLoop(maps, followers, rows)
    for periods in range(round(MAX_DELAY_S / maps.dt) + 1):
        if loop.count_unstable(periods):
            return max(periods - 1, 0) * maps.dt
    return math.inf


class _MessageLoop:
    """The loop of messages between followers, at frequencies."""

    def __init__(
        self, maps: PeriodMaps, followers: Sequence[LinearFollower], rows: Sequence[int]
    ) -> None:
        self._maps, self._followers, self._rows = maps, followers, rows
        self._frequency_hz = np.geomspace(_LOWEST_HZ, 0.5 / maps.dt, _FREQUENCIES)
        self._z = self._points(self._frequency_hz)
        self._responses = self._respond(self._z)

    def _points(self, frequency_hz: Array) -> Array:
        # a little outside the unit circle: slow drifts are no instability
        points: Array = np.exp(self._maps.dt * (SLOWEST + 2j * np.pi * frequency_hz))
        return points

    def _respond(self, z: Array) -> dict[tuple[int, int], Array]:
        """Return the responses of each follower to the messages of each other, at points (F,)."""
        return {
            (i, j): transfer(own.a, own.b_message[j + 1], own.c_message, z)
            for i in self._rows
            for own in (self._followers[i],)
            for j in self._rows
            if j + 1 in own.b_message
        }

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
        return round(-float(self._turns(periods).sum()) / math.pi)

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
        maps, size = self._maps, MESSAGE_SIZE
        width = size * len(self._rows)
        loop = np.zeros((len(self._z), width, width), dtype=complex)
        for (i, j), response in self._responses.items():
            age = round(float(np.nan_to_num(maps.age_s[i, j + 1])) / maps.dt) + periods
            turned = np.kron(np.eye(3), about_vertical(age * maps.turn))
            used = self._extrapolated(i, periods) @ turned
            at, of = self._rows.index(i), self._rows.index(j)
            block = response @ used * self._z[:, np.newaxis, np.newaxis] ** -age
            loop[:, size * at : size * (at + 1), size * of : size * (of + 1)] = block
        determinant: Array = np.linalg.det(np.eye(width) - loop)
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
