"""Arithmetic netem against Linux's tc netem itself, between two network namespaces.

Both sides draw random numbers, those of the kernel anew each time. A claim is refuted when two
pairs of samples in a row differ at 1 %: by chance one claim in ten thousand is.
20 000 packets a sample; TESTBED_PACKETS=100000 sends more.
"""

import functools
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from link_loop import LinkLoop, make_settings
from netem_namespaces import HEADERS, netem, why_not
from reference.channel_simulation import transmit
from scipy import stats

from testbed.network.channel import make_channel
from testbed.network.delays import netem_table
from testbed.network.links import NETEM_TABLE, NORMAL, PARETO, PARETONORMAL, resolve_links
from testbed.scenario.network import Network

PACKETS = int(os.environ.get("TESTBED_PACKETS", "20000"))
LEVEL = 0.01
TRIES = 2
BLOCKS = 100  # of packets; what happens in one hardly depends on the one before
LONGEST_RUN = 5  # runs at least so long count as one kind
RARE = 20  # kinds of runs seen less often say nothing that is normally distributed
OVERTOOK = 0.025  # s, half of the delay of those that were not sent at once
TABLES = {"normal": NORMAL, "pareto": PARETO, "paretonormal": PARETONORMAL}
FOLDERS = [*Path("/usr").glob("lib*/tc"), *Path("/usr/lib").glob("*/tc"), Path("/usr/share/tc")]

with_netem = pytest.mark.usefixtures("kernel_with_netem")


@pytest.fixture(scope="module")
def kernel_with_netem():
    if missing := why_not():
        pytest.skip(missing)


def ours(knobs, *, packets=PACKETS, period_s=1e-4, seed=0):
    """What one link of ours does with packets."""
    network = Network.model_validate({"arithmetic": "netem", **knobs})
    channel = make_channel(resolve_links(("leader", "uav1"), network), seed)
    return transmit(channel, packets=packets, period_s=period_s)


def our_copies(knobs, seed):
    return ours(knobs, seed=seed).copies[:, 0, 0]


def our_delays(knobs, seed):
    sent = ours(knobs, seed=seed)
    return sent.received_s[:, 0, 0] - sent.sent_s[:, 0]


def agrees(chance_of):
    """The chance of such a difference between like samples, by a function of a seed."""
    chances = []
    for seed in range(TRIES):
        chances.append(chance_of(seed))
        if chances[-1] > LEVEL:
            return
    pytest.fail(f"differs from the kernel: chances {chances}")


def runs(events):
    """By block, how many runs of an event (K,) begin and how many of none, by length."""
    ends = np.flatnonzero(np.diff(events)) + 1
    begins, lengths = ends[:-1], np.minimum(np.diff(ends), LONGEST_RUN)
    counts = np.zeros((BLOCKS, 2, LONGEST_RUN + 1))
    block = begins * BLOCKS // len(events)
    np.add.at(counts, (block, events[begins].astype(int), lengths), 1.0)
    # of the long runs of none there are as many as of the rest, all but one
    return np.concatenate([counts[:, 1, 1:], counts[:, 0, 1:LONGEST_RUN]], axis=1)


def chance_of_likes(one, other):
    """Hotelling's test of the means of two samples (BLOCKS, features)."""
    common = (one.sum(axis=0) >= RARE) & (other.sum(axis=0) >= RARE)
    one, other = one[:, common], other[:, common]
    number, features = one.shape
    assert features
    apart = one.mean(axis=0) - other.mean(axis=0)
    spread = (np.cov(one.T) + np.cov(other.T)).reshape(features, features) / number
    squared = apart @ np.linalg.solve(spread, apart)
    rest = 2 * number - features - 1
    return stats.f.sf(squared * rest / (features * (2 * number - 2)), features, rest)


def behaviour(copies):
    """By block, losses and packets that came twice, with their runs (BLOCKS, features)."""
    return np.concatenate([runs(copies == 0), runs(copies == 2)], axis=1)


def from_netem(options, **how):
    with netem(*options.split()) as wire:
        return wire.send(**{"packets": PACKETS} | how)


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_those_of_iproute2(name):
    files = [folder / f"{name}.dist" for folder in FOLDERS]
    found = next((file for file in files if file.exists()), None)
    if found is None:
        pytest.skip("iproute2's tables are not installed")
    lines = found.read_text().splitlines()
    theirs = np.array(
        [int(word) for line in lines if not line.startswith("#") for word in line.split()]
    )
    table = netem_table(TABLES[name]).astype(int)
    assert table.shape == theirs.shape == (NETEM_TABLE,)
    # iproute2's program found its quantiles on a grid of 0.00005 and cut where it might round
    assert np.abs(table - theirs).max() <= 1


