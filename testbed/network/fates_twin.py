"""The compiled twin of `fates`: the same steps written out per link.

A test holds it to the numpy functions. numba compiles each function at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import ceil, inf, isinf, isnan

import numpy as np

from testbed.compiled import twin
from testbed.network.dice_twin import exact_delay, happens, loses, netem_delay, philox, unit
from testbed.network.fates import MUTE
from testbed.network.links import CORRUPT, DUPLICATE, OUTCOME, PATH, REORDER, SLOT, Fate
from testbed.network.slots import SIMULTANEOUS_S

DELIVERED, LOST, FADED = int(Fate.DELIVERED), int(Fate.LOST), int(Fate.FADED)
CORRUPTED, QUEUE, UNHEARD = int(Fate.CORRUPTED), int(Fate.QUEUE), int(Fate.UNHEARD)


def fates(channel, traffic, rows, sequence, sent_s, script, replayed, faded):
    arrivals, fate = np.empty((*script.shape, 2)), np.empty(script.shape, np.uint8)
    told = (rows, sequence, sent_s, script, replayed, faded)
    _fates(*channel_of(channel, traffic), *told, arrivals, fate)
    return arrivals, fate


def befall(channel, traffic, rows, sequence, sent_s, script, replayed, faded, arrivals, fate):
    told = (rows, sequence, sent_s, script, replayed, faded)
    _fates(*channel_of(channel, traffic), *told, arrivals, fate)


def channel_of(channel, traffic):
    return (channel.links, channel.keys, channel.quantiles, channel.tables, *traffic)


@twin
def _next_slot(link, state, key, ready_s):
    shortest, longest = link.slot[0], link.slot[1]
    if shortest == longest:
        number = int(ceil((ready_s - link.first_slot) / longest - SIMULTANEOUS_S))
        number = max(number, state.slot_number)
        if number > state.slot_number:
            state.slot_left = link.per_slot
        elif state.slot_left == 0:
            number += 1
            state.slot_left = link.per_slot
        state.slot_number = number
        state.slot_at = link.first_slot + number * longest
    while state.slot_at < ready_s - SIMULTANEOUS_S or state.slot_left == 0:
        dice = unit(philox(key, state.slot_number, 0, SLOT)[0])
        state.slot_at += shortest + (longest - shortest) * dice
        state.slot_number += 1
        state.slot_left = link.per_slot
    state.slot_left -= 1
    return state.slot_at


@twin
def _queue_is_full(link, state, ring, sent_s):
    return link.queue > 0 and ring[state.place] > sent_s + SIMULTANEOUS_S


@twin
def _queue(link, state, ring, leaves):
    if link.queue > 0:
        ring[state.place] = leaves
        state.place = (state.place + 1) % link.queue


@twin
def _travel(link, state, ring, key, words, sent_s, departs, told, quantiles, tables):
    """Arrival of a packet."""
    overtakes = False
    if state.passed >= link.gap - 1:
        overtakes = happens(link, state, REORDER, words[1])
    if link.netem:
        delay = link.delay if overtakes else netem_delay(link, state, words[2], tables)
    else:
        delay = exact_delay(link, state, words[2], words[3], quantiles)
    if not isnan(told):
        delay = told
    if overtakes:
        state.passed = 0
        return departs
    state.passed += 1
    arrives = departs + delay
    if link.netem:
        if link.service > 0.0:
            arrives = max(sent_s + delay, state.latest) + link.service
        if link.slot[1] > 0.0:
            arrives = _next_slot(link, state, key, arrives)
        _queue(link, state, ring, arrives)
    if link.in_order:
        arrives = max(arrives, state.latest)
    state.latest = max(arrives, state.latest)
    return arrives


@twin
def _second(
    link, state, ring, key, number, sent_s, departs, told, quantiles, tables, arrivals, spoiled_s
):
    """Put the arrival of the second copy in place."""
    dice = philox(key, number, 1, PATH)
    at = spoiled_s if happens(link, state, CORRUPT, dice[0]) else arrivals
    at[1] = _travel(link, state, ring, key, dice, sent_s, departs, told, quantiles, tables)


@twin
def _one(
    link,
    state,
    key,
    ring,
    number,
    sent_s,
    script,
    told,
    faded,
    quantiles,
    tables,
    arrivals,
    spoiled_s,
):
    """The fate of one packet; its arrivals (2,) are put in place, those of spoiled copies apart."""
    words = philox(key, number, 0, OUTCOME)
    lost = loses(link, state, words[0], words[1])
    twice = happens(link, state, DUPLICATE, words[3])
    traced = not isnan(told)
    if traced:
        lost = isinf(told)
    gone = lost and (traced or not (link.netem and twice))
    sending = script != MUTE
    departs, full = sent_s, False
    if sending and not link.netem:
        full = _queue_is_full(link, state, ring, sent_s)
        if not full:
            if link.service > 0.0:
                departs = state.free = max(departs, state.free) + link.service
            if link.slot[1] > 0.0:
                departs = _next_slot(link, state, key, departs)
            _queue(link, state, ring, departs)
    if sending and not gone and not full:
        dice = philox(key, number, 0, PATH)
        spoiled = happens(link, state, CORRUPT, dice[0])
        full = link.netem and _queue_is_full(link, state, ring, sent_s)
        if not full:
            if link.netem and twice and not lost:
                other = philox(key, number, 1, OUTCOME)
                if traced or not loses(link, state, other[0], other[1]):
                    _second(
                        link,
                        state,
                        ring,
                        key,
                        number,
                        sent_s,
                        departs,
                        told,
                        quantiles,
                        tables,
                        arrivals,
                        spoiled_s,
                    )
            at = spoiled_s if spoiled else arrivals
            at[0] = _travel(link, state, ring, key, dice, sent_s, departs, told, quantiles, tables)
            if twice and not link.netem:
                _second(
                    link,
                    state,
                    ring,
                    key,
                    number,
                    sent_s,
                    departs,
                    told,
                    quantiles,
                    tables,
                    arrivals,
                    spoiled_s,
                )
    if script > 0:
        return script
    if min(arrivals[0], arrivals[1]) == inf:
        if full:
            return QUEUE
        if gone:
            return LOST
    if unit(words[2]) < faded:
        return FADED
    return CORRUPTED if min(arrivals[0], arrivals[1]) == inf else DELIVERED


@twin
def _fates(
    links,
    keys,
    quantiles,
    tables,
    states,
    rings,
    spoiled,
    rows,
    sequence,
    sent_s,
    script,
    replayed,
    faded,
    arrivals,
    fate,
):
    n, senders = script.shape
    arrivals[:] = inf
    fate[:] = 0
    for i in range(n):  # links to one follower are neighbours in memory
        for s in range(senders):
            m = rows[s]
            link, spoiled_s = links[i, m], spoiled[i, m]
            spoiled_s[:] = inf
            if link.own:
                arrivals[i, s, 0] = sent_s[s]
                continue
            if link.unheard:
                fate[i, s] = UNHEARD
                continue
            fate[i, s] = _one(
                link,
                states[i, m],
                keys[i, m],
                rings[i, m],
                sequence[s],
                sent_s[s],
                script[i, s],
                replayed[i, s],
                faded[i, s],
                quantiles,
                tables,
                arrivals[i, s],
                spoiled_s,
            )
            if fate[i, s] != DELIVERED:
                arrivals[i, s] = inf
                if fate[i, s] != CORRUPTED:
                    spoiled_s[:] = inf
