"""The radio of a run: send broadcasts, and deliver the newest messages."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.core.compile import Kernel
from testbed.core.records import (
    LINK,
    MESSAGE,
    Array,
    BoolArray,
    Broadcast,
    Inbox,
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
from testbed.network.links import Numbers, Outcomes
from testbed.network.packet_outcomes import transmit_broadcast
from testbed.network.packet_queue import (
    NO_MESSAGE,
    allocate_queue,
    deliver_due,
    enqueue_broadcast,
    send_broadcast,
)


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

    Attributes:
        links: (n, N) of LINK, the newest message received of each aircraft, and counters.
        packets: (n, N) of PACKET, of the last broadcast of each aircraft.
        statistics: (n, N) of LINK_STATISTICS.
        needs_all_positions: whether sending needs the positions of all aircraft.
    """

    def __init__(
        self,
        channel: Channel,
        losses: ExtraLosses | None = None,
        encoding: Encoding | None = None,
        clocks: Records | None = None,
    ) -> None:
        """See the class."""
        n, aircraft = channel.links.shape
        self._channel, self._losses = channel, losses or ExtraLosses()
        self.needs_all_positions = self._losses.fading is not None
        self._has_losses = losses is not None and losses != ExtraLosses()
        self._encoder = Encoder(encoding, channel) if encoding else None
        self._links, self.statistics = initial_links(channel), initial_statistics(n, aircraft)
        self._transmitters = initial_transmitters(aircraft, clocks)
        self.packets = self._links["packet"]
        self.links = allocate(LINK, n, aircraft)
        for name in (*Inbox._fields, "measured_s"):
            self.links[name] = np.nan
        self.links["number"] = NO_MESSAGE
        self._inbox = fields_of(Inbox, self.links)
        self._messages = allocate(MESSAGE, aircraft)
        self._all, self._none = np.ones(aircraft, dtype=bool), np.zeros(aircraft, dtype=bool)
        self._departures_s = initial_departures(channel)
        self._count = 0  # messages on their way
        self._most = 2 * n * aircraft  # that one broadcast adds
        self._bind(allocate_queue(2 * self._most))

    def _bind(self, queue: Records) -> None:
        """Bind the entries to the state of this radio and to a queue."""
        links, transmitters = self._links, self._transmitters
        self._queue = queue
        self._transmit = functools.partial(
            transmit_broadcast, links, self._departures_s, self._channel.tables, transmitters
        )
        self._enqueue = functools.partial(
            enqueue_broadcast, links, transmitters, queue, self.links, self.statistics
        )
        self._send = functools.partial(
            send_broadcast,
            links,
            self._departures_s,
            self._channel.tables,
            transmitters,
            queue,
            self.links,
            self.statistics,
        )
        self._deliver = functools.partial(deliver_due, queue, self.links, self.statistics)

    def _grow_queue(self) -> None:
        """Double the space for messages on their way."""
        queue = allocate_queue(2 * len(self._queue))
        queue[: self._count] = self._queue[: self._count]
        self._bind(queue)

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
            message: of all N, or (N,) of MESSAGE, which is not copied; stamped with the true
                times of the content.
            truth: motion of all N, which fading depends on.
            senders: (N,); None: all.
            muted: (N,) transmitters that are off: their messages are numbered and not sent; None:
                none.

        Returns:
            `packets`: their outcomes and arrival times.
        """
        senders = self._all if senders is None else senders
        muted = self._none if muted is None else muted
        if isinstance(message, Broadcast):
            write_fields(self._messages, message)
            message = self._messages
        if self._count + self._most > len(self._queue):
            self._grow_queue()
        if self._has_losses:
            self._write_losses(sent_s, truth, senders)
        if self._encoder is not None:
            self._send_frames(self._encoder, sent_s, message, senders, muted)
        else:
            self._count = self._send(senders, muted, sent_s, message, self._count)
        return self.packets

    def deliver(self, now: float) -> Inbox:
        """Deliver what has arrived by `now`, s; a newer message replaces an older.

        Returns:
            The newest messages received: views of `links`.
        """
        if self._count:
            self._count = self._deliver(self._count, now)
        return self._inbox

    def summary(self) -> Mapping[str, Any]:
        """Return the statistics of every link, ready for JSON."""
        channel = self._channel
        summary = summarise(self.statistics, channel.names, channel.links["unsubscribed"])
        if self._encoder:
            keys = ("refused", "discarded", "undetected")
            summary["damaged"] = {key: getattr(self._encoder, key) for key in keys}
        return summary

    def kernels(self) -> list[Kernel]:
        """Return the compiled calls of `send` and `deliver`, for `core.compile.prepare`."""
        sent_s = np.zeros(len(self._all))
        deliver = functools.partial(self._deliver, 0, 0.0)
        if self._encoder is None:
            args = self._all, self._none, sent_s, self._messages, 0
            return [functools.partial(self._send, *args), deliver]
        return [
            functools.partial(self._transmit, self._all, self._none, sent_s, self._messages),
            functools.partial(self._enqueue, 0, sent_s, self._messages, 0),
            deliver,
        ]

    def _write_losses(self, sent_s: Array, truth: VehicleState | None, senders: BoolArray) -> None:
        """Write what acts on the senders' packets besides the links' random numbers."""
        losses, packets, rows = self._losses, self.packets, np.flatnonzero(senders)
        if losses.outages:
            numbers = self._transmitters["number"][rows] + 1
            packets["scripted"][:, rows] = losses.outages(sent_s[rows], rows, numbers)
        if losses.trace:
            packets["trace_delay_s"][:, rows] = losses.trace(sent_s[rows], rows)
        if losses.fading and truth is not None:
            packets["fading"][:, rows] = losses.fading(truth, rows)

    def _send_frames(
        self,
        encoder: Encoder,
        sent_s: Array,
        messages: Records,
        senders: BoolArray,
        muted: BoolArray,
    ) -> None:
        """Send messages as frames, of which some are corrupted and pass the checksum."""
        transmitters, first = self._transmitters, self._count
        sending = self._transmit(senders, muted, sent_s, messages)
        rows = np.flatnonzero(senders)
        numbers = np.array(transmitters["number"][rows])
        messages = encoder.encode(messages, transmitters["stamp_s"], rows, numbers)
        errors = encoder.corrupt(self.packets, rows, numbers)
        self._count = self._enqueue(sending, sent_s, messages, first)
        if errors is not None:
            self._write_errors(first, errors, rows)

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
