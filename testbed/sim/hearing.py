"""Who hears whom: followers that do not hear their leader, or a neighbour that they heed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.formation.flags import Guard
from testbed.formation.paper_law import PaperLaw
from testbed.sim.control import Group
from testbed.state import Array, Event, Flags, Truths

SILENT = int(Guard.LEADER_SILENT)


def some_deaf(guards: Flags) -> bool:
    """Whether any of the followers (n,) does not hear its leader."""
    return bool((guards & SILENT).any())


def overdue(
    rows: NDArray[np.intp],
    received_s: Array,
    heeded: Truths,
    missed: Truths,
    limit: float,
    late: Truths,
    now: float,
) -> bool:
    """Whether anybody's news has become too old, or is so no longer.

    Args:
        rows: (m,) of the followers that look.
        received_s: (n, N) s, when they last heard of each aircraft; nan: never.
        heeded: (n, N) whom they reckon with.
        missed: (n, N) whose news was too old before.
        limit: s since it was received, or since the start.
        late: (n, N) whose news is too old now, is written in these rows.
        now: s.
    """
    heard = np.fmax(received_s[rows], 0.0)
    late[rows] = heeded[rows] & (now - heard > limit)
    return bool((late[rows] != missed[rows]).any())


READY_SOME_DEAF = ready_of(some_deaf, "testbed.sim.hearing_twin")
READY_OVERDUE = ready_of(overdue, "testbed.sim.hearing_twin")


class Silence:
    """Watches which followers have stopped or begun to hear their leader."""

    def __init__(self, names: Sequence[str], patience: float) -> None:
        """Nobody is deaf yet; who has heard nothing at all is given this long, s."""
        self._names, self._patience = names, patience
        self._deaf: Truths = np.zeros(len(names), dtype=bool)
        self._waiting: Truths = np.ones(len(names), dtype=bool)
        self._quiet = False  # everybody has heard the leader, and hears it
        self._guards: Flags | None = None  # that are looked at

    def changes(self, now: float, guards: Flags, apart: Truths) -> Iterator[Event]:
        """An event for each follower whose leader fell silent or came back since the last call.

        Args:
            now: s
            guards: (n,)
            apart: (n,) who is lost, or has left: nothing is said of them.
        """
        if guards is not self._guards:
            self._guards, self._some_deaf = guards, READY_SOME_DEAF(guards)
        if self._quiet and not self._some_deaf():
            return
        deaf = ((guards & SILENT) != 0) & ~apart
        self._waiting = self._waiting & deaf & (now < self._patience)
        deaf &= ~self._waiting
        for name, before, after in zip(self._names, self._deaf, deaf, strict=True):
            if after and not before:
                yield Event(now, "warning", name, "does not hear the leader: flies on its own")
            elif before and not after:
                yield Event(now, "info", name, "hears the leader again")
        self._deaf = deaf
        self._quiet = not (deaf.any() or self._waiting.any())


class Staleness:
    """Watches which followers have stopped or begun to hear the neighbours that they heed."""

    def __init__(self, names: Sequence[str], groups: Sequence[Group]) -> None:
        """Of N names, the leader's first: nobody is missed; news is given time from 0 s on."""
        self._names = names
        self._heeded = _heeded(len(names), groups)
        law = groups[0].law
        self._limit = groups[0].team.stale_after
        self._leaders_limit = groups[0].team.silent_after
        self._paper = isinstance(law, PaperLaw)  # of a law of the user's own nobody knows
        self._hold = isinstance(law, PaperLaw) and law.hold
        self._missed, self._late = np.zeros((2, *self._heeded.shape), dtype=bool)
        self._looks: dict[int, tuple[Any, ...]] = {}  # by who looks, which are kept in it
        # Whom a law that holds places has none for yet: it takes them while the leader is heard.
        self._nowhere: Truths = self._heeded & self._hold
        self._placing = self._hold

    def changes(self, now: float, rows: NDArray[np.intp], received_s: Array) -> Iterator[Event]:
        """An event for each neighbour whose news became too old, or new, since the last call.

        Args:
            now: s, when the followers of these rows stepped.
            rows: (m,) among the n followers.
            received_s: (n, N) as in the inboxes then; nan: nothing heard yet.
        """
        if self._placing:
            age = now - received_s[rows]
            self._nowhere[rows] &= ~((age <= self._limit) & (age[:, :1] <= self._leaders_limit))
            self._placing = bool(self._nowhere.any())
        _, given, look = self._looks.get(id(rows), (None, None, None))
        if given is not received_s or look is None:
            at = rows, received_s, self._heeded, self._missed, self._limit, self._late
            look = READY_OVERDUE(*at)
            self._looks[id(rows)] = rows, received_s, look
        if not look(now):
            return
        for i, m in np.argwhere(self._late != self._missed):
            name, other = self._names[i + 1], self._names[m]
            if self._late[i, m]:
                what = self._consequence(bool(self._nowhere[i, m]))
                yield Event(now, "warning", name, f"does not hear {other}{what}")
            else:
                yield Event(now, "info", name, f"hears {other} again")
        self._missed[:] = self._late

    def heed(self, groups: Sequence[Group], apart: Truths) -> None:
        """Miss no one from now on but those that these groups reckon with.

        Args:
            groups: of the followers.
            apart: (n,) who misses nobody: who is lost, or has left.
        """
        self._heeded[:] = _heeded(len(self._names), groups) & ~apart[:, np.newaxis]
        for each in (self._missed, self._late, self._nowhere):
            each &= self._heeded

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
