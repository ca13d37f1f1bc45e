"""The compiled twin of `post`: the same steps written out per message.

A test holds it to the numpy functions. numba compiles each function at its first call. It is handed
the records that posts and ledgers are views of: one array costs less than many.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import inf

import numpy as np

from testbed.compiled import bound, twin
from testbed.network.clocks_twin import show
from testbed.network.fates_twin import _fates as fates_of
from testbed.network.fates_twin import channel_of
from testbed.network.ledger_twin import count_message
from testbed.network.post import UNHEARD
from testbed.network.slots import SIMULTANEOUS_S


def post_round(post, ledger, count, rows, numbers, sent_s, stamps_s, message, arrivals, fate):
    return _post_round(
        post.link.base,
        ledger.sent.base,
        count,
        rows,
        numbers,
        sent_s,
        stamps_s,
        *message,
        arrivals,
        fate,
    )


def ready_take_due(post, ledger, read, inbox):
    given = post.link.base, ledger.sent.base, *read, *inbox, *_desk(post)
    return bound(_take_due, *given, more=(0, 0.0))


def _desk(post):
    """Where messages are put in order; numba's own arrays would take long to load."""
    return np.empty((2, len(post.link.base)), np.int64)


def ready_send_round(
    channel,
    traffic,
    post,
    ledger,
    rows,
    numbers,
    sent_s,
    script,
    replayed,
    faded,
    clocks,
    shown_s,
    ahead_s,
    message,
    arrivals,
    fate,
):
    return bound(
        _send_round,
        *channel_of(channel, traffic),
        post.link.base,
        ledger.sent.base,
        rows,
        numbers,
        sent_s,
        script,
        replayed,
        faded,
        *clocks,
        shown_s,
        ahead_s,
        *message,
        arrivals,
        fate,
        np.empty(len(rows), np.int64),
        np.empty(len(rows)),
        np.empty_like(ahead_s),
        more=(0,),
    )


@twin
def _post_round(
    post,
    ledger,
    count,
    rows,
    numbers,
    sent_s,
    stamps_s,
    measured_s,
    position,
    velocity,
    acceleration,
    euler,
    euler_rates,
    arrivals,
    fate,
):
    n, senders = fate.shape
    for i in range(n):
        for s in range(senders):
            m = rows[s]
            for copy in range(2):
                if arrivals[i, s, copy] == inf:
                    continue
                entry = post[count]
                entry.arrival_s = arrivals[i, s, copy]
                entry.link[0], entry.link[1], entry.link[2] = i, m, numbers[s]
                entry.measured_s, entry.stamp_s = measured_s[m], stamps_s[i, s]
                for axis in range(3):
                    entry.content[0, axis] = position[m, axis]
                    entry.content[1, axis] = velocity[m, axis]
                    entry.content[2, axis] = acceleration[m, axis]
                    entry.content[3, axis] = euler[m, axis]
                    entry.content[4, axis] = euler_rates[m, axis]
                count += 1
            if m != i + 1 and fate[i, s] != UNHEARD:
                first = min(arrivals[i, s, 0], arrivals[i, s, 1])
                both = max(arrivals[i, s, 0], arrivals[i, s, 1]) < inf
                count_message(ledger[i, m], fate[i, s], first - sent_s[s], both)
    return count


@twin
def _put_in_order(post, arrived, spare, due):
    """By arrival, those of one moment as they are: merges of ever longer runs."""
    width = 1
    while width < due:
        for left in range(0, due, 2 * width):
            middle, right = min(left + width, due), min(left + 2 * width, due)
            i, j = left, middle
            for k in range(left, right):
                early = i < middle
                if early and j < right:
                    early = post[arrived[i]].arrival_s <= post[arrived[j]].arrival_s
                if early:
                    spare[k] = arrived[i]
                    i += 1
                else:
                    spare[k] = arrived[j]
                    j += 1
        for k in range(due):
            arrived[k] = spare[k]
        width *= 2


@twin
def _take_due(
    post,
    ledger,
    read,
    measured_s,
    stamp_s,
    received_s,
    position,
    velocity,
    acceleration,
    euler,
    euler_rates,
    arrived,
    spare,
    count,
    now,
):
    due = 0
    # most rounds arrive in the order they were sent in
    sorted_already = True
    for k in range(count):
        if post[k].arrival_s <= now + SIMULTANEOUS_S:
            if due and post[k].arrival_s < post[arrived[due - 1]].arrival_s:
                sorted_already = False
            arrived[due] = k
            due += 1
    if due == 0:
        return count
    first = arrived[0]
    if not sorted_already:
        _put_in_order(post, arrived, spare, due)
    for at in range(due):
        entry = post[arrived[at]]
        i, m, number = entry.link[0], entry.link[1], entry.link[2]
        if number > read[i, m]:
            read[i, m], measured_s[i, m] = number, entry.measured_s
            stamp_s[i, m], received_s[i, m] = entry.stamp_s, entry.arrival_s
            content = entry.content
            for axis in range(3):
                position[i, m, axis] = content[0, axis]
                velocity[i, m, axis] = content[1, axis]
                acceleration[i, m, axis] = content[2, axis]
                euler[i, m, axis] = content[3, axis]
                euler_rates[i, m, axis] = content[4, axis]
        elif number < read[i, m]:
            ledger[i, m].overtaken += 1
    stay = first
    for k in range(first, count):
        if post[k].arrival_s > now + SIMULTANEOUS_S:
            post[stay] = post[k]
            stay += 1
    return stay


@twin
def _send_round(
    links,
    keys,
    quantiles,
    tables,
    states,
    rings,
    spoiled,
    post,
    ledger,
    rows,
    numbers,
    sent_s,
    script,
    replayed,
    faded,
    offset,
    drift,
    resolution,
    shown_s,
    ahead_s,
    measured_s,
    position,
    velocity,
    acceleration,
    euler,
    euler_rates,
    arrivals,
    fate,
    sequence,
    sent,
    stamps_s,
    count,
):
    senders = len(rows)
    for s in range(senders):
        m = rows[s]
        numbers[m] += 1
        sequence[s], sent[s] = numbers[m], sent_s[m]
    show(offset, drift, resolution, measured_s, rows, shown_s, ahead_s)
    for i in range(len(stamps_s)):
        for s in range(senders):
            stamps_s[i, s] = shown_s[s] - ahead_s[i, s]
    told = (script, replayed, faded)
    way = (links, keys, quantiles, tables, states, rings, spoiled)
    fates_of(*way, rows, sequence, sent, *told, arrivals, fate)
    said = (measured_s, position, velocity, acceleration, euler, euler_rates)
    return _post_round(post, ledger, count, rows, sequence, sent, stamps_s, *said, arrivals, fate)
