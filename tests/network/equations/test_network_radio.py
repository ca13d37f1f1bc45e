"""The radio: what is received when on which link, what replaces what, what is counted."""

import contextlib
import io
import os
import subprocess
import sys
import warnings

import numpy as np
import pytest
from cases import in_full
from places import ROOT

from testbed.core.records import Broadcast, Messages
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.link_statistics import bin_ends, bin_of
from testbed.network.links import PacketOutcome, resolve_links
from testbed.network.radio import ExtraLosses, Radio
from testbed.scenario.network import Network, StampClock

NAMES = ("leader", "uav1", "uav2")
N, FOLLOWERS = 3, 2
PERIOD = 0.04
OWN = np.array([[False, True, False], [False, False, True]])


def broadcast(now, mark=None):
    """Make a broadcast of all aircraft whose numbers identify the sender and the broadcast."""
    mark = round(now / PERIOD) if mark is None else mark
    vectors = mark * 1000.0 + np.arange(5 * N * 3, dtype=float).reshape(5, N, 3)
    return Broadcast(np.full(N, now), *vectors)


def radio(delay_s=0.0, *, losses=None, clocks=None, **more):
    """Make a radio with one delay for all links, or one for each (follower, aircraft)."""
    delays = np.broadcast_to(delay_s, (FOLLOWERS, N))
    links = {
        name: {NAMES[i + 1]: {"delay_s": float(delays[i, m])} for i in range(FOLLOWERS)}
        for m, name in enumerate(NAMES)
    }
    network = Network.model_validate({"links": links, **more})
    return Radio(make_channel(resolve_links(NAMES, network), 1), losses, clocks=clocks)


def by_trace(*delays):
    """Make a trace that gives each broadcast a delay of its own."""
    rounds = iter(delays)
    return ExtraLosses(trace=lambda sent_s, rows: np.full((FOLLOWERS, len(rows)), next(rounds)))


def exchange(link, until, period=PERIOD):
    """Yield the inboxes after each tick of an exchange with one broadcast a tick."""
    for k in range(until + 1):
        now = k * period
        link.send(np.full(N, now), broadcast(now), None)
        yield now, link.deliver(now)


def assert_is_round(inbox, k, now_received, where=~OWN):
    """All of the chosen links hold broadcast k."""
    expected = broadcast(k * PERIOD)
    stamps = np.broadcast_to(expected.stamp_s, (FOLLOWERS, N))
    assert inbox.stamp_s[where] == pytest.approx(stamps[where], abs=0)
    assert inbox.received_s[where] == pytest.approx(now_received, abs=1e-12)
    for name in Broadcast._fields[1:]:
        sent = np.broadcast_to(getattr(expected, name), (FOLLOWERS, N, 3))
        assert np.array_equal(getattr(inbox, name)[where], sent[where]), name


def test_inbox_is_nan_before_the_first_message():
    for array in radio().deliver(0.0):
        assert np.isnan(array).all()


def test_no_delay_delivers_at_the_same_tick():
    for k, (now, inbox) in enumerate(exchange(radio(), 50)):
        assert_is_round(inbox, k, now, np.full((FOLLOWERS, N), True))


@pytest.mark.parametrize("periods", [1, 2, 25])
def test_delay_of_whole_periods_is_exact(periods):
    # k·0.04 + delay and (k + periods)·0.04 differ in binary; both mean the same tick
    for k, (now, inbox) in enumerate(exchange(radio(periods * PERIOD), 300)):
        if k < periods:
            assert np.isnan(inbox.stamp_s[~OWN]).all()
        else:
            assert_is_round(inbox, k - periods, now)


def test_delay_between_ticks_delivers_at_the_next():
    for k, (now, inbox) in enumerate(exchange(radio(0.1), 100)):
        if k < 3:
            assert np.isnan(inbox.stamp_s[~OWN]).all()
        else:
            # sent 3 ticks ago, arrived half a tick ago
            assert_is_round(inbox, k - 3, now - 0.5 * PERIOD)


def test_own_message_arrives_at_once():
    for k, (now, inbox) in enumerate(exchange(radio(0.2, loss=1.0), 20)):
        assert_is_round(inbox, k, now, OWN)
        assert np.isnan(inbox.stamp_s[~OWN]).all()


