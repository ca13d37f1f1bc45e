"""The radio: what is heard when, on which link, what replaces what, and what is counted."""

from functools import partial

import numpy as np
import pytest

from testbed.network import ledger as numpy_ledger
from testbed.network import post as numpy_post
from testbed.network import radio as radio_module
from testbed.network.channel import make_channel
from testbed.network.clocks import Clocks, make_clocks, show
from testbed.network.ledger import Ledger, bin_of, edges
from testbed.network.links import Fate
from testbed.network.radio import Conditions, Radio
from testbed.scenario.network import Network, StampClock
from testbed.state import Broadcast, Inbox

NAMES = ("leader", "uav1", "uav2")
N, FOLLOWERS = 3, 2
PERIOD = 0.04
OWN = np.array([[False, True, False], [False, False, True]])


def say(now, mark=None):
    """A round of broadcasts stamped `now` whose every number tells its sender and its round."""
    mark = round(now / PERIOD) if mark is None else mark
    vectors = mark * 1000.0 + np.arange(5 * N * 3, dtype=float).reshape(5, N, 3)
    return Broadcast(np.full(N, now), *vectors)


def radio(delay_s=0.0, *, conditions=None, **more):
    """With one delay for all links, or one for each (follower, aircraft)."""
    delays = np.broadcast_to(delay_s, (FOLLOWERS, N))
    links = {
        name: {NAMES[i + 1]: {"delay_s": float(delays[i, m])} for i in range(FOLLOWERS)}
        for m, name in enumerate(NAMES)
    }
    network = Network.model_validate({"links": links, **more})
    return Radio(make_channel(NAMES, network, 1), conditions)


def told(*delays):
    """A condition that gives each round of messages a delay of its own."""
    rounds = iter(delays)
    return Conditions(trace=lambda sent_s, rows: np.full((FOLLOWERS, len(rows)), next(rounds)))


def heard(link, until, period=PERIOD):
    """The inboxes after each tick of an exchange with one broadcast a tick."""
    for k in range(until + 1):
        now = k * period
        link.send(np.full(N, now), say(now), None)
        yield now, link.deliver(now)


def assert_is_round(inbox, k, now_received, where=~OWN):
    """All of the chosen links hold round k."""
    expected = say(k * PERIOD)
    stamps = np.broadcast_to(expected.stamp_s, (FOLLOWERS, N))
    assert inbox.stamp_s[where] == pytest.approx(stamps[where], abs=0)
    assert inbox.received_s[where] == pytest.approx(now_received, abs=1e-12)
    for name in Broadcast._fields[1:]:
        sent = np.broadcast_to(getattr(expected, name), (FOLLOWERS, N, 3))
        assert np.array_equal(getattr(inbox, name)[where], sent[where]), name


def test_nothing_was_heard_before_the_first_message():
    for array in radio().deliver(0.0):
        assert np.isnan(array).all()


def test_without_delay_a_message_is_there_for_the_tick_it_was_sent_at():
    for k, (now, inbox) in enumerate(heard(radio(), 50)):
        assert_is_round(inbox, k, now, np.full((FOLLOWERS, N), True))


@pytest.mark.parametrize("periods", [1, 2, 25])
def test_a_delay_of_whole_periods_is_met_to_the_tick(periods):
    # k·0.04 + delay and (k + periods)·0.04 differ in binary; both mean the same tick
    for k, (now, inbox) in enumerate(heard(radio(periods * PERIOD), 300)):
        if k < periods:
            assert np.isnan(inbox.stamp_s[~OWN]).all()
        else:
            assert_is_round(inbox, k - periods, now)


def test_a_tenth_of_a_second_is_two_and_a_half_periods():
    for k, (now, inbox) in enumerate(heard(radio(0.1), 100)):
        if k < 3:
            assert np.isnan(inbox.stamp_s[~OWN]).all()
        else:
            # sent 3 ticks ago, arrived half a tick ago
            assert_is_round(inbox, k - 3, now - 0.5 * PERIOD)


def test_an_aircraft_hears_itself_at_once_whatever_the_radio_does():
    for k, (now, inbox) in enumerate(heard(radio(0.2, loss=1.0), 20)):
        assert_is_round(inbox, k, now, OWN)
        assert np.isnan(inbox.stamp_s[~OWN]).all()


def test_the_delay_is_that_of_the_link():
    delays = np.array([[0.0, 0.0, 0.12], [0.2, 0.08, 0.0]])
    late = np.round(delays / PERIOD).astype(int)
    for k, (now, inbox) in enumerate(heard(radio(delays), 100)):
        for i, m in np.ndindex(FOLLOWERS, N):
            if k < late[i, m]:
                assert np.isnan(inbox.stamp_s[i, m])
                assert np.isnan(inbox.position_ned[i, m]).all()
            else:
                assert_is_round(inbox, k - late[i, m], now, where=np.s_[i, m])


