"""Statistics of links: outcomes, delays, bursts of loss, message ages; and their summary."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isnan, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import jitable, kernel
from testbed.core.records import Array, BoolArray, Record, Records, allocate
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


Links = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns (L,) of some links

QUANTILES = {"p50": 0.50, "p95": 0.95, "p99": 0.99}
OF_DELAYS, OF_AGES = ("min", "max", "p50", "p95", "p99"), ("max", "p50", "p95")
# Outcomes of messages that were sent and not delivered.
LOSSES = tuple(
    each
    for each in PacketOutcome
    if each not in (PacketOutcome.DELIVERED, PacketOutcome.MUTED, PacketOutcome.UNSUBSCRIBED)
)


def outcome_name(outcome: PacketOutcome) -> str:
    """Return an outcome's name in reports."""
    return outcome.name.lower()


def summarise(
    statistics: Records, names: Sequence[str], unsubscribed: BoolArray | None = None
) -> dict[str, Any]:
    """Return statistics of every link by sender and receiver, and of all links together.

    A message still on its way counts as what will happen to it; a burst of loss that continues
    counts as long as it is by now. Delays are those of the first copy received.

    Args:
        statistics: (n, N) of LINK_STATISTICS.
        names: N, the leader first.
        unsubscribed: (n, N) links whose messages are not used, which are left out; None: none.
    """
    n, aircraft = statistics.shape
    left_out = np.eye(aircraft, n, k=-1, dtype=bool)
    if unsubscribed is not None:
        left_out |= unsubscribed.T
    senders, receivers = np.nonzero(~left_out)
    links: dict[str, dict[str, Any]] = {}
    for m, i in zip(senders.tolist(), receivers.tolist(), strict=True):
        only = np.array([i]), np.array([m])
        links.setdefault(names[m], {})[names[i + 1]] = _summary(statistics, only)
    return {"links": links, "all": _summary(statistics, (receivers, senders))}


def _summary(statistics: Records, links: Links) -> dict[str, Any]:
    """Return the statistics of these links taken together."""

    def total(name: str) -> int:
        return int(statistics[name][links].sum())

    outcomes = statistics["outcomes"][links].sum(axis=0)
    sent = int(outcomes.sum() - outcomes[PacketOutcome.MUTED])
    delivered = int(outcomes[PacketOutcome.DELIVERED])
    ages = _durations(statistics, links, "age", total("uses"), OF_AGES)
    lost = {outcome_name(each): int(outcomes[each]) for each in LOSSES if outcomes[each]}
    return {
        "sent": sent,
        "delivered": delivered,
        "delivered_share": delivered / sent if sent else None,
        "lost": lost,
        "muted": int(outcomes[PacketOutcome.MUTED]),
        "duplicated": total("duplicated"),
        "overtaken": total("overtaken"),
        "delay_s": _durations(statistics, links, "delay", delivered, OF_DELAYS),
        "bursts": _bursts(statistics, links, sum(lost.values())),
        "age_s": ages and {**ages, "uses": total("uses")},
    }


def _durations(
    statistics: Records, links: Links, kind: str, count: int, more: Sequence[str]
) -> dict[str, float] | None:
    """Summarise so many delays or ages ("delay", "age"): the mean, and these further values."""
    if not count:
        return None
    least = float(statistics[f"{kind}_min"][links].min())
    most = float(statistics[f"{kind}_max"][links].max())
    mean = float(statistics[f"{kind}_sum"][links].sum()) / count
    bins = statistics[f"{kind}s"][links].sum(axis=0)
    # rounding must not put the mean of equal numbers outside them
    values = {"mean": min(max(mean, least), most), "min": least, "max": most}
    values |= {name: quantile(bins, part, least, most) for name, part in QUANTILES.items()}
    return {name: values[name] for name in ("mean", *more)}


def _bursts(statistics: Records, links: Links, lost: int) -> dict[str, Any]:
    """Summarise bursts of loss.

    Each lost message is in one burst; one that is not sent is in none.
    """
    lengths = statistics["bursts"][links].sum(axis=0)
    current = statistics["burst"][links]
    np.add.at(lengths, np.minimum(current[current > 0], LONGEST_BURST) - 1, 1)
    count = int(lengths.sum())
    return {
        "count": count,
        "mean": lost / count if count else None,
        "longest": int(statistics["longest_burst"][links].max(initial=0)),
        "lengths": {
            f"{length}+" if length == LONGEST_BURST else f"{length}": int(lengths[length - 1])
            for length in range(1, LONGEST_BURST + 1)
            if lengths[length - 1]
        },
    }


def quantile(bins: Numbers, part: float, least: float, most: float) -> float:
    """Return a quantile of durations in bins, s, linear within its bin.

    In bin 0 it is the shortest: most durations there are equal, 0 s.

    Args:
        bins: (BINS,) durations in each bin, at least one in all.
        part: 0..1
        least: the shortest of them, s.
        most: the longest of them, s.
    """
    ends = bin_ends().tolist()
    upto = np.cumsum(bins)
    wanted = part * upto[-1]
    k = int(np.searchsorted(upto, wanted))
    if k == 0:
        return least
    below = int(upto[k - 1])
    low, high = max(ends[k - 1], least), min(ends[k], most)
    value = low + (high - low) * (wanted - below) / int(bins[k])
    return float(min(max(value, least), most))
