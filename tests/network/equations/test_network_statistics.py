"""Numbers of links: by hand, and against the messages one by one."""

import json
import os

import numpy as np
import pytest
from reference.interpreted import interpreted

from testbed.network.link_statistics import (
    BINS,
    LONGEST_BURST,
    bin_ends,
    initial_statistics,
    outcome_name,
    quantile,
    record_ages,
    summarise,
)
from testbed.network.links import PacketOutcome
from testbed.probes.channel_probe import probe_channel
from testbed.scenario import load_scenario

NAMES = ("leader", "uav1", "uav2")
PACKETS = int(os.environ.get("TESTBED_PACKETS", "2000"))
BIN = bin_ends()[1] / bin_ends()[0]  # a bin ends at this many times its beginning


def delivered(statistics, link, delays):
    """Write these delays (s) of delivered messages into statistics."""
    statistics["outcomes"][(*link, PacketOutcome.DELIVERED)] += len(delays)
    statistics["delay_sum"][link] += np.sum(delays)
    statistics["delay_min"][link] = min(statistics["delay_min"][link], *delays)
    statistics["delay_max"][link] = max(statistics["delay_max"][link], *delays)
    np.add.at(statistics["delays"], (*link, bin_of(np.array(delays))), 1)


def bin_of(seconds):
    """Bins (...) of durations (...), s, by their ends."""
    return np.searchsorted(bin_ends(), seconds)


def test_summary_has_no_links_to_oneself():
    links = summarise(initial_statistics(2, 3), NAMES)["links"]
    assert {sender: list(to) for sender, to in links.items()} == {
        "leader": ["uav1", "uav2"],
        "uav1": ["uav2"],
        "uav2": ["uav1"],
    }


@pytest.mark.parametrize("n", [0, 2])
def test_summary_of_nothing_sent_is_null(n):
    report = summarise(initial_statistics(n, n + 1), NAMES[: n + 1])
    assert report["all"] == {
        "sent": 0,
        "delivered": 0,
        "delivered_share": None,
        "lost": {},
        "muted": 0,
        "duplicated": 0,
        "overtaken": 0,
        "delay_s": None,
        "bursts": {"count": 0, "mean": None, "longest": 0, "lengths": {}},
        "age_s": None,
    }


# at the end of a bin, beside it, inside, in the first bin, in the last, and none at all
@pytest.mark.parametrize("delay", [0.1, 0.002, 0.128, np.nextafter(0.002, 1.0), 4e-4, 500.0, 0.0])
def test_constant_delay_is_exact(delay):
    statistics = initial_statistics(2, 3)
    delivered(statistics, (1, 0), [delay] * 77)
    report = summarise(statistics, NAMES)
    expected = dict.fromkeys(("mean", "min", "max", "p50", "p95", "p99"), delay)
    assert report["links"]["leader"]["uav2"]["delay_s"] == expected
    assert report["all"]["delay_s"] == expected
    assert report["links"]["leader"]["uav1"]["delay_s"] is None


def test_all_links_are_the_sum_of_each():
    statistics = initial_statistics(2, 3)
    delivered(statistics, (0, 0), [0.1, 0.3])
    delivered(statistics, (1, 1), [0.5])
    delivered(statistics, (0, 1), [9.0])  # uav1 to itself
    statistics["duplicated"][1, 1] = 4
    statistics["overtaken"][0, 0], statistics["overtaken"][1, 2] = 5, 6
    statistics["outcomes"][1, 1, PacketOutcome.QUEUE] = 3
    statistics["outcomes"][1, 1, PacketOutcome.MUTED] = 2
    together = summarise(statistics, NAMES)["all"]
    assert (together["sent"], together["delivered"]) == (6, 3)
    assert together["delivered_share"] == 0.5
    assert (together["lost"], together["muted"]) == ({"queue": 3}, 2)
    assert (together["duplicated"], together["overtaken"]) == (4, 5)
    assert together["delay_s"]["mean"] == pytest.approx(0.3, rel=1e-15)
    assert (together["delay_s"]["min"], together["delay_s"]["max"]) == (0.1, 0.5)


def test_current_burst_counts_with_its_length():
    statistics = initial_statistics(1, 2)
    statistics["bursts"][0, 0, :2] = 3, 1
    statistics["burst"][0, 0], statistics["longest_burst"][0, 0] = 2, 2
    statistics["outcomes"][0, 0, PacketOutcome.LOST] = 3 + 2 + 2
    bursts = summarise(statistics, NAMES[:2])["links"]["leader"]["uav1"]["bursts"]
    assert bursts == {"count": 5, "mean": 7 / 5, "longest": 2, "lengths": {"1": 3, "2": 2}}


def test_longest_bursts_share_a_length_not_the_mean():
    statistics = initial_statistics(1, 2)
    statistics["bursts"][0, 0, LONGEST_BURST - 1] = 1
    statistics["burst"][0, 0], statistics["longest_burst"][0, 0] = 1000, 1000
    statistics["outcomes"][0, 0, PacketOutcome.BLACKOUT] = 1080
    bursts = summarise(statistics, NAMES[:2])["all"]["bursts"]
    assert bursts == {"count": 2, "mean": 540.0, "longest": 1000, "lengths": {"64+": 2}}


def test_ages_are_those_of_uses():
    statistics = initial_statistics(1, 2)
    ages = np.array([0.02, 0.04, 0.06, 0.2])
    link = statistics[0, 0]
    link["uses"], link["age_sum"] = 4, ages.sum()
    link["age_min"], link["age_max"] = ages.min(), ages.max()
    np.add.at(statistics["ages"][0, 0], bin_of(ages), 1)
    age = summarise(statistics, NAMES[:2])["links"]["leader"]["uav1"]["age_s"]
    assert age["mean"] == pytest.approx(0.08, rel=1e-15)
    assert (age["max"], age["uses"]) == (0.2, 4)
    assert 0.04 / BIN <= age["p50"] <= 0.04 * BIN
    assert 0.06 < age["p95"] <= 0.2


