"""Statistics of all links as numbers ready for JSON; null stands for statistics of nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import BoolArray, Records
from testbed.network.link_statistics import LONGEST_BURST, bin_ends
from testbed.network.links import Numbers, PacketOutcome

Links = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns (L,) of some links

QUANTILES = {"p50": 0.50, "p95": 0.95, "p99": 0.99}
OF_AGES = ("p50", "p95")
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
    lost = {outcome_name(each): int(outcomes[each]) for each in LOSSES if outcomes[each]}
    return {
        "sent": sent,
        "delivered": delivered,
        "delivered_share": delivered / sent if sent else None,
        "lost": lost,
        "muted": int(outcomes[PacketOutcome.MUTED]),
        "duplicated": total("duplicated"),
        "overtaken": total("overtaken"),
        "delay_s": _delays(statistics, links, delivered),
        "bursts": _bursts(statistics, links, sum(lost.values())),
        "age_s": _ages(statistics, links, total("uses")),
    }


def _delays(statistics: Records, links: Links, count: int) -> dict[str, float] | None:
    if not count:
        return None
    least = float(statistics["delay_min"][links].min())
    most = float(statistics["delay_max"][links].max())
    mean = float(statistics["delay_sum"][links].sum()) / count
    bins = statistics["delays"][links].sum(axis=0)
    return {
        # rounding must not put the mean of equal numbers outside them
        "mean": min(max(mean, least), most),
        "min": least,
        "max": most,
        **{name: quantile(bins, part, least, most) for name, part in QUANTILES.items()},
    }


def _ages(statistics: Records, links: Links, uses: int) -> dict[str, float | int] | None:
    if not uses:
        return None
    least = float(statistics["age_min"][links].min())
    most = float(statistics["age_max"][links].max())
    mean = float(statistics["age_sum"][links].sum()) / uses
    bins = statistics["ages"][links].sum(axis=0)
    return {
        "mean": min(max(mean, least), most),
        "max": most,
        **{name: quantile(bins, QUANTILES[name], least, most) for name in OF_AGES},
        "uses": uses,
    }


def _bursts(statistics: Records, links: Links, lost: int) -> dict[str, Any]:
    """Summarise bursts of loss; each lost message is in one, and one that is not sent in none."""
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
    """Return the duration, s, that this part of all does not exceed, linear within its bin.

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
