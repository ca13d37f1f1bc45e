"""Detect aircraft that come too close to each other, and collisions.

Distances are between centres, at the times of the calls. Of two aircraft that pass at a distance d
with a relative speed v, the smallest sampled distance is at most √(d² + (v dt/2)²), with dt between
the calls.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.records import Array, BoolArray, Event, Indices
from testbed.scenario import Scenario

HYSTERESIS = (
    1.1  # separations at which an encounter ends, so that events do not repeat at the limit
)
MAX_EVENTS = 5  # about pairs at one time; more are summarised in one


class ProximityMonitor:
    """Report pairs of aircraft below a separation, and which aircraft have collided."""

    def __init__(
        self,
        names: Sequence[str],
        *,
        collision_m: float | None = None,
        separation_m: float | None = None,
    ) -> None:
        """Start without encounters, for N names; None: no such limit."""
        self._names = names
        self._collision, self._separation = collision_m or 0.0, separation_m or 0.0
        self._limit = max(self._collision, self._separation)
        self._first, self._second = np.triu_indices(len(names), 1)  # of each pair (P,)
        self._close: BoolArray = np.zeros(len(self._first), dtype=bool)
        self._closest: Array = np.full(len(self._first), np.inf)  # m, during the encounter
        self._collided: BoolArray = np.zeros(len(names), dtype=bool)

    @property
    def enabled(self) -> bool:
        """Whether there is a limit."""
        return self._limit > 0.0

    def changes(
        self, now: float, position_ned: Array, lost: BoolArray
    ) -> tuple[tuple[Event, ...], BoolArray]:
        """Compare distances with the limits; return events and which aircraft have collided.

        Args:
            now: s.
            position_ned: (N, 3) m.
            lost: (N,) aircraft that are ignored, as are those that collided earlier.

        Returns:
            A warning for each pair that came below the separation, an information for each that
            has separated again, an error for each that collided; and the aircraft that have
            collided, now or earlier (N,). Encounters with a lost aircraft end without an event.
        """
        if not self.enabled:
            return (), self._collided
        distance = self._distances(position_ned)
        if not (distance < self._limit).any() and not self._close.any():
            return (), self._collided

        ignored = lost | self._collided
        distance[ignored[self._first] | ignored[self._second]] = np.nan
        collided = distance < self._collision
        end = HYSTERESIS * self._separation
        close = ~collided & (distance < np.where(self._close, end, self._separation))
        begun, separated = close & ~self._close, self._close & (distance >= end)
        events = (
            *self._collision_events(now, distance, collided),
            *self._encounter_events(now, distance, begun),
            *self._separation_events(now, separated),
        )
        self._closest = np.where(close, np.fmin(distance, self._closest), np.inf)
        self._close = close
        if collided.any():
            self._collided = self._collided.copy()  # callers keep the array returned before
            self._collided[self._first[collided]] = self._collided[self._second[collided]] = True
        return events, self._collided

    def _distances(self, position_ned: Array) -> Array:
        """Compute the distance of each pair (P,), m."""
        with np.errstate(over="ignore", invalid="ignore"):  # lost aircraft may be anywhere
            north, east, down = (axis[self._second] - axis[self._first] for axis in position_ned.T)
            distance: Array = np.sqrt(north * north + east * east + down * down)
        return distance

    def _collision_events(self, now: float, distance: Array, pairs: BoolArray) -> Iterator[Event]:
        for pair in np.flatnonzero(pairs):
            first, second = self._pair_names(pair)
            text = f"collided with {second}: {distance[pair]:.1f} m between centres"
            yield Event(now, "error", first, text)

    def _encounter_events(self, now: float, distance: Array, pairs: BoolArray) -> Iterator[Event]:
        found, limit = np.flatnonzero(pairs), f"within {self._separation:g} m of"
        if len(found) > MAX_EVENTS:
            closest = self._closest_pair(found, distance)
            yield Event(now, "warning", "run", f"{len(found)} pairs {limit} each other, {closest}")
            return
        for pair in found:
            first, second = self._pair_names(pair)
            yield Event(now, "warning", first, f"{limit} {second}: {distance[pair]:.1f} m")

    def _separation_events(self, now: float, pairs: BoolArray) -> Iterator[Event]:
        found = np.flatnonzero(pairs)
        if len(found) > MAX_EVENTS:
            closest = self._closest_pair(found, self._closest)
            yield Event(now, "info", "run", f"{len(found)} pairs separated again, {closest}")
            return
        for pair in found:
            first, second = self._pair_names(pair)
            text = f"separated from {second} again, closest {self._closest[pair]:.1f} m"
            yield Event(now, "info", first, text)

    def _closest_pair(self, pairs: Indices, distance: Array) -> str:
        """Describe the pair with the smallest distance among some."""
        pair = pairs[distance[pairs].argmin()]
        first, second = self._pair_names(pair)
        return f"closest {first} and {second} at {distance[pair]:.1f} m"

    def _pair_names(self, pair: np.intp) -> tuple[str, str]:
        return self._names[self._first[pair]], self._names[self._second[pair]]


def build_proximity(scenario: Scenario) -> ProximityMonitor:
    """Build the monitor with the limits of a scenario."""
    limits = scenario.limits
    return ProximityMonitor(
        scenario.aircraft_names, collision_m=limits.collision_m, separation_m=limits.separation_m
    )
