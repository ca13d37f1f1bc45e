"""The radio: broadcasts go in, per-link arrivals come out, memory is a value."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.state import Array, Broadcast, Inbox, Truths

# Arrival times are continuous; a tick is k dt. A message that arrives within this much after a
# tick arrived at it: 0.04 s + 0.1 s is not 0.14 s in binary.
SIMULTANEOUS_S = 1e-9


class Channel(NamedTuple):
    """A channel between N aircraft and their n followers that loses nothing but what is muted.

    Args:
        delay_s: (n, N) one-way delay from aircraft m to follower i, s.
        mute: windows [from, to) in s, by row of the aircraft that sends nothing then.
    """

    delay_s: Array
    mute: tuple[tuple[int, float, float], ...] = ()


class Packet(NamedTuple):
    """One round of broadcasts on its way."""

    sent_s: float
    arrival_s: Array  # (n, N); infinite: never
    content: Broadcast


class ChannelMemory(NamedTuple):
    """What has arrived, and what is on its way in order of sending."""

    inbox: Inbox
    in_flight: tuple[Packet, ...] = ()
    newest_s: float = -np.inf  # when the newest message in any inbox was sent


def silent(channel: Channel) -> ChannelMemory:
    """A channel on which nothing was said yet."""
    shape = channel.delay_s.shape
    nothing = np.full((*shape, 3), np.nan)
    never = np.full(shape, np.nan)
    vectors = len(Inbox._fields) - 2
    return ChannelMemory(Inbox(never, never, *(nothing,) * vectors))


def send(
    channel: Channel,
    memory: ChannelMemory,
    content: Broadcast,
    now: float,
    who: Truths | None = None,
) -> ChannelMemory:
    """The aircraft `who` (N,) broadcast at the time `now` (s); all of them by default."""
    arrival = now + channel.delay_s
    if who is not None and not who.all():
        arrival[:, ~who] = np.inf
    for row, begin, end in channel.mute:
        if begin <= now < end:
            arrival[:, row] = np.inf
    packet = Packet(now, arrival, content)
    return ChannelMemory(memory.inbox, (*memory.in_flight, packet), memory.newest_s)


def deliver(memory: ChannelMemory, now: float) -> ChannelMemory:
    """Put what has arrived by `now` (s) into the inboxes; a newer message replaces an older."""
    inbox, newest = memory.inbox, memory.newest_s
    waiting = []
    for packet in memory.in_flight:
        due = packet.arrival_s <= now + SIMULTANEOUS_S
        everywhere = due.all()
        if everywhere and packet.sent_s > newest:
            inbox = _replace_all(packet)
        elif due.any():
            inbox = _replace(inbox, packet, due & ~(inbox.stamp_s > packet.content.stamp_s))
        else:
            if np.isfinite(packet.arrival_s).any():
                waiting.append(packet)
            continue
        newest = max(newest, packet.sent_s)
        if not everywhere:
            later = np.where(due, np.inf, packet.arrival_s)
            if np.isfinite(later).any():
                waiting.append(Packet(packet.sent_s, later, packet.content))
    return ChannelMemory(inbox, tuple(waiting), newest)


def _replace_all(packet: Packet) -> Inbox:
    stamp, *vectors = packet.content
    links = packet.arrival_s.shape
    return Inbox(
        _spread(stamp, links), packet.arrival_s, *(_spread(each, (*links, 3)) for each in vectors)
    )


def _replace(inbox: Inbox, packet: Packet, fresh: Truths) -> Inbox:
    stamp, *vectors = packet.content
    rows = fresh[:, :, None]
    return Inbox(
        np.where(fresh, stamp, inbox.stamp_s),
        np.where(fresh, packet.arrival_s, inbox.received_s),
        *(np.where(rows, new, old) for new, old in zip(vectors, inbox[2:], strict=True)),
    )


def _spread(values: Array, shape: tuple[int, ...]) -> Array:
    """The same for every follower; a copy, for the laws want contiguous arrays."""
    out = np.empty(shape)
    out[:] = values
    return out
