"""The kernels of the network against the numpy reference, on random links and broadcasts.

TESTBED_PACKETS doubles the broadcasts.
"""

import os

import numpy as np
import pytest
from reference import network_queue
from reference.adapters_network import KernelChannel
from reference.network_outcomes import initial_states, packet_outcomes

from testbed.core.compile import entry
from testbed.core.records import Broadcast
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.link_statistics import LINK_STATISTICS, initial_statistics, record_ages
from testbed.network.links import PacketOutcome, resolve_links
from testbed.network.radio import Radio
from testbed.scenario.network import Network, StampClock

NAMES = ("leader", "uav1", "uav2", "uav3", "uav4")
N = len(NAMES)
BROADCASTS = 250 if "TESTBED_PACKETS" in os.environ else 120
PERIOD = 0.1
# The two take logarithms and the like from other libraries: 1e-16, which the quantile of Pareto's
# law and an hour of flight magnify. The times are of the order of a second.
TOLERANCE = 1e-9


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("delays"), np.random.default_rng(9)
    paths = [folder / f"delays{k}.csv" for k in range(2)]
    for path in paths:
        samples = "\n".join(map(repr, rng.gamma(2.0, 0.03, 50).tolist()))
        path.write_text(f"delay_s\n{samples}\n", encoding="utf-8")
    return [str(path) for path in paths]


def random_link(rng, files):
    """Return a link with some of everything."""

    def probability():
        return float(rng.choice([0.0, 1.0, *rng.uniform(0.0, 0.5, 6)]))

    def event():
        return {"probability": probability(), "correlation": float(rng.choice([0.0, 0.5, 0.95]))}

    def one_of(*choices):
        return choices[rng.integers(len(choices))]

    kind = one_of("uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical")
    jitter = {"distribution": kind, "correlation": float(rng.choice([0.0, 0.3, 0.8]))}
    jitter |= {"file": one_of(*files)} if kind == "empirical" else {"spread_s": rng.uniform(0, 0.1)}
    jitter["in_order"] = bool(rng.random() < 0.3)
    low = rng.uniform(0.02, 0.2)
    every = one_of(low, [low, low + rng.uniform(0.0, 0.2)])
    keys = {
        "delay_s": rng.uniform(0.1, 0.4),
        "jitter": jitter,
        "loss": one_of(
            event(),
            {
                "kind": "gilbert-elliott",
                **dict(zip(("p", "r", "loss_bad", "loss_good"), rng.random(4), strict=True)),
            },
            {
                "kind": "four-state",
                **dict(zip(("p13", "p31", "p32", "p23", "p14"), rng.random(5) / 2, strict=True)),
            },
        ),
        "duplicate": event(),
        "corrupt": event(),
        "reorder": {**event(), "gap": int(rng.integers(1, 5))},
        "rate": {
            "bit_per_s": rng.uniform(4000, 20000),
            "queue_packets": int(rng.integers(1, 8)),
        },
        "slots": {
            "every_s": every,
            "first_s": rng.uniform(0.0, 0.5),
            "packets": int(rng.integers(1, 3)),
            "queue_packets": int(rng.integers(1, 8)),
        },
        "arithmetic": one_of("exact", "netem"),
    }
    kept = [key for key in keys if key in ("delay_s", "arithmetic") or rng.random() < 0.6]
    return {key: keys[key] for key in kept}


def random_channel(rng, files, *, subscribed=None, **common):
    links = {
        sender: {receiver: random_link(rng, files) for receiver in NAMES[1:] if receiver != sender}
        for sender in NAMES
    }
    if "tdma" in common:
        for receivers in links.values():
            for link in receivers.values():
                link.pop("slots", None)
    network = Network.model_validate({"links": links, **common})
    return make_channel(resolve_links(NAMES, network), int(rng.integers(1000)), subscribed)


