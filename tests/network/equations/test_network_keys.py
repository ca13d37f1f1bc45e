"""Random numbers depend on the link and the packet number only, not on other settings."""

from functools import cache

import numpy as np
import pytest
from network_samples import PACKETS, assert_chance, make, send
from reference.channel_simulation import transmit
from scipy.stats import chi2_contingency

from testbed.network.links import PacketOutcome

NAMES = ("leader", "uav1", "uav2", "uav3")
SOURCE, DESTINATION = 1, 1  # uav1 to uav2
HERE = (slice(None), DESTINATION, SOURCE)
SOME = 300
# A channel with all effects.
EVERYTHING = {
    "delay_s": 0.15,
    "jitter": {"distribution": "lognormal", "spread_s": 0.05, "correlation": 0.4},
    "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.3, "loss_bad": 0.8, "loss_good": 0.05},
    "duplicate": {"probability": 0.2, "correlation": 0.3},
    "corrupt": {"probability": 0.1, "correlation": 0.3},
    "reorder": {"probability": 0.2, "correlation": 0.3, "gap": 3},
    "rate": {"bit_per_s": 7000, "queue_packets": 2},
    "slots": {"every_s": [0.03, 0.09], "packets": 2, "queue_packets": 4},
}
SETTINGS = {
    "delay_s": [0.05, 0.3],
    "jitter": [
        {"distribution": name, "spread_s": 0.1, "correlation": 0.7}
        for name in ("uniform", "normal", "lognormal", "pareto", "paretonormal")
    ]
    + [{"spread_s": 0.05, "in_order": True}],
    "loss": [
        0.0,
        0.6,
        {"probability": 0.6, "correlation": 0.9},
        {"kind": "gilbert-elliott", "p": 0.5, "r": 0.1},
        {"kind": "four-state", "p13": 0.2, "p31": 0.3, "p32": 0.3, "p23": 0.6, "p14": 0.2},
    ],
    "duplicate": [0.0, 1.0, {"probability": 0.5, "correlation": 0.9}],
    "corrupt": [0.0, 0.9, {"probability": 0.5, "correlation": 0.9}],
    "reorder": [0.0, {"probability": 1.0, "gap": 2}, {"probability": 0.5, "correlation": 0.9}],
    "rate": [
        {"bit_per_s": 0},
        {"bit_per_s": 5000, "queue_packets": 1},
        {"bit_per_s": 7000, "overhead_bytes": 50},
    ],
    "slots": [{"every_s": 0}, {"every_s": 0.2, "first_s": 0.1}, {"every_s": [0.1, 0.4]}],
}


def sent(names=NAMES, seed=None, **keys):
    return transmit(make(names, seed, **keys), packets=SOME, period_s=0.1)


def same(ours, theirs, where):
    """Return whether all outcomes and times are the same to the bit."""
    return all(
        np.array_equal(a[where], b[where], equal_nan=True)
        for a, b in zip(ours[1:], theirs[1:], strict=True)
    )


def others():
    """Choose every link but the one from uav1 to uav2."""
    chosen = np.ones((len(NAMES) - 1, len(NAMES)), dtype=bool)
    chosen[DESTINATION, SOURCE] = False
    return slice(None), chosen


@cache
def sent_as(arithmetic):
    return sent(**EVERYTHING, arithmetic=arithmetic)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize("key", SETTINGS)
def test_setting_of_one_link_changes_no_other(key, arithmetic):
    common = {**EVERYTHING, "arithmetic": arithmetic}
    before = sent_as(arithmetic)
    assert len(np.unique(before.outcome)) > 3  # most outcomes occur
    for value in SETTINGS[key]:
        after = sent(**common, links={"uav1": {"uav2": {key: value}}})
        assert same(before, after, others()), value
        assert not same(before, after, HERE), value


def test_arithmetic_of_one_link_changes_no_other():
    before = sent_as("exact")
    after = sent(**EVERYTHING, links={"uav1": {"uav2": {"arithmetic": "netem"}}})
    assert same(before, after, others())
    assert not same(before, after, HERE)


def test_one_more_aircraft_changes_no_other_link():
    """Wherever in the list it stands."""
    before = sent_as("exact")
    for at in (1, 2, 4):
        names = [*NAMES[:at], "new", *NAMES[at:]]
        after = sent(names, **EVERYTHING)
        rows = [names.index(name) for name in NAMES]
        kept = [each[:, [row - 1 for row in rows[1:]]][:, :, rows] for each in after[1:]]
        assert same(before, (None, *kept), slice(None))


def test_order_of_the_fleet_changes_nothing():
    before = sent_as("exact")
    after = sent(("leader", "uav3", "uav1", "uav2"), **EVERYTHING)
    kept = [each[:, [1, 2, 0]][:, :, [0, 2, 3, 1]] for each in after[1:]]
    assert same(before, (None, *kept), slice(None))


