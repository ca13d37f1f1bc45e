"""The channel: what is heard when, on which link, and what replaces what."""

import numpy as np
import pytest

from testbed.network.channel import Channel, deliver, send, silent
from testbed.state import Broadcast, Inbox

N, FOLLOWERS = 3, 2
PERIOD = 0.04


def say(now, mark=None):
    """A round of broadcasts stamped `now` whose every number tells its sender and its round."""
    mark = round(now / PERIOD) if mark is None else mark
    vectors = mark * 1000.0 + np.arange(5 * N * 3, dtype=float).reshape(5, N, 3)
    return Broadcast(np.full(N, now), *vectors)


def channel(delay_s):
    return Channel(np.broadcast_to(np.asarray(delay_s, dtype=float), (FOLLOWERS, N)).copy())


def heard(radio, until, *, start=None, period=PERIOD):
    """The inboxes after each tick of an exchange with one broadcast a tick."""
    memory = start or silent(radio)
    for k in range(until + 1):
        now = k * period
        memory = deliver(send(radio, memory, say(now), now), now)
        yield now, memory


def assert_is_round(inbox, k, now_received, where=np.s_[:]):
    """All of the chosen links hold round k."""
    expected = say(k * PERIOD)
    assert inbox.stamp_s[where] == pytest.approx(
        np.broadcast_to(expected.stamp_s, (FOLLOWERS, N))[where], abs=0
    )
    assert inbox.received_s[where] == pytest.approx(now_received, abs=1e-12)
    for name in Broadcast._fields[1:]:
        sent = np.broadcast_to(getattr(expected, name), (FOLLOWERS, N, 3))
        assert np.array_equal(getattr(inbox, name)[where], sent[where]), name


def test_nothing_was_heard_before_the_first_message():
    for array in silent(channel(0.0)).inbox:
        assert np.isnan(array).all()


def test_without_delay_a_message_is_there_for_the_tick_it_was_sent_at():
    for k, (now, memory) in enumerate(heard(channel(0.0), 50)):
        assert_is_round(memory.inbox, k, now)
        assert memory.in_flight == ()


@pytest.mark.parametrize("periods", [1, 2, 25])
def test_a_delay_of_whole_periods_is_met_to_the_tick(periods):
    # k·0.04 + delay and (k + periods)·0.04 differ in binary; both mean the same tick
    delay = periods * PERIOD
    for k, (now, memory) in enumerate(heard(channel(delay), 300)):
        if k < periods:
            assert np.isnan(memory.inbox.stamp_s).all()
        else:
            assert_is_round(memory.inbox, k - periods, now)
        assert len(memory.in_flight) == min(k + 1, periods)


def test_a_tenth_of_a_second_is_two_and_a_half_periods():
    for k, (now, memory) in enumerate(heard(channel(0.1), 100)):
        if k < 3:
            assert np.isnan(memory.inbox.stamp_s).all()
        else:
            # sent 3 ticks ago, arrived half a tick ago
            assert_is_round(memory.inbox, k - 3, now - 0.5 * PERIOD)


def test_the_delay_is_that_of_the_link():
    delays = np.array([[0.0, 0.04, 0.12], [0.2, 0.0, 0.08]])
    for k, (now, memory) in enumerate(heard(channel(delays), 100)):
        late = np.round(delays / PERIOD).astype(int)
        for i in range(FOLLOWERS):
            for m in range(N):
                if k < late[i, m]:
                    assert np.isnan(memory.inbox.stamp_s[i, m])
                    assert np.isnan(memory.inbox.position_ned[i, m]).all()
                else:
                    assert_is_round(memory.inbox, k - late[i, m], now, where=np.s_[i, m])
        assert len(memory.in_flight) <= late.max()