def broadcasts(rng, conditions):
    """Yield arguments of `packet_outcomes`, with outages, traces and fading if wanted."""
    numbers, clock = np.zeros(N, dtype=np.int64), rng.uniform(0.0, PERIOD, N)
    traced = rng.random((N - 1, N)) < (0.3 if conditions else 0.0)
    fading = rng.random((N - 1, N)) * rng.integers(0, 2, (N - 1, N))
    outages = [int(each) for each in PacketOutcome if each.name in ("BLACKOUT", "LISTED", "MUTED")]
    for _ in range(BROADCASTS):
        rows = np.flatnonzero(rng.random(N) < 0.8)
        shape = (N - 1, len(rows))
        scripted = np.where(rng.random(shape) < 0.1, rng.choice(outages, shape), 0)
        delay = np.where(rng.random(shape) < 0.3, np.inf, rng.uniform(0.0, 0.5, shape))
        delay = np.where(traced[:, rows], delay, np.nan)
        yield (
            *(rows, numbers[rows].copy(), clock[rows].copy()),
            *(scripted.astype(np.uint8), delay, fading[:, rows]),
        )
        numbers[rows] += 1
        clock += PERIOD * rng.uniform(0.5, 1.5, N)


def compare(channel, rng, conditions=True):
    """Send by kernels and reference; return how often each outcome occurred."""
    kernel, states = KernelChannel(channel), initial_states(channel)
    seen = np.zeros(len(PacketOutcome), int)
    for sending in broadcasts(rng, conditions):
        arrivals, outcomes = kernel.packet_outcomes(*sending)
        expected, why = packet_outcomes(channel, states, *sending)
        np.testing.assert_array_equal(outcomes, why)
        np.testing.assert_allclose(arrivals, expected, rtol=0.0, atol=TOLERANCE)
        rows = sending[0]
        corrupted, theirs = (each.corrupted_s[:, rows] for each in (kernel, states))
        np.testing.assert_allclose(corrupted, theirs, rtol=0.0, atol=TOLERANCE)
        # a corrupted copy is never received too, and decides the outcome if it is the only one
        assert not (np.isfinite(corrupted) & np.isfinite(arrivals)).any()
        hit = np.isfinite(corrupted).any(axis=2)
        assert hit[outcomes == PacketOutcome.CORRUPTED].all()
        seen += np.bincount(outcomes.ravel(), minlength=len(seen))
        for name in states.state.dtype.names:
            ours, expected = kernel.links["state"][name], states.state[name]
            if expected.dtype.kind == "f":
                np.testing.assert_allclose(ours, expected, rtol=TOLERANCE, atol=TOLERANCE)
            else:
                np.testing.assert_array_equal(ours, expected, err_msg=name)
    np.testing.assert_allclose(kernel.departures_s, states.departures_s, rtol=0.0, atol=TOLERANCE)
    return seen


@pytest.mark.parametrize("case", range(6))
def test_random_links_match_reference(case, files):
    rng = np.random.default_rng([50, case])
    seen = compare(random_channel(rng, files), rng)
    for name in ("DELIVERED", "LOST", "FADED", "CORRUPTED", "QUEUE", "MUTED"):
        assert seen[PacketOutcome[name]] > 20, name


@pytest.mark.parametrize("case", range(2))
def test_unsubscribed_links_match_reference(case, files):
    rng = np.random.default_rng([55, case])
    subscribed = rng.random((N - 1, N)) < 0.6
    seen = compare(random_channel(rng, files, subscribed=subscribed), rng)
    assert min(seen[PacketOutcome.UNSUBSCRIBED], seen[PacketOutcome.DELIVERED]) > 100


@pytest.mark.parametrize("case", range(2))
def test_tdma_slots_match_reference(case, files):
    rng = np.random.default_rng([60, case])
    tdma = {"frame_s": 0.15, "packets": case + 1, "queue_packets": 3}
    seen = compare(random_channel(rng, files, tdma=tdma), rng, conditions=False)
    assert seen[PacketOutcome.DELIVERED] > 500
    assert seen[PacketOutcome.QUEUE] > 20


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize(
    "distribution", ["uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical"]
)
def test_distributions_match_reference(distribution, arithmetic, files):
    spread = {"file": files[0]} if distribution == "empirical" else {"spread_s": 0.02}
    jitter = {"distribution": distribution, "correlation": 0.5, **spread}
    network = Network.model_validate(
        {"delay_s": 0.1, "jitter": jitter, "arithmetic": arithmetic, "duplicate": 0.2}
    )
    channel, rng = make_channel(resolve_links(NAMES, network), 3), np.random.default_rng(70)
    assert compare(channel, rng, conditions=False)[PacketOutcome.DELIVERED] > 500