def test_delay_is_that_of_the_link():
    delays = np.array([[0.0, 0.0, 0.12], [0.2, 0.08, 0.0]])
    late = np.round(delays / PERIOD).astype(int)
    for k, (now, inbox) in enumerate(exchange(radio(delays), 100)):
        for i, m in np.ndindex(FOLLOWERS, N):
            if k < late[i, m]:
                assert np.isnan(inbox.stamp_s[i, m])
                assert np.isnan(inbox.position_ned[i, m]).all()
            else:
                assert_is_round(inbox, k - late[i, m], now, where=np.s_[i, m])


def test_newer_message_is_not_replaced_by_older():
    # the first broadcast takes 0.2 s, the second none: when the first comes in, the second stays
    link = radio(losses=by_trace(0.2, 0.0))
    for now in (0.0, 0.04):
        link.send(np.full(N, now), broadcast(now), None)
    assert_is_round(link.deliver(0.04), 1, 0.04)
    assert_is_round(link.deliver(0.2), 1, 0.04)
    assert link.statistics["overtaken"].sum() == (~OWN).sum()


def test_second_copy_does_not_renew_the_receipt():
    """The age of a message counts from its first copy, whenever the second one arrives."""
    jitter = {"distribution": "uniform", "spread_s": 0.04, "in_order": False}
    link = radio(0.1, jitter=jitter, duplicate=1.0)
    link.send(np.zeros(N), broadcast(0.0), None)
    first, on_the_way = np.full((FOLLOWERS, N), np.nan), 0
    for now in np.arange(0.0, 0.2, 0.001):
        received = link.deliver(now).received_s
        first = np.where(np.isnan(first), received, first)
        assert np.array_equal(received, first, equal_nan=True)
        on_the_way += np.isfinite(received[~OWN]).all() and link._counts[0] > 0
    assert np.isfinite(first).all() and on_the_way > 0


def test_simultaneous_messages_leave_the_newest():
    link = radio(losses=by_trace(0.12, 0.08, 0.04))
    for k in range(3):
        link.send(np.full(N, k * PERIOD), broadcast(k * PERIOD), None)
    assert_is_round(link.deliver(0.12), 2, 0.12)
    assert not link.statistics["overtaken"].any()


def test_message_is_not_delivered_early():
    link = radio(0.1)
    link.send(np.zeros(N), broadcast(0.0), None)
    assert np.isnan(link.deliver(0.099).stamp_s[~OWN]).all()
    assert not np.isnan(link.deliver(0.1).stamp_s).any()


def test_aircraft_that_does_not_send_is_not_received():
    link = radio()
    link.send(np.zeros(N), broadcast(0.0), None, np.array([True, False, False]))
    inbox = link.deliver(0.0)
    assert not np.isnan(inbox.stamp_s[:, 0]).any()
    assert np.isnan(inbox.stamp_s[:, 1:]).all()


def test_message_sent_between_ticks_arrives_between():
    link = radio(0.05)
    link.send(np.array([0.001, 0.002, 0.003]), broadcast(0.0), None)
    inbox = link.deliver(0.0521)
    assert inbox.received_s[:, 0] == pytest.approx(0.051)
    assert inbox.received_s[1, 1] == pytest.approx(0.052)
    assert np.isnan(inbox.received_s[0, 2])


def test_writing_to_the_inbox_changes_no_message():
    """Scribbling over one inbox changes neither a later one nor what is on its way."""
    link, clean = (radio([[0.0, 0.04, 0.0], [0.04, 0.0, 0.0]]) for _ in range(2))
    for one in (link, clean):
        one.send(np.zeros(N), broadcast(0.0), None)
    for array in link.deliver(0.0):
        array[:] = -1.0
    clean.deliver(0.0)
    for one in (link, clean):
        one.send(np.full(N, 0.04), broadcast(0.04), None)
    for ours, theirs in zip(link.deliver(0.04), clean.deliver(0.04), strict=True):
        assert np.array_equal(ours, theirs)


def test_queue_grows():
    link = radio(60.0)
    for k in range(500):
        link.send(np.full(N, k * PERIOD), broadcast(k * PERIOD), None)
    assert_is_round(link.deliver(60.0 + 499 * PERIOD), 499, 60.0 + 499 * PERIOD)


