"""The links between N aircraft and their n followers as tables: what is set, and what is going on.

Rows of a table are followers, columns aircraft: [i, m] is the directed link from m to i. The names
of fields stand for the keys of the page.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Links = np.ndarray[tuple[int, ...], np.dtype[np.void]]
Fates = NDArray[np.uint8]


class Fate(IntEnum):
    """What became of a packet."""

    DELIVERED = 0
    LOST = 1  # by the loss model or the trace
    FADED = 2  # by distance, or behind an airframe
    CORRUPTED = 3  # arrived, and its checksum was wrong
    QUEUE = 4  # dropped at the tail of the transmitter's queue
    BLACKOUT = 5
    PARTITION = 6
    LISTED = 7  # in the list of packets to drop
    MUTE = 8  # was not even sent
    UNHEARD = 9  # by who does not listen to its sender


NO_LOSS, BERNOULLI, GILBERT_ELLIOTT, FOUR_STATE = range(4)
NO_JITTER, UNIFORM, NORMAL, LOGNORMAL, PARETO, PARETONORMAL, EMPIRICAL = range(7)
# Events with a probability and a correlation; netem correlates the delay in the same way.
LOSS, DUPLICATE, CORRUPT, REORDER, DELAY = range(5)

# What is set. Of events: the probability after a packet that had none and after one that had one,
# by which a probability and a lag-1 correlation come about; for netem its 32-bit numbers.
LINK = np.dtype(
    [
        ("own", "?"),  # from an aircraft to itself: perfect
        ("unheard", "?"),  # the receiver does not listen; neither is anything counted
        ("netem", "?"),
        ("delay", "f8"),  # s
        ("jitter", "i8"),
        ("spread", "f8"),  # s
        ("shape", "f8", (2,)),  # of lognormal: mean and deviation of the logarithm
        ("table", "i8"),  # of quantiles, for empirical and for netem
        ("rho", "f8"),  # of the normal process behind the jitter
        ("in_order", "?"),
        ("loss", "i8"),
        ("p", "f8", (5,)),  # of the Markov chains, in the order of the page
        ("after_none", "f8", (4,)),
        ("after_one", "f8", (4,)),
        ("share", "u8", (4,)),
        ("blend", "u8", (5,)),
        ("gap", "i8"),
        ("service", "f8"),  # s on the air per packet; 0: none
        ("queue", "i8"),  # packets that may wait; 0: any number
        ("slot", "f8", (2,)),  # s from slot to slot, shortest and longest; 0: no slots
        ("first_slot", "f8"),  # s
        ("per_slot", "i8"),
        ("bits", "i8"),  # of a corrupt frame that are not what they were
    ]
)

# What is going on.
STATE = np.dtype(
    [
        ("chain", "i8"),  # state of the loss model, 0 is the good one
        ("had", "u1", (4,)),  # whether the packet before had the event
        ("blended", "u8", (5,)),  # what netem remembers of its dice
        ("z", "f8"),  # of the normal process; nan: not begun
        ("passed", "i8"),  # packets since the last that overtook
        ("free", "f8"),  # when the transmitter is free, s
        ("latest", "f8"),  # arrival, s
        ("slot_number", "i8"),  # the last slot that was used, or the first of all
        ("slot_at", "f8"),  # s
        ("slot_left", "i8"),  # packets that it still takes
        ("place", "i8"),  # of the next packet in the ring of the queue
    ]
)

# Blocks of dice: what each word of them decides.
OUTCOME, PATH, START, SLOT, PLACES = range(5)
