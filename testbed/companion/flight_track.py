"""What has to be remembered from one observation to the next: jumps, stops, pauses, heights."""

from __future__ import annotations

import math
from collections.abc import Mapping

from testbed.companion.observation import Observation, Vector

RECENT_S = 5.0  # for which a jump counts as recent
STANDING_MPS, STANDING_S = 1.0, 5.0  # slower than this for this long is on the ground
FLYING_MPS = 3.0  # faster than this a position changes between samples
ACCELERATION_MPS2 = 15.0  # of a turn with 57° of bank; more is no manoeuvre of a formation


class PositionTrack:
    """Positions of one aircraft, and how far the last one was from where its velocity led."""

    def __init__(self) -> None:
        self.excess_m = 0.0  # beyond what an acceleration explains, the largest of the last 5 s
        self._time_s = -math.inf
        self._position: Vector | None = None
        self._velocity: Vector = (0.0, 0.0, 0.0)
        self._jumped_s = -math.inf

    def add(self, time_s: float, position: Vector, velocity: Vector) -> None:
        """Take a sample; one that is not newer than the last changes nothing.

        Args:
            time_s: of its measurement.
            position: m, north, east, down.
            velocity: m/s.
        """
        if time_s - self._jumped_s > RECENT_S:
            self.excess_m = 0.0
        if time_s <= self._time_s or not all(map(math.isfinite, (*position, *velocity))):
            return
        if self._position is not None:
            dt = time_s - self._time_s
            led = [
                p + 0.5 * dt * (v + w)
                for p, v, w in zip(self._position, self._velocity, velocity, strict=True)
            ]
            excess = math.dist(led, position) - 0.5 * ACCELERATION_MPS2 * dt * dt
            if excess > self.excess_m:
                self.excess_m, self._jumped_s = excess, time_s
        self._time_s, self._position, self._velocity = time_s, position, velocity


class _Standing:
    """Since when an aircraft stands on the ground."""

    def __init__(self) -> None:
        self._since_s = math.inf

    def add(self, now_s: float, velocity: Vector) -> bool:
        """Take a velocity; return whether it has stood for some seconds."""
        if not math.hypot(*velocity) < STANDING_MPS:  # NaN does not stand
            self._since_s = math.inf
        else:
            self._since_s = min(self._since_s, now_s)
        return now_s - self._since_s >= STANDING_S


class FlightTrack:
    """What follows from all observations up to now.

    Attributes:
        pause_s: time from the pass before the last to the last, s.
        stalled_s: for which the autopilot's time since boot has not grown, s.
        frozen_s: of boot time for which the own position has been the same in flight, s.
        restarted: the autopilot's boot time went back within the last 5 s.
        time_jump_s: largest recent change of the GPS time at boot, s.
        own: positions of the own aircraft.
        peers: positions of the others.
        heights_m: difference of the own height to another's while both stood, by name, m.
    """

    def __init__(self) -> None:
        self.pause_s = self.stalled_s = self.frozen_s = self.time_jump_s = 0.0
        self.restarted = False
        self.own = PositionTrack()
        self.peers: dict[str, PositionTrack] = {}
        self.heights_m: dict[str, float] = {}
        self._now_s: float | None = None
        self._boot_s: float | None = None
        self._grew_s = self._restarted_s = self._time_jumped_s = -math.inf
        self._base_ms: int | None = None
        self._position: Vector | None = None
        self._moved_s = math.inf
        self._standing = _Standing()
        self._peers_standing: dict[str, _Standing] = {}

    def add(self, seen: Observation) -> None:
        """Take an observation."""
        now = seen.now_s
        self.pause_s = 0.0 if self._now_s is None else now - self._now_s
        self._now_s = now
        self._add_boot_time(seen)
        self._add_gps_time(seen)
        if seen.boot_s is not None:
            self.own.add(seen.boot_s, seen.position_ned, seen.velocity_ned)
            self._add_frozen(seen.boot_s, seen.position_ned, seen.velocity_ned)
        for name, peer in seen.peers.items():
            track = self.peers.setdefault(name, PositionTrack())
            track.add(peer.stamp_s, peer.position_ned, peer.velocity_ned)
        self._add_heights(seen)

    def peer_excess_m(self, name: str) -> float:
        """Return how far another aircraft has jumped recently, m."""
        return self.peers[name].excess_m if name in self.peers else 0.0

    def _add_boot_time(self, seen: Observation) -> None:
        boot, now = seen.boot_s, seen.now_s
        if boot is None:
            return
        if self._boot_s is None or boot > self._boot_s:
            self._grew_s = now
        elif boot < self._boot_s:
            self._restarted_s = self._grew_s = now
            self._forget_own_state()
        self._boot_s = boot
        self.stalled_s = now - self._grew_s
        self.restarted = now - self._restarted_s < RECENT_S

    def _forget_own_state(self) -> None:
        """Forget what an autopilot that was started again counts from another moment."""
        self.own, self._base_ms, self._position = PositionTrack(), None, None

    def _add_gps_time(self, seen: Observation) -> None:
        if seen.now_s - self._time_jumped_s >= RECENT_S:
            self.time_jump_s = 0.0
        if seen.base_ms is None:
            return
        if self._base_ms is not None and seen.base_ms != self._base_ms:
            jump = abs(seen.base_ms - self._base_ms) / 1000.0
            if jump > self.time_jump_s:
                self.time_jump_s, self._time_jumped_s = jump, seen.now_s
        self._base_ms = seen.base_ms

    def _add_frozen(self, boot_s: float, position: Vector, velocity: Vector) -> None:
        if position != self._position or not math.hypot(*velocity) > FLYING_MPS:
            self._position, self._moved_s = position, boot_s
        self.frozen_s = max(boot_s - self._moved_s, 0.0)

    def _add_heights(self, seen: Observation) -> None:
        stands = self._standing.add(seen.now_s, seen.velocity_ned)
        for name, peer in seen.peers.items():
            known = self._peers_standing.setdefault(name, _Standing())
            velocity = peer.velocity_ned if peer.age_s < STANDING_S else (math.nan,) * 3
            apart = seen.height_m - peer.height_m
            if known.add(seen.now_s, velocity) and stands and math.isfinite(apart):
                self.heights_m[name] = apart


def largest(values: Mapping[str, float]) -> tuple[str, float]:
    """Return the name and the value that is farthest from 0; of none an empty name and 0."""
    return max(values.items(), key=lambda item: abs(item[1]), default=("", 0.0))
