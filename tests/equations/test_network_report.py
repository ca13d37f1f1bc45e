"""Numbers of links: by hand, and against the messages one by one."""

import json
import os

import numpy as np
import pytest

from testbed.network.ledger import BINS, LONGEST_BURST, bin_of, blank, edges
from testbed.network.links import Fate
from testbed.network.report import quantile, summarise, word
from testbed.scenario import load
from testbed.sim.sounding import sound

NAMES = ("leader", "uav1", "uav2")
PACKETS = int(os.environ.get("TESTBED_PACKETS", "2000"))
BIN = edges()[1] / edges()[0]  # a bin ends at this many times its beginning


def delivered(ledger, link, delays):
    """Write these delays (s) of delivered messages into a ledger."""
    ledger.fates[(*link, Fate.DELIVERED)] += len(delays)
    ledger.sent[link] += len(delays)
    ledger.delivered[link] += len(delays)
    ledger.delay_sum[link] += np.sum(delays)
    ledger.delay_least[link] = min(ledger.delay_least[link], *delays)
    ledger.delay_most[link] = max(ledger.delay_most[link], *delays)
    np.add.at(ledger.delays, (*link, bin_of(np.array(delays))), 1)


def test_links_are_by_sender_and_receiver_without_those_to_oneself():
    links = summarise(blank(2, 3), NAMES)["links"]
    assert {sender: list(to) for sender, to in links.items()} == {
        "leader": ["uav1", "uav2"],
        "uav1": ["uav2"],
        "uav2": ["uav1"],
    }


@pytest.mark.parametrize("n", [0, 2])
def test_of_nothing_sent_there_are_no_numbers(n):
    report = summarise(blank(n, n + 1), NAMES[: n + 1])
    assert report["all"] == {
        "sent": 0,
        "delivered": 0,
        "delivered_share": None,
        "lost": {},
        "mute": 0,
        "duplicated": 0,
        "overtaken": 0,
        "delay_s": None,
        "bursts": {"count": 0, "mean": None, "longest": 0, "lengths": {}},
        "age_s": None,
    }


# at the end of a bin, beside it, inside, in the first bin, in the last, and none at all
@pytest.mark.parametrize("delay", [0.1, 0.002, 0.128, np.nextafter(0.002, 1.0), 4e-4, 500.0, 0.0])
def test_a_constant_delay_is_exact(delay):
    ledger = blank(2, 3)
    delivered(ledger, (1, 0), [delay] * 77)
    report = summarise(ledger, NAMES)
    expected = dict.fromkeys(("mean", "min", "max", "p50", "p95", "p99"), delay)
    assert report["links"]["leader"]["uav2"]["delay_s"] == expected
    assert report["all"]["delay_s"] == expected
    assert report["links"]["leader"]["uav1"]["delay_s"] is None


def test_all_links_together_are_the_sum_of_each_less_those_to_oneself():
    ledger = blank(2, 3)
    delivered(ledger, (0, 0), [0.1, 0.3])
    delivered(ledger, (1, 1), [0.5])
    delivered(ledger, (0, 1), [9.0])  # uav1 to itself
    ledger.twice[1, 1], ledger.overtaken[0, 0], ledger.overtaken[1, 2] = 4, 5, 6
    ledger.fates[1, 1, Fate.QUEUE], ledger.fates[1, 1, Fate.MUTE] = 3, 2
    together = summarise(ledger, NAMES)["all"]
    assert (together["sent"], together["delivered"]) == (6, 3)
    assert together["delivered_share"] == 0.5
    assert (together["lost"], together["mute"]) == ({"queue": 3}, 2)
    assert (together["duplicated"], together["overtaken"]) == (4, 5)
    assert together["delay_s"]["mean"] == pytest.approx(0.3, rel=1e-15)
    assert (together["delay_s"]["min"], together["delay_s"]["max"]) == (0.1, 0.5)


def test_a_burst_that_goes_on_counts_as_long_as_it_is():
    ledger = blank(1, 2)
    ledger.bursts[0, 0, :2] = 3, 1
    ledger.missing[0, 0], ledger.longest[0, 0] = 2, 2
    ledger.fates[0, 0, Fate.LOST] = 3 + 2 + 2
    bursts = summarise(ledger, NAMES[:2])["links"]["leader"]["uav1"]["bursts"]
    assert bursts == {"count": 5, "mean": 7 / 5, "longest": 2, "lengths": {"1": 3, "2": 2}}


def test_the_longest_bursts_share_a_length_but_not_the_mean():
    ledger = blank(1, 2)
    ledger.bursts[0, 0, LONGEST_BURST - 1] = 1
    ledger.missing[0, 0], ledger.longest[0, 0] = 1000, 1000
    ledger.fates[0, 0, Fate.BLACKOUT] = 1080
    bursts = summarise(ledger, NAMES[:2])["all"]["bursts"]
    assert bursts == {"count": 2, "mean": 540.0, "longest": 1000, "lengths": {"64+": 2}}


def test_ages_are_of_what_was_used():
    ledger = blank(1, 2)
    ages = np.array([0.02, 0.04, 0.06, 0.2])
    ledger.uses[0, 0], ledger.age_sum[0, 0], ledger.age_most[0, 0] = 4, ages.sum(), ages.max()
    ledger.age_least[0, 0] = ages.min()
    np.add.at(ledger.ages[0, 0], bin_of(ages), 1)
    age = summarise(ledger, NAMES[:2])["links"]["leader"]["uav1"]["age_s"]
    assert age["mean"] == pytest.approx(0.08, rel=1e-15)
    assert (age["max"], age["uses"]) == (0.2, 4)
    assert 0.04 / BIN <= age["p50"] <= 0.04 * BIN
    assert 0.06 < age["p95"] <= 0.2


