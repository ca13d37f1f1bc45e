"""Report timeouts: followers that receive no messages of their leader, or of a neighbour."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from testbed.core.compile import Kernel, entry
from testbed.core.records import BoolArray, Event, Indices, Records, allocate
from testbed.formation.law import LimiterFlag
from testbed.network.link_statistics import record_ages

LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
# What `check_links` finds: timeouts of neighbours began or ended; a leader timeout is active.
NEIGHBOUR, LEADER = 1, 2

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
        """See the class."""
        self._names, self._neighbours = names, neighbours
        self._followers, links = records
        self._builtin, self._hold = builtin, hold
        self._leader_timeout_s, neighbour_timeout_s = timeouts_s
        self._watches = allocate(LINK_WATCH, *neighbours.shape)
        self._check_links = partial(
            check_links, statistics, links, self._followers, self._watches, neighbour_timeout_s
        )
        self._leader_late: BoolArray = np.zeros(len(self._followers), dtype=bool)
        # no message of the leader yet, and it is not late yet
        self._waiting: BoolArray = np.ones(len(self._followers), dtype=bool)
        # a leader timeout is active, or one is waited for or to be reported as over
        self._leader_timeout, self._leader_pending = True, True
        self.set_left(np.zeros(len(self._followers), dtype=bool))

    def set_left(self, left: BoolArray) -> None:
        """Watch only the messages that are used now, of followers that have not left (n,)."""
        self._left = left
        used = np.array(self._neighbours["used"])
        used[:, 0] = False  # the leader has a timeout of its own
        np.fill_diagonal(used[:, 1:], False)
        self._watches["watched"] = watched = used & ~left[:, np.newaxis]
        for name in ("late", "reported"):
            self._watches[name] &= watched

    def kernels(self) -> list[Kernel]:
        """Return the compiled calls of `neighbour_changes`, for `core.compile.prepare`."""
        return [partial(self._check_links, np.arange(len(self._followers)), 0.0)]

    def neighbour_changes(self, now: float, rows: Indices) -> Iterable[Event]:
        """Return an event for each neighbour timeout that began or ended since the last call.

        Args:
            now: s, when the followers of these rows stepped.
            rows: (m,) among the n followers.
        """
        found = self._check_links(rows, now)
        self._leader_timeout = bool(found & LEADER)
        return self._neighbour_events(now) if found & NEIGHBOUR else ()

    def leader_changes(self, now: float) -> Iterable[Event]:
        """Return an event for each leader timeout that began or ended since the last call.

        Args:
            now: s, after all followers that are due have stepped.
        """
        if not (self._leader_timeout or self._leader_pending):
            return ()
        return self._leader_events(now)

    def _leader_events(self, now: float) -> Iterator[Event]:
        late = (self._followers["limiter_flags"] & LEADER_TIMEOUT != 0) & ~self._left
        self._waiting &= late & (now < self._leader_timeout_s)
        late &= ~self._waiting
        for i in np.flatnonzero(late != self._leader_late).tolist():
            if late[i]:
                text = "leader timeout: no messages of the leader"
                yield Event(now, "warning", self._names[i + 1], text)
            else:
                yield Event(now, "info", self._names[i + 1], "receives the leader again")
        self._leader_late = late
        self._leader_pending = bool(late.any() or self._waiting.any())

    def _neighbour_events(self, now: float) -> Iterator[Event]:
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
    followers: Records,
    watches: Records,
    timeout_s: float,
    rows: Indices,
    now: float,
) -> int:
    """Count the ages of the messages used, and find timeouts.

    Args:
        statistics: (n, N) of LINK_STATISTICS; written.
        links: (n, N) of LINK.
        followers: (n,) of FOLLOWER.
        watches: (n, N) of LINK_WATCH; `late` is written.
        timeout_s: of a neighbour, since the last message, or since the start.
        rows: (m,) of the followers that have stepped.
        now: s.

    Returns:
        NEIGHBOUR and LEADER, or'ed.
    """
    record_ages(statistics, rows, links["age_s"])
    found = 0
    for i in rows:
        for m in range(watches.shape[1]):
            watch, received_s = watches[i, m], links[i, m].received_s
            # NaN, before the first message, is not above 0
            age = now - (received_s if received_s > 0.0 else 0.0)
            watch.late = watch.watched and age > timeout_s
            if watch.late != watch.reported:
                found |= NEIGHBOUR
    for i in range(len(followers)):
        if followers[i].limiter_flags & LEADER_TIMEOUT:
            found |= LEADER
    return found
