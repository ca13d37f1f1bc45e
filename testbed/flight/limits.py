"""Monitors of the scenario's `limits`: separations of the aircraft, and the flight envelope."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, isnan, nan, sqrt

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry, kernel
from testbed.core.records import Array, BoolArray, Event, Record, Records, allocate
from testbed.flight.faults import SIMULTANEOUS_S, FaultManager
from testbed.metrics.document import SEPARATION_LOST

# separations at which an encounter ends, so that events do not repeat at the limit
HYSTERESIS = 1.1
MAX_EVENTS = 5  # about pairs at one time; more are summarised in one


class ProximityMonitor:
    """Report pairs of aircraft below a separation, and which aircraft have collided.

    Attributes:
        limit_m: distance below which any two aircraft are reported, m.
        minimum_m: (N,) the same by aircraft, m; the larger of two counts, NaN: none with this
            aircraft.
        watching: (1,) two aircraft are in an encounter.
        outcome: "completed", or "separation_lost" once a pair without a fault was below it.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        collision_m: float | None = None,
        separation_m: float | None = None,
        minimum_m: Array | None = None,
        source: str = "a wingspan",
        stops: bool = False,
    ) -> None:
        """Start without encounters; None: no such limit.

        Args:
            names: N aircraft.
            collision_m: distance below which two aircraft have collided.
            separation_m: distance below which there is a warning.
            minimum_m: (N,) distance below which separation is lost; see `minimum_m`.
            source: what `minimum_m` is, for texts.
            stops: the run ends when separation is lost.
        """
        self._names, self._source, self._stops = names, source, stops
        self._collision, self._separation = collision_m or 0.0, separation_m or 0.0
        self._first, self._second = np.triu_indices(len(names), 1)  # of each pair (P,)
        self.limit_m = max(self._collision, self._separation)
        self.minimum_m: Array = np.full(len(names), np.nan) if minimum_m is None else minimum_m
        minimum = np.maximum(self.minimum_m[self._first], self.minimum_m[self._second])
        self._minimum: Array = np.nan_to_num(minimum, nan=0.0)  # (P,)
        self._limit: Array = np.maximum(self._minimum, self.limit_m)
        self._close: BoolArray = np.zeros(len(self._first), dtype=bool)
        self._below: BoolArray = self._close  # below the minimum, in one encounter
        self._closest: Array = np.full(len(self._first), np.inf)  # m, during the encounter
        self._collided: BoolArray = np.zeros(len(names), dtype=bool)
        self.watching = np.zeros(1, dtype=bool)
        self.outcome = "completed"

    @property
    def enabled(self) -> bool:
        """Whether there is a limit."""
        return bool((self._limit > 0.0).any())

    @property
    def terminate(self) -> bool:
        """Whether the run ends here."""
        return self._stops and self.outcome != "completed"

    def changes(
        self,
        now: float,
        position_ned: Array,
        lost: BoolArray,
        faulty: BoolArray | None = None,
    ) -> tuple[tuple[Event, ...], BoolArray]:
        """Compare distances with the limits; return events and which aircraft have collided.

        Args:
            now: s.
            position_ned: (N, 3) m.
            lost: (N,) aircraft that are ignored, as are those that collided earlier.
            faulty: (N,) aircraft with an active fault, which explains a lost separation; None:
                none.

        Returns:
            A warning for each pair that came below the separation, an error, or with a fault a
            warning, for each below the minimum, an information for each that has separated again,
            an error for both that collided; and the aircraft that have collided, now or earlier
            (N,). Encounters with a lost aircraft end without an event.
        """
        if not self.enabled:
            return (), self._collided
        distance = self._distances(position_ned)
        if not (distance < self._limit).any() and not self.watching[0]:
            return (), self._collided

        ignored = lost | self._collided
        distance[ignored[self._first] | ignored[self._second]] = np.nan
        collided = distance < self._collision
        close = ~collided & (distance < _held(self._close, self._separation))
        below = ~collided & (distance < _held(self._below, self._minimum))
        separated = ~(close | below) & ~collided & (self._close | self._below)
        events = (
            *self._collision_events(now, distance, collided),
            *self._minimum_events(now, distance, below & ~self._below, faulty),
            *self._events(
                *(now, "warning", close & ~self._close, distance),
                f"within {self._separation:g} m of {{other}}: {{m:.1f}} m",
                f"{{pairs}} pairs within {self._separation:g} m of each other",
            ),
            *self._events(
                *(now, "info", separated & ~np.isnan(distance), self._closest),
                "separated from {other} again, closest {m:.1f} m",
                "{pairs} pairs separated again",
            ),
        )
        self._closest = np.where(close | below, np.fmin(distance, self._closest), np.inf)
        self._close, self._below = close, below
        self.watching[0] = close.any() or below.any()
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
            for name, other in ((first, second), (second, first)):
                text = f"collided with {other}: {distance[pair]:.1f} m between centres"
                yield Event(now, "error", name, text)

    def _minimum_events(
        self, now: float, distance: Array, pairs: BoolArray, faulty: BoolArray | None
    ) -> Iterator[Event]:
        """Report lost separations, and take those that no fault explains as the outcome."""
        if not pairs.any():
            return
        explained = np.zeros_like(pairs)
        if faulty is not None:
            explained = faulty[self._first] | faulty[self._second]
        if (pairs & ~explained).any():
            self.outcome = "separation_lost"
        for level, some in (("error", pairs & ~explained), ("warning", pairs & explained)):
            one = SEPARATION_LOST + ": {m:.1f} m from {other} (limit {limit:.3g} m, {source})"
            yield from self._events(
                now, level, some, distance, one, SEPARATION_LOST + ": {pairs} pairs"
            )

    def _events(
        self, now: float, level: str, which: BoolArray, distance: Array, one: str, many: str
    ) -> Iterator[Event]:
        """Report each of some pairs, or all together if there are more than MAX_EVENTS."""
        found = np.flatnonzero(which)
        if len(found) > MAX_EVENTS:
            pair = found[distance[found].argmin()]
            closest = "closest {} and {}".format(*self._pair_names(pair))
            text = f"{many.format(pairs=len(found))}, {closest} at {distance[pair]:.1f} m"
            yield Event(now, level, "run", text)
            return
        for pair in found:
            first, other = self._pair_names(pair)
            limits = {"limit": self._minimum[pair], "source": self._source}
            yield Event(now, level, first, one.format(m=distance[pair], other=other, **limits))

    def _pair_names(self, pair: np.intp) -> tuple[str, str]:
        return self._names[self._first[pair]], self._names[self._second[pair]]