def test_seed_decides_every_packet():
    before = sent_as("exact")
    assert same(before, sent(**EVERYTHING), slice(None))
    after = sent(**EVERYTHING, seed=2)
    for i in range(len(NAMES) - 1):
        for m in range(len(NAMES)):
            where = (slice(None), i, m)
            assert same(before, after, where) == (m == i + 1)


def test_outcomes_of_two_links_are_independent():
    """There and back, from one sender, to one receiver, and with another seed."""

    def lost(**how):
        return transmit(make(NAMES, **how, loss=0.3), packets=PACKETS // 4, period_s=0.1).outcome

    outcome, reseeded = lost(), lost(seed=2)
    here = outcome[HERE] > 0
    pairs = [outcome[:, 0, 2], outcome[:, 2, 1], outcome[:, 1, 0], reseeded[HERE]]
    for other in pairs:
        cells = [[np.sum((here == a) & ((other > 0) == b)) for b in (0, 1)] for a in (0, 1)]
        assert_chance(chi2_contingency(cells).pvalue)


# one link


def test_higher_loss_loses_the_same_packets_and_more():
    """So that runs with more loss can be compared packet by packet."""
    for arithmetic in ("exact", "netem"):
        few = send(5000, loss=0.1, arithmetic=arithmetic).lost
        many = send(5000, loss=0.3, arithmetic=arithmetic).lost
        assert (many | ~few).all()
        assert many.sum() > few.sum() > 0


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_loss_changes_no_delay_of_other_packets(arithmetic):
    keys = {
        "delay_s": 0.3,
        "jitter": {"spread_s": 0.05},
        "corrupt": 0.1,
        "arithmetic": arithmetic,
    }
    free, lossy = send(5000, **keys), send(5000, loss=0.4, **keys)
    assert 0.3 < lossy.lost.mean() < 0.5
    kept = ~lossy.lost
    assert np.array_equal(free.received_s[kept], lossy.received_s[kept], equal_nan=True)
    assert np.array_equal(free.outcome[kept], lossy.outcome[kept])


def with_outages(scripted, **keys):
    """Send messages on one link, of which some (K,) have an outcome by an outage."""
    return transmit(make(**keys), packets=len(scripted), period_s=0.1, scripted=scripted)


def received(run):
    """Return arrivals (K, 2) and outcomes (K,) on the link."""
    return np.stack([run.received_s, run.second_s], axis=-1)[:, 0, 0], run.outcome[:, 0, 0]


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize("outage", ["LISTED", "BLACKOUT", "PARTITION"])
def test_scripted_loss_changes_no_other_packet(outage, arithmetic):
    """Not even with correlations and a queue: the packet was sent, and had its place in both."""
    scripted = np.zeros(SOME, np.uint8)
    scripted[[0, 7, 100, 101, 102, 250]] = PacketOutcome[outage]
    keys = {**EVERYTHING, "arithmetic": arithmetic}
    before, outcome_before = received(with_outages(np.zeros(SOME, np.uint8), **keys))
    after, outcome_after = received(with_outages(scripted, **keys))
    hit = scripted > 0
    assert (outcome_after[hit] == PacketOutcome[outage]).all()
    assert np.isnan(after[hit]).all()
    assert np.isfinite(before).any()
    assert np.array_equal(before[~hit], after[~hit], equal_nan=True)
    assert np.array_equal(outcome_before[~hit], outcome_after[~hit])


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_muted_packets_change_no_later_random_numbers(arithmetic):
    """A muted aircraft's messages are numbered, and use their random numbers."""
    scripted = np.zeros(SOME, np.uint8)
    scripted[40:90] = PacketOutcome.MUTED
    for loss in (0.3, EVERYTHING["loss"], {"probability": 0.3, "correlation": 0.5}):
        keys = {
            "delay_s": 0.2,
            "jitter": {"spread_s": 0.02},
            "loss": loss,
            "duplicate": EVERYTHING["duplicate"],
            "arithmetic": arithmetic,
        }
        before, outcome_before = received(with_outages(np.zeros(SOME, np.uint8), **keys))
        after, outcome_after = received(with_outages(scripted, **keys))
        sent_at = scripted == 0
        assert (outcome_after[~sent_at] == PacketOutcome.MUTED).all()
        assert np.array_equal(outcome_before[sent_at], outcome_after[sent_at])
        assert np.array_equal(np.isnan(before)[sent_at], np.isnan(after)[sent_at])
        if arithmetic == "exact":  # netem draws again for a clone, and keeps the number
            assert np.array_equal(before[sent_at], after[sent_at], equal_nan=True)


def test_own_link_is_perfect():
    flight = sent(**{**EVERYTHING, "loss": 1.0})
    for i in range(len(NAMES) - 1):
        assert (flight.outcome[:, i, i + 1] == PacketOutcome.DELIVERED).all()
        assert np.array_equal(flight.received_s[:, i, i + 1], flight.sent_s[:, i + 1])
        assert (flight.copies[:, i, i + 1] == 1).all()
