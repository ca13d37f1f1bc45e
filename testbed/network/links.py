"""Tables of the links between N aircraft and their n followers: parameters, state, packets.

Rows of a table are followers, columns are aircraft: [i, m] is the directed link from aircraft m to
follower i, which is aircraft i + 1. Fields of LINK_PARAMETERS stand for keys of the scenario.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.reads import derive
from testbed.scenario.network import Link, Network

Numbers = NDArray[np.int64]
Outcomes = NDArray[np.uint8]  # of PacketOutcome


class PacketOutcome(IntEnum):
    """What happened to a packet on a link."""

    DELIVERED = 0
    LOST = 1  # by the loss model or the trace
    FADED = 2  # by distance, or behind an airframe
    CORRUPTED = 3  # received with a wrong checksum
    QUEUE = 4  # dropped because the transmitter's queue was full
    BLACKOUT = 5
    PARTITION = 6
    LISTED = 7  # in the list of packets to drop
    MUTED = 8  # not sent: the transmitter is off
    UNSUBSCRIBED = 9  # the receiver does not use this sender's messages


BERNOULLI, GILBERT_ELLIOTT, FOUR_STATE = range(1, 4)  # kinds of loss; 0: none
# Kinds of jitter, by their place.
JITTERS = ("none", "uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical")
NO_JITTER, UNIFORM, NORMAL, LOGNORMAL, PARETO, PARETONORMAL, EMPIRICAL = range(len(JITTERS))
# Random events with a probability and a correlation; netem correlates delays in the same way.
LOSS, DUPLICATE, CORRUPT, REORDER, DELAY = range(5)
NETEM_ONE = 0xFFFFFFFF  # netem's number for a probability or correlation of one
NETEM_TABLE = 4096  # values of a table of netem
# Blocks of random words of one packet or link, by what they decide.
OUTCOME, PATH, START, SLOT, BITS = range(5)

# Parameters of one link. Of each event: the probability after a packet without the event and after
# one with it, which give its probability and lag-1 correlation; for netem its 32-bit numbers.
LINK_PARAMETERS = np.dtype(
    [
        ("key", "u8", 2),  # of the link's random numbers
        ("own", "?"),  # from an aircraft to itself: perfect
        ("random", "?"),  # whether any random event can occur, or delays are random
        ("unsubscribed", "?"),  # the receiver does not use the messages, which are not counted
        ("netem", "?"),  # arithmetic of netem
        ("in_order", "?"),
        ("delay", "f8"),  # s
        ("jitter", "i8"),  # kind
        ("spread", "f8"),  # s
        ("lognormal", "f8", 2),  # mean and standard deviation of the logarithm
        ("table", "i8"),  # row of the tables of delays
        ("rho", "f8"),  # coefficient of the normal process behind the jitter
        ("loss", "i8"),  # kind
        ("p", "f8", 5),  # transition probabilities of the loss model, in the scenario's order
        ("after_none", "f8", 4),  # probability of an event after a packet without it
        ("after_one", "f8", 4),  # probability of an event after a packet with it
        ("share", "u8", 4),  # netem: probability of an event, of NETEM_ONE
        ("blend", "u8", 5),  # netem: correlation of an event, of NETEM_ONE
        ("gap", "i8"),  # packets from one that may overtake to the next
        ("service", "f8"),  # s on the air per packet; 0: none
        ("queue", "i8"),  # packets that may wait; 0: any number
        ("slot", "f8", 2),  # s from slot to slot, shortest and longest; 0: no slots
        ("first_slot", "f8"),  # s
        ("per_slot", "i8"),  # packets
        ("bits", "i8"),  # wrong bits of a corrupt frame
    ],
    align=True,
)
# A table of delays: quantiles (`delays.quantiles`), s, in the first values, or netem's table.
DELAY_TABLE = np.dtype([("values", "f8", NETEM_TABLE)])
# What a link keeps from one packet to the next.
LINK_STATE = np.dtype(
    [
        ("chain", "i8"),  # state of the loss model; 0 is the good one
        ("had", "u1", 4),  # whether the last packet had the event
        ("blended", "u8", 5),  # netem: last correlated word of each event
        ("z", "f8"),  # of the normal process behind the jitter; nan: not started
        ("passed", "i8"),  # packets since the last that overtook
        ("free", "f8"),  # time at which the transmitter is free, s
        ("latest", "f8"),  # latest arrival so far, s
        ("slot_number", "i8"),  # of the last slot used, or of the first
        ("slot_at", "f8"),  # s, its time
        ("slot_left", "i8"),  # packets that it still takes
        ("next_departure", "i8"),  # index of the next packet in the ring of departures
    ],
    align=True,
)
# The newest packet of a link: what decides about it besides the link's random numbers, and what
# happened to it.
PACKET = np.dtype(
    [
        ("scripted", "u1"),  # PacketOutcome by the scenario's outages; 0: none
        ("outcome", "u1"),  # PacketOutcome
        ("trace_delay_s", "f8"),  # delay by a trace; infinite: lost, nan: no trace
        ("fading", "f8"),  # probability of a loss to distance and airframes
        ("arrival_s", "f8", 2),  # of the packet and its second copy; infinite: none
        ("corrupted_s", "f8", 2),  # arrivals of corrupted copies; infinite: none
        ("departures_s", "f8", 2),  # times at which its copies leave the queue, the first `queued`
        ("queued", "i8"),
    ],
    align=True,
)


class PairLinks(NamedTuple):
    """The resolved links between N aircraft and their n followers; equal links are one."""

    names: tuple[str, ...]  # N, the leader first, which does not receive
    network: Network
    distinct: tuple[Link, ...]
    numbers: NDArray[np.int64]  # (n, N) of each link in `distinct`; -1 from an aircraft to itself

    def pairs(self) -> Iterator[tuple[int, int, Link]]:
        """Yield row, column and link of each pair, row by row."""
        for i, row in enumerate(self.numbers.tolist()):
            for m, k in enumerate(row):
                if k >= 0:
                    yield i, m, self.distinct[k]


def resolve_links(names: Sequence[str], network: Network) -> PairLinks:
    """Resolve the link of each pair of aircraft once.

    Args:
        names: N, the leader first, which does not receive.
        network: the section of the scenario.
    """
    distinct: dict[Link, int] = {}
    made: dict[tuple[int, ...], int] = {}  # by the entries that make it
    index = np.full((len(names) - 1, len(names)), -1)
    for i, receiver in enumerate(names[1:]):
        for m, sender in enumerate(names):
            if sender != receiver:
                entries = tuple(map(id, network.entries(sender, receiver)))
                if entries not in made:
                    link = network.link(sender, receiver)
                    made[entries] = distinct.setdefault(link, len(distinct))
                    first = list(distinct)[made[entries]]
                    if first is not link:  # which stands for both
                        derive(first, {name: [(link, name)] for name in Link.model_fields})
                index[i, m] = made[entries]
    return PairLinks(tuple(names), network, tuple(distinct), index)
