"""Messages on their way: queued when they are sent, delivered when they have arrived."""

from __future__ import annotations

from math import inf

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.copies import copy_content
from testbed.core.records import MESSAGE, Array, BoolArray, Record, Records, allocate
from testbed.network.clocks import clock_error
from testbed.network.link_statistics import record_packet
from testbed.network.links import Numbers
from testbed.network.packet_outcomes import SIMULTANEOUS_S, UNSUBSCRIBED, transmit_broadcast

NO_MESSAGE = -1  # number of the newest message where none has been received

# A copy of a message on its way to one follower.
QUEUED_MESSAGE = np.dtype(
    [
        ("arrival_s", "f8"),
        ("follower", "i8"),  # row of the receiver among the n followers
        ("sender", "i8"),  # row among the N aircraft
        ("number", "i8"),  # sequence number
        ("measured_s", "f8"),  # true time of its content
        ("message", MESSAGE),  # stamped by the sender's clock minus the receiver's error
    ],
    align=True,
)


def allocate_queue(capacity: int) -> Records:
    """Return space for C messages on their way, (C,) of QUEUED_MESSAGE."""
    return allocate(QUEUED_MESSAGE, capacity)


@entry
def send_and_count(
    links: Records,
    departures_s: Array,
    tables: Records,
    transmitters: Records,
    queue: Records,
    received: Records,
    statistics: Records,
    senders: BoolArray,
    muted: BoolArray,
    sent_s: Array,
    messages: Records,
    counts: Numbers,
) -> bool:
    """Transmit one message of each sender and queue the copies that arrive.

    See `transmit_broadcast` and `enqueue_broadcast`.
    """
    sending = transmit_broadcast(
        links, departures_s, tables, transmitters, senders, muted, sent_s, messages
    )
    return enqueue_broadcast(
        links, transmitters, queue, received, statistics, sending, sent_s, messages, counts
    )


@entry
def enqueue_broadcast(
    links: Records,
    transmitters: Records,
    queue: Records,
    received: Records,
    statistics: Records,
    sending: int,
    sent_s: Array,
    messages: Records,
    counts: Numbers,
) -> bool:
    """Queue the copies of a broadcast that arrive, and count what happened to it.

    Args:
        links: (n, N) of CHANNEL_LINK; `packet` is read.
        transmitters: (N,) of TRANSMITTER.
        queue: (C,) of QUEUED_MESSAGE, with space for two copies on each link; written.
        received: (n, N) of LINK; `sent` and `delivered` are written.
        statistics: (n, N) of LINK_STATISTICS; written.
        sending: S, number of senders; their rows are in `transmitters`.
        sent_s: (N,) s, transmission times.
        messages: (N,) of MESSAGE, stamped with the true times of their content.
        counts: (2,) messages on their way, written, and the most that one broadcast adds.

    Returns:
        Whether the next broadcast needs a larger queue.
    """
    count = counts[0]
    for i in range(len(links)):
        for k in range(sending):
            m = transmitters[k].sender
            packet, content_s = links[i, m].packet, messages[m].stamp_s
            stamp_s = transmitters[m].stamp_s - clock_error(transmitters[i + 1].clock, content_s)
            for copy in range(2):
                if packet.arrival_s[copy] == inf:
                    continue
                queued = queue[count]
                queued.arrival_s = packet.arrival_s[copy]
                queued.follower, queued.sender, queued.number = i, m, transmitters[m].number
                queued.measured_s = content_s
                copy_content(messages[m], queued.message)
                queued.message.stamp_s = stamp_s
                count += 1
            outcome = packet.outcome
            if m != i + 1 and outcome != UNSUBSCRIBED:
                first_s = min(packet.arrival_s[0], packet.arrival_s[1])
                both = max(packet.arrival_s[0], packet.arrival_s[1]) < inf
                record_packet(statistics[i, m], received[i, m], outcome, first_s - sent_s[m], both)
    counts[0] = count
    return bool(count + counts[1] > len(queue))


@entry
def deliver_due(
    queue: Records, received: Records, statistics: Records, counts: Numbers, now: float
) -> None:
    """Deliver the messages that have arrived, in order of arrival; a newer replaces an older.

    Args:
        queue: (C,) of QUEUED_MESSAGE; the messages that have arrived are removed.
        received: (n, N) of LINK; written.
        statistics: (n, N) of LINK_STATISTICS; `overtaken` is written.
        counts: (2,) of `enqueue_broadcast`; the messages on their way are written.
        now: s.
    """
    count, latest_s = counts[0], now + SIMULTANEOUS_S
    due, last_s, in_order = 0, -inf, True
    for k in range(count):
        arrival_s = queue[k].arrival_s
        if arrival_s <= latest_s:
            due += 1
            in_order = in_order and arrival_s >= last_s
            last_s = arrival_s
    if due == 0:
        return
    if in_order:  # as most broadcasts arrive
        for k in range(count):
            queued = queue[k]
            if queued.arrival_s <= latest_s:
                i, m = queued.follower, queued.sender
                if _deliver(queued, received[i, m]):
                    statistics[i, m].overtaken += 1
    else:
        order = np.empty((2, due), np.int64)
        due = 0
        for k in range(count):
            if queue[k].arrival_s <= latest_s:
                order[0, due] = k
                due += 1
        _sort_by_arrival(queue, order, due)
        for k in range(due):
            queued = queue[order[0, k]]
            i, m = queued.follower, queued.sender
            if _deliver(queued, received[i, m]):
                statistics[i, m].overtaken += 1
    left = 0
    for k in range(count):
        if queue[k].arrival_s > latest_s:
            if left < k:
                queue[left] = queue[k]
            left += 1
    counts[0] = left


@kernel
def _deliver(queued: Record, link: Record) -> bool:
    """Deliver a message to its LINK unless a newer one is there.

    Return whether it is older.
    """
    if queued.number > link.number:
        link.number = queued.number
        link.measured_s, link.received_s = queued.measured_s, queued.arrival_s
        link.stamp_s = queued.message.stamp_s
        copy_content(queued.message, link)
    return bool(queued.number < link.number)


@kernel
def _sort_by_arrival(queue: Records, order: Numbers, due: int) -> None:
    """Sort the first `due` of order[0] by arrival, stably, by merging ever longer runs."""
    width = 1
    while width < due:
        for left in range(0, due, 2 * width):
            middle, right = min(left + width, due), min(left + 2 * width, due)
            i, j = left, middle
            for k in range(left, right):
                take_left = i < middle
                if take_left and j < right:
                    take_left = queue[order[0, i]].arrival_s <= queue[order[0, j]].arrival_s
                if take_left:
                    order[1, k] = order[0, i]
                    i += 1
                else:
                    order[1, k] = order[0, j]
                    j += 1
        for k in range(due):
            order[0, k] = order[1, k]
        width *= 2