# clocks


def test_clock_errors_change_stamps_only():
    clocks = {
        "leader": StampClock(offset_s=0.5, drift_ppm=100.0),
        "uav1": StampClock(offset_s=-0.25),
        "uav2": StampClock(resolution_s=0.1),
    }
    right, wrong = (
        radio(0.02),
        radio(0.02, clocks=make_clocks(NAMES, clocks)),
    )
    for one in (right, wrong):
        one.send(np.full(N, 200.07), broadcast(200.07, 5), None)
    ours, theirs = wrong.deliver(200.1), right.deliver(200.1)
    # by hand: the sender's error at 200.07 s, less the receiver's
    drifted = 0.5 + 200.07e-4
    error = np.array([[drifted + 0.25, 0.0, -0.07 + 0.25], [drifted, -0.25, -0.07]])
    assert ours.stamp_s - theirs.stamp_s == pytest.approx(error, abs=1e-12)
    for name in Messages._fields[1:]:
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name
    assert np.array_equal(wrong.links["measured_s"], right.links["measured_s"])


@pytest.mark.parametrize("resolution_s", [0.01, 0.02, 0.001])
def test_clock_shows_a_multiple_that_is_reached(resolution_s):
    """Also where the quotient rounds to just below it, as that of 0.58 s and 0.01 s."""
    coarse = {"leader": StampClock(resolution_s=resolution_s)}
    link, stamps = radio(0.0, clocks=make_clocks(NAMES, coarse)), []
    for k in range(1, 2000):
        for early, expected in ((1e-4, 0.02 * k - resolution_s), (0.0, 0.02 * k)):
            now = 0.02 * k - early * resolution_s
            link.send(np.full(N, now), broadcast(now), None)
            stamps.append(link.deliver(now).stamp_s[0, 0] - expected)
    assert stamps == pytest.approx(np.zeros(len(stamps)), abs=1e-9)


def test_equal_clock_errors_cancel():
    clocks = {name: StampClock(offset_s=7.0, drift_ppm=-30.0) for name in NAMES}
    link = radio(clocks=make_clocks(NAMES, clocks))
    link.send(np.full(N, 100.0), broadcast(100.0), None)
    assert link.deliver(100.0).stamp_s == pytest.approx(100.0, abs=1e-12)


# statistics


def test_bursts_are_counted_by_length():
    """Lost 0, 2, 3, 7, 8, 9 of ten, then muted: bursts of 1, 2 and, not over yet, 3."""
    losses = ExtraLosses(
        outages=lambda sent, rows, number: (
            np.where(
                number >= 10,
                PacketOutcome.MUTED,
                np.where(np.isin(number, (0, 2, 3, 7, 8, 9)), PacketOutcome.LISTED, 0),
            ).astype(np.uint8)
            * np.ones((FOLLOWERS, 1), np.uint8)
        )
    )
    result = radio(losses=losses)
    for _ in exchange(result, 11):
        pass
    statistics = result.statistics
    for i, m in np.argwhere(~OWN):
        link = statistics[i, m]
        assert link["bursts"][:3].tolist() == [1, 1, 0]
        assert (link["burst"], link["longest_burst"]) == (3, 3)
        assert link["outcomes"][PacketOutcome.LISTED] == 6
        assert link["outcomes"][PacketOutcome.MUTED] == 2
        assert (result.links["sent"][i, m], result.links["delivered"][i, m]) == (10, 4)
    assert not statistics["outcomes"][OWN].any()


def test_duration_lies_in_its_bin():
    ends = bin_ends()
    for seconds in (0.0, 1e-4, 1e-3, 1.001e-3, 0.04, 0.1, 1.0, 59.0, 1e4):
        at = bin_of(seconds)
        assert seconds <= ends[at]
        assert at == 0 or seconds > ends[at - 1]
    assert (ends[2:-1] / ends[1:-2] < 1.1).all()


