"""Who is left of the formation, as each follower knows it, and what each makes of that.

A follower that has failed says so with every message, for good. Others know it from the first such
message that reaches them. A leader that fails leads on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from testbed.formation.paper_law import PaperLaw
from testbed.frames import velocity_frame
from testbed.sim.breakdowns import Breakdowns
from testbed.sim.control import Group
from testbed.state import Array, Event, Inbox, Truths


class Roster:
    """What n followers know of who has failed, and where each belongs then.

    A follower leaves out of its graph whom it knows to have failed. If they close up, who has
    failed leaves the formation: it flies as without a leader. The others take the first places in
    the order of the fleet once it has left its own; a place has its offset and its gains, whoever
    is in it. If they do not, who has failed goes on as before.

    Args:
        names: N aircraft, the leader first.
        offsets: υ (N, 3) m of the places.
        gains: (n, N, 3) β of the places.
        breakdowns: what aircraft say of themselves.
        clear_m: how far from its place one must be to have left it; None: nobody closes up.
        close_up: take the places of those that failed, "re-slot"; or only leave them out.
    """

    def __init__(
        self,
        names: Sequence[str],
        offsets: Array,
        gains: Array,
        breakdowns: Breakdowns,
        clear_m: float | None,
    ) -> None:
        """Everybody is there."""
        self._names, self._breakdowns, self._clear_m = names, breakdowns, clear_m
        self._offsets, self._gains = offsets, gains
        n = len(names) - 1
        self.known: Truths = np.zeros((n, n + 1), dtype=bool)
        self._left: Truths = np.zeros_like(self.known)  # who has left its place, too
        self.alone: Truths = np.zeros(n, dtype=bool)  # who has failed itself, and left
        self._places = np.tile(np.arange(n + 1), (n, 1))  # (n, N) by agent, as agent i sees it

    @property
    def places(self) -> NDArray[np.intp]:
        """Rows (n,) of the places that the followers take to be their own."""
        own: NDArray[np.intp] = self._places.diagonal(1).copy()
        return own

    @property
    def offsets(self) -> Array:
        """υ (N, 3) m of the place that each takes itself to have."""
        return np.vstack([self._offsets[:1], self._offsets[self.places]])

    def changes(
        self,
        now: float,
        rows: NDArray[np.intp],
        inbox: Inbox,
        measured_s: Array,
    ) -> Iterator[Event]:
        """An event for each thing a follower has learnt since the last call.

        Args:
            now: s
            rows: (m,) followers that step now.
            inbox: (n, N)
            measured_s: (n, N) s, when what is in their inboxes was true.
        """
        known = self.known[rows] | self._breakdowns.told(measured_s[rows])
        known[np.arange(len(rows)), rows + 1] = known[:, 0] = False
        for at, m in np.argwhere(known & ~self.known[rows]).tolist():
            row = int(rows[at])
            self.known[row, m] = True
            heeded = self._gains[self.places[row] - 1, self._places[row, m]].any()
            what = ": leaves it out" if heeded and not self.alone[row] else ""
            yield self._news(now, row, f"{self._names[m]} has failed{what}")
        if self._clear_m is None:
            return
        failed = self._breakdowns.told(np.full(len(self._names), now))[rows + 1]
        for row in rows[failed & ~self.alone[rows]].tolist():
            self.alone[row] = True
            yield self._news(now, row, "leaves the formation: flies on its own")
        for row, m in np.argwhere(self.known & ~self._left).tolist():
            if row in rows and not self.alone[row] and self._far(row, m, inbox, measured_s[row]):
                self._left[row, m] = True
                before = self.places[row]
                self._close_up(row)
                place = self.places[row]
                taken = "" if place == before else f", takes the place of {self._names[place]}"
                yield self._news(now, row, f"{self._names[m]} has left its place{taken}")

    def _news(self, now: float, row: int, text: str) -> Event:
        return Event(now, "warning", self._names[row + 1], text)

    def _far(self, row: int, m: int, inbox: Inbox, measured_s: Array) -> bool:
        """Whether by its last message m was far from its place, as this follower reckons."""
        velocity = inbox.velocity_ned[row, 0]
        leader = inbox.position_ned[row, 0] + velocity * (measured_s[m] - measured_s[0])
        offset = self._offsets[self._places[row, m]]
        place = leader + velocity_frame(velocity[np.newaxis])[0] @ offset
        return float(np.linalg.norm(inbox.position_ned[row, m] - place)) > (self._clear_m or 0.0)

    def _close_up(self, row: int) -> None:
        """Give who is left the first places that no failed aircraft has, as this one sees it."""
        places = self._places[row]
        kept = set(places[self.known[row] & ~self._left[row]].tolist())
        free = [place for place in range(1, len(places)) if place not in kept]
        here = [m for m in range(1, len(places)) if not self.known[row, m]]
        places[here] = free[: len(here)]

    def regrouped(self, group: Group) -> Group:
        """The group with gains and offsets as its followers know them now."""
        gains, offsets = group.team.gains.copy(), np.empty((len(group.rows), *self._offsets.shape))
        for at, row in enumerate(group.rows.tolist()):
            places = self._places[row]
            offsets[at] = self._offsets[places]
            gains[at] = self._gains[places[row + 1] - 1, places]
            gains[at, self.known[row]] = 0.0
        law = group.law
        if isinstance(law, PaperLaw):
            law = replace(law, gains=gains, offsets=offsets)
        return replace(group, law=law, team=replace(group.team, gains=gains))

    def heard(self, inbox: Inbox) -> Inbox:
        """The inboxes without those who are known to have failed: as if never heard.

        Who has left the formation hears nobody.
        """
        out = self.known | self.alone[:, np.newaxis]
        if not out.any():
            return inbox
        stamp, received = (np.where(out, np.nan, e) for e in (inbox.stamp_s, inbox.received_s))
        gone = out[:, :, np.newaxis]
        return Inbox(stamp, received, *(np.where(gone, np.nan, each) for each in inbox[2:]))
