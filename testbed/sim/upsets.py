"""Who is upset: too fast, stalled, or far from its slot; it flies on, and may recover."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from operator import is_

import numpy as np

from testbed.compiled import ready_of
from testbed.scenario import Scenario
from testbed.sim.breakdowns import SIMULTANEOUS_S, Breakdowns
from testbed.state import (
    AirData,
    Airframe,
    Array,
    Event,
    FormationState,
    Truths,
    VehicleState,
)
from testbed.steady import Steady
from testbed.vehicle.params import FbwaParams

HOLD_S = np.array([[0.5], [0.5], [5.0]])  # beyond a limit for so long: a gust is no upset
OWN_OVERSPEED = 1.5  # of AIRSPEED_MAX
BACK = 0.95  # of the limit, below which it is over: who flies at a limit does not chatter
_BEGINS = (
    "overspeed: {at:.1f} m/s equivalent airspeed (limit {limit:.1f} m/s)",
    "stalled: {at:.1f}° angle of attack (limit {limit:.1f}°)",
    "lost its formation: {at:.0f} m from its slot (limit {limit:.0f} m)",
)
_ENDS = (
    "no longer overspeed after {lasted:.1f} s, {most:.1f} m/s at most",
    "no longer stalled after {lasted:.1f} s, {most:.1f}° at most",
    "back from {most:.0f} m off its slot at most, after {lasted:.1f} s",
)
_SHOWN = (1.0, 180.0 / np.pi, 1.0)  # units of the texts


def measured(airspeed: Array, alpha: Array, error_ned: Array) -> Array:
    """What is held to the limits (3, N), as `beyond` takes it; the leader has no slot."""
    out = np.zeros((3, len(airspeed)))
    out[0], out[1] = airspeed, alpha
    out[2, 1:] = np.sqrt((error_ned * error_ned).sum(axis=1))
    return out


def beyond(
    airspeed: Array, alpha: Array, error_ned: Array, limits: Array, closest_m: Array
) -> bool:
    """Whether any of N aircraft is beyond a limit; `closest_m` follows.

    Args:
        airspeed: (N,) m/s, equivalent.
        alpha: (N,) rad, angle of attack.
        error_ned: (N − 1, 3) m, of the followers.
        limits: (3, N) of airspeed, angle of attack, and how much farther from its slot a follower
            may be than it has been; infinite where nobody looks.
        closest_m: (N,) how close to its slot each has been, m; the leader's is 0.
    """
    values = measured(airspeed, alpha, error_ned)
    np.fmin(closest_m, values[2], out=closest_m)
    return bool((values[:2] > limits[:2]).any() or (values[2] > limits[2] + closest_m).any())


READY_BEYOND = ready_of(beyond, "testbed.sim.upsets_twin")


class Upsets:
    """Remembers who of N aircraft is beyond which limit, and what the run makes of it.

    An aircraft of which the page has broken something may be upset while it is broken, and a
    formation in which anything is broken may be lost: such a run has flown all the same.
    """

    def __init__(
        self,
        names: Sequence[str],
        limits: Array,
        breakdowns: Breakdowns | None,
        *,
        stops: bool,
    ) -> None:
        """Nobody is upset yet.

        Args:
            names: N
            limits: (3, N) largest equivalent airspeed, m/s, angle of attack, rad, and how much
                farther from its slot a follower may be than it has been, m; infinite where nobody
                looks.
            breakdowns: of the page.
            stops: whether the run ends with the first upset that no fault of the page explains.
        """
        self._names, self._breakdowns, self._stops = names, breakdowns, stops
        self._limits = limits
        # to the slot, since the start or since it flew something else: who joins may come from far
        self._closest_m: Array = np.full(len(names), np.inf)
        self._apart: Truths | None = None
        self._somebody_apart = False
        self._since: Array = np.full(limits.shape, np.nan)  # s, beyond it without a break
        self._most: Array = np.zeros(limits.shape)  # since then
        self._told: Truths = np.zeros(limits.shape, dtype=bool)
        self._busy = False  # somebody was beyond a limit at the last look
        self.unforeseen = False  # somebody was upset without a fault that explains it
        self._steady = Steady(), Steady(), Steady()
        self._bound: tuple[object, ...] = (None, None, None)

    def changes(
        self,
        now: float,
        truth: VehicleState,
        air: AirData,
        formation: FormationState,
        away: tuple[Truths, Truths],
    ) -> Iterable[Event]:
        """An event for each upset that began or ended since the last call.

        What ends because an aircraft is away ends without a word.

        Args:
            now: s
            truth: of N aircraft.
            air: what the truth knows of theirs.
            formation: of the n followers.
            away: (N,) who is lost, and (n,) who has no slot to keep; other arrays when that has
                changed.
        """
        if away[1] is not self._apart:
            self._apart, self._somebody_apart = away[1], bool(away[1].any())
        if self._somebody_apart:
            self._closest_m[1:][away[1]] = np.inf
        if not all(map(is_, (truth, air, formation), self._bound)):
            looks = zip(self._steady, (truth, air, formation), strict=True)
            given = tuple(steady(record) for steady, record in looks)
            if not all(map(is_, given, self._bound)):
                self._bound = given
                seen = given[0].equivalent_airspeed, given[1].alpha, given[2].error_ned
                self._look = READY_BEYOND(*seen, self._limits, self._closest_m)
        if not self._look() and not self._busy:
            return ()
        values = measured(truth.equivalent_airspeed, air.alpha, formation.error_ned)
        return self._changed(now, values, away)

    @property
    def over(self) -> bool:
        """Whether the run ends here."""
        return self._stops and self.unforeseen

    def _changed(self, now: float, values: Array, away: tuple[Truths, Truths]) -> Iterator[Event]:
        lost, without_slot = away
        here = np.tile(~lost, (3, 1))
        here[2, 1:] &= ~without_slot & ~lost[0]
        limits = self._limits.copy()
        limits[2] += self._closest_m
        above = here & (values > np.where(self._told, BACK * limits, limits))
        most = np.fmax(self._most, values)
        since = np.where(np.isnan(self._since), now, self._since)
        began = above & ~self._told & (now - since >= HOLD_S - SIMULTANEOUS_S)
        ended = here & self._told & ~above
        explained = self._explained()
        for kind, row in np.argwhere(began):
            level = "warning" if explained[kind, row] else "error"
            at, limit = (each[kind, row] * _SHOWN[kind] for each in (values, limits))
            text = _BEGINS[kind].format(at=at, limit=limit)
            yield Event(now, level, self._names[row], text)
        for kind, row in np.argwhere(ended):
            lasted, peak = now - since[kind, row], most[kind, row] * _SHOWN[kind]
            yield Event(now, "info", self._names[row], _ENDS[kind].format(lasted=lasted, most=peak))
        self.unforeseen |= bool((began & ~explained).any())
        self._told = (self._told | began) & above
        self._since, self._most = np.where(above, since, np.nan), np.where(above, most, 0.0)
        self._busy = bool(above.any())

    def _explained(self) -> Truths:
        """By a fault that is on: of the aircraft itself, or, for its place, of anybody (3, N)."""
        broken: Truths = np.zeros(len(self._names), dtype=bool)
        if self._breakdowns is not None:
            broken = self._breakdowns.broken
        return np.stack((broken, broken, np.full_like(broken, broken.any())))


def make_upsets(
    page: Scenario,
    tunes: Sequence[FbwaParams],
    airframes: Sequence[Airframe],
    flown: Sequence[int],
    breakdowns: Breakdowns | None,
) -> Upsets:
    """The watch that a page wants.

    Args:
        page: the scenario.
        tunes: of N aircraft.
        airframes: N
        flown: rows of those that are flight models: of others nobody asks how fast they are.
        breakdowns: of the page.
    """
    wanted = page.limits
    limits = np.full((3, len(tunes)), np.inf)
    for row in flown:
        stall = wanted.stall_deg
        limits[0, row] = wanted.overspeed_mps or OWN_OVERSPEED * tunes[row].airspeed_max
        limits[1, row] = math.radians(stall) if stall else airframes[row].stall_angle
    if wanted.formation_m is not None:
        limits[2, 1:] = wanted.formation_m
    stops = wanted.when_upset == "stop"
    return Upsets(page.aircraft_names, limits, breakdowns, stops=stops)
