"""The radio: broadcasts go in, per-link arrivals come out, memory is a value."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.state import Array, Broadcast, Inbox, Truths

# Arrival times are continuous; a tick is k dt. A message that arrives within this much after a
# tick arrived at it: 0.04 s + 0.1 s is not 0.14 s in binary.
SIMULTANEOUS_S = 1e-9


class Channel(NamedTuple):
    """A lossless channel between N aircraft and their n followers.

    Args:
        delay_s: (n, N) one-way delay from aircraft m to follower i, s.
    """

    delay_s: Array


class Packet(NamedTuple):
    """One round of broadcasts on its way."""

    sent_s: float
    arrival_s: Array  # (n, N)
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
    return ChannelMemory(Inbox(never, never, nothing, nothing, nothing, nothing))


def send(channel: Channel, memory: ChannelMemory, content: Broadcast, now: float) -> ChannelMemory:
    """Every aircraft broadcasts at the time `now` (s)."""
    packet = Packet(now, now + channel.delay_s, content)
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
            waiting.append(packet)
            continue
        newest = max(newest, packet.sent_s)
        if not everywhere:
            later = np.where(due, np.inf, packet.arrival_s)
            if np.isfinite(later).any():
                waiting.append(Packet(packet.sent_s, later, packet.content))
    return ChannelMemory(inbox, tuple(waiting), newest)


def _replace_all(packet: Packet) -> Inbox:
    content, links = packet.content, packet.arrival_s.shape
    return Inbox(
        _spread(content.stamp_s, links),
        packet.arrival_s,
        _spread(content.position_ned, (*links, 3)),
        _spread(content.velocity_ned, (*links, 3)),
        _spread(content.acceleration_ned, (*links, 3)),
        _spread(content.euler_rates, (*links, 3)),
    )


def _replace(inbox: Inbox, packet: Packet, fresh: Truths) -> Inbox:
    content = packet.content
    vector = fresh[:, :, None]
    return Inbox(
        np.where(fresh, content.stamp_s, inbox.stamp_s),
        np.where(fresh, packet.arrival_s, inbox.received_s),
        np.where(vector, content.position_ned, inbox.position_ned),
        np.where(vector, content.velocity_ned, inbox.velocity_ned),
        np.where(vector, content.acceleration_ned, inbox.acceleration_ned),
        np.where(vector, content.euler_rates, inbox.euler_rates),
    )


def _spread(values: Array, shape: tuple[int, ...]) -> Array:
    """The same for every follower; a copy, for the laws want contiguous arrays."""
    out = np.empty(shape)
    out[:] = values
    return out
