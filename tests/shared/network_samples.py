"""Messages on one link, and tests of whether chance explains their outcomes."""

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from reference.channel_simulation import transmit
from scipy.stats import binomtest, chisquare, norm, ttest_1samp

from testbed.network.channel import make_channel
from testbed.network.links import PacketOutcome, resolve_links
from testbed.scenario.network import Network

PACKETS = int(os.environ.get("TESTBED_PACKETS", "12000"))
SEED = 1
# The tests of the channel ask some 200 times whether chance explains a deviation. Bonferroni: at
# this level, a channel that is right fails one or more of them for one seed in a hundred.
LEVEL = 0.01 / 200
BATCHES = 100
LEAST = 10  # expected in a cell of a chi-square test


class Flow(NamedTuple):
    """K messages on one link."""

    sent_s: NDArray[np.float64]
    received_s: NDArray[np.float64]
    second_s: NDArray[np.float64]
    outcome: NDArray[np.uint8]
    copies: NDArray[np.uint8]

    @property
    def delay_s(self):
        return self.received_s - self.sent_s

    @property
    def lost(self):
        return self.outcome == PacketOutcome.LOST


def make(names=("leader", "uav1"), seed=None, **keys):
    """Make a channel with these keys of a scenario's network."""
    return make_channel(
        resolve_links(names, Network.model_validate(keys)), SEED if seed is None else seed
    )


def send(packets=PACKETS, period_s=1.0, phase_s=0.0, **keys):
    """Send messages at equal intervals on one link with these keys of a network."""
    sent = transmit(make(**keys), packets=packets, period_s=period_s, phase_s=phase_s)
    return Flow(sent.sent_s[:, 0], *(each[:, 0, 0] for each in sent[1:]))


def assert_chance(p_value):
    assert p_value > LEVEL


def assert_share(events, probability):
    """Independent events have this probability: an exact binomial test."""
    events = np.asarray(events)
    assert_chance(binomtest(int(events.sum()), events.size, probability).pvalue)


def assert_counts(counts, probabilities):
    """Counts are multinomial: chi-square, neighbours pooled where too few are expected."""
    counts = np.asarray(counts)
    expected = counts.sum() * np.asarray(probabilities) / np.sum(probabilities)
    assert counts[expected == 0.0].sum() == 0
    cell = pooled(expected)
    assert cell[-1] > 0, "too few packets to tell"
    assert_chance(chisquare(np.bincount(cell, counts), np.bincount(cell, expected)).pvalue)


def pooled(expected):
    """Numbers of cells in each of which enough are expected, by neighbours."""
    cell, first, inside = np.zeros(len(expected), dtype=np.int64), 0, 0.0
    for k, each in enumerate(expected):
        inside += each
        cell[k] = first
        if inside >= LEAST:
            first, inside = first + 1, 0.0
    return np.minimum(cell, max(first - 1, 0))  # what is left over joins the last


def assert_mean(values, mean):
    """Values that depend on near ones only have this mean: Student's test of means of batches."""
    batches = np.array([each.mean() for each in np.array_split(values, BATCHES)])
    assert_chance(ttest_1samp(batches, mean).pvalue)


def assert_normal(deviation):
    """One number that should be standard normal."""
    assert_chance(2.0 * norm.sf(abs(deviation)))


def runs(events):
    """Lengths of the runs of events, of their gaps too, but for the first run and the last.

    Returns:
        Lengths of runs of events, and of runs of none.
    """
    edges = np.flatnonzero(np.diff(events.astype(np.int8))) + 1
    lengths, what = np.diff(edges), events[edges[:-1]]
    return lengths[what], lengths[~what]


def assert_lengths(lengths, probability_of):
    """Independent lengths from 1 have this probability, given as a function of an array."""
    longest = int(lengths.max()) + 1
    expected = probability_of(np.arange(1, longest + 1))
    expected = np.append(expected, max(1.0 - expected.sum(), 0.0))
    assert_counts(np.bincount(lengths, minlength=longest + 2)[1:], expected)
