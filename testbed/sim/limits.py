"""How close aircraft come to one another: warnings, and who has collided.

Distances are between centres, when somebody looks: of two aircraft that pass at a distance d with
the relative speed v, every dt, the smallest that is seen is at most √(d² + (v dt/2)²).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.scenario import Scenario
from testbed.state import Array, Event, Truths

AGAIN = 1.1  # of the separation, beyond which an encounter is over: a pair at it does not chatter
MOST_LINES = 5  # about pairs at one time; more are summed up


class Proximity:
    """Watches which pairs of aircraft come too close, and remembers who has collided."""

    def __init__(
        self,
        names: Sequence[str],
        *,
        collision_m: float | None = None,
        separation_m: float | None = None,
    ) -> None:
        """Of N names; nobody is near anybody yet. None: that limit is nobody's to keep."""
        self._names = names
        self._collision, self._separation = collision_m or 0.0, separation_m or 0.0
        self._reach = max(self._collision, self._separation)
        self._one, self._other = np.triu_indices(len(names), 1)  # of each pair (P,)
        self._near: Truths = np.zeros(len(self._one), dtype=bool)
        self._least: Array = np.full(len(self._one), np.inf)  # m, since it came near
        self._collided: Truths = np.zeros(len(names), dtype=bool)

    @property
    def watches(self) -> bool:
        """Whether there is a limit to keep."""
        return self._reach > 0.0

    def changes(
        self, now: float, position_ned: Array, gone: Truths
    ) -> tuple[tuple[Event, ...], Truths]:
        """What has changed since the last call.

        Args:
            now: s.
            position_ned: (N, 3) m.
            gone: (N,) who is lost and does not count; nor does who has collided before.

        Returns:
            A warning for each pair that came closer than the separation, an information when it is
            apart again, an error for each pair that collided; and who has collided, now or before
            (N,). What ends because one of a pair is gone ends without a word.
        """
        if not self.watches:
            return (), self._collided
        distance = self._distances(position_ned)
        if not (distance < self._reach).any() and not self._near.any():
            return (), self._collided

        out = gone | self._collided
        distance[out[self._one] | out[self._other]] = np.nan
        collided = distance < self._collision
        over = AGAIN * self._separation
        within = ~collided & (distance < np.where(self._near, over, self._separation))
        came, apart = within & ~self._near, self._near & (distance >= over)
        events = (
            *self._collisions(now, distance, collided),
            *self._arrivals(now, distance, came),
            *self._partings(now, apart),
        )
        self._least = np.where(within, np.fmin(distance, self._least), np.inf)
        self._near = within
        if collided.any():
            self._collided = self._collided.copy()  # the one given out before stays as it was
            self._collided[self._one[collided]] = self._collided[self._other[collided]] = True
        return events, self._collided

    def _distances(self, position_ned: Array) -> Array:
        """Of every pair (P,), m."""
        with np.errstate(over="ignore", invalid="ignore"):  # the lost may be anywhere
            north, east, down = (axis[self._other] - axis[self._one] for axis in position_ned.T)
            distance: Array = np.sqrt(north * north + east * east + down * down)
        return distance

    def _collisions(self, now: float, distance: Array, pairs: Truths) -> Iterator[Event]:
        for pair in np.flatnonzero(pairs):
            one, other = self._of(pair)
            text = f"collided with {other}: {distance[pair]:.1f} m between centres"
            yield Event(now, "error", one, text)

    def _arrivals(self, now: float, distance: Array, pairs: Truths) -> Iterator[Event]:
        found, limit = np.flatnonzero(pairs), f"within {self._separation:g} m of"
        if len(found) > MOST_LINES:
            closest = found[distance[found].argmin()]
            text = f"{len(found)} pairs {limit} each other: {self._told(closest, distance)}"
            yield Event(now, "warning", "run", text)
            return
        for pair in found:
            one, other = self._of(pair)
            yield Event(now, "warning", one, f"{limit} {other}: {distance[pair]:.1f} m")

    def _partings(self, now: float, pairs: Truths) -> Iterator[Event]:
        found = np.flatnonzero(pairs)
        if len(found) > MOST_LINES:
            closest = found[self._least[found].argmin()]
            text = f"{len(found)} pairs are apart again: {self._told(closest, self._least)}"
            yield Event(now, "info", "run", text)
            return
        for pair in found:
            one, other = self._of(pair)
            text = f"apart from {other} again: {self._least[pair]:.1f} m at the closest"
            yield Event(now, "info", one, text)

    def _told(self, pair: np.intp, distance: Array) -> str:
        one, other = self._of(pair)
        return f"{one} and {other} the closest, {distance[pair]:.1f} m"

    def _of(self, pair: np.intp) -> tuple[str, str]:
        return self._names[self._one[pair]], self._names[self._other[pair]]


def make_proximity(page: Scenario) -> Proximity:
    """The watch that a page wants."""
    wanted = page.limits
    return Proximity(
        page.aircraft_names, collision_m=wanted.collision_m, separation_m=wanted.separation_m
    )