@pytest.mark.parametrize("part", [0.01, 0.5, 0.95, 0.99, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_quantile_is_within_its_bin_of_the_sorted_durations(part, seed):
    rng = np.random.default_rng(seed)
    durations = np.sort(0.05 * rng.lognormal(0.0, 1.5, 999))
    bins = np.bincount(bin_of(durations), minlength=BINS)
    got = quantile(bins, part, durations[0], durations[-1])
    exact = durations[int(np.ceil(part * 999)) - 1]
    assert exact / BIN <= got <= exact * BIN
    assert durations[0] <= got <= durations[-1]


def test_most_ages_of_none_make_a_median_of_none():
    durations = np.array([0.0] * 7 + [0.04] * 3)
    bins = np.bincount(bin_of(durations), minlength=BINS)
    assert quantile(bins, 0.5, 0.0, 0.04) == 0.0
    assert 0.04 / BIN <= quantile(bins, 0.95, 0.0, 0.04) <= 0.04


PAGES = {
    "exact": (
        "network.delay_s=0.05",
        "network.jitter={distribution: lognormal, spread_s: 0.05}",
        "network.loss={kind: gilbert-elliott, p: 0.05, r: 0.3, loss_bad: 0.9}",
        "network.duplicate=0.05",
        "network.corrupt=0.02",
        "network.mute_s={uav1: [[20, 24]]}",
        "network.blackout_s=[[60, 64]]",
        "network.drop=[0, 5, 6, 7]",
        "network.links={leader: {uav2: {loss: 0}}}",
    ),
    "netem": (
        "network.arithmetic=netem",
        "network.delay_s=0.1",
        "network.jitter={distribution: normal, spread_s: 0.04, correlation: 0.2}",
        "network.loss={probability: 0.2, correlation: 0.3}",
        "network.duplicate=0.1",
        "network.reorder={probability: 0.2, gap: 3}",
    ),
}


def test_a_message_is_overtaken_if_a_newer_one_came_before():
    page = load(
        "simulation-3",
        (
            "network.delay_s=0.2",
            "network.jitter={distribution: uniform, spread_s: 0.1}",
            "network.reorder=0.1",
            "network.loss=0.1",
        ),
    )
    sounding = sound(page, PACKETS, keep=True)
    for source, destinations in sounding.summary["links"].items():
        m = page.aircraft_names.index(source)
        for destination, link in destinations.items():
            came = sounding.heard.received_s[:, page.aircraft_names.index(destination) - 1, m]
            came = came[~np.isnan(came)]
            first_of_newer = np.minimum.accumulate(came[::-1])[::-1][1:]
            overtaken = (came[:-1] > first_of_newer).sum()
            assert overtaken > PACKETS // 20
            assert link["overtaken"] == overtaken


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_the_numbers_are_those_of_the_messages_one_by_one(page):
    heard_page = load("simulation-3", page)
    sounding = sound(heard_page, PACKETS, keep=True)
    names, heard = heard_page.aircraft_names, sounding.heard
    assert json.dumps(sounding.summary, allow_nan=False)
    for i, receiver in enumerate(names[1:]):
        for m, sender in enumerate(names):
            if m == i + 1:
                continue
            link = sounding.summary["links"][sender][receiver]
            fate, copies = heard.fate[:, i, m], heard.copies[:, i, m]
            there = fate == Fate.DELIVERED
            said = fate != Fate.MUTE
            assert link["sent"] == said.sum()
            assert link["delivered"] == there.sum()
            assert link["delivered_share"] == there.sum() / said.sum()
            losses = {fate for fate in Fate if fate not in (Fate.DELIVERED, Fate.MUTE)}
            counts = {word(each): int((fate == each).sum()) for each in losses}
            assert link["lost"] == {name: count for name, count in counts.items() if count}
            assert link["mute"] == (~said).sum()
            assert link["duplicated"] == (copies == 2).sum()

            delays = np.sort((heard.received_s[:, i, m] - heard.sent_s[:, m])[there])
            assert link["delay_s"]["mean"] == pytest.approx(delays.mean(), rel=1e-12)
            assert [link["delay_s"][end] for end in ("min", "max")] == [delays[0], delays[-1]]
            for name, part in (("p50", 0.5), ("p95", 0.95), ("p99", 0.99)):
                exact = delays[int(np.ceil(part * len(delays))) - 1]
                tolerance = max(exact * (BIN - 1.0), edges()[0])
                assert link["delay_s"][name] == pytest.approx(exact, abs=tolerance)

            runs = np.split(there[said], np.flatnonzero(np.diff(there[said])) + 1)
            lengths = [len(run) for run in runs if not run[0]]
            assert link["bursts"]["count"] == len(lengths)
            assert link["bursts"]["longest"] == max(lengths, default=0)
            if lengths:
                assert link["bursts"]["mean"] == pytest.approx(np.mean(lengths), rel=1e-12)
            for length in range(1, LONGEST_BURST):
                counted = link["bursts"]["lengths"].get(str(length), 0)
                assert counted == lengths.count(length)
            long = sum(length >= LONGEST_BURST for length in lengths)
            assert link["bursts"]["lengths"].get("64+", 0) == long
