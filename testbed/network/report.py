"""What happened on every link in numbers, ready for JSON: null stands for what there is none of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.network.ledger import LONGEST_BURST, Ledger, Numbers, edges
from testbed.network.links import Fate
from testbed.state import Truths

Links = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows and columns (L,) of some links

QUANTILES = {"p50": 0.50, "p95": 0.95, "p99": 0.99}
OF_AGES = ("p50", "p95")
# What became of messages that were sent and not delivered; the mute send none.
LOSSES = tuple(f for f in Fate if f not in (Fate.DELIVERED, Fate.MUTE, Fate.UNHEARD))


def word(fate: Fate) -> str:
    """A fate as reports name it."""
    return fate.name.lower()


def summarise(
    ledger: Ledger, names: Sequence[str], unheard: Truths | None = None
) -> dict[str, Any]:
    """Numbers of every link by sender and receiver, and of all links together.

    A message still on its way counts as what will become of it; a burst of loss that goes on
    counts as long as it is by now. Delays are those of the first copy that arrives.

    Args:
        ledger: of the links between N aircraft and n followers.
        names: N, the leader first.
        unheard: (n, N) links on which nobody listens, which are left out; None: none.
    """
    n, aircraft = ledger.sent.shape
    left_out = np.eye(aircraft, n, k=-1, dtype=bool)
    if unheard is not None:
        left_out |= unheard.T
    senders, receivers = np.nonzero(~left_out)
    links: dict[str, dict[str, Any]] = {}
    for m, i in zip(senders.tolist(), receivers.tolist(), strict=True):
        only = np.array([i]), np.array([m])
        links.setdefault(names[m], {})[names[i + 1]] = _numbers(ledger, only)
    return {"links": links, "all": _numbers(ledger, (receivers, senders))}


def _numbers(ledger: Ledger, links: Links) -> dict[str, Any]:
    """Numbers of these links taken together."""

    def total(counts: Numbers) -> int:
        return int(counts[links].sum())

    fates = ledger.fates[links].sum(axis=0)
    sent = int(fates.sum() - fates[Fate.MUTE])
    delivered = int(fates[Fate.DELIVERED])
    lost = {word(fate): int(fates[fate]) for fate in LOSSES if fates[fate]}
    return {
        "sent": sent,
        "delivered": delivered,
        "delivered_share": delivered / sent if sent else None,
        "lost": lost,
        "mute": int(fates[Fate.MUTE]),
        "duplicated": total(ledger.twice),
        "overtaken": total(ledger.overtaken),
        "delay_s": _delays(ledger, links, delivered),
        "bursts": _bursts(ledger, links, sum(lost.values())),
        "age_s": _ages(ledger, links, total(ledger.uses)),
    }


def _delays(ledger: Ledger, links: Links, count: int) -> dict[str, float] | None:
    if not count:
        return None
    least, most = float(ledger.delay_least[links].min()), float(ledger.delay_most[links].max())
    mean = float(ledger.delay_sum[links].sum()) / count
    bins = ledger.delays[links].sum(axis=0)
    return {
        # rounding must not put the mean of equal numbers beside them
        "mean": min(max(mean, least), most),
        "min": least,
        "max": most,
        **{name: quantile(bins, part, least, most) for name, part in QUANTILES.items()},
    }


def _ages(ledger: Ledger, links: Links, uses: int) -> dict[str, float | int] | None:
    if not uses:
        return None
    least, most = float(ledger.age_least[links].min()), float(ledger.age_most[links].max())
    bins = ledger.ages[links].sum(axis=0)
    return {
        "mean": min(max(float(ledger.age_sum[links].sum()) / uses, least), most),
        "max": most,
        **{name: quantile(bins, QUANTILES[name], least, most) for name in OF_AGES},
        "uses": uses,
    }


def _bursts(ledger: Ledger, links: Links, lost: int) -> dict[str, Any]:
    """Bursts of loss: every lost message is in one, and a message of a mute sender is none."""
    lengths = ledger.bursts[links].sum(axis=0)
    going_on = ledger.missing[links]
    np.add.at(lengths, np.minimum(going_on[going_on > 0], LONGEST_BURST) - 1, 1)
    count = int(lengths.sum())
    return {
        "count": count,
        "mean": lost / count if count else None,
        "longest": int(ledger.longest[links].max(initial=0)),
        "lengths": {
            f"{length}+" if length == LONGEST_BURST else f"{length}": int(lengths[length - 1])
            for length in range(1, LONGEST_BURST + 1)
            if lengths[length - 1]
        },
    }


def quantile(bins: Numbers, part: float, least: float, most: float) -> float:
    """The duration, s, that this part of all is not longer than, linear within its bin.

    Of bin 0 it is the shortest: most durations in it are the same, none at all.

    Args:
        bins: (BINS,) durations in each bin, at least one in all.
        part: 0..1
        least: the shortest of them, s.
        most: the longest of them, s.
    """
    ends = edges().tolist()
    upto = np.cumsum(bins)
    wanted = part * upto[-1]
    k = int(np.searchsorted(upto, wanted))
    if k == 0:
        return least
    below = int(upto[k - 1])
    low, high = max(ends[k - 1], least), min(ends[k], most)
    value = low + (high - low) * (wanted - below) / int(bins[k])
    return float(min(max(value, least), most))
