"""Outcomes and arrival times of the packets of a broadcast, link by link.

With arithmetic `exact` a packet waits for its transmitter and its slot, is lost or not, and if it
is not lost arrives after its delay, perhaps twice. With `netem` the order of the steps, the random
numbers and their widths are those of Linux's net/sched/sch_netem.c: a second copy is made before
the loss is decided, and the loss takes one of the two; delays come before the transmitter.
"""

from __future__ import annotations

from math import ceil, inf, isinf, isnan

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, BoolArray, Record, Records, Values
from testbed.network.clocks import clock_reading
from testbed.network.links import CORRUPT, DUPLICATE, OUTCOME, PATH, REORDER, SLOT, PacketOutcome
from testbed.network.packet_random import event_occurs, exact_delay, loss_occurs, netem_delay
from testbed.network.philox import philox, unit

SIMULTANEOUS_S = 1e-9  # times closer than this are equal: 0.04 + 0.1 is not 0.14 in binary
DELIVERED, LOST, FADED = map(int, list(PacketOutcome)[:3])
CORRUPTED, QUEUE = int(PacketOutcome.CORRUPTED), int(PacketOutcome.QUEUE)
MUTED, UNSUBSCRIBED = int(PacketOutcome.MUTED), int(PacketOutcome.UNSUBSCRIBED)
NO_WORDS = (np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0))  # where none are used


@entry
def transmit_broadcast(
    links: Records,
    departures_s: Array,
    tables: Records,
    transmitters: Records,
    senders: BoolArray,
    muted: BoolArray,
    sent_s: Array,
    messages: Records,
) -> int:
    """Send one message of each sender to all followers; write what happens to the packets.

    Args:
        links: (n, N) of CHANNEL_LINK; `packet` and `state` of the senders are written.
        departures_s: (n, N, Q) s, see `channel.initial_departures`; written.
        tables: (T,) of DELAY_TABLE.
        transmitters: (N,) of TRANSMITTER; `number` and `stamp_s` of the senders are written, and
            the rows of the senders.
        senders: (N,)
        muted: (N,) transmitters that are off; their messages are numbered and not sent.
        sent_s: (N,) s, transmission times.
        messages: (N,) of MESSAGE, stamped with the true times of their content.

    Returns:
        S, number of senders.
    """
    count = 0
    for m in range(len(senders)):
        if senders[m]:
            transmitter = transmitters[m]
            transmitter.number += 1
            transmitter.stamp_s = clock_reading(transmitter.clock, messages[m].stamp_s)
            transmitters[count].sender = m
            count += 1
    for i in range(len(links)):  # links to one follower are neighbours in memory
        for k in range(count):
            m = transmitters[k].sender
            link = links[i, m]
            p, state, packet = link.parameters, link.state, link.packet
            full = p.queue > 0 and (
                departures_s[i, m, state.next_departure] > sent_s[m] + SIMULTANEOUS_S
            )
            _transmit(link, tables[p.table], full, transmitters[m].number, muted[m], sent_s[m])
            for copy in range(packet.queued):
                departures_s[i, m, state.next_departure] = packet.departures_s[copy]
                state.next_departure = (state.next_departure + 1) % p.queue
    return count


# Arrays are kept out of what is called for each packet: counting references to them costs more than
# the packet.


@kernel
def _transmit(
    link: Record, table: Record, full: bool, number: int, muted: bool, sent_s: float
) -> None:
    """Write what happens to one packet on one link.

    Args:
        link: record of CHANNEL_LINK; `packet` and `state` are written.
        table: record of DELAY_TABLE.
        full: as many packets as may wait have not left the queue yet.
        number: sequence number.
        muted: the transmitter is off.
        sent_s: s.
    """
    packet = link.packet
    packet.queued = 0
    for copy in range(2):
        packet.arrival_s[copy] = packet.corrupted_s[copy] = inf
    if link.parameters.own:
        packet.arrival_s[0] = sent_s
        packet.outcome = DELIVERED
    elif link.parameters.unsubscribed:
        packet.outcome = UNSUBSCRIBED
    else:
        scripted = MUTED if muted else packet.scripted
        outcome = _outcome(link, table, full, number, scripted, sent_s)
        packet.outcome = outcome
        if outcome != DELIVERED:
            for copy in range(2):
                packet.arrival_s[copy] = inf
                if outcome != CORRUPTED:
                    packet.corrupted_s[copy] = inf


