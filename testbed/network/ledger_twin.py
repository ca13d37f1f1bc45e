"""What compiled code writes into a ledger."""

# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import ceil, log2

from testbed.compiled import twin
from testbed.network.ledger import BINS, LONGEST_BURST, PER_OCTAVE, SHORTEST_S
from testbed.network.post import DELIVERED, MUTE


@twin
def bin_of(seconds):
    octaves = log2(max(seconds, SHORTEST_S) / SHORTEST_S)
    return min(int(ceil(octaves * PER_OCTAVE)), BINS - 1)


@twin
def count_message(link, fate, delay, both):
    link.fates[fate] += 1
    if fate == MUTE:
        return
    link.sent += 1
    if fate == DELIVERED:
        link.delivered += 1
        link.twice += both
        link.delay_sum += delay
        link.delay_least = min(link.delay_least, delay)
        link.delay_most = max(link.delay_most, delay)
        link.delays[bin_of(delay)] += 1
        if link.missing:
            link.bursts[min(link.missing, LONGEST_BURST) - 1] += 1
            link.missing = 0
    else:
        link.missing += 1
        link.longest = max(link.longest, link.missing)
