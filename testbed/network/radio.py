"""The radio of a run: broadcasts go in, what each follower has heard comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.network.channel import Channel
from testbed.network.clocks import Clocks, ahead, shows
from testbed.network.encoded import Believed, Coder, Encoding
from testbed.network.fates import BEFALL
from testbed.network.ledger import blank
from testbed.network.links import Fate, Fates
from testbed.network.post import (
    NOTHING,
    POST_ROUND,
    TAKE_DUE,
    USE,
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
        self._rounds: dict[int, tuple[Any, ...]] = {}
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
            round of as many changes them.
        """
        rows = self._everyone if who is None else self._rows(who)
        sent, number, measured = sent_s, self._number, message.stamp_s
        if len(rows) == len(number):
            number += 1
        else:
            number[rows] += 1
            sent, number, measured = sent[rows], number[rows], measured[rows]
        script, traced, faded, told, arrivals, fate = self._round_of(len(rows))
        given, coder, clocks = self._conditions, self._coder, self._conditions.clocks
        if given.script:
            script = given.script(sent_s, rows, number)
        if given.trace:
            traced = given.trace(sent_s, rows)
        if given.fading:
            faded = given.fading(truth, rows)
        if hushed is not None:
            script = np.where(hushed[rows], np.uint8(Fate.MUTE), script)
        stamp = shows(clocks, measured, rows) if clocks else measured
        if coder:
            message, stamp = coder.says(message, stamp, rows, number)
        BEFALL(
            self._channel,
            self._traffic,
            rows,
            number,
            sent,
            script,
            traced,
            faded,
            arrivals,
            fate,
        )
        believed = None
        if coder:
            spoiled_s = self._traffic.spoiled_s[:, rows]
            believed = coder.damage(spoiled_s, arrivals, fate, rows, number)
        if self._count + arrivals.size > len(self._post.arrival_s):
            self._post = more_room(self._post, self._count)
        wrong = ahead(clocks, measured) if clocks else None
        told[:] = stamp if wrong is None else stamp - wrong
        first = self._count
        self._count = POST_ROUND(
            self._post,
            self._ledger,
            self._count,
            rows,
            number,
            sent,
            told,
            message,
            arrivals,
            fate,
        )
        if believed is not None:
            self._falsify(first, believed, arrivals, wrong)
        return arrivals, fate

    def deliver(self, now: float) -> Inbox:
        """What the followers have received by `now`, s; a newer message replaces an older.

        The inbox is the radio's own: the next delivery changes it.
        """
        if self._count:
            self._count = TAKE_DUE(
                self._post, self._ledger, self._count, self._read, self._inbox, now
            )
        return self._inbox

    def use(self, rows: Numbers, age_s: Array) -> None:
        """The followers `rows` (m,) of all used information of these ages (n, N) s; nan: none."""
        USE(self._ledger, rows, age_s)

    def counts(self) -> LinkCounts:
        """Messages sent and delivered up to now; the next call changes them."""
        np.copyto(self._counts.sent, self._ledger.sent)
        np.copyto(self._counts.delivered, self._ledger.delivered)
        return self._counts

    def summary(self) -> Mapping[str, Any]:
        """Numbers of every link, ready for JSON."""
        summary = summarise(self._ledger, self._channel.names)
        if self._coder:
            keys = ("refused", "discarded", "believed")
            summary["damaged"] = {key: getattr(self._coder, key) for key in keys}
        return summary

    def _falsify(
        self, first: int, believed: Believed, arrivals: Array, wrong: Array | None
    ) -> None:
        """Put what damaged copies say into the messages on their way; the round's begin at first.

        Args:
            first: place of the round's first copy.
            believed: the copies.
            arrivals: (n, S, 2) s
            wrong: (n, S) s, by how much the receivers' clocks are ahead; None: by nothing.
        """
        i, s, copy = believed.at.T
        way = np.flatnonzero(np.isfinite(arrivals))  # in the order of the post
        at = first + np.searchsorted(way, np.ravel_multi_index((i, s, copy), arrivals.shape))
        self._post.content[at] = believed.content
        self._post.stamp_s[at] = believed.stamp_s - (0.0 if wrong is None else wrong[i, s])

    def _rows(self, who: Truths) -> Numbers:
        """Rows of those who send together; most rounds are like others."""
        key = who.tobytes()
        if key not in self._together:
            self._together[key] = np.flatnonzero(who)
        return self._together[key]

    def _round_of(self, senders: int) -> tuple[Any, ...]:
        """Room for a round of S senders, made once for each S.

        What befalls messages if nothing does: fates (n, S) of a script, delays (n, S) of a trace
        and probabilities (n, S); and room for their stamps (n, S), arrivals (n, S, 2) and fates.
        """
        if senders not in self._rounds:
            shape = len(self._channel.links), senders
            self._rounds[senders] = (
                np.zeros(shape, np.uint8),
                np.full(shape, np.nan),
                np.zeros(shape),
                np.empty(shape),
                np.empty((*shape, 2)),
                np.empty(shape, np.uint8),
            )
        return self._rounds[senders]