@kernel
def _outcome(
    link: Record, table: Record, full: bool, number: int, scripted: int, sent_s: float
) -> int:
    """Return the outcome of one packet; arrivals are written whatever the scripted outcome.

    A packet that an outage takes is sent all the same: it changes the chances, the queue and the
    slots of those behind it. One that is not sent changes its random numbers only.
    """
    p, state, packet = link.parameters, link.state, link.packet
    random = p.random or packet.fading > 0.0
    words = philox(p.key[0], p.key[1], number, 0, OUTCOME) if random else NO_WORDS
    lost = loss_occurs(p, state, words[0], words[1])
    duplicate = event_occurs(p, state, DUPLICATE, words[3])
    traced = not isnan(packet.trace_delay_s)
    if traced:
        lost = isinf(packet.trace_delay_s)
    both_lost = lost and (traced or not (p.netem and duplicate))
    sent = scripted != MUTED
    departure_s, dropped = sent_s, False
    if sent and not p.netem:
        dropped = full
        if not full:
            if p.service > 0.0:
                departure_s = state.free = max(departure_s, state.free) + p.service
            if p.slot[1] > 0.0:
                departure_s = next_slot(p, state, departure_s)
            _enter_queue(p, packet, departure_s)
    if sent and not both_lost and not dropped:
        path = philox(p.key[0], p.key[1], number, 0, PATH) if random else NO_WORDS
        corrupt = event_occurs(p, state, CORRUPT, path[0])
        dropped = p.netem and full
        if not dropped:
            # netem's second copy enters the queue before the first, and can be lost itself
            if p.netem and duplicate and not lost:
                other = philox(p.key[0], p.key[1], number, 1, OUTCOME)
                if traced or not loss_occurs(p, state, other[0], other[1]):
                    _send_second(link, table, number, sent_s, departure_s)
            arrival_s = _arrival(link, table, path, sent_s, departure_s)
            if corrupt:
                packet.corrupted_s[0] = arrival_s
            else:
                packet.arrival_s[0] = arrival_s
            if duplicate and not p.netem:
                _send_second(link, table, number, sent_s, departure_s)
    if scripted > 0:
        return scripted
    none = min(packet.arrival_s[0], packet.arrival_s[1]) == inf
    if none and dropped:
        return QUEUE
    if none and both_lost:
        return LOST
    if unit(words[2]) < packet.fading:
        return FADED
    return CORRUPTED if none else DELIVERED


@kernel
def _send_second(
    link: Record, table: Record, number: int, sent_s: float, departure_s: float
) -> None:
    """Write the arrival of the second copy of a packet."""
    p, packet = link.parameters, link.packet
    path = philox(p.key[0], p.key[1], number, 1, PATH)
    corrupt = event_occurs(p, link.state, CORRUPT, path[0])
    arrival_s = _arrival(link, table, path, sent_s, departure_s)
    if corrupt:
        packet.corrupted_s[1] = arrival_s
    else:
        packet.arrival_s[1] = arrival_s


@kernel
def _arrival(link: Record, table: Record, path: Values, sent_s: float, departure_s: float) -> float:
    """Return when one copy of a packet arrives, s.

    Args:
        link: record of CHANNEL_LINK; `state` is written, and `packet` with netem.
        table: record of DELAY_TABLE.
        path: four random words of the copy.
        sent_s: s.
        departure_s: s, when it has left the queue, without netem.
    """
    p, state = link.parameters, link.state
    overtakes = False
    if state.passed >= p.gap - 1:
        overtakes = event_occurs(p, state, REORDER, path[1])
    if p.netem:
        delay_s = p.delay if overtakes else netem_delay(p, state, path[2], table)
    else:
        delay_s = exact_delay(p, state, path[2], path[3], table)
    if not isnan(link.packet.trace_delay_s):
        delay_s = link.packet.trace_delay_s
    if overtakes:
        state.passed = 0
        return departure_s
    state.passed += 1
    arrival_s = departure_s + delay_s
    if p.netem:
        if p.service > 0.0:
            arrival_s = max(sent_s + delay_s, state.latest) + p.service
        if p.slot[1] > 0.0:
            arrival_s = next_slot(p, state, arrival_s)
        _enter_queue(p, link.packet, arrival_s)
    if p.in_order:
        arrival_s = max(arrival_s, state.latest)
    state.latest = max(arrival_s, state.latest)
    return arrival_s


@kernel
def _enter_queue(p: Record, packet: Record, departure_s: float) -> None:
    """Store the departure time of a copy, s, if the queue is limited."""
    if p.queue > 0:
        packet.departures_s[packet.queued] = departure_s
        packet.queued += 1


@kernel
def next_slot(p: Record, state: Record, ready_s: float) -> float:
    """Take the first slot with capacity after a packet is ready; return its time, s.

    Args:
        p: record of LINK_PARAMETERS.
        state: record of LINK_STATE; written.
        ready_s: s.
    """
    shortest, longest = p.slot[0], p.slot[1]
    if shortest == longest:
        number = int(ceil((ready_s - p.first_slot) / longest - SIMULTANEOUS_S))
        number = max(number, state.slot_number)
        if number > state.slot_number:
            state.slot_left = p.per_slot
        elif state.slot_left == 0:
            number += 1
            state.slot_left = p.per_slot
        state.slot_number = number
        state.slot_at = p.first_slot + number * longest
    while state.slot_at < ready_s - SIMULTANEOUS_S or state.slot_left == 0:
        drawn = unit(philox(p.key[0], p.key[1], state.slot_number, 0, SLOT)[0])
        state.slot_at += shortest + (longest - shortest) * drawn
        state.slot_number += 1
        state.slot_left = p.per_slot
    state.slot_left -= 1
    return float(state.slot_at)
