"""Transmission slots: a packet waits for the next slot with capacity left."""

from __future__ import annotations

from math import ceil

from testbed.core.compile import kernel
from testbed.core.records import Record
from testbed.network.links import SLOT
from testbed.network.philox import philox, unit

SIMULTANEOUS_S = 1e-9  # times closer than this are equal: 0.04 + 0.1 is not 0.14 in binary


@kernel
def next_slot(p: Record, state: Record, ready_s: float) -> float:
    """Take the first slot with capacity left after a packet is ready; return its time, s.

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