GEMODEL = {"kind": "gilbert-elliott", "p": 0.05, "r": 0.3, "loss_bad": 0.9, "loss_good": 0.02}
STATE = {"kind": "four-state", "p13": 0.05, "p31": 0.3, "p32": 0.1, "p23": 0.6, "p14": 0.02}
FATES = {
    "loss 30%": {"loss": 0.3},
    "loss 30% 50%": {"loss": {"probability": 0.3, "correlation": 0.5}},
    "loss gemodel 5% 30% 90% 2%": {"loss": GEMODEL},
    "loss state 5% 30% 10% 60% 2%": {"loss": STATE},
    "duplicate 20%": {"duplicate": 0.2},
    # tc keeps the correlation of duplicates to itself unless there is another one
    "loss 0% 1% duplicate 20% 50%": {"duplicate": {"probability": 0.2, "correlation": 0.5}},
    "duplicate 20% loss 30%": {"duplicate": 0.2, "loss": 0.3},
    "duplicate 20% loss gemodel 5% 30% 90% 2%": {"duplicate": 0.2, "loss": GEMODEL},
    "corrupt 20%": {"corrupt": 0.2},
    "corrupt 20% 50%": {"corrupt": {"probability": 0.2, "correlation": 0.5}},
    "corrupt 20% duplicate 20%": {"corrupt": 0.2, "duplicate": 0.2},
}
LONG = 1400  # bytes: where netem flips a bit of Ethernet's addresses UDP's checksum holds


@with_netem
@pytest.mark.parametrize("options", FATES)
def test_loss_rates_and_runs_equal_the_kernels(options):
    payload = LONG if "corrupt" in options else 100

    def chance(seed):
        theirs = from_netem(options, payload=payload).copies
        return chance_of_likes(behaviour(our_copies(FATES[options], seed)), behaviour(theirs))

    agrees(chance)


NUMBER = struct.Struct("<q")


def through_sockets(knobs, packets, seed):
    """Numbers of the packets that `testbed link` delivers between two programs, in their order."""
    settings = {"arithmetic": "netem", **knobs}
    given = [f"network.{key}={json.dumps(value)}" for key, value in settings.items()]
    link = make_settings("ends=[leader, uav1]", *given, seed=seed)
    with LinkLoop(link) as loop:
        arrived = loop.carry(map(NUMBER.pack, range(packets)))
        assert loop.emulator.summary()["emulator"]["unread"] == 0
    return np.array([NUMBER.unpack(each)[0] for each in arrived], dtype=int)


def test_link_between_programs_does_as_the_channel():
    """Which the other tests compare with the kernel: the same packets lost, and come twice."""
    knobs = {"duplicate": 0.2, "loss": GEMODEL, "corrupt": {"probability": 0.2}}
    found = np.bincount(through_sockets(knobs, 600, 3), minlength=600)
    channel = ours(knobs, packets=600, seed=3)
    np.testing.assert_array_equal(found, channel.copies[:, 0, 0])


@with_netem
@pytest.mark.parametrize("options", ["loss gemodel 5% 30% 90% 2%", "duplicate 20% loss 30%"])
def test_link_between_programs_loses_as_the_kernel(options):
    """Both are live: sockets through `testbed link`, and through the kernel's netem."""

    def chance(seed):
        found = through_sockets(FATES[options], PACKETS, seed)
        mine = np.bincount(found, minlength=PACKETS)
        return chance_of_likes(behaviour(mine), behaviour(from_netem(options).copies))

    agrees(chance)


@with_netem
def test_correlated_loss_of_25_percent_loses_7():
    """Blended half and half the words are Σ 2⁻ⁿ uₙ, below 1/4 with chance 5/72 (Fabius 1966)."""
    fabius = 5.0 / 72.0
    knobs = {"loss": {"probability": 0.25, "correlation": 0.5}}

    def chance(seed):
        chances = []
        for copies in (our_copies(knobs, seed), from_netem("loss 25% 50%").copies):
            losses = (copies == 0).reshape(BLOCKS, -1).mean(axis=1)
            chances.append(stats.ttest_1samp(losses, fabius).pvalue)
        return 2.0 * min(chances)

    agrees(chance)


OVERTAKING = {
    "delay 50ms reorder 25% gap 5": {"probability": 0.25, "gap": 5},
    "delay 50ms reorder 50% 50%": {"probability": 0.5, "correlation": 0.5},
    "delay 50ms reorder 40% 30% gap 3": {"probability": 0.4, "correlation": 0.3, "gap": 3},
}


