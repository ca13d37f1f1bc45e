"""Slots in time: a packet waits for the next one that has room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.network.links import SLOT, Links
from testbed.network.philox import philox, unit

SIMULTANEOUS_S = 1e-9  # times nearer than this are the same: 0.04 + 0.1 is not 0.14 in binary


def next_slot(link: Links, state: Links, key: NDArray[np.uint64], ready_s: float) -> float:
    """The time of the first slot with room from when a packet is ready, which takes it."""
    shortest, longest = link["slot"]
    if shortest == longest:
        number = int(np.ceil((ready_s - link["first_slot"]) / longest - SIMULTANEOUS_S))
        number = max(number, int(state["slot_number"]))
        if number > state["slot_number"]:
            state["slot_left"] = link["per_slot"]
        elif state["slot_left"] == 0:
            number, state["slot_left"] = number + 1, link["per_slot"]
        state["slot_number"] = number
        state["slot_at"] = link["first_slot"] + number * longest
    while state["slot_at"] < ready_s - SIMULTANEOUS_S or state["slot_left"] == 0:
        dice = unit(philox(key[0], key[1], state["slot_number"], 0, SLOT)[0])
        state["slot_at"] += shortest + (longest - shortest) * dice
        state["slot_number"] += 1
        state["slot_left"] = link["per_slot"]
    state["slot_left"] -= 1
    return float(state["slot_at"])