def test_trace_loss_does_not_stop_later_packets():
    """In either arithmetic: duplicates and queues after a packet that the trace loses."""
    for arithmetic in ("exact", "netem"):
        rate = {"bit_per_s": 80_000, "queue_packets": 3}
        keys = {"duplicate": 1.0, "rate": rate, "arithmetic": arithmetic}
        channel = make_channel(resolve_links(("leader", "uav1"), Network.model_validate(keys)), 1)
        kernel = KernelChannel(channel)
        for k in range(20):
            lost = k % 5 == 2
            delay = np.inf if lost else 0.04
            arrivals, outcome = kernel.packet_outcomes([0], [k], 0.1 * k, 0, delay, 0.0)
            assert outcome == (PacketOutcome.LOST if lost else PacketOutcome.DELIVERED)
            assert np.isfinite(arrivals).sum() == (0 if lost else 2)


# queue, statistics, clocks

CLOCKS = {
    "leader": StampClock(offset_s=0.5, drift_ppm=100.0),
    "uav1": StampClock(offset_s=-0.25, resolution_s=0.1),
    "uav3": StampClock(resolution_s=0.003),
}
LINKS = {
    "delay_s": 0.1,
    "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.3},
    "duplicate": 0.2,
    "corrupt": 0.1,
    "jitter": {"distribution": "pareto", "spread_s": 0.05},
    "rate": {"bit_per_s": 30000, "queue_packets": 2},
}


def test_radio_matches_reference():
    """What is received, the stamps and all statistics, from the same packets."""
    rng, clocks = np.random.default_rng(5), make_clocks(NAMES, CLOCKS)
    channel = make_channel(resolve_links(NAMES, Network.model_validate(LINKS)), 1)
    radio = Radio(channel, clocks=clocks)
    queue, numbers = network_queue.Queue(N - 1, N), np.full(N, -1)
    plain = np.stack([clocks[name] for name in ("offset", "drift", "resolution")], axis=1)
    for k in range(300):
        now, senders = 0.04 * k, rng.random(N) < 0.8
        rows, sent_s = np.flatnonzero(senders), now + 0.01 * rng.random(N)
        message = Broadcast(np.full(N, now), *rng.normal(0.0, 50.0, (5, N, 3)))
        packets = radio.send(sent_s, message, None, senders)[:, rows]
        numbers[rows] += 1
        queue.send(
            *(rows, numbers[rows], sent_s[rows]),
            *(network_queue.stamps(plain, message.stamp_s, rows), message),
            *(packets["arrival_s"], packets["outcome"]),
        )
        inbox = radio.deliver(now)
        queue.deliver(now)
        known = ~np.isnan(inbox.stamp_s)
        assert set(queue.newest) == {tuple(link) for link in np.argwhere(known).tolist()}
        for link, (number, arrival_s, content_s, stamp_s, vectors) in queue.newest.items():
            assert radio.links["number"][link] == number
            assert (inbox.received_s[link], radio.links["measured_s"][link]) == (
                arrival_s,
                content_s,
            )
            assert inbox.stamp_s[link] == stamp_s
            assert np.array_equal([each[link] for each in inbox[2:]], vectors)
    assert_same_statistics(radio.statistics, queue.statistics)
    assert np.array_equal(radio.links["sent"], queue.sent)
    assert np.array_equal(radio.links["delivered"], queue.delivered)
    assert queue.statistics["overtaken"].any()
    assert queue.statistics["duplicated"].any()


def assert_same_statistics(ours, expected):
    for name in LINK_STATISTICS.names:
        np.testing.assert_allclose(ours[name], expected[name], rtol=1e-12, err_msg=name)


def test_message_ages_match_reference():
    rng = np.random.default_rng(6)
    ours, expected = initial_statistics(3, 4), initial_statistics(3, 4)
    for _ in range(100):
        rows = np.flatnonzero(rng.random(3) < 0.7)
        age_s = np.where(rng.random((3, 4)) < 0.3, np.nan, rng.gamma(1.0, 0.1, (3, 4)))
        _record_ages(ours, rows, age_s)
        network_queue.count_ages(expected, rows, age_s)
    assert ours["uses"].all()
    assert_same_statistics(ours, expected)


@entry
def _record_ages(statistics, rows, age_s):
    record_ages(statistics, rows, age_s)
