"""Monitors of a run: gusts, joining, losses and timeouts, reported as events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import sqrt

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.flags import LimiterFlag
from testbed.core.records import Array, BoolArray, Event, Indices, Records, allocate
from testbed.flight.faults import FaultManager
from testbed.flight.limits import ProximityMonitor
from testbed.metrics.accumulator import JOIN_HOLD_S, JOIN_RADIUS_M
from testbed.network.link_statistics import record_ages


class GustMonitor:
    """Report when a gust reaches an aircraft.

    Args:
        gusts: G names of gusts.
        names: N names of aircraft.
    """

    def __init__(self, gusts: Sequence[str], names: Sequence[str]) -> None:
        self._gusts, self._names = gusts, names
        self._active: BoolArray = np.zeros((len(gusts), len(names)), dtype=bool)

    def changes(self, now: float, active: BoolArray) -> Iterator[Event]:
        """Return an event for each gust that has reached an aircraft since the last call.

        Args:
            now: s
            active: (G, N) which gust acts on which aircraft now.
        """
        for gust, reached in zip(self._gusts, active & ~self._active, strict=True):
            if reached.all():
                yield Event(now, "info", "run", f"gust {gust} reaches all aircraft")
                continue
            for i in np.flatnonzero(reached).tolist():
                yield Event(now, "info", self._names[i], f"gust {gust} reaches it")
        self._active = active


# What is known of one follower.
JOIN = np.dtype(
    [
        ("since", "i8"),  # tick from which it has been in its slot; -1: it is not
        ("joined", "?"),  # it has held its slot for long enough
    ],
    align=True,
)


class JoinMonitor:
    """Report followers that join the formation, by the rule of the metrics.

    Args:
        names: of the n followers.
        base_rate_hz: of the ticks.
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.

    Attributes:
        call: after which `changes` is needed where it returns true.
    """

    def __init__(
        self, names: Sequence[str], base_rate_hz: int, aircraft: Records, followers: Records
    ) -> None:
        self._names, self._rate_hz = names, base_rate_hz
        self._joins = allocate(JOIN, len(names))
        self._joins["since"] = -1
        self._reported: BoolArray = np.zeros(len(names), dtype=bool)
        rate_hz = float(base_rate_hz)
        rule = JOIN_RADIUS_M, JOIN_HOLD_S * rate_hz, rate_hz
        self.call = Call(find_joined, aircraft, followers, *rule, self._joins, NOW)

    def changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each follower that has held its slot for long enough, once in a run.

        Args:
            now: s.
        """
        joined = self._joins["joined"]
        for i in np.flatnonzero(joined & ~self._reported).tolist():
            since = f"{self._joins['since'][i] / self._rate_hz:.1f} s"
            text = f"joined: within {JOIN_RADIUS_M:g} m of its slot since {since}"
            yield Event(now, "info", self._names[i], text)
        self._reported = joined.copy()


@entry
def find_joined(
    aircraft: Records,
    followers: Records,
    radius_m: float,
    hold_ticks: float,
    rate_hz: float,
    joins: Records,
    now: float,
) -> bool:
    """Write which followers have joined; return whether one has at this tick.

    Args:
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
        radius_m: of a slot.
        hold_ticks: how long a follower has to stay in its slot.
        rate_hz: of the ticks.
        joins: (n,) of JOIN; written.
        now: s.
    """
    new, tick = False, round(now * rate_hz)
    for i in range(len(followers)):
        x, y, z = followers[i].error_ned
        inside = sqrt(x * x + y * y + z * z) <= radius_m
        join = joins[i]
        if aircraft[0].lost or aircraft[i + 1].lost or not inside:
            join.since = -1
        else:
            if join.since < 0:
                join.since = tick
            if not join.joined and tick - join.since >= hold_ticks:
                join.joined = new = True
    return new