def test_ages_are_recorded_of_the_rows_that_use_them():
    rng, statistics = np.random.default_rng(6), initial_statistics(3, 4)
    used = [[[] for _ in range(4)] for _ in range(3)]
    for _ in range(100):
        rows = np.flatnonzero(rng.random(3) < 0.7)
        age_s = np.where(rng.random((3, 4)) < 0.3, np.nan, rng.gamma(1.0, 0.1, (3, 4)))
        _record_ages(statistics, rows, age_s)
        for i, m in np.argwhere(~np.isnan(age_s)).tolist():
            if i in rows:
                used[i][m].append(age_s[i, m])
    for i, m in np.ndindex(3, 4):
        link, ages = statistics[i, m], np.array(used[i][m])
        assert link["uses"] == len(ages) > 0
        assert link["age_sum"] == pytest.approx(ages.sum(), rel=1e-12)
        assert (link["age_min"], link["age_max"]) == (ages.min(), ages.max())
        assert np.array_equal(link["ages"], np.bincount(bin_of(ages), minlength=BINS))


@interpreted
def _record_ages(statistics, rows, age_s):
    record_ages(statistics, rows, age_s)


@pytest.mark.parametrize("part", [0.01, 0.5, 0.95, 0.99, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_quantile_is_within_its_bin(part, seed):
    rng = np.random.default_rng(seed)
    durations = np.sort(0.05 * rng.lognormal(0.0, 1.5, 999))
    bins = np.bincount(bin_of(durations), minlength=BINS)
    got = quantile(bins, part, durations[0], durations[-1])
    exact = durations[int(np.ceil(part * 999)) - 1]
    assert exact / BIN <= got <= exact * BIN
    assert durations[0] <= got <= durations[-1]


def test_median_of_zeros_is_zero():
    durations = np.array([0.0] * 7 + [0.04] * 3)
    bins = np.bincount(bin_of(durations), minlength=BINS)
    assert quantile(bins, 0.5, 0.0, 0.04) == 0.0
    assert 0.04 / BIN <= quantile(bins, 0.95, 0.0, 0.04) <= 0.04


SCENARIOS = {
    "exact": (
        "network.delay_s=0.05",
        "network.jitter={distribution: lognormal, spread_s: 0.05}",
        "network.loss={kind: gilbert-elliott, p: 0.05, r: 0.3, loss_bad: 0.9}",
        "network.duplicate=0.05",
        "network.corrupt=0.02",
        "network.transmitter_off_s={uav1: [[20, 24]]}",
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


def test_overtaken_counts_older_after_newer():
    scenario = load_scenario(
        "simulation-3",
        (
            "network.delay_s=0.2",
            "network.jitter={distribution: uniform, spread_s: 0.1}",
            "network.reorder=0.1",
            "network.loss=0.1",
        ),
    )
    probe = probe_channel(scenario, PACKETS, record=True)
    for source, destinations in probe.summary["links"].items():
        m = scenario.aircraft_names.index(source)
        for destination, link in destinations.items():
            came = probe.messages.received_s[:, scenario.aircraft_names.index(destination) - 1, m]
            came = came[~np.isnan(came)]
            first_of_newer = np.minimum.accumulate(came[::-1])[::-1][1:]
            overtaken = (came[:-1] > first_of_newer).sum()
            assert overtaken > PACKETS // 20
            assert link["overtaken"] == overtaken


@pytest.mark.parametrize("overrides", SCENARIOS.values(), ids=SCENARIOS)
def test_summary_matches_the_messages_one_by_one(overrides):
    scenario = load_scenario("simulation-3", overrides)
    probe = probe_channel(scenario, PACKETS, record=True)
    names, messages = scenario.aircraft_names, probe.messages
    assert json.dumps(probe.summary, allow_nan=False)
    for i, receiver in enumerate(names[1:]):
        for m, sender in enumerate(names):
            if m == i + 1:
                continue
            link = probe.summary["links"][sender][receiver]
            outcome, copies = messages.outcome[:, i, m], messages.copies[:, i, m]
            there = outcome == PacketOutcome.DELIVERED
            sent = outcome != PacketOutcome.MUTED
            assert link["sent"] == sent.sum()
            assert link["delivered"] == there.sum()
            assert link["delivered_share"] == there.sum() / sent.sum()
            losses = set(PacketOutcome) - {PacketOutcome.DELIVERED, PacketOutcome.MUTED}
            counts = {outcome_name(each): int((outcome == each).sum()) for each in losses}
            assert link["lost"] == {name: count for name, count in counts.items() if count}
            assert link["muted"] == (~sent).sum()
            assert link["duplicated"] == (copies == 2).sum()

            delays = np.sort((messages.received_s[:, i, m] - messages.sent_s[:, m])[there])
            assert link["delay_s"]["mean"] == pytest.approx(delays.mean(), rel=1e-12)
            assert [link["delay_s"][end] for end in ("min", "max")] == [delays[0], delays[-1]]
            for name, part in (("p50", 0.5), ("p95", 0.95), ("p99", 0.99)):
                exact = delays[int(np.ceil(part * len(delays))) - 1]
                tolerance = max(exact * (BIN - 1.0), bin_ends()[0])
                assert link["delay_s"][name] == pytest.approx(exact, abs=tolerance)

            runs = np.split(there[sent], np.flatnonzero(np.diff(there[sent])) + 1)
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