def _held(active: BoolArray, limit: Array | float) -> Array:
    """Return the distance (P,) below which an encounter begins, or one that is active continues."""
    held: Array = np.where(active, HYSTERESIS, 1.0) * limit
    return held


# What is limited, a row of all arrays (3, N) here: equivalent airspeed, m/s, angle of attack, rad,
# and how much farther from its slot than at its closest a follower is, m.
OVERSPEED, STALL, FORMATION = range(3)
HOLD_S = 0.5, 0.5, 5.0  # beyond a limit for so long, so that gusts do not count
OWN_OVERSPEED = 1.5  # of AIRSPEED_MAX
RECOVERED = 0.95  # of the limit, below which the aircraft is within it again
_BEGINS = (
    "overspeed: {value:.1f} m/s equivalent airspeed (limit {limit:.1f} m/s)",
    "stalled: {value:.1f}° angle of attack (limit {limit:.1f}°)",
    "lost its formation: {value:.0f} m from its slot (limit {limit:.0f} m)",
)
_ENDS = (
    "no longer overspeed after {lasted:.1f} s, {peak:.1f} m/s at most",
    "no longer stalled after {lasted:.1f} s, {peak:.1f}° at most",
    "back in its formation after {lasted:.1f} s, {peak:.0f} m from its slot at most",
)
OUTCOMES = ("envelope_exceeded", "envelope_exceeded", "formation_lost")
_UNITS = (1.0, 180.0 / np.pi, 1.0)  # of the texts
# A value and its limit.
EXCESS = np.dtype(
    [
        ("value", "f8"),
        ("limit", "f8"),
        ("since_s", "f8"),  # beyond the limit; NaN: it is not
        ("lasted_s", "f8"),  # up to the last call at which it was not
        ("peak", "f8"),  # largest value of the present excess, or of the last one
        ("reported", "?"),
        ("began", "?"),  # at the last call, as an event
        ("ended", "?"),
    ],
    align=True,
)


