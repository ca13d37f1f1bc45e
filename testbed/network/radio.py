"""The radio of a run: send broadcasts, and deliver the newest messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import bind_entry
from testbed.core.records import (
    LINK,
    MESSAGE,
    Array,
    BoolArray,
    Broadcast,
    Messages,
    Records,
    VehicleState,
    allocate,
    fields_of,
    write_fields,
)
from testbed.network.channel import Channel, initial_departures, initial_links, initial_transmitters
from testbed.network.clocks import clock_error
from testbed.network.encoding import Encoder, Encoding, UndetectedErrors
from testbed.network.link_statistics import initial_statistics, summarise
from testbed.network.links import CORRUPT, Numbers, Outcomes
from testbed.network.packet_outcomes import transmit_broadcast
from testbed.network.packet_queue import (
    NO_MESSAGE,
    QUEUED_MESSAGE,
    deliver_due,
    enqueue_broadcast,
    send_and_count,
)
from testbed.network.payload import Payloads


@dataclass(frozen=True, slots=True)
class ExtraLosses:
    """Losses and delays besides the random numbers of the links; None: none.

    All are functions of transmission times (S,) s or motions, and of the rows (S,) of the senders.
    """

    # PacketOutcome (n, S) by outages, 0: none; of times, rows and sequence numbers (S,)
    outages: Callable[[Array, Numbers, Numbers], Outcomes] | None = None
    # Delay (n, S) s by a trace, infinite: lost, nan: no trace; of times and rows
    trace: Callable[[Array, Numbers], Array] | None = None
    # Probability (n, S) of a loss to distance and airframes; of the motion of all N, and rows
    fading: Callable[[VehicleState, Numbers], Array] | None = None


class Radio:
    """Send messages between N aircraft and deliver them to n followers.

    Args:
        channel: the links.
        losses: besides those of the links' random numbers.
        encoding: as frames of bytes; None: messages arrive with every digit.
        clocks: (N,) of CLOCK, which stamp messages; None: all are exact.
        links: (n, N) of LINK, of zeros, to be used; None: new ones.
        payload: numbers of a law's own in each message.

    Attributes:
        links: (n, N) of LINK, the newest message received of each aircraft, and counters.
        packets: (n, N) of PACKET, of the last broadcast of each aircraft.
        statistics: (n, N) of LINK_STATISTICS.
        needs_all_positions: whether sending needs the positions of all aircraft.
        senders: (N,) of the next broadcast.
        muted: (N,) transmitters that are off: their messages are numbered and not sent.
        sent_s: (N,) s, transmission times of the senders.
        messages: (N,) of MESSAGE, stamped with the true times of the content.
        deliver_call: delivers what has arrived; a newer message replaces an older.
        payloads: numbers of a law's own in the messages.
    """

    def __init__(
        self,
        channel: Channel,
        losses: ExtraLosses | None = None,
        encoding: Encoding | None = None,
        clocks: Records | None = None,
        links: Records | None = None,
        payload: int = 0,
    ) -> None:
        n, aircraft = channel.links.shape
        self.payloads = Payloads(n, aircraft, payload)
        self._channel, self._losses = channel, losses or ExtraLosses()
        self.needs_all_positions = self._losses.fading is not None
        self._has_losses = losses is not None and losses != ExtraLosses()
        self._encoder = Encoder(encoding, channel, self.payloads.sent) if encoding else None
        self._links, self.statistics = initial_links(channel), initial_statistics(n, aircraft)
        self._transmitters = initial_transmitters(aircraft, clocks)
        self.packets = self._links["packet"]
        self.links = allocate(LINK, n, aircraft) if links is None else links
        for name in (*Messages._fields, "measured_s"):
            self.links[name] = np.nan
        self.links["number"] = NO_MESSAGE
        self._inbox = fields_of(Messages, self.links)
        self.messages, self.sent_s = allocate(MESSAGE, aircraft), np.zeros(aircraft)
        self.senders, self.muted = np.ones(aircraft, dtype=bool), np.zeros(aircraft, dtype=bool)
        self._departures_s = initial_departures(channel)
        # messages on their way, and the most that one broadcast adds
        self._counts = np.array([0, 2 * n * aircraft], dtype=np.int64)
        self._queue = allocate(QUEUED_MESSAGE, 4 * n * aircraft)
        self.deliver_call = Call(deliver_due, *self._received, self._counts, NOW)
        broadcast = self.senders, self.muted, self.sent_s, self.messages
        if self._encoder is None:
            self._send = Call(send_and_count, *self._sending)
        else:
            sending = self._links, self._departures_s, channel.tables, self._transmitters
            self._transmit = bind_entry(transmit_broadcast, *sending, *broadcast)
            like = *self._received, 0, self.sent_s, self.messages, self._counts
            self._enqueue = bind_entry(
                enqueue_broadcast, self._links, self._transmitters, like=like
            )

    @property
    def is_random(self) -> bool:
        """Whether outcomes may depend on the seed."""
        slot = self._channel.links["slot"]
        random = self._channel.links["random"].any() or (slot[..., 0] != slot[..., 1]).any()
        return bool(random or self._losses.trace or self._losses.fading)

    @property
    def corrupts(self) -> bool:
        """Whether links flip bits of frames."""
        links = self._channel.links
        return any(bool(links[name][..., CORRUPT].any()) for name in ("after_none", "after_one"))

    @property
    def _received(self) -> tuple[Records, ...]:
        return self._queue, self.links, self.statistics

    @property
    def _sending(self) -> tuple[Any, ...]:
        """Arguments of `send_and_count`."""
        return (
            *(self._links, self._departures_s, self._channel.tables, self._transmitters),
            *(*self._received, self.senders, self.muted, self.sent_s, self.messages),
            self._counts,
        )

    def send_stage(self, truth: VehicleState) -> tuple[Call | None, Callable[[float], None]]:
        """Return the call that sends the next broadcast, and the step that enlarges a full queue.

        Where Python sends, the call is None and the step sends. `truth` is the motion of all N
        aircraft, which fading depends on.
        """
        if self._has_losses or self._encoder is not None:
            return None, lambda now: self._send_broadcast(truth)
        return self._send, lambda now: self._grow_queue()

    def keep_payloads_call(self) -> Call:
        """Return the call that keeps what the senders of a broadcast have sent besides."""
        return self.payloads.keep_call(self.senders, self._transmitters)

    def match(self, other: Radio) -> None:
        """Have space for as many messages on their way as another radio of the same links."""
        while len(self._queue) < len(other._queue):
            self._grow_queue()

    def sent(self) -> Iterator[tuple[float, int, int]]:
        """Yield arrival time, s, follower and sender of each copy of the last broadcast.

        In the order in which copies that arrive at the same time are delivered.
        """
        senders = np.flatnonzero(self.senders)
        arrival_s = self.packets["arrival_s"][:, senders]
        for i, k, copy in np.argwhere(np.isfinite(arrival_s)).tolist():
            yield float(arrival_s[i, k, copy]), i, int(senders[k])

    def restart_statistics(self) -> None:
        """Count from now on."""
        self.statistics[:] = initial_statistics(*self.statistics.shape)

    def _grow_queue(self) -> None:
        """Double the space for messages on their way."""
        queue, count = allocate(QUEUED_MESSAGE, 2 * len(self._queue)), self._counts[0]
        queue[:count] = self._queue[:count]
        self._queue = queue
        self.deliver_call.rebind(*self._received, self._counts)
        if self._encoder is None:
            self._send.rebind(*self._sending)

    def send(
        self,
        sent_s: Array,
        message: Broadcast | Records,
        truth: VehicleState | None,
        senders: BoolArray | None = None,
        muted: BoolArray | None = None,
    ) -> Records:
        """Send one message of each sender.

        Args:
            sent_s: (N,) s, transmission times of the senders.
            message: of all N, or (N,) of MESSAGE; stamped with the true times of the content.
            truth: motion of all N, which fading depends on.
            senders: (N,); None: all.
            muted: (N,) transmitters that are off: their messages are numbered and not sent; None:
                none.

        Returns:
            `packets`: their outcomes and arrival times.
        """
        self.senders[:] = True if senders is None else senders
        self.muted[:] = False if muted is None else muted
        self.sent_s[:] = sent_s
        if isinstance(message, Broadcast):
            write_fields(self.messages, message)
        else:
            self.messages[:] = message
        self._send_broadcast(truth)
        return self.packets

    def _send_broadcast(self, truth: VehicleState | None) -> None:
        if self._has_losses:
            self._write_losses(truth)
        if self._encoder is None:
            grow = self._send(0.0)
        else:
            grow = self._send_frames(self._encoder)
        if grow:
            self._grow_queue()

    def deliver(self, now: float) -> Messages:
        """Deliver what has arrived by `now`, s; a newer message replaces an older.

        Returns:
            The newest messages received: views of `links`.
        """
        self.deliver_call(now)
        return self._inbox

    def summary(self) -> Mapping[str, Any]:
        """Return the statistics of every link, ready for JSON."""
        channel = self._channel
        summary = summarise(self.statistics, channel.names, channel.links["unsubscribed"])
        if self._encoder:
            keys = ("refused", "discarded", "undetected")
            summary["damaged"] = {key: getattr(self._encoder, key) for key in keys}
        return summary

    def _write_losses(self, truth: VehicleState | None) -> None:
        """Write what acts on the senders' packets besides the links' random numbers."""
        losses, packets, sent_s = self._losses, self.packets, self.sent_s
        rows = np.flatnonzero(self.senders)
        if losses.outages:
            numbers = self._transmitters["number"][rows] + 1
            packets["scripted"][:, rows] = losses.outages(sent_s[rows], rows, numbers)
        if losses.trace:
            packets["trace_delay_s"][:, rows] = losses.trace(sent_s[rows], rows)
        if losses.fading and truth is not None:
            packets["fading"][:, rows] = losses.fading(truth, rows)

    def _send_frames(self, encoder: Encoder) -> bool:
        """Send messages as frames, of which some are corrupted and pass the checksum.

        Return whether the next broadcast needs a larger queue.
        """
        transmitters, first = self._transmitters, int(self._counts[0])
        sending = self._transmit()
        rows = np.flatnonzero(self.senders)
        numbers = np.array(transmitters["number"][rows])
        messages = encoder.encode(self.messages, transmitters["stamp_s"], rows, numbers)
        errors = encoder.corrupt(self.packets, rows, numbers)
        grow = self._enqueue(*self._received, sending, self.sent_s, messages, self._counts)
        if errors is not None:
            self._write_errors(first, errors, rows)
        return grow

    def _write_errors(self, first: int, errors: UndetectedErrors, rows: Numbers) -> None:
        """Write the content of corrupted copies into the queue, where a broadcast is from first."""
        i, s, copy = errors.at.T
        arrival_s = self.packets["arrival_s"][:, rows]
        queued = np.flatnonzero(np.isfinite(arrival_s))  # in the order of the queue
        at = first + np.searchsorted(queued, np.ravel_multi_index((i, s, copy), arrival_s.shape))
        written = self._queue["message"]
        for name, values in zip(Broadcast._fields[1:], errors.message[1:], strict=True):
            written[name][at] = values
        clocks = self._transmitters["clock"].view(np.recarray)[i + 1]
        ahead_s = clock_error(clocks, self._queue["measured_s"][at])
        written["stamp_s"][at] = errors.message.stamp_s - ahead_s