def test_a_newer_message_is_never_replaced_by_an_older():
    # the first round takes 0.2 s, the second none: when the first comes in, the second stays
    link = radio(conditions=told(0.2, 0.0))
    for now in (0.0, 0.04):
        link.send(np.full(N, now), say(now), None)
    assert_is_round(link.deliver(0.04), 1, 0.04)
    assert_is_round(link.deliver(0.2), 1, 0.04)
    assert ledger_of(link).overtaken.sum() == (~OWN).sum()


def test_messages_that_arrive_together_leave_the_newest_and_none_was_overtaken():
    link = radio(conditions=told(0.12, 0.08, 0.04))
    for k in range(3):
        link.send(np.full(N, k * PERIOD), say(k * PERIOD), None)
    assert_is_round(link.deliver(0.12), 2, 0.12)
    assert not ledger_of(link).overtaken.any()


def test_nothing_is_heard_early():
    link = radio(0.1)
    link.send(np.zeros(N), say(0.0), None)
    assert np.isnan(link.deliver(0.099).stamp_s[~OWN]).all()
    assert not np.isnan(link.deliver(0.1).stamp_s).any()


def test_who_does_not_send_is_not_heard():
    link = radio()
    link.send(np.zeros(N), say(0.0), None, np.array([True, False, False]))
    inbox = link.deliver(0.0)
    assert not np.isnan(inbox.stamp_s[:, 0]).any()
    assert np.isnan(inbox.stamp_s[:, 1:]).all()


def test_a_message_leaves_between_ticks_and_arrives_between_ticks():
    link = radio(0.05)
    link.send(np.array([0.001, 0.002, 0.003]), say(0.0), None)
    inbox = link.deliver(0.0521)
    assert inbox.received_s[:, 0] == pytest.approx(0.051)
    assert inbox.received_s[1, 1] == pytest.approx(0.052)
    assert np.isnan(inbox.received_s[0, 2])


def test_inboxes_share_nothing():
    """Scribbling over one inbox changes neither a later one nor what is on its way."""
    link, clean = (radio([[0.0, 0.04, 0.0], [0.04, 0.0, 0.0]]) for _ in range(2))
    for one in (link, clean):
        one.send(np.zeros(N), say(0.0), None)
    for array in link.deliver(0.0):
        array[:] = -1.0
    clean.deliver(0.0)
    for one in (link, clean):
        one.send(np.full(N, 0.04), say(0.04), None)
    for ours, theirs in zip(link.deliver(0.04), clean.deliver(0.04), strict=True):
        assert np.array_equal(ours, theirs)


def test_there_is_always_room():
    link = radio(60.0)
    for k in range(500):
        link.send(np.full(N, k * PERIOD), say(k * PERIOD), None)
    assert_is_round(link.deliver(60.0 + 499 * PERIOD), 499, 60.0 + 499 * PERIOD)


# clocks


def test_wrong_clocks_move_stamps_and_nothing_else():
    clocks = {
        "leader": StampClock(offset_s=0.5, drift_ppm=100.0),
        "uav1": StampClock(offset_s=-0.25),
        "uav2": StampClock(resolution_s=0.1),
    }
    right, wrong = (
        radio(0.02),
        radio(0.02, conditions=Conditions(clocks=make_clocks(NAMES, clocks))),
    )
    for one in (right, wrong):
        one.send(np.full(N, 200.07), say(200.07, 5), None)
    ours, theirs = wrong.deliver(200.1), right.deliver(200.1)
    # by hand: the sender's error at 200.07 s, less the receiver's
    drifted = 0.5 + 200.07e-4
    error = np.array([[drifted + 0.25, 0.0, -0.07 + 0.25], [drifted, -0.25, -0.07]])
    assert ours.stamp_s - theirs.stamp_s == pytest.approx(error, abs=1e-12)
    for name in Inbox._fields[1:]:
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name
    assert np.array_equal(wrong.measured_s, right.measured_s)


def test_clocks_that_are_wrong_alike_agree():
    clocks = {name: StampClock(offset_s=7.0, drift_ppm=-30.0) for name in NAMES}
    link = radio(conditions=Conditions(clocks=make_clocks(NAMES, clocks)))
    link.send(np.full(N, 100.0), say(100.0), None)
    assert link.deliver(100.0).stamp_s == pytest.approx(100.0, abs=1e-12)


def test_the_compiled_clocks():
    twin = pytest.importorskip("testbed.network.clocks_twin", exc_type=ImportError)
    rng = np.random.default_rng(46)
    grain = np.where(rng.random(N) < 0.5, 0.0, rng.uniform(1e-3, 0.5, N))
    clocks = Clocks(rng.normal(0.0, 100.0, N), rng.normal(0.0, 1e-4, N), grain)
    measured, rows = np.empty(N), np.array([2, 0])
    ours, theirs = (
        (np.full(len(rows), np.nan), np.full((FOLLOWERS, len(rows)), np.nan)) for _ in range(2)
    )
    for _ in range(200):
        measured[:] = rng.uniform(0.0, 1e4, N)
        show(clocks, measured, rows, *ours)
        twin.show(*clocks, measured, rows, *theirs)
        for one, two in zip(ours, theirs, strict=True):
            assert np.array_equal(one, two)  # the same sums in the same order: to the bit


