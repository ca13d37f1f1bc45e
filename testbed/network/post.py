"""Messages on their way: put in when they are sent, taken out when they have arrived."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of, twin_of
from testbed.network.channel import Channel
from testbed.network.clocks import Clocks, show
from testbed.network.fates import fates
from testbed.network.ledger import LONGEST_BURST, Ledger, bin_of
from testbed.network.links import Fate, Fates
from testbed.network.slots import SIMULTANEOUS_S
from testbed.network.traffic import Traffic
from testbed.state import Array, Broadcast, Inbox

Numbers = NDArray[np.int64]
VECTORS = len(Inbox._fields) - 2
DELIVERED, MUTE, UNHEARD = int(Fate.DELIVERED), int(Fate.MUTE), int(Fate.UNHEARD)
NOTHING = -1  # the number of a message that was never read


RECORD = np.dtype(
    [
        ("arrival_s", "f8"),
        ("link", "i8", (3,)),
        ("measured_s", "f8"),
        ("stamp_s", "f8"),
        ("content", "f8", (VECTORS, 3)),
    ]
)


class Post(NamedTuple):
    """Room for C messages on their way, in the order of sending; the first `count` are there."""

    arrival_s: Array  # (C,)
    link: Numbers  # (C, 3) follower, aircraft, number of the message
    measured_s: Array  # (C,) when its content was true
    stamp_s: Array  # (C,) what the receiver takes that for
    content: Array  # (C, VECTORS, 3)


class Read(NamedTuple):
    """What the followers have of each aircraft, beside their inboxes; (n, N) each."""

    number: Numbers  # of the newest message; NOTHING: none yet
    measured_s: Array  # when its content was true; nan: none yet


def room(capacity: int) -> Post:
    """For this many messages: views of one array of records (C,), which is their base."""
    records = np.empty(capacity, dtype=RECORD)
    return Post(*(records[name] for name in Post._fields))


def more_room(post: Post, count: int) -> Post:
    """Twice the room, with the first `count` messages in it."""
    larger = room(2 * len(post.arrival_s))
    for new, old in zip(larger, post, strict=True):
        new[:count] = old[:count]
    return larger


def post_round(
    post: Post,
    ledger: Ledger,
    count: int,
    rows: Numbers,
    numbers: Numbers,
    sent_s: Array,
    stamps_s: Array,
    message: Broadcast,
    arrivals: Array,
    fate: Fates,
) -> int:
    """Put a round of messages on their way, and count what becomes of them.

    Args:
        post: changed in place; there must be room.
        ledger: changed in place.
        count: messages that are on their way.
        rows: (S,) who sends.
        numbers: (S,) of their messages.
        sent_s: (S,) when.
        stamps_s: (n, S) what each receiver takes the time of the content for, s.
        message: of all N aircraft; its stamps are the true time.
        arrivals: (n, S, 2) s, infinite where there is none.
        fate: (n, S) of links.Fate.

    Returns:
        How many messages are on their way now.
    """
    vectors = np.stack(message[1:], axis=1)
    for i, s, copy in np.argwhere(np.isfinite(arrivals)):
        m = rows[s]
        post.arrival_s[count] = arrivals[i, s, copy]
        post.link[count] = i, m, numbers[s]
        post.measured_s[count], post.stamp_s[count] = message.stamp_s[m], stamps_s[i, s]
        post.content[count] = vectors[m]
        count += 1
    first = arrivals.min(axis=2)
    for i, s in np.ndindex(*fate.shape):
        if rows[s] != i + 1 and fate[i, s] != UNHEARD:
            both = np.isfinite(arrivals[i, s]).all()
            _count(ledger, (i, rows[s]), int(fate[i, s]), first[i, s] - sent_s[s], bool(both))
    return count


def _count(ledger: Ledger, link: tuple[int, int], fate: int, delay: float, both: bool) -> None:
    ledger.fates[(*link, fate)] += 1
    ledger.sent[link] += fate != MUTE
    if fate == DELIVERED:
        ledger.delivered[link] += 1
        ledger.twice[link] += both
        ledger.delay_sum[link] += delay
        ledger.delay_least[link] = min(ledger.delay_least[link], delay)
        ledger.delay_most[link] = max(ledger.delay_most[link], delay)
        ledger.delays[(*link, bin_of(np.array(delay)))] += 1
        if ledger.missing[link]:
            length = min(ledger.missing[link], LONGEST_BURST)
            ledger.bursts[(*link, length - 1)] += 1
            ledger.missing[link] = 0
    elif fate != MUTE:
        ledger.missing[link] += 1
        ledger.longest[link] = max(ledger.longest[link], ledger.missing[link])


def take_due(post: Post, ledger: Ledger, read: Read, inbox: Inbox, count: int, now: float) -> int:
    """Take out what has arrived by `now` (s), in the order of arrival; the newest is kept.

    Args:
        post: changed in place.
        ledger: changed in place.
        read: changed in place.
        inbox: changed in place.
        count: messages that are on their way.
        now: s.

    Returns:
        How many messages are still on their way.
    """
    due = post.arrival_s[:count] <= now + SIMULTANEOUS_S
    if not due.any():
        return count
    arrived = np.flatnonzero(due)
    for k in arrived[np.argsort(post.arrival_s[arrived], kind="stable")]:
        i, m, number = post.link[k]
        if number > read.number[i, m]:
            read.number[i, m], read.measured_s[i, m] = number, post.measured_s[k]
            inbox.stamp_s[i, m], inbox.received_s[i, m] = post.stamp_s[k], post.arrival_s[k]
            for vector, new in zip(inbox[2:], post.content[k], strict=True):
                vector[i, m] = new
        elif number < read.number[i, m]:
            ledger.overtaken[i, m] += 1
    stay = np.flatnonzero(~due)
    for each in post:
        each[: len(stay)] = each[stay]
    return len(stay)


def send_round(
    channel: Channel,
    traffic: Traffic,
    post: Post,
    ledger: Ledger,
    rows: Numbers,
    numbers: Numbers,
    sent_s: Array,
    script: Fates,
    replayed: Array,
    faded: Array,
    clocks: Clocks,
    shown_s: Array,
    ahead_s: Array,
    message: Broadcast,
    arrivals: Array,
    fate: Fates,
    count: int,
) -> int:
    """One message of each of S aircraft: what becomes of it, and off it goes.

    Args:
        channel: see `fates.fates`.
        traffic: changed in place.
        post: changed in place; there must be room.
        ledger: changed in place.
        rows: (S,) who sends.
        numbers: (N,) of the last message of each; changed in place.
        sent_s: (N,) when they send, s.
        script: (n, S) see `fates.fates`.
        replayed: (n, S)
        faded: (n, S)
        clocks: of all N aircraft.
        shown_s: (S,) see `clocks.show`, written.
        ahead_s: (n, S) see `clocks.show`, written.
        message: of all N aircraft.
        arrivals: (n, S, 2) s, written.
        fate: (n, S) of links.Fate, written.
        count: messages that are on their way.

    Returns:
        How many messages are on their way now.
    """
    numbers[rows] += 1
    sequence, sent = numbers[rows], sent_s[rows]
    show(clocks, message.stamp_s, rows, shown_s, ahead_s)
    stamps_s, told = shown_s - ahead_s, (script, replayed, faded)
    arrivals[:], fate[:] = fates(channel, traffic, rows, sequence, sent, *told)
    return post_round(post, ledger, count, rows, sequence, sent, stamps_s, message, arrivals, fate)


POST_ROUND = twin_of(post_round, "testbed.network.post_twin")
READY_SEND_ROUND = ready_of(send_round, "testbed.network.post_twin")
READY_TAKE_DUE = ready_of(take_due, "testbed.network.post_twin")