class LossMonitor:
    """Report aircraft that are lost, and whether the run ends.

    A run that continues completes if all lost aircraft had an active fault of the scenario.

    Attributes:
        lost: (N,) a new array when it changes, because observers keep the old one.
        terminate: the run ends now.
    """

    def __init__(
        self,
        names: Sequence[str],
        lowest_m: Array,
        proximity: ProximityMonitor,
        faults: FaultManager | None,
        *,
        fly_on: bool,
    ) -> None:
        """Start without lost aircraft.

        Args:
            names: N aircraft.
            lowest_m: (N,) see `find_losses`.
            proximity: reports collisions.
            faults: of the scenario; None: it has none.
            fly_on: the run continues without lost aircraft.
        """
        self._names, self._proximity, self._faults = names, proximity, faults
        self._lowest_m, self._fly_on = lowest_m, fly_on
        self.lost: BoolArray = np.zeros(len(names), dtype=bool)
        self.terminate = False
        self._unexpected = False  # an aircraft without an active fault was lost
        self._last_down = self.lost.tobytes()

    def changes(self, now: float, position_ned: Array, down: BoolArray) -> list[Event]:
        """Return an event for each aircraft lost since the last call; update `lost`.

        Args:
            now: s.
            position_ned: (N, 3) m.
            down: (N,) on the ground, or outside their flight models.
        """
        bits = down.tobytes()
        if bits == self._last_down and not self._proximity.enabled:
            return []
        self._last_down = bits
        events = [
            Event(
                now,
                "error",
                self._names[row],
                f"lost: {self._cause(row, position_ned[row])}",
            )
            for row in np.flatnonzero(down & ~self.lost).tolist()
        ]
        faulty = self._faults.active if self._faults else None
        close, collided = self._proximity.changes(now, position_ned, self.lost | down, faulty)
        lost = self.lost | down | collided
        new = lost & ~self.lost
        if new.any():
            expected = self._faults.active if self._faults else self.lost
            self._unexpected |= bool((new & ~expected).any())
            self.lost = lost
            self.terminate = bool(lost.all()) or not self._fly_on
        return [*events, *close]

    def _cause(self, row: int, position_ned: Array) -> str:
        """Describe why an aircraft at this position (3,) is lost."""
        if -position_ned[2] < self._lowest_m[row]:
            return f"on the ground, at {-position_ned[2]:.1f} m"
        return "its motion is not finite, or outside the range of its flight model"

    @property
    def outcome(self) -> str:
        """Outcome of a run that has ended: "lost" or "completed"."""
        return "lost" if self.terminate or self._unexpected else "completed"


LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
# The messages of the leader at one follower.
LEADER_WATCH = np.dtype(
    [
        ("waiting", "?"),  # no message yet, and it is not late yet
        ("late", "?"),  # a leader timeout is active
        ("reported", "?"),  # late at the last event
        ("left", "?"),  # the follower has left the formation
    ],
    align=True,
)

# The link from one aircraft to one follower.
LINK_WATCH = np.dtype(
    [
        ("watched", "?"),  # the follower uses the neighbour's messages
        ("late", "?"),  # no message for the neighbour timeout
        ("reported", "?"),  # late at the last event
    ],
    align=True,
)


