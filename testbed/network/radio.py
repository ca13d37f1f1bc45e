"""The radio of a run: broadcasts go in, what each follower has heard comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.network.channel import Channel
from testbed.network.clocks import Clocks, show
from testbed.network.encoded import Believed, Coder, Encoding
from testbed.network.fates import BEFALL
from testbed.network.ledger import READY_COUNT, blank
from testbed.network.links import Fate, Fates
from testbed.network.post import (
    NOTHING,
    POST_ROUND,
    READY_SEND_ROUND,
    READY_TAKE_DUE,
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
    clocks: Clocks | None = None  # None: all are right


class _Round:
    """What the rounds of S senders are written into; and what befalls them if nothing does."""

    __slots__ = (
        *("ahead_s", "arrivals", "faded", "fate", "message", "muted", "rows", "script"),
        *("send", "shown_s", "traced"),
    )

    def __init__(self, rows: Numbers, shape: tuple[int, int]) -> None:
        self.rows = rows  # (S,)
        self.script: Fates = np.zeros(shape, np.uint8)
        self.muted = False  # somebody was, in the script
        self.traced, self.faded = np.full(shape, np.nan), np.zeros(shape)
        self.shown_s, self.ahead_s = np.empty(len(rows)), np.empty(shape)
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
        self._traffic = idle(channel)
        self.ledger = blank(n, aircraft)  # of what happens to messages, and of their use
        self._everyone = np.arange(aircraft)
        self._number = np.full(aircraft, -1)  # of the last message of each
        self._count = 0  # messages on their way
        self._post = room(4 * n * aircraft)
        self._read = Read(np.full(links, NOTHING), np.full(links, np.nan))
        vectors = np.full((VECTORS, *links, 3), np.nan)
        self._inbox = Inbox(*np.full((2, *links), np.nan), *vectors)
        self._counts = LinkCounts(*np.zeros((2, *links), np.uint32))
        self._count_up = READY_COUNT(self.ledger, self._counts)
        self._take_due = READY_TAKE_DUE(self._post, self.ledger, self._read, self._inbox)
        self._sent_s = np.zeros(aircraft)
        self._clocks = self._conditions.clocks or Clocks(*np.zeros((3, aircraft)))
        # whether more befalls a message than the links' own dice
        given = self._conditions
        self._eventful = any((given.script, given.trace, given.fading))
        # whether it asks for the motion of those too who neither send nor listen
        self.looks_around = given.fading is not None
        self._rounds: dict[int, _Round] = {}  # by the senders' rows, kept in `_together`
        self._together: dict[bytes, Numbers] = {}

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
            round of the same senders changes them.
        """
        rows = self._everyone if who is None else self._rows(who)
        spot = self._rounds.get(id(rows)) or self._round(rows)
        if self._count + spot.arrivals.size > len(self._post.arrival_s):
            self._make_room()
        self._sent_s[:] = sent_s
        if self._eventful or spot.muted or hushed is not None:
            self._befall(sent_s, truth, hushed, spot)
        if self._coder is not None:
            self._send_coded(self._coder, message, spot)
        else:
            same = spot.message is message
            send = spot.send if same and spot.send else self._bound(spot, message)
            self._count = send(self._count)
        return spot.arrivals, spot.fate

    def _befall(
        self, sent_s: Array, truth: VehicleState, hushed: Truths | None, spot: _Round
    ) -> None:
        """Write what more befalls a round than the links' own dice."""
        given, rows = self._conditions, spot.rows
        if given.script:
            spot.script[:] = given.script(sent_s[rows], rows, self._number[rows] + 1)
        elif spot.muted:
            spot.script.fill(0)
        if given.trace:
            spot.traced[:] = given.trace(sent_s[rows], rows)
        if given.fading:
            spot.faded[:] = given.fading(truth, rows)
        spot.muted = hushed is not None
        if hushed is not None:
            spot.script[:, hushed[rows]] = Fate.MUTE

    def _bound(self, spot: _Round, message: Broadcast) -> Callable[[int], int]:
        """The sending of rounds of these senders, bound to the records it works on."""
        spot.message = message
        spot.send = READY_SEND_ROUND(
            self._channel,
            self._traffic,
            self._post,
            self.ledger,
            spot.rows,
            self._number,
            self._sent_s,
            *(spot.script, spot.traced, spot.faded),
            *(self._clocks, spot.shown_s, spot.ahead_s),
            message,
            *(spot.arrivals, spot.fate),
        )
        return spot.send

    def _send_coded(self, coder: Coder, message: Broadcast, spot: _Round) -> None:
        """Send a round as frames, of which some are damaged and believed."""
        rows, became = spot.rows, (spot.arrivals, spot.fate)
        self._number[rows] += 1
        number, sent = self._number[rows], self._sent_s[rows]
        show(self._clocks, message.stamp_s, rows, spot.shown_s, spot.ahead_s)
        message, stamp_s = coder.says(message, spot.shown_s, rows, number)
        befallen = spot.script, spot.traced, spot.faded
        BEFALL(self._channel, self._traffic, rows, number, sent, *befallen, *became)
        believed = coder.damage(self._traffic.spoiled_s[:, rows], *became, rows, number)
        first, stamps_s = self._count, stamp_s - spot.ahead_s
        self._count = POST_ROUND(
            self._post, self.ledger, first, rows, number, sent, stamps_s, message, *became
        )
        if believed is not None:
            self._falsify(first, believed, spot)

    def _make_room(self) -> None:
        self._post = more_room(self._post, self._count)
        self._take_due = READY_TAKE_DUE(self._post, self.ledger, self._read, self._inbox)
        for spot in self._rounds.values():
            spot.send = None

    def deliver(self, now: float) -> Inbox:
        """What the followers have received by `now`, s; a newer message replaces an older.

        The inbox is the radio's own: the next delivery changes it.
        """
        if self._count:
            self._count = self._take_due(self._count, now)
        return self._inbox

    def counts(self) -> LinkCounts:
        """Messages sent and delivered up to now; the next call changes them."""
        self._count_up()
        return self._counts

    def summary(self) -> Mapping[str, Any]:
        """Numbers of every link, ready for JSON."""
        summary = summarise(self.ledger, self._channel.names, self._channel.links["unheard"])
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

    def _round(self, rows: Numbers) -> _Round:
        """What rounds of these senders are written into."""
        made = self._rounds[id(rows)] = _Round(rows, (len(self._channel.links), len(rows)))
        return made