def test_a_newer_message_is_never_replaced_by_an_older():
    # the first round takes 0.2 s, the second none: when the first comes in, the second stays
    slow, fast = channel(0.2), channel(0.0)
    memory = send(slow, silent(slow), say(0.0), 0.0)
    memory = deliver(send(fast, memory, say(0.04), 0.04), 0.04)
    assert_is_round(memory.inbox, 1, 0.04)
    memory = deliver(memory, 0.2)
    assert_is_round(memory.inbox, 1, 0.04)
    assert memory.in_flight == ()


def test_what_overtakes_on_one_link_does_not_on_another():
    mixed = channel([[0.2, 0.0, 0.2], [0.0, 0.0, 0.2]])
    memory = send(mixed, silent(mixed), say(0.0), 0.0)
    memory = deliver(send(channel(0.08), memory, say(0.04), 0.04), 0.12)
    assert_is_round(memory.inbox, 1, 0.12)
    memory = deliver(memory, 0.2)
    assert_is_round(memory.inbox, 1, 0.12)


def test_messages_that_arrive_together_leave_the_newest():
    memory = silent(channel(0.0))
    for k, delay in enumerate((0.12, 0.08, 0.04)):
        memory = send(channel(delay), memory, say(k * PERIOD), k * PERIOD)
    assert_is_round(deliver(memory, 0.12).inbox, 2, 0.12)


def test_nothing_is_heard_early():
    memory = send(channel(0.1), silent(channel(0.1)), say(0.0), 0.0)
    assert np.isnan(deliver(memory, 0.099).inbox.stamp_s).all()
    assert not np.isnan(deliver(memory, 0.1).inbox.stamp_s).any()


@pytest.mark.parametrize("delays", [0.0, [[0.0, 0.04, 0.0], [0.04, 0.0, 0.0]]])
def test_inboxes_share_nothing(delays):
    """Scribbling over one follower's inbox changes neither the others' nor what is sent later."""
    radio = channel(delays)
    content = say(0.0)
    memory = deliver(send(radio, silent(radio), content, 0.0), 0.04)
    before = Inbox(*(each.copy() for each in memory.inbox))
    for name, array in zip(Inbox._fields, memory.inbox, strict=True):
        if name != "received_s":
            array[0] = -1.0
        assert np.array_equal(array[1:], getattr(before, name)[1:]), name
    again = say(0.0)
    for name in Broadcast._fields:
        assert np.array_equal(getattr(content, name), getattr(again, name)), name


def test_a_delivery_changes_no_memory_given_to_it():
    radio = channel([[0.0, 0.04, 0.0], [0.04, 0.0, 0.0]])
    *_, (_, memory) = heard(radio, 5)
    kept = [each.copy() for each in memory.inbox]
    arrivals = [packet.arrival_s.copy() for packet in memory.in_flight]
    deliver(send(radio, memory, say(0.24), 0.24), 0.3)
    for array, copy in zip(memory.inbox, kept, strict=True):
        assert np.array_equal(array, copy)
    for packet, copy in zip(memory.in_flight, arrivals, strict=True):
        assert np.array_equal(packet.arrival_s, copy)


def test_inboxes_are_contiguous():
    """The compiled laws want it, whichever way the messages came."""
    for delays in (0.0, 0.04, [[0.0, 0.04, 0.0], [0.04, 0.0, 0.0]]):
        *_, (_, memory) = heard(channel(delays), 4)
        assert all(each.flags["C_CONTIGUOUS"] for each in memory.inbox)


# who speaks


def only(*rows):
    return np.isin(np.arange(N), rows)


def test_only_those_who_broadcast_are_heard():
    radio = channel(0.0)
    memory = deliver(send(radio, silent(radio), say(0.0), 0.0, only(1)), 0.0)
    assert_is_round(memory.inbox, 0, 0.0, where=np.s_[:, 1])
    assert np.isnan(memory.inbox.stamp_s[:, [0, 2]]).all()
    assert np.isnan(memory.inbox.position_ned[:, [0, 2]]).all()
    assert memory.in_flight == ()