class LinkMonitor:
    """Report timeouts of leader and neighbours, and count the ages of the messages used.

    Args:
        names: N names of aircraft, the leader first.
        neighbours: (n, N) of NEIGHBOUR.
        records: followers (n,) of FOLLOWER and links (n, N) of LINK.
        statistics: (n, N) of LINK_STATISTICS; written.
        timeouts_s: of the leader and of a neighbour.
        builtin: the law is that of [HBH23], so that its response to a timeout is known.
        hold: it holds neighbours at their last relative position.
    """

    def __init__(
        self,
        names: Sequence[str],
        neighbours: Records,
        records: tuple[Records, Records],
        statistics: Records,
        timeouts_s: tuple[float, float],
        *,
        builtin: bool,
        hold: bool,
    ) -> None:
        self._names, self._neighbours = names, neighbours
        self._followers, links = records
        self._builtin, self._hold = builtin, hold
        self._leader_timeout_s, neighbour_timeout_s = timeouts_s
        self._watches = allocate(LINK_WATCH, *neighbours.shape)
        self._checked = statistics, links, self._watches, neighbour_timeout_s
        self._leaders = allocate(LEADER_WATCH, len(self._followers))
        self._leaders["waiting"] = True
        self.leader_call = Call(
            check_leaders, self._followers, self._leaders, self._leader_timeout_s, NOW
        )
        self.set_left(np.zeros(len(self._followers), dtype=bool))

    def set_left(self, left: BoolArray) -> None:
        """Watch only the messages that are used now, of followers that have not left (n,)."""
        self._leaders["left"] = left
        used = np.array(self._neighbours["used"])
        used[:, 0] = False  # the leader has a timeout of its own
        np.fill_diagonal(used[:, 1:], False)
        self._watches["watched"] = watched = used & ~left[:, np.newaxis]
        for name in ("late", "reported"):
            self._watches[name] &= watched

    def neighbour_call(self, rows: Indices) -> Call:
        """Return the call after which `neighbour_changes` is needed where it returns true.

        Args:
            rows: (m,) followers that have stepped, among the n.
        """
        return Call(check_links, *self._checked, rows, NOW)

    def leader_changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each leader timeout that began or ended since the last call.

        Args:
            now: s, after all followers that are due have stepped.
        """
        leaders = self._leaders
        for i in np.flatnonzero(leaders["late"] != leaders["reported"]).tolist():
            if leaders["late"][i]:
                text = "leader timeout: no messages of the leader"
                yield Event(now, "warning", self._names[i + 1], text)
            else:
                yield Event(now, "info", self._names[i + 1], "receives the leader again")
        leaders["reported"] = leaders["late"]

    def neighbour_changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each neighbour timeout that began or ended since the last call."""
        watches = self._watches
        for i, m in np.argwhere(watches["late"] != watches["reported"]).tolist():
            name, other = self._names[i + 1], self._names[m]
            if watches["late"][i, m]:
                text = f"neighbour timeout: no messages of {other}{self._response(i, m)}"
                yield Event(now, "warning", name, text)
            else:
                yield Event(now, "info", name, f"receives {other} again")
        watches["reported"] = watches["late"]

    def _response(self, i: int, m: int) -> str:
        """Return the law's response to a neighbour timeout, for the text of the event."""
        if not self._builtin:
            return ""
        held = self._hold and not np.isnan(self._neighbours["held_time_s"][i, m])
        return ", held at its relative position" if held else ", left out"


@entry
def check_links(
    statistics: Records,
    links: Records,
    watches: Records,
    timeout_s: float,
    rows: Indices,
    now: float,
) -> bool:
    """Count the ages of the messages used, and find timeouts of neighbours.

    Args:
        statistics: (n, N) of LINK_STATISTICS; written.
        links: (n, N) of LINK.
        watches: (n, N) of LINK_WATCH; `late` is written.
        timeout_s: of a neighbour, since the last message, or since the start.
        rows: (m,) of the followers that have stepped.
        now: s.

    Returns:
        Whether a timeout has begun or ended since the last report.
    """
    record_ages(statistics, rows, links["age_s"])
    found = False
    for i in rows:
        for m in range(watches.shape[1]):
            watch, received_s = watches[i, m], links[i, m].received_s
            # NaN, before the first message, is not above 0
            age = now - (received_s if received_s > 0.0 else 0.0)
            watch.late = watch.watched and age > timeout_s
            if watch.late != watch.reported:
                found = True
    return found


@entry
def check_leaders(followers: Records, leaders: Records, timeout_s: float, now: float) -> bool:
    """Find timeouts of the leader; return whether one has begun or ended since the last report.

    Args:
        followers: (n,) of FOLLOWER.
        leaders: (n,) of LEADER_WATCH; `waiting` and `late` are written.
        timeout_s: of the leader, since the start.
        now: s.
    """
    found = False
    for i in range(len(followers)):
        leader = leaders[i]
        late = followers[i].limiter_flags & LEADER_TIMEOUT != 0 and not leader.left
        leader.waiting = leader.waiting and late and now < timeout_s
        leader.late = late and not leader.waiting
        if leader.late != leader.reported:
            found = True
    return found