@with_netem
@pytest.mark.parametrize("options", OVERTAKING)
def test_packets_overtake_as_often_and_as_far_apart(options):
    reorder = OVERTAKING[options]

    def chance(seed):
        mine = our_delays({"delay_s": 0.05, "reorder": reorder}, seed) < OVERTOOK
        theirs = from_netem(options).delays < OVERTOOK
        for overtook in (mine, theirs):
            assert np.diff(np.flatnonzero(overtook), prepend=-1).min() >= reorder.get("gap", 1)
        return chance_of_likes(spacings(mine), spacings(theirs))

    agrees(chance)


def spacings(events):
    """By block, how many events come so many packets after the one before."""
    at = np.flatnonzero(events)
    spaces = np.minimum(np.diff(at), 3 * LONGEST_RUN)
    counts = np.zeros((BLOCKS, 3 * LONGEST_RUN + 1))
    np.add.at(counts, (at[:-1] * BLOCKS // len(events), spaces), 1.0)
    return counts


JITTERS = {
    "delay 50ms 20ms": {"distribution": "uniform"},
    "delay 50ms 20ms 25%": {"distribution": "uniform", "correlation": 0.25},
    "delay 50ms 20ms distribution normal": {"distribution": "normal"},
    "delay 50ms 20ms 25% distribution normal": {"distribution": "normal", "correlation": 0.25},
    "delay 50ms 20ms distribution pareto": {"distribution": "pareto"},
    "delay 50ms 20ms distribution paretonormal": {"distribution": "paretonormal"},
}


@functools.cache
def lateness():
    """How much later than netem means this machine delivers, least and most, s; 1 % are beyond."""
    late = from_netem("delay 50ms").delays - 0.05
    assert late.min() >= 0.0
    return np.quantile(late, [0.01, 0.99])


def further(low, high):
    """The chance that delays of these two samples are so much, or more, greater in the second."""
    return stats.ks_2samp(low, high, alternative="greater", method="asymp").pvalue


@with_netem
@pytest.mark.parametrize("options", JITTERS)
def test_delay_distributions_equal_the_kernels(options):
    jitter = {"spread_s": 0.02, **JITTERS[options]}

    def chance(seed):
        mine = our_delays({"delay_s": 0.05, "jitter": jitter}, seed)
        theirs = from_netem(options).delays
        least, most = lateness()
        # the kernel's are late by at least the one and at most the other
        allowed = [further(theirs, mine + least), further(mine + most, theirs)]
        z = [np.arctanh(np.corrcoef(delays[1:], delays[:-1])[0, 1]) for delays in (mine, theirs)]
        deviation = np.sqrt(2.0 / PACKETS)
        alike = 2.0 * stats.norm.sf(abs(z[0] - z[1]) / deviation)
        none = 2.0 * stats.norm.sf(abs(z[1]) * np.sqrt(PACKETS))
        return 4.0 * min(*allowed, alike, none)

    agrees(chance)


def test_netem_removes_correlation_of_jitter():
    jitter = {"distribution": "normal", "spread_s": 0.02, "correlation": 0.25}
    for arithmetic, wanted in (("netem", 0.0), ("exact", 0.25)):
        knobs = {"delay_s": 0.2, "jitter": jitter, "arithmetic": arithmetic}
        delays = our_delays(knobs, 0)
        found = np.corrcoef(delays[1:], delays[:-1])[0, 1]
        assert abs(found - wanted) < 4.0 / np.sqrt(PACKETS)


RATE, OVERHEAD, PAYLOAD = 2e6, 20, 100


@with_netem
def test_transmitter_sends_packets_in_sequence():
    packets = 2000
    theirs = from_netem("rate 2mbit 20", packets=packets, payload=PAYLOAD)
    period = np.ptp(theirs.sent_s) / (packets - 1)
    service = 8.0 * (PAYLOAD + HEADERS + OVERHEAD) / RATE
    assert period < service
    rate = {"bit_per_s": RATE, "overhead_bytes": HEADERS + OVERHEAD, "queue_packets": packets}
    mine = ours(
        {"rate": rate, "message_bytes": PAYLOAD}, packets=packets, period_s=period
    ).received_s[:, 0, 0]
    np.testing.assert_allclose(mine, service * np.arange(1, packets + 1), atol=1e-9)
    # a sender that hesitates before packets pile up, and a timer, make the kernel's only later
    late = (theirs.at_s - mine).reshape(4, -1).min(axis=1)
    assert late.min() >= 0.0
    assert abs(late[3] - late[1]) < 0.5 * service  # in 1000 packets: a byte more would make 4 ms


@with_netem
def test_a_full_queue_drops_what_comes_last():
    packets, limit, bit_per_s = 200, 50, 1e5
    theirs = from_netem(f"limit {limit} rate 100kbit", packets=packets, payload=PAYLOAD)
    period = np.ptp(theirs.sent_s) / (packets - 1)
    rate = {"bit_per_s": bit_per_s, "overhead_bytes": HEADERS, "queue_packets": limit}
    knobs = {"rate": rate, "message_bytes": PAYLOAD}
    mine = ours(knobs, packets=packets, period_s=period).copies[:, 0, 0]
    both = mine, theirs.copies
    assert all((copies[:limit] == 1).all() for copies in both)
    served = packets * period * bit_per_s / (8.0 * (PAYLOAD + HEADERS))
    assert all(limit <= copies.sum() <= limit + np.ceil(served) for copies in both)


@with_netem
def test_two_copies_enter_the_last_place_of_a_queue():
    packets = 5
    theirs = from_netem("limit 1 rate 100kbit duplicate 100%", packets=packets, payload=PAYLOAD)
    rate = {"bit_per_s": 1e5, "overhead_bytes": HEADERS, "queue_packets": 1}
    knobs = {"rate": rate, "duplicate": 1, "message_bytes": PAYLOAD}
    period = np.ptp(theirs.sent_s) / (packets - 1)
    mine = ours(knobs, packets=packets, period_s=period).copies[:, 0, 0]
    assert mine.tolist() == theirs.copies.tolist() == [2, 0, 0, 0, 0]


@with_netem
def test_no_reordering_behind_a_busy_transmitter():
    packets = 2000
    theirs = from_netem("delay 50ms 20ms rate 2mbit", packets=packets, payload=PAYLOAD)
    rate = {"bit_per_s": RATE, "overhead_bytes": HEADERS, "queue_packets": packets}
    jitter = {"distribution": "uniform", "spread_s": 0.02}
    knobs = {"delay_s": 0.05, "jitter": jitter, "rate": rate, "message_bytes": PAYLOAD}
    mine = ours(knobs, packets=packets).received_s[:, 0, 0]
    assert (np.diff(theirs.number) > 0).all()
    assert (np.diff(mine) > 0).all()
    # without the transmitter it does
    assert (np.diff(from_netem("delay 50ms 20ms", packets=packets).number) < 0).any()


@with_netem
def test_slots_limit_packets_and_their_times():
    packets, every, room = 300, 0.002, 3
    theirs = from_netem(f"slot 2ms 2ms packets {room}", packets=packets).at_s
    slots = {"every_s": every, "first_s": every, "packets": room, "queue_packets": packets}
    mine = ours({"slots": slots}, packets=packets).received_s[:, 0, 0]
    for arrivals in (mine, theirs):
        begins = np.flatnonzero(np.diff(arrivals, prepend=-every) > 0.5 * every)
        sizes = np.diff(begins, append=packets)
        assert sizes.max() == np.median(sizes) == room
        # the kernel's slot follows the last packet of the one before, which is a little late
        assert every - 1e-9 <= np.median(np.diff(arrivals[begins])) < 1.1 * every


@pytest.mark.parametrize(
    ("one", "other"),
    [
        pytest.param({"loss": 0.3}, {"loss": 0.33}, id="3 % more losses"),
        pytest.param(
            {"loss": {"probability": 0.3, "correlation": 0.5}},
            {"loss": {"probability": 0.3, "correlation": 0.5}, "arithmetic": "exact"},
            id="exact correlation",
        ),
        pytest.param({"duplicate": 0.2, "loss": 0.3}, {"loss": 0.3}, id="no duplicates"),
    ],
)
def test_other_losses_are_found(one, other):
    def chance(seed):
        samples = our_copies(one, seed), our_copies(other, seed + TRIES)
        return chance_of_likes(*map(behaviour, samples))

    with pytest.raises(pytest.fail.Exception, match="differs from the kernel"):
        agrees(chance)


def test_other_overtaking_is_found():
    knobs = [{"delay_s": 0.05, "reorder": {"probability": 0.25, "gap": gap}} for gap in (5, 4)]

    def chance(seed):
        overtook = (our_delays(each, seed) < OVERTOOK for each in knobs)
        return chance_of_likes(*map(spacings, overtook))

    with pytest.raises(pytest.fail.Exception, match="differs from the kernel"):
        agrees(chance)


@pytest.mark.parametrize("change", [{"delay_s": 0.051}, {"spread_s": 0.022}])
def test_other_delays_are_found(change):
    """A millisecond or two more."""

    def delays(seed, delay_s=0.05, spread_s=0.02):
        jitter = {"distribution": "normal", "spread_s": spread_s}
        return our_delays({"delay_s": delay_s, "jitter": jitter}, seed)

    with pytest.raises(pytest.fail.Exception, match="differs from the kernel"):
        agrees(lambda seed: further(delays(seed), delays(seed + TRIES, **change)))
