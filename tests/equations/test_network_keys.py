"""Dice belong to a link and a number: nothing that is set or said elsewhere moves them."""

import numpy as np
import pytest
from network_samples import PACKETS, assert_chance, make, send
from scipy.stats import chi2_contingency

from testbed.network.alone import transmit
from testbed.network.fates import BEFALL
from testbed.network.links import Fate
from testbed.network.traffic import idle

NAMES = ("leader", "uav1", "uav2", "uav3")
SOURCE, DESTINATION = 1, 1  # uav1 to uav2
HERE = (slice(None), DESTINATION, SOURCE)
SOME = 300
# A channel on which everything happens.
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
KNOBS = {
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


def sent(names=NAMES, seed=None, **knobs):
    return transmit(make(names, seed, **knobs), packets=SOME, period_s=0.1)


def same(ours, theirs, where):
    """Whether all that happened is the same to the bit."""
    return all(
        np.array_equal(a[where], b[where], equal_nan=True)
        for a, b in zip(ours[1:], theirs[1:], strict=True)
    )


def others():
    """Every link but the one from uav1 to uav2."""
    chosen = np.ones((len(NAMES) - 1, len(NAMES)), dtype=bool)
    chosen[DESTINATION, SOURCE] = False
    return slice(None), chosen


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize("knob", KNOBS)
def test_another_setting_of_one_link_is_nothing_to_any_other(knob, arithmetic):
    common = {**EVERYTHING, "arithmetic": arithmetic}
    before = sent(**common)
    assert len(np.unique(before.fate)) > 3  # of what can happen much does
    for value in KNOBS[knob]:
        after = sent(**common, links={"uav1": {"uav2": {knob: value}}})
        assert same(before, after, others()), value
        assert not same(before, after, HERE), value


def test_the_other_arithmetic_on_one_link_is_nothing_to_any_other():
    before = sent(**EVERYTHING)
    after = sent(**EVERYTHING, links={"uav1": {"uav2": {"arithmetic": "netem"}}})
    assert same(before, after, others())
    assert not same(before, after, HERE)


def test_one_more_aircraft_is_nothing_to_the_others():
    """Wherever in the list it comes."""
    before = sent(**EVERYTHING)
    for at in (1, 2, 4):
        names = [*NAMES[:at], "new", *NAMES[at:]]
        after = sent(names, **EVERYTHING)
        rows = [names.index(name) for name in NAMES]
        kept = [each[:, [row - 1 for row in rows[1:]]][:, :, rows] for each in after[1:]]
        assert same(before, (None, *kept), slice(None))


def test_another_order_of_the_fleet_is_the_same_fleet():
    before = sent(**EVERYTHING)
    after = sent(("leader", "uav3", "uav1", "uav2"), **EVERYTHING)
    kept = [each[:, [1, 2, 0]][:, :, [0, 2, 3, 1]] for each in after[1:]]
    assert same(before, (None, *kept), slice(None))


def test_the_same_seed_is_the_same_to_the_bit_and_another_is_not():
    before = sent(**EVERYTHING)
    assert same(before, sent(**EVERYTHING), slice(None))
    after = sent(**EVERYTHING, seed=2)
    for i in range(len(NAMES) - 1):
        for m in range(len(NAMES)):
            where = (slice(None), i, m)
            assert same(before, after, where) == (m == i + 1)


def test_fates_of_two_links_have_nothing_to_do_with_another():
    """There and back, from one sender, to one receiver, and with another seed."""

    def lost(**how):
        return transmit(make(NAMES, **how, loss=0.3), packets=PACKETS // 4, period_s=0.1).fate

    fate, reseeded = lost(), lost(seed=2)
    here = fate[HERE] > 0
    pairs = [fate[:, 0, 2], fate[:, 2, 1], fate[:, 1, 0], reseeded[HERE]]
    for other in pairs:
        cells = [[np.sum((here == a) & ((other > 0) == b)) for b in (0, 1)] for a in (0, 1)]
        assert_chance(chi2_contingency(cells).pvalue)


# one link


def test_a_higher_probability_loses_the_same_packets_and_more():
    """So that runs with more loss can be compared packet by packet."""
    for arithmetic in ("exact", "netem"):
        few = send(5000, loss=0.1, arithmetic=arithmetic).lost
        many = send(5000, loss=0.3, arithmetic=arithmetic).lost
        assert (many | ~few).all()
        assert many.sum() > few.sum() > 0


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_loss_moves_no_delay_of_what_arrives(arithmetic):
    knobs = {
        "delay_s": 0.3,
        "jitter": {"spread_s": 0.05},
        "corrupt": 0.1,
        "arithmetic": arithmetic,
    }
    free, lossy = send(5000, **knobs), send(5000, loss=0.4, **knobs)
    assert 0.3 < lossy.lost.mean() < 0.5
    kept = ~lossy.lost
    assert np.array_equal(free.received_s[kept], lossy.received_s[kept], equal_nan=True)
    assert np.array_equal(free.fate[kept], lossy.fate[kept])


def scripted(script, **knobs):
    """Arrivals (K, 2) and fates (K,) of one link whose packets have these scripted fates (K,)."""
    channel = make(**knobs)
    traffic, row = idle(channel), np.array([0])
    untold, fading = np.full((1, 1), np.nan), np.zeros((1, 1))
    arrivals, fate = np.empty((len(script), 2)), np.empty(len(script), np.uint8)
    for k, said in enumerate(script):
        one = np.array([[said]], dtype=np.uint8)
        both, became = np.empty((1, 1, 2)), np.empty((1, 1), np.uint8)
        sending = row, np.array([k]), np.array([0.1 * k])
        BEFALL(channel, traffic, *sending, one, untold, fading, both, became)
        arrivals[k], fate[k] = both[0, 0], became[0, 0]
    return arrivals, fate


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize("said", [Fate.LISTED, Fate.BLACKOUT, Fate.PARTITION])
def test_a_scripted_loss_changes_no_other_packet(said, arithmetic):
    """Not even with correlations and a queue: it was sent, and it had its place in both."""
    script = np.zeros(SOME, np.uint8)
    script[[0, 7, 100, 101, 102, 250]] = said
    knobs = {**EVERYTHING, "arithmetic": arithmetic}
    before, fate_before = scripted(np.zeros(SOME, np.uint8), **knobs)
    after, fate_after = scripted(script, **knobs)
    hit = script > 0
    assert (fate_after[hit] == said).all()
    assert np.isinf(after[hit]).all()
    assert np.isfinite(before).any()
    assert np.array_equal(before[~hit], after[~hit])
    assert np.array_equal(fate_before[~hit], fate_after[~hit])


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_silence_moves_no_loss_and_no_second_copy(arithmetic):
    """A mute sender's numbers count on, and so do the dice of them."""
    script = np.zeros(SOME, np.uint8)
    script[40:90] = Fate.MUTE
    for loss in (0.3, EVERYTHING["loss"], {"probability": 0.3, "correlation": 0.5}):
        knobs = {
            "delay_s": 0.2,
            "jitter": {"spread_s": 0.02},
            "loss": loss,
            "duplicate": EVERYTHING["duplicate"],
            "arithmetic": arithmetic,
        }
        before, fate_before = scripted(np.zeros(SOME, np.uint8), **knobs)
        after, fate_after = scripted(script, **knobs)
        sent_at = script == 0
        assert (fate_after[~sent_at] == Fate.MUTE).all()
        assert np.array_equal(fate_before[sent_at], fate_after[sent_at])
        assert np.array_equal(np.isinf(before)[sent_at], np.isinf(after)[sent_at])
        if arithmetic == "exact":  # netem asks again for a clone, and remembers
            assert np.array_equal(before[sent_at], after[sent_at])


def test_the_own_link_is_perfect_whatever_is_set():
    flight = sent(**{**EVERYTHING, "loss": 1.0})
    for i in range(len(NAMES) - 1):
        assert (flight.fate[:, i, i + 1] == Fate.DELIVERED).all()
        assert np.array_equal(flight.received_s[:, i, i + 1], flight.sent_s[:, i + 1])
        assert (flight.copies[:, i, i + 1] == 1).all()