@pytest.mark.parametrize("delays", [0.0, 0.1, [[0.0, 0.04, 0.12], [0.2, 0.0, 0.08]]])
def test_aircraft_in_turn_are_aircraft_at_once_each_at_its_own_time(delays):
    """Three aircraft that take turns, one a tick: each is heard as alone, on every link."""
    radio = channel(delays)
    memory = silent(radio)
    late = np.ceil(np.broadcast_to(delays, (FOLLOWERS, N)) / PERIOD - 1e-9).astype(int)
    for k in range(60):
        now = k * PERIOD
        memory = deliver(send(radio, memory, say(now), now, only(k % N)), now)
        for i in range(FOLLOWERS):
            for m in range(N):
                arrived = k - late[i, m]
                last = arrived - (arrived - m) % N
                where = np.s_[i, m]
                if last < 0:
                    assert np.isnan(memory.inbox.stamp_s[where])
                else:
                    received = last * PERIOD + np.broadcast_to(delays, (FOLLOWERS, N))[where]
                    assert_is_round(memory.inbox, last, received, where=where)
        assert len(memory.in_flight) <= 6  # what never arrives is not waited for


def test_everybody_is_the_default():
    radio = channel([[0.0, 0.04, 0.0], [0.04, 0.0, 0.1]])
    ours = theirs = silent(radio)
    for k in range(20):
        now = k * PERIOD
        ours = deliver(send(radio, ours, say(now), now), now)
        theirs = deliver(send(radio, theirs, say(now), now, only(0, 1, 2)), now)
        for one, two in zip(ours.inbox, theirs.inbox, strict=True):
            np.testing.assert_array_equal(one, two)


def test_a_late_message_of_one_aircraft_leaves_the_newer_of_another():
    # uav1's word takes 0.12 s, the leader's, said a tick later, none
    radio = channel([[0.0, 0.12, 0.0], [0.0, 0.12, 0.0]])
    memory = send(radio, silent(radio), say(0.0), 0.0, only(1))
    memory = deliver(send(radio, memory, say(0.04), 0.04, only(0)), 0.04)
    assert_is_round(memory.inbox, 1, 0.04, where=np.s_[:, 0])
    assert np.isnan(memory.inbox.stamp_s[:, 1]).all()
    memory = deliver(memory, 0.12)
    assert_is_round(memory.inbox, 1, 0.04, where=np.s_[:, 0])
    assert_is_round(memory.inbox, 0, 0.12, where=np.s_[:, 1])


# who is muted


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_muted_aircraft_sends_nothing_in_its_windows(delay):
    """By when it is sent: what is on its way arrives, and windows are [from, to)."""
    radio = Channel(channel(delay).delay_s, mute=((1, 0.4, 0.8), (1, 1.2, 1.4), (2, 0.0, 0.2)))
    late = round(np.ceil(delay / PERIOD))
    for k, (_, memory) in enumerate(heard(radio, 50)):
        newest = [
            max(
                (
                    sent
                    for sent in range(k - late + 1)
                    if not any(
                        row == m and begin <= sent * PERIOD < end for row, begin, end in radio.mute
                    )
                ),
                default=None,
            )
            for m in range(N)
        ]
        for m, last in enumerate(newest):
            where = np.s_[:, m]
            if last is None:
                assert np.isnan(memory.inbox.stamp_s[where]).all()
            else:
                assert_is_round(memory.inbox, last, last * PERIOD + delay, where=where)
        assert len(memory.in_flight) <= late
    assert newest == [50 - late] * N


def test_a_run_in_which_everyone_is_muted_waits_for_nothing():
    radio = Channel(channel(0.1).delay_s, mute=tuple((m, 0.0, 9.0) for m in range(N)))
    *_, (_, memory) = heard(radio, 50)
    assert np.isnan(memory.inbox.stamp_s).all()
    assert memory.in_flight == ()