# the ledger


def ledger_of(link) -> Ledger:
    return link.ledger


def test_bursts_of_loss_are_counted_by_their_length():
    """Lost 0, 2, 3, 7, 8, 9 of ten, then muted: bursts of 1, 2 and, not over yet, 3."""
    conditions = Conditions(
        script=lambda sent, rows, number: (
            np.where(
                number >= 10,
                Fate.MUTE,
                np.where(np.isin(number, (0, 2, 3, 7, 8, 9)), Fate.LISTED, 0),
            ).astype(np.uint8)
            * np.ones((FOLLOWERS, 1), np.uint8)
        )
    )
    link = radio(conditions=conditions)
    for _ in heard(link, 11):
        pass
    ledger = ledger_of(link)
    for i, m in np.argwhere(~OWN):
        assert ledger.bursts[i, m, :3].tolist() == [1, 1, 0]
        assert ledger.missing[i, m] == 3
        assert ledger.longest[i, m] == 3
        assert ledger.fates[i, m, Fate.LISTED] == 6
        assert ledger.fates[i, m, Fate.MUTE] == 2
        assert (ledger.sent[i, m], ledger.delivered[i, m]) == (10, 4)
    assert not ledger.fates[OWN].any()


def test_every_duration_lies_in_its_bin():
    ends = edges()
    for seconds in (0.0, 1e-4, 1e-3, 1.001e-3, 0.04, 0.1, 1.0, 59.0, 1e4):
        at = int(bin_of(np.array(seconds)))
        assert seconds <= ends[at]
        assert at == 0 or seconds > ends[at - 1]
    assert (ends[2:-1] / ends[1:-2] < 1.1).all()


def test_compiled_and_numpy_radios_count_and_deliver_the_same(monkeypatch):
    pytest.importorskip("numba")
    page = {
        "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.3},
        "duplicate": 0.2,
        "corrupt": 0.1,
        "jitter": {"distribution": "pareto", "spread_s": 0.05},
        "rate": {"bit_per_s": 30000, "queue_packets": 2},
    }
    rng = np.random.default_rng(5)

    def flight():
        link = radio(0.1, **page)
        found = []
        for k in range(300):
            now = k * PERIOD
            who = rng.random(N) < 0.8
            if who.any():
                link.send(now + 0.01 * rng.random(N), say(now), None, who)
            inbox = link.deliver(now)
            read = *inbox, *link.counts()
            found.append(([each.copy() for each in read], link.measured_s.copy()))
        return link, found

    compiled, ours = flight()
    rng = np.random.default_rng(5)
    fates_twin = pytest.importorskip("testbed.network.fates_twin", exc_type=ImportError)
    monkeypatch.setattr(numpy_post, "fates", fates_twin.fates)  # the same delays to the last bit
    for of, name in (
        *((numpy_post, each) for each in ("send_round", "take_due")),
        (numpy_ledger, "count"),
    ):
        plainly = partial(partial, getattr(of, name))
        monkeypatch.setattr(radio_module, f"READY_{name.upper()}", plainly)
    plain, theirs = flight()
    for (inbox, measured), (other, others) in zip(ours, theirs, strict=True):
        for one, two in zip((*inbox, measured), (*other, others), strict=True):
            np.testing.assert_array_equal(one, two)
    for name, one, two in zip(Ledger._fields, compiled.ledger, plain.ledger, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, err_msg=name)
    assert compiled.ledger.overtaken.any()
    assert compiled.ledger.twice.any()
    assert compiled._count == plain._count > 0


@pytest.mark.parametrize("post_round", [None, numpy_post.post_round], ids=["own", "numpy"])
def test_who_is_not_listened_to_is_neither_heard_nor_counted(post_round, monkeypatch):
    """And whoever is listened to is heard as if everybody were."""
    if post_round:
        monkeypatch.setattr(
            radio_module, "READY_SEND_ROUND", partial(partial, numpy_post.send_round)
        )
    network = Network.model_validate({"loss": 0.3, "delay_s": 0.02})
    heeded = np.array([[True, False, False], [True, True, False]])
    everyone, some = (Radio(make_channel(NAMES, network, 1, mask)) for mask in (None, heeded))
    for (_, full), (_, inbox) in zip(heard(everyone, 60), heard(some, 60), strict=True):
        listened = heeded | OWN
        for of_all, of_some in zip(full, inbox, strict=True):
            np.testing.assert_array_equal(of_some[listened], of_all[listened])
            assert np.isnan(of_some[~listened]).all()
    assert (some.counts().sent == 61 * heeded).all()
    assert some.summary()["links"].keys() == {"leader", "uav1"}
    assert some.summary()["links"]["uav1"].keys() == {"uav2"}
    assert some.summary()["all"]["sent"] == 3 * 61
