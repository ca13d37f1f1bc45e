"""The radio of a run: broadcasts go in, what each follower has heard comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.network.channel import Channel
from testbed.network.clocks import READY_SHOW, Clocks
from testbed.network.encoded import Believed, Coder, Encoding
from testbed.network.fates import BEFALL
from testbed.network.ledger import blank
from testbed.network.links import Fate, Fates
from testbed.network.post import (
    NOTHING,
    POST_ROUND,
    READY_SEND_ROUND,
    READY_TAKE_DUE,
    READY_USE,
    VECTORS,
    Numbers,
    Read,
    more_room,
    room,
)
from testbed.network.report import summarise
from testbed.network.traffic import idle
from testbed.state import Array, Broadcast, Inbox, LinkCounts, Truths, VehicleState


@dataclass(frozen=True, slots=True)
class Conditions:
    """What befalls messages beside the links' own dice; None: nothing."""

    # `links.Fate` (n, S) that a script has, 0: none, for messages sent at these times (S,) s, by
    # `rows` (S,), with these numbers (S,).
    script: Callable[[Array, Numbers, Numbers], Fates] | None = None
    # Delay (n, S) s that a trace has for them, infinite: lost, nan: none; by times and rows.
    trace: Callable[[Array, Numbers], Array] | None = None
    # Probability (n, S) of being lost to distance and airframes, in this formation (N).
    fading: Callable[[VehicleState, Numbers], Array] | None = None
    clocks: Clocks | None = None


class _Round:
    """What the rounds of S senders are written into; and what befalls them if nothing does."""

    __slots__ = (
        *("ahead_s", "arrivals", "faded", "fate", "measured_s", "message", "rows", "script"),
        *("send", "show", "shown_s", "stamp_s", "traced"),
    )

    def __init__(self, rows: Numbers, shape: tuple[int, int]) -> None:
        self.rows = rows  # (S,)
        self.script: Fates = np.zeros(shape, np.uint8)
        self.traced, self.faded = np.full(shape, np.nan), np.zeros(shape)
        self.stamp_s, self.shown_s = np.empty(shape), np.empty(len(rows))
        self.ahead_s = np.zeros(shape)  # of the receivers' clocks
        self.measured_s: Array | None = None  # that the clocks are bound to
        self.show: Callable[[], None] | None = None
        self.arrivals, self.fate = np.empty((*shape, 2)), np.empty(shape, np.uint8)
        self.message: Broadcast | None = None  # that the sending is bound to
        self.send: Callable[[int], int] | None = None


