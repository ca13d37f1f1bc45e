"""Statistics of each link: outcomes, delays, bursts of loss, message ages at use."""

from __future__ import annotations

from math import ceil, isnan, log2

import numpy as np

from testbed.core.compile import jitable, kernel
from testbed.core.records import Array, Record, Records, allocate
from testbed.network.links import Numbers, PacketOutcome

DELIVERED, MUTED = int(PacketOutcome.DELIVERED), int(PacketOutcome.MUTED)
# Delays and ages are counted in bins: bin 0 ends at SHORTEST_S, and the widths double every
# PER_OCTAVE bins, so that a quantile read from them is within 9 %.
SHORTEST_S = 1e-4
PER_OCTAVE = 8
BINS = 1 + 20 * PER_OCTAVE  # the last has all above 95 s
LONGEST_BURST = 64  # bursts of loss of this length or longer share the last bin

# Statistics of one link since the start. Delays are those of the first copy received.
LINK_STATISTICS = np.dtype(
    [
        ("outcomes", "i8", len(PacketOutcome)),  # packets by PacketOutcome
        ("duplicated", "i8"),  # packets of which two copies were received
        ("overtaken", "i8"),  # packets received after a newer one
        ("burst", "i8"),  # packets lost in a row up to now
        ("longest_burst", "i8"),  # packets
        ("delay_sum", "f8"),  # s
        ("delay_min", "f8"),  # s
        ("delay_max", "f8"),  # s
        ("uses", "i8"),  # control steps that used a message
        ("age_sum", "f8"),  # s, of the content at each use
        ("age_min", "f8"),  # s
        ("age_max", "f8"),  # s
        ("delays", "i8", BINS),  # packets by bin
        ("ages", "i8", BINS),  # uses by bin
        ("bursts", "i8", LONGEST_BURST),  # bursts of loss by length, from 1
    ],
    align=True,
)


def initial_statistics(*shape: int) -> Records:
    """Return LINK_STATISTICS of links on which nothing was sent."""
    statistics = allocate(LINK_STATISTICS, *shape)
    statistics["delay_min"] = statistics["age_min"] = np.inf
    return statistics


@jitable
def bin_of(seconds: float) -> int:
    """Return the bin of a duration, s."""
    octaves = log2(max(seconds, SHORTEST_S) / SHORTEST_S)
    return min(int(ceil(octaves * PER_OCTAVE)), BINS - 1)


def bin_ends() -> Array:
    """Return the upper ends of the bins (BINS,), s; the last is infinite."""
    ends: Array = SHORTEST_S * 2.0 ** (np.arange(BINS) / PER_OCTAVE)
    ends[-1] = np.inf
    return ends


@kernel
def record_packet(
    statistics: Record, link: Record, outcome: int, delay_s: float, both: bool
) -> None:
    """Count a packet.

    Args:
        statistics: record of LINK_STATISTICS; written.
        link: record of LINK; `sent` and `delivered` are written.
        outcome: PacketOutcome.
        delay_s: s, if it is delivered.
        both: two copies are delivered.
    """
    statistics.outcomes[outcome] += 1
    if outcome == MUTED:
        return
    link.sent += 1
    if outcome == DELIVERED:
        link.delivered += 1
        statistics.duplicated += both
        statistics.delay_sum += delay_s
        statistics.delay_min = min(statistics.delay_min, delay_s)
        statistics.delay_max = max(statistics.delay_max, delay_s)
        statistics.delays[bin_of(delay_s)] += 1
        if statistics.burst:
            statistics.bursts[min(statistics.burst, LONGEST_BURST) - 1] += 1
            statistics.burst = 0
    else:
        statistics.burst += 1
        statistics.longest_burst = max(statistics.longest_burst, statistics.burst)


@kernel
def record_ages(statistics: Records, rows: Numbers, age_s: Array) -> None:
    """Count the ages of the messages that followers used in a control step.

    Args:
        statistics: (n, N) of LINK_STATISTICS; written.
        rows: (m,) of the followers.
        age_s: (n, N) s, of all followers; nan: not used.
    """
    for i in rows:
        for m in range(age_s.shape[1]):
            age = age_s[i, m]
            if not isnan(age):
                link = statistics[i, m]
                link.uses += 1
                link.age_sum += age
                link.age_min = min(link.age_min, age)
                link.age_max = max(link.age_max, age)
                link.ages[bin_of(age)] += 1
