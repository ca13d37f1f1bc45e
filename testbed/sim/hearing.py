"""Who hears whom: followers that do not hear their leader, or a neighbour that they heed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from operator import is_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.formation.flags import Guard, Missing
from testbed.formation.paper_law import PaperLaw
from testbed.network.ledger import Ledger, use
from testbed.sim.control import Group
from testbed.state import Array, Event, Flags, Truths

Numbers = NDArray[np.intp]

SILENT = int(Guard.LEADER_SILENT)
OVERDUE, DEAF = map(int, Missing)


def heard(
    ledger: Ledger,
    rows: Numbers,
    age_s: Array,
    guards: Flags,
    received_s: Array,
    heeded: Truths,
    missed: Truths,
    limit: float,
    late: Truths,
    now: float,
) -> int:
    """Count what followers used, and look whether anybody's news has become too old or new.

    Args:
        ledger: of the radio; what was used is counted in it.
        rows: (m,) of the followers that have stepped.
        age_s: (n, N) s, of what they used of each aircraft; nan: nothing.
        guards: (n,)
        received_s: (n, N) s, when they last heard of each aircraft; nan: never.
        heeded: (n, N) whom they reckon with.
        missed: (n, N) whose news was too old before.
        limit: s since it was received, or since the start.
        late: (n, N) whose news is too old now, is written in these rows.
        now: s.

    Returns:
        OVERDUE where `late` and `missed` differ in these rows, DEAF where any of the n followers
        does not hear its leader.
    """
    use(ledger, rows, age_s)
    late[rows] = heeded[rows] & (now - np.fmax(received_s[rows], 0.0) > limit)
    overdue = (late[rows] != missed[rows]).any()
    return OVERDUE * int(overdue) | DEAF * int((guards & SILENT).any())


READY_HEARD = ready_of(heard, "testbed.sim.hearing_twin")


class Hearing:
    """Watches who hears whom, and counts how old what they use is.

    Args:
        names: N of the aircraft, the leader's first.
        groups: of the followers.
        ledger: of the radio.
    """

    def __init__(self, names: Sequence[str], groups: Sequence[Group], ledger: Ledger) -> None:
        """See the class."""
        self._ledger = ledger
        self._silence = Silence(names[1:], groups[0].team.silent_after)
        self._staleness = Staleness(names, groups)
        self._deaf = True  # somebody may be
        self._looks: dict[int, tuple[Any, ...]] = {}  # by who looks, which are kept in it

    def changes(
        self, now: float, rows: Numbers, age_s: Array, guards: Flags, received_s: Array
    ) -> Iterable[Event]:
        """An event for each neighbour whose news became too old, or new, since the last call.

        Args:
            now: s, when the followers of these rows stepped.
            rows: (m,) among the n followers.
            age_s: (n, N) s, of what they used.
            guards: (n,)
            received_s: (n, N) s, as in the inboxes then; nan: nothing heard yet.
        """
        stale = self._staleness
        if stale.placing:
            stale.place(now, rows, received_s)
        given = age_s, guards, received_s
        known = self._looks.get(id(rows))
        if known is None or not all(map(is_, given, known[1])):
            at = stale.heeded, stale.missed, stale.limit, stale.late
            look = READY_HEARD(self._ledger, rows, *given, *at)
            known = self._looks[id(rows)] = rows, given, look
        found = known[2](now)
        self._deaf = bool(found & DEAF)
        return stale.changes(now) if found & OVERDUE else ()

    def silences(self, now: float, guards: Flags, apart: Truths) -> Iterable[Event]:
        """An event for each follower whose leader fell silent or came back since the last call.

        Args:
            now: s
            guards: (n,) after all that have stepped.
            apart: (n,) who is lost, or has left: nothing is said of them.
        """
        if self._silence.quiet and not self._deaf:
            return ()
        return self._silence.changes(now, guards, apart)

    def heed(self, groups: Sequence[Group], apart: Truths) -> None:
        """Miss no one from now on but those that these groups reckon with.

        Args:
            groups: of the followers.
            apart: (n,) who misses nobody: who is lost, or has left.
        """
        self._staleness.heed(groups, apart)


class Silence:
    """Watches which followers have stopped or begun to hear their leader."""

    def __init__(self, names: Sequence[str], patience: float) -> None:
        """Nobody is deaf yet; who has heard nothing at all is given this long, s."""
        self._names, self._patience = names, patience
        self._deaf: Truths = np.zeros(len(names), dtype=bool)
        self._waiting: Truths = np.ones(len(names), dtype=bool)
        self.quiet = False  # everybody has heard the leader, and hears it

    def changes(self, now: float, guards: Flags, apart: Truths) -> Iterator[Event]:
        """An event for each follower whose leader fell silent or came back since the last call.

        Args:
            now: s
            guards: (n,)
            apart: (n,) who is lost, or has left: nothing is said of them.
        """
        deaf = ((guards & SILENT) != 0) & ~apart
        self._waiting = self._waiting & deaf & (now < self._patience)
        deaf &= ~self._waiting
        for name, before, after in zip(self._names, self._deaf, deaf, strict=True):
            if after and not before:
                yield Event(now, "warning", name, "does not hear the leader: flies on its own")
            elif before and not after:
                yield Event(now, "info", name, "hears the leader again")
        self._deaf = deaf
        self.quiet = not (deaf.any() or self._waiting.any())


class Staleness:
    """Watches which followers have stopped or begun to hear the neighbours that they heed."""

    def __init__(self, names: Sequence[str], groups: Sequence[Group]) -> None:
        """Of N names, the leader's first: nobody is missed; news is given time from 0 s on."""
        self._names = names
        law, team = groups[0].law, groups[0].team
        self.limit, self._leaders_limit = team.stale_after, team.silent_after
        self._paper = isinstance(law, PaperLaw)  # of a law of the user's own nobody knows
        self._hold = isinstance(law, PaperLaw) and law.hold
        # (n, N) whom each reckons with; whose news was too old before; and is now
        self.heeded = _heeded(len(names), groups)
        self.missed, self.late = np.zeros((2, *self.heeded.shape), dtype=bool)
        # Whom a law that holds places has none for yet: it takes them while the leader is heard.
        self._nowhere: Truths = self.heeded & self._hold
        self.placing = self._hold

    def place(self, now: float, rows: Numbers, received_s: Array) -> None:
        """Take it in that followers (m,) have places for those they hear (n, N) now, s."""
        age = now - received_s[rows]
        self._nowhere[rows] &= ~((age <= self.limit) & (age[:, :1] <= self._leaders_limit))
        self.placing = bool(self._nowhere.any())

    def changes(self, now: float) -> Iterator[Event]:
        """An event for each neighbour who is late now and was not missed, or the reverse."""
        for i, m in np.argwhere(self.late != self.missed):
            name, other = self._names[i + 1], self._names[m]
            if self.late[i, m]:
                what = self._consequence(bool(self._nowhere[i, m]))
                yield Event(now, "warning", name, f"does not hear {other}{what}")
            else:
                yield Event(now, "info", name, f"hears {other} again")
        self.missed[:] = self.late

    def heed(self, groups: Sequence[Group], apart: Truths) -> None:
        """Miss no one from now on but those that these groups reckon with.

        Args:
            groups: of the followers.
            apart: (n,) who misses nobody: who is lost, or has left.
        """
        self.heeded[:] = _heeded(len(self._names), groups) & ~apart[:, np.newaxis]
        for each in (self.missed, self.late, self._nowhere):
            each &= self.heeded

    def _consequence(self, nowhere: bool) -> str:
        if not self._paper:
            return ""
        return ": takes it to hold its place" if self._hold and not nowhere else ": leaves it out"


def _heeded(aircraft: int, groups: Sequence[Group]) -> Truths:
    """Whose messages each follower uses (n, N), the leader's aside."""
    out: Truths = np.zeros((aircraft - 1, aircraft), dtype=bool)
    for group in groups:
        out[group.rows] = ~group.unheeded
    out[:, 0] = False
    np.fill_diagonal(out[:, 1:], False)
    return out