class Radio:
    """Messages between N aircraft and their n followers."""

    def __init__(
        self,
        channel: Channel,
        conditions: Conditions | None = None,
        encoding: Encoding | None = None,
    ) -> None:
        """Nothing was said yet. Without an encoding, messages arrive to the last digit."""
        self._channel, self._conditions = channel, conditions or Conditions()
        n, aircraft = links = channel.links.shape
        self._coder = Coder(encoding, channel) if encoding else None
        self._traffic, self._ledger = idle(channel), blank(n, aircraft)
        self._everyone = np.arange(aircraft)
        self._number = np.full(aircraft, -1)  # of the last message of each
        self._count = 0  # messages on their way
        self._post = room(4 * n * aircraft)
        self._read = Read(np.full(links, NOTHING), np.full(links, np.nan))
        vectors = np.full((VECTORS, *links, 3), np.nan)
        self._inbox = Inbox(*np.full((2, *links), np.nan), *vectors)
        self._counts = LinkCounts(*np.zeros((2, *links), np.uint32))
        self._take_due = READY_TAKE_DUE(self._post, self._ledger, self._read, self._inbox)
        self._sent_s = np.zeros(aircraft)
        given = self._conditions
        befalls = given.script, given.trace, given.fading, given.clocks, self._coder
        self._plain = not any(befalls)  # nothing but the links' dice befalls a message
        self._rounds: dict[tuple[int, bool], _Round] = {}
        self._together: dict[bytes, Numbers] = {}
        self._used: dict[int, tuple[Any, Any]] = {}

    @property
    def measured_s(self) -> Array:
        """(n, N) when what is in the inboxes was true, s; nan: nothing heard yet."""
        return self._read.measured_s

    def send(
        self,
        sent_s: Array,
        message: Broadcast,
        truth: VehicleState,
        who: Truths | None = None,
        hushed: Truths | None = None,
    ) -> tuple[Array, Fates]:
        """The aircraft `who` (N,), by default all, send their messages at sent_s (N,).

        Args:
            sent_s: (N,) s, of those who send.
            message: of all N; its stamps are the true time of its content.
            truth: the motion of all N, on which distances and airframes in the way depend.
            who: (N,)
            hushed: (N,) whose transmitters are silent; their messages count as not sent.

        Returns:
            Arrivals (n, S, 2) s and fates (n, S) of the S messages; see `fates.fates`. The next
            round of as many changes them.
        """
        rows = self._everyone if who is None else self._rows(who)
        amid = hushed is not None or not self._plain
        spot = self._round(rows, amid)
        if self._count + spot.arrivals.size > len(self._post.arrival_s):
            self._make_room()
        self._sent_s[:] = sent_s
        if amid:
            message = self._befall(sent_s, message, truth, hushed, spot)
        if self._coder is None:
            self._count = self._ready(spot, message, shown=amid)(self._count)
        else:
            self._send_coded(self._coder, message, spot)
        return spot.arrivals, spot.fate

    def _befall(
        self,
        sent_s: Array,
        message: Broadcast,
        truth: VehicleState,
        hushed: Truths | None,
        spot: _Round,
    ) -> Broadcast:
        """Write what more befalls a round than the links' own dice; what its senders say."""
        given, rows = self._conditions, spot.rows
        if given.script:
            spot.script[:] = given.script(sent_s[rows], rows, self._number[rows] + 1)
        else:
            spot.script.fill(0)
        if given.trace:
            spot.traced[:] = given.trace(sent_s[rows], rows)
        if given.fading:
            spot.faded[:] = given.fading(truth, rows)
        if hushed is not None:
            spot.script[:, hushed[rows]] = Fate.MUTE
        if given.clocks is None:
            stamp = message.stamp_s[rows]
        else:
            if spot.show is None or spot.measured_s is not message.stamp_s:
                said = spot.measured_s = message.stamp_s
                spot.show = READY_SHOW(given.clocks, said, rows, spot.shown_s, spot.ahead_s)
            spot.show()
            stamp = spot.shown_s
        if self._coder:
            message, stamp = self._coder.says(message, stamp, rows, self._number[rows] + 1)
        np.subtract(stamp, spot.ahead_s, out=spot.stamp_s)
        return message

    def _ready(self, spot: _Round, message: Broadcast, *, shown: bool) -> Callable[[int], int]:
        """The sending of rounds of these senders, bound to the records it works on."""
        if spot.send is None or spot.message is not message:
            befallen = spot.script, spot.traced, spot.faded, shown, spot.stamp_s
            spot.message = message
            spot.send = READY_SEND_ROUND(
                self._channel,
                self._traffic,
                self._post,
                self._ledger,
                spot.rows,
                self._number,
                self._sent_s,
                *befallen,
                message,
                spot.arrivals,
                spot.fate,
            )
        return spot.send

    def _send_coded(self, coder: Coder, message: Broadcast, spot: _Round) -> None:
        """Send a round as frames, of which some are damaged and believed."""
        rows, became = spot.rows, (spot.arrivals, spot.fate)
        self._number[rows] += 1
        number, sent = self._number[rows], self._sent_s[rows]
        befallen = spot.script, spot.traced, spot.faded
        BEFALL(self._channel, self._traffic, rows, number, sent, *befallen, *became)
        believed = coder.damage(self._traffic.spoiled_s[:, rows], *became, rows, number)
        first = self._count
        self._count = POST_ROUND(
            self._post, self._ledger, first, rows, number, sent, spot.stamp_s, message, *became
        )
        if believed is not None:
            self._falsify(first, believed, spot)

    def _make_room(self) -> None:
        self._post = more_room(self._post, self._count)
        self._take_due = READY_TAKE_DUE(self._post, self._ledger, self._read, self._inbox)
        for spot in self._rounds.values():
            spot.send = None

    def deliver(self, now: float) -> Inbox:
        """What the followers have received by `now`, s; a newer message replaces an older.

        The inbox is the radio's own: the next delivery changes it.
        """
        if self._count:
            self._count = self._take_due(self._count, now)
        return self._inbox

    def use(self, rows: Numbers, age_s: Array) -> None:
        """The followers `rows` (m,) of all used information of these ages (n, N) s; nan: none."""
        given, count = self._used.get(id(rows), ((), None))
        if count is None or given[0] is not rows or given[1] is not age_s:
            count = READY_USE(self._ledger, rows, age_s)
            self._used[id(rows)] = (rows, age_s), count
        count()

    def counts(self) -> LinkCounts:
        """Messages sent and delivered up to now; the next call changes them."""
        np.copyto(self._counts.sent, self._ledger.sent)
        np.copyto(self._counts.delivered, self._ledger.delivered)
        return self._counts

    def summary(self) -> Mapping[str, Any]:
        """Numbers of every link, ready for JSON."""
        summary = summarise(self._ledger, self._channel.names, self._channel.links["unheard"])
        if self._coder:
            keys = ("refused", "discarded", "believed")
            summary["damaged"] = {key: getattr(self._coder, key) for key in keys}
        return summary

    def _falsify(self, first: int, believed: Believed, spot: _Round) -> None:
        """Put what damaged copies say into the messages on their way; the round begins at first."""
        i, s, copy = believed.at.T
        way = np.flatnonzero(np.isfinite(spot.arrivals))  # in the order of the post
        at = first + np.searchsorted(way, np.ravel_multi_index((i, s, copy), spot.arrivals.shape))
        self._post.content[at] = believed.content
        self._post.stamp_s[at] = believed.stamp_s - spot.ahead_s[i, s]

    def _rows(self, who: Truths) -> Numbers:
        """Rows of those who send together; most rounds are like others."""
        key = who.tobytes()
        if key not in self._together:
            self._together[key] = np.flatnonzero(who)
        return self._together[key]

    def _round(self, rows: Numbers, amid: bool) -> _Round:
        """What rounds of these senders are written into."""
        key = id(rows), amid
        if key not in self._rounds:
            self._rounds[key] = _Round(rows, (len(self._channel.links), len(rows)))
        return self._rounds[key]
