"""Report aircraft beyond a limit: overspeed, stall, or far from their slots.

They fly on, and may recover; a run may end with the first one that no fault explains.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from math import inf, sqrt

import numpy as np

from testbed.autopilot.parameters import FbwaParams
from testbed.core.compile import Kernel, entry
from testbed.core.records import Airframe, Array, BoolArray, Event, Records
from testbed.scenario import Scenario
from testbed.sim.faults import SIMULTANEOUS_S, FaultManager

# What is limited, a row of all arrays (3, N) here: equivalent airspeed, m/s, angle of attack, rad,
# and how much farther from its slot than at its closest a follower is, m.
OVERSPEED, STALL, FORMATION = range(3)
HOLD_S = np.array([[0.5], [0.5], [5.0]])  # beyond a limit for so long, so that gusts do not count
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
        """See the class."""
        self._names, self._faults, self._stops = names, faults, stops
        self._limits = limits
        self._closest_m: Array = np.full(len(names), inf)
        self._values: Array = np.zeros(limits.shape)
        self._since: Array = np.full(limits.shape, np.nan)  # s, beyond the limit
        self._peak: Array = np.zeros(limits.shape)  # since then
        self._reported: BoolArray = np.zeros(limits.shape, dtype=bool)
        self._active = False  # an aircraft was beyond a limit at the last call
        self.outcome = "completed"

    def changes(
        self, now: float, aircraft: Records, followers: Records, left: BoolArray
    ) -> Iterable[Event]:
        """Return an event for each excess that began or ended since the last call.

        An excess that ends because the aircraft is lost or has left its slot has no event.

        Args:
            now: s
            aircraft: (N,) of AIRCRAFT, the leader first.
            followers: (n,) of FOLLOWER.
            left: (n,) have left the formation, and have no slot.
        """
        given = self._limits, self._closest_m, self._values
        if not find_exceeded(aircraft, followers, left, *given) and not self._active:
            return ()
        lost = aircraft["lost"]
        watched = np.tile(~lost, (3, 1))
        watched[FORMATION, 1:] &= ~left & ~lost[0]
        return self._report(now, watched)

    def kernels(self, aircraft: Records, followers: Records) -> list[Kernel]:
        """Return the compiled calls of `changes`, for `core.compile.prepare`."""
        left = np.zeros(len(followers), dtype=bool)
        given = left, self._limits, self._closest_m, self._values
        return [partial(find_exceeded, aircraft, followers, *given)]

    @property
    def terminate(self) -> bool:
        """Whether the run ends here."""
        return self._stops and self.outcome != "completed"

    def _report(self, now: float, watched: BoolArray) -> Iterator[Event]:
        """Return the events of aircraft watched (3, N)."""
        values, limits = self._values, self._limits.copy()
        limits[FORMATION] += self._closest_m
        beyond = watched & (values > np.where(self._reported, RECOVERED * limits, limits))
        peak = np.fmax(self._peak, values)
        since = np.where(np.isnan(self._since), now, self._since)
        began = beyond & ~self._reported & (now - since >= HOLD_S - SIMULTANEOUS_S)
        ended = watched & self._reported & ~beyond
        explained = self._explained()
        for kind, row in np.argwhere(began):
            level = "warning" if explained[kind, row] else "error"
            value, limit = (each[kind, row] * _UNITS[kind] for each in (values, limits))
            text = _BEGINS[kind].format(value=value, limit=limit)
            yield Event(now, level, self._names[row], text)
        for kind, row in np.argwhere(ended):
            lasted, most = now - since[kind, row], peak[kind, row] * _UNITS[kind]
            text = _ENDS[kind].format(lasted=lasted, peak=most)
            yield Event(now, "info", self._names[row], text)
        unexplained = (began & ~explained).any(axis=1)
        if self.outcome == "completed" and unexplained.any():
            self.outcome = OUTCOMES[int(unexplained.argmax())]
        self._reported = (self._reported | began) & beyond
        self._since, self._peak = np.where(beyond, since, np.nan), np.where(beyond, peak, 0.0)
        self._active = bool(beyond.any())

    def _explained(self) -> BoolArray:
        """Return which excess an active fault explains (3, N); any fault that of a formation."""
        faulty: BoolArray = np.zeros(len(self._names), dtype=bool)
        if self._faults is not None:
            faulty = self._faults.active
        return np.stack((faulty, faulty, np.full_like(faulty, faulty.any())))


@entry
def find_exceeded(
    aircraft: Records,
    followers: Records,
    left: BoolArray,
    limits: Array,
    closest_m: Array,
    values: Array,
) -> bool:
    """Write what is limited; return whether an aircraft is beyond a limit.

    Args:
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
        left: (n,) have left the formation: their closest distance counts from their return.
        limits: (3, N) of airspeed, m/s, angle of attack, rad, and distance beyond the closest, m.
        closest_m: (N,) closest distance to the slot so far; written.
        values: (3, N) airspeed, angle of attack, and distance from the slot; written.
    """
    beyond = False
    for i in range(len(aircraft)):
        a = aircraft[i]
        airspeed, alpha, distance = a.truth.equivalent_airspeed, a.air.alpha, 0.0
        if i > 0:
            if left[i - 1]:
                closest_m[i] = inf
            x, y, z = followers[i - 1].error_ned
            distance = sqrt(x * x + y * y + z * z)
        if distance < closest_m[i]:
            closest_m[i] = distance
        values[OVERSPEED, i], values[STALL, i], values[FORMATION, i] = airspeed, alpha, distance
        if (
            airspeed > limits[OVERSPEED, i]
            or alpha > limits[STALL, i]
            or distance > limits[FORMATION, i] + closest_m[i]
        ):
            beyond = True
    return beyond


def build_envelope_monitor(
    scenario: Scenario,
    tunes: Sequence[FbwaParams],
    airframes: Sequence[Airframe],
    rows: Sequence[int],
    faults: FaultManager | None,
) -> EnvelopeMonitor:
    """Build the monitor with the limits of a scenario.

    Args:
        scenario: whose limits are used.
        tunes: of N aircraft.
        airframes: N
        rows: of the aircraft with a flight model; overspeed and stall of others are not watched.
        faults: of the scenario; None: none.
    """
    given = scenario.limits
    limits = np.full((3, len(tunes)), inf)
    for row in rows:
        stall = given.stall_deg
        limits[OVERSPEED, row] = given.overspeed_mps or OWN_OVERSPEED * tunes[row].airspeed_max
        limits[STALL, row] = math.radians(stall) if stall else airframes[row].stall_angle
    if given.formation_lost_m is not None:
        limits[FORMATION, 1:] = given.formation_lost_m
    stops = given.on_limit_exceeded == "stop"
    return EnvelopeMonitor(scenario.aircraft_names, limits, faults, stops=stops)
