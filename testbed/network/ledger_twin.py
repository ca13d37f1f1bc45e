"""What compiled code writes into a ledger, and the twins of `ledger.use` and `ledger.count`.

Tests hold them to the numpy functions. It is handed the records that a ledger is views of.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import ceil, isnan, log2

from testbed.compiled import bound, twin
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


def ready_count(ledger, counts):
    return bound(_count, ledger.sent.base, *counts)


@twin
def _count(ledger, sent, delivered):
    n, aircraft = ledger.shape
    for i in range(n):
        for m in range(aircraft):
            sent[i, m], delivered[i, m] = ledger[i, m].sent, ledger[i, m].delivered


@twin
def use(ledger, rows, age_s):
    for i in rows:
        for m in range(age_s.shape[1]):
            age = age_s[i, m]
            if not isnan(age):
                link = ledger[i, m]
                link.uses += 1
                link.age_sum += age
                link.age_least = min(link.age_least, age)
                link.age_most = max(link.age_most, age)
                link.ages[bin_of(age)] += 1
