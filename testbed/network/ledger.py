"""What happened on each link, counted: fates, delays, bursts of loss, ages at use."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.network.links import Fate
from testbed.state import Array, Counts, LinkCounts

Numbers = NDArray[np.int64]

# Delays and ages are sorted into bins: bin 0 ends at SHORTEST_S, and bins double in width every
# PER_OCTAVE, so that a quantile read from them is within 9 %.
SHORTEST_S = 1e-4
PER_OCTAVE = 8
BINS = 1 + 20 * PER_OCTAVE  # the last has all above 95 s
LONGEST_BURST = 64  # bursts of loss as long or longer share the last bin


LEDGER = np.dtype(
    [
        ("fates", "i8", (len(Fate),)),
        ("sent", "u4"),
        ("delivered", "u4"),
        ("twice", "i8"),
        ("overtaken", "i8"),
        ("delay_sum", "f8"),
        ("delay_least", "f8"),
        ("delay_most", "f8"),
        ("delays", "i8", (BINS,)),
        ("missing", "i8"),
        ("bursts", "i8", (LONGEST_BURST,)),
        ("longest", "i8"),
        ("uses", "i8"),
        ("age_sum", "f8"),
        ("age_least", "f8"),
        ("age_most", "f8"),
        ("ages", "i8", (BINS,)),
    ]
)


class Ledger(NamedTuple):
    """Counts of the links between N aircraft and their n followers; written in place."""

    fates: Numbers  # (n, N, F) messages by links.Fate
    sent: Counts  # (n, N) messages, less those of the mute
    delivered: Counts  # (n, N)
    twice: Numbers  # (n, N) messages of which two copies arrived
    overtaken: Numbers  # (n, N) arrivals that a newer message had overtaken
    delay_sum: Array  # (n, N) s, of the first copies
    delay_least: Array  # (n, N) s
    delay_most: Array  # (n, N) s
    delays: Numbers  # (n, N, BINS)
    missing: Numbers  # (n, N) messages not delivered in a row up to now
    bursts: Numbers  # (n, N, LONGEST_BURST) bursts of loss by length, from 1
    longest: Numbers  # (n, N) messages
    uses: Numbers  # (n, N) control steps that used a message
    age_sum: Array  # (n, N) s, of the information at each use
    age_least: Array  # (n, N) s
    age_most: Array  # (n, N) s
    ages: Numbers  # (n, N, BINS)


def blank(n: int, aircraft: int) -> Ledger:
    """Of nothing sent: views of one array of records (n, N), which is their base."""
    records = np.zeros((n, aircraft), dtype=LEDGER)
    ledger = Ledger(*(records[name] for name in Ledger._fields))
    ledger.delay_least[:] = ledger.age_least[:] = np.inf
    return ledger


def bin_of(seconds: Array) -> Numbers:
    """The bin of each duration (…), s."""
    octaves = np.log2(np.maximum(seconds, SHORTEST_S) / SHORTEST_S)
    bins: Numbers = np.minimum(np.ceil(octaves * PER_OCTAVE), BINS - 1).astype(np.int64)
    return bins


def edges() -> Array:
    """The upper ends of the bins (BINS,), s; the last is open."""
    ends: Array = SHORTEST_S * 2.0 ** (np.arange(BINS) / PER_OCTAVE)
    ends[-1] = np.inf
    return ends


def use(ledger: Ledger, rows: Numbers, age_s: Array) -> None:
    """Count the age of what each of the followers `rows` (m,) used of each aircraft.

    Args:
        ledger: changed in place.
        rows: (m,) followers.
        age_s: (n, N) s of all followers; nan: it used nothing.
    """
    for k, m in np.argwhere(~np.isnan(age_s[rows])):
        link = rows[k], m
        age = age_s[link]
        ledger.uses[link] += 1
        ledger.age_sum[link] += age
        ledger.age_least[link] = min(ledger.age_least[link], age)
        ledger.age_most[link] = max(ledger.age_most[link], age)
        ledger.ages[(*link, bin_of(age))] += 1


def count(ledger: Ledger, counts: LinkCounts) -> None:
    """Write how many messages were sent and delivered on each link."""
    np.copyto(counts.sent, ledger.sent)
    np.copyto(counts.delivered, ledger.delivered)


READY_COUNT = ready_of(count, "testbed.network.ledger_twin")