class EnvelopeMonitor:
    """Report aircraft beyond a limit, and decide the outcome of the run.

    An aircraft with an active fault may be beyond its limits, and a formation with any active fault
    may be lost: the run counts as completed all the same.

    Args:
        names: N names of aircraft.
        limits: (3, N); infinite: not watched.
        faults: of the scenario; None: none.
        stops: the run ends with the first excess that no fault explains.

    Attributes:
        outcome: "completed", or that of the first excess that no fault explains.
    """

    def __init__(
        self, names: Sequence[str], limits: Array, faults: FaultManager | None, *, stops: bool
    ) -> None:
        self._names, self._faults, self._stops = names, faults, stops
        self._limits = limits
        self._closest_m: Array = np.full(len(names), inf)
        self._excesses = allocate(EXCESS, *limits.shape)
        self._excesses["since_s"] = nan
        self.outcome = "completed"

    def bind(self, aircraft: Records, followers: Records, left: BoolArray) -> Call:
        """Return the call after which `changes` is needed where it returns true.

        Args:
            aircraft: (N,) of AIRCRAFT, the leader first.
            followers: (n,) of FOLLOWER.
            left: (n,) have left the formation, and have no slot.
        """
        known = self._limits, self._closest_m, self._excesses
        return Call(find_exceeded, *known, aircraft, followers, left, NOW)

    def changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each excess that began or ended at the last call, at its time, s.

        An excess that ends because the aircraft is lost or has left its slot has no event.
        """
        excesses, explained = self._excesses, self._explained()
        began = np.array(excesses["began"])
        for kind, row in np.argwhere(began):
            level = "warning" if explained[kind, row] else "error"
            value, limit = (excesses[each][kind, row] * _UNITS[kind] for each in ("value", "limit"))
            text = _BEGINS[kind].format(value=value, limit=limit)
            yield Event(now, level, self._names[row], text)
        for kind, row in np.argwhere(excesses["ended"]):
            lasted_s, most = excesses[kind, row]["lasted_s"], excesses[kind, row]["peak"]
            text = _ENDS[kind].format(lasted=lasted_s, peak=most * _UNITS[kind])
            yield Event(now, "info", self._names[row], text)
        unexplained = (began & ~explained).any(axis=1)
        if self.outcome == "completed" and unexplained.any():
            self.outcome = OUTCOMES[int(unexplained.argmax())]

    @property
    def terminate(self) -> bool:
        """Whether the run ends here."""
        return self._stops and self.outcome != "completed"

    def _explained(self) -> BoolArray:
        """Return which excess an active fault explains (3, N); any fault that of a formation."""
        faulty: BoolArray = np.zeros(len(self._names), dtype=bool)
        if self._faults is not None:
            faulty = self._faults.active
        return np.stack((faulty, faulty, np.full_like(faulty, faulty.any())))


@entry
def find_exceeded(
    limits: Array,
    closest_m: Array,
    excesses: Records,
    aircraft: Records,
    followers: Records,
    left: BoolArray,
    now: float,
) -> bool:
    """Write what is beyond its limit; return whether an excess begins or ends that is reported.

    Args:
        limits: (3, N) of airspeed, m/s, angle of attack, rad, and distance beyond the closest, m;
            infinite: not watched.
        closest_m: (N,) closest distance to the slot so far; written.
        excesses: (3, N) of EXCESS; written.
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
        left: (n,) have left the formation: their closest distance counts from their return.
        now: s.
    """
    found = False
    for i in range(len(aircraft)):
        a, has_slot, distance = aircraft[i], True, 0.0
        if i > 0:
            if left[i - 1]:
                closest_m[i] = inf
            has_slot = not left[i - 1] and not aircraft[0].lost
            x, y, z = followers[i - 1].error_ned
            distance = sqrt(x * x + y * y + z * z)
        if distance < closest_m[i]:
            closest_m[i] = distance
        for kind in range(len(limits)):
            value, limit = distance, limits[kind, i]
            if kind == OVERSPEED:
                value = a.truth.equivalent_airspeed
            elif kind == STALL:
                value = a.air.alpha
            else:
                limit += closest_m[i]
            watched = not a.lost and (has_slot or kind != FORMATION)
            hold_s = HOLD_S[kind] - SIMULTANEOUS_S
            if _update_excess(excesses[kind, i], watched, value, limit, hold_s, now):
                found = True
    return found


@kernel
def _update_excess(
    excess: Record, watched: bool, value: float, limit: float, hold_s: float, now: float
) -> bool:
    """Write whether a value is beyond its limit; return whether that is reported now.

    Args:
        excess: record of EXCESS; written.
        watched: false: it is not beyond it, whatever the value.
        value: present.
        limit: of it.
        hold_s: how long it is beyond the limit before that is reported.
        now: s.
    """
    excess.value, excess.limit = value, limit
    excess.began = excess.ended = False
    if watched and value > (RECOVERED * limit if excess.reported else limit):
        if isnan(excess.since_s):
            excess.since_s, excess.peak = now, value
        if value > excess.peak:
            excess.peak = value
        excess.began = not excess.reported and now - excess.since_s >= hold_s
        excess.reported = excess.reported or excess.began
        return bool(excess.began)
    excess.ended = watched and excess.reported
    excess.lasted_s = now - excess.since_s
    excess.since_s, excess.reported = nan, False
    return bool(excess.ended)