def test_unsubscribed_links_are_not_counted():
    """And the other links are as if all were used."""
    network = Network.model_validate({"loss": 0.3, "delay_s": 0.02})
    subscribed = np.array([[True, False, False], [True, True, False]])
    all_links, some = (
        Radio(make_channel(resolve_links(NAMES, network), 1, mask)) for mask in (None, subscribed)
    )
    for (_, full), (_, inbox) in zip(exchange(all_links, 60), exchange(some, 60), strict=True):
        used = subscribed | OWN
        for of_all, of_some in zip(full, inbox, strict=True):
            np.testing.assert_array_equal(of_some[used], of_all[used])
            assert np.isnan(of_some[~used]).all()
    assert (some.links["sent"] == 61 * subscribed).all()
    assert some.summary()["links"].keys() == {"leader", "uav1"}
    assert some.summary()["links"]["uav1"].keys() == {"uav2"}
    assert some.summary()["all"]["sent"] == 3 * 61


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_corrupted_copies_would_have_arrived(arithmetic):
    """Their times are those of the same packets on a link that corrupts none."""
    keys = {
        "delay_s": 0.1,
        "jitter": {"distribution": "uniform", "spread_s": 0.05},
        **{"loss": 0.3, "duplicate": 0.4, "reorder": 0.2, "arithmetic": arithmetic},
    }
    losses = ExtraLosses(
        outages=lambda sent_s, rows, numbers: np.full(
            (FOLLOWERS, len(rows)), PacketOutcome.BLACKOUT * (numbers[0] % 5 == 0), np.uint8
        ),
        fading=lambda truth, rows: np.full((FOLLOWERS, len(rows)), 0.2),
    )
    some, none = (
        Radio(make_channel(resolve_links(NAMES, Network.model_validate(each)), 1), losses)
        for each in ({**keys, "corrupt": 0.4}, keys)
    )
    corrupted = 0
    for k in range(200):
        now = k * PERIOD
        clean = none.send(np.full(N, now), broadcast(now), None)
        packets = some.send(np.full(N, now), broadcast(now), None)
        arrival_s, corrupted_s = packets["arrival_s"], packets["corrupted_s"]
        assert np.array_equal(np.minimum(arrival_s, corrupted_s), clean["arrival_s"])
        assert (np.maximum(arrival_s, corrupted_s) == np.inf).all()
        hit = np.isfinite(corrupted_s).any(axis=2)
        assert hit[packets["outcome"] == PacketOutcome.CORRUPTED].all()
        corrupted += np.isfinite(corrupted_s).sum()
    assert corrupted > 100


@in_full  # kernels of a flight with a radio as Python: tests/core/contract/test_compile.py
def test_debug_mode_gives_the_same_messages():
    """Kernels as Python: the same numbers, to rounding, and no warning of an overflow."""
    program = f"rounds = 100\n{EXCHANGE}"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), warnings.catch_warnings(action="error"):
        exec(program, {})
    debug = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        cwd=ROOT,
        capture_output=True,
        check=True,
        text=True,
    )
    texts = printed.getvalue(), debug.stdout
    compiled, plain = (list(map(float, each.split())) for each in texts)
    assert compiled == pytest.approx(plain, rel=1e-12)


EXCHANGE = """
import numpy as np
from testbed.core.records import Broadcast, NedOrigin
from testbed.mavlink.follow_target import FollowTarget
from testbed.network.channel import make_channel
from testbed.network.links import resolve_links
from testbed.network.radio import Radio
from testbed.scenario.network import Network

KEYS = {
    "delay_s": 0.1,
    "jitter": {"distribution": "pareto", "spread_s": 0.05, "correlation": 0.3},
    "loss": {"probability": 0.1, "correlation": 0.3},
    "duplicate": 0.2,
    "corrupt": 0.1,
    "rate": {"bit_per_s": 30000, "queue_packets": 2},
}
for arithmetic, encoding in (("exact", None), ("netem", FollowTarget(NedOrigin()))):
    network = Network.model_validate({**KEYS, "arithmetic": arithmetic})
    links = resolve_links(("leader", "uav1", "uav2"), network)
    radio = Radio(make_channel(links, 1), None, encoding)
    rng = np.random.default_rng(3)
    for k in range(rounds):
        vectors = rng.normal(0.0, 0.3, (5, 3, 3))
        radio.send(np.full(3, 0.04 * k), Broadcast(np.full(3, 0.04 * k), *vectors), None)
        print(*(np.nansum(each) for each in radio.deliver(0.04 * k)))
    print(*(np.sum(radio.statistics[name]) for name in radio.statistics.dtype.names))
"""
