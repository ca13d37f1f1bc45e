"""What the hub of companions passes on, when, and to whom: with sockets, without processes."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from mavlink_control import sample
from waiting import TIMEOUT_S

from testbed.mavlink.codec import Codec
from testbed.mavlink.lockstep_messages import RECEIPT, pack_receipt, receipt_time
from testbed.mavlink.udp_endpoint import Address, Endpoint
from testbed.runs.companion_hub import LATE_S, CompanionHub

EPOCH_MS = 1_790_000_000_000
N = 3


class Radio:
    """A radio of three aircraft whose decisions are written down."""

    def __init__(self):
        self.senders, self.muted = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
        self.copies = []  # arrival, s, follower, sender

    def sent(self):
        yield from self.copies


class Companion:
    """A socket of one companion."""

    def __init__(self, hub, row):
        _, host, port = hub.address.split(":")
        self.socket = Endpoint(Address("udpout", host, int(port)), time.monotonic)
        self.codec, self.parser = Codec(row + 1, 191), Codec(1, 1)

    def broadcast(self, time_s, **changes):
        fields = {"timestamp": EPOCH_MS + round(1e3 * time_s), "custom_state": 7}
        fields |= dict.fromkeys(("lat", "lon"), 0) | {"alt": 0.0, "est_capabilities": 15}
        fields |= dict.fromkeys(("vel", "acc", "rates", "position_cov"), (0.0,) * 3)
        frame = self.codec.pack("FOLLOW_TARGET", attitude_q=(1.0, 0, 0, 0), **fields | changes)
        self.socket.send(frame)
        return frame

    def received(self):
        """Return the frames of each datagram that has come."""
        return [self.parser.feed(data, datagram=True) for _, data in self.socket.receive()]


@pytest.fixture
def rig():
    """Make a hub with three companions that it knows; `rig(pace)`."""
    opened = []

    def make(pace=None, clock=time.monotonic):
        hub, radio = CompanionHub(1000 * EPOCH_MS, pace=pace, clock=clock), Radio()
        companions = [Companion(hub, row) for row in range(N)]
        opened.extend([hub, *(each.socket for each in companions)])
        stage = hub.stage(SimpleNamespace(formation=SimpleNamespace(radio=radio)))
        for each in companions:
            each.broadcast(-10.0)
        until = time.monotonic() + TIMEOUT_S
        while hub.listening != {0, 1, 2} and time.monotonic() < until:
            hub.wait_for_greetings(0.1)
        assert hub.listening == {0, 1, 2}
        return hub, radio, companions, lambda now: stage.step(now, None)

    yield make
    for each in opened:
        each.close()


def told(datagram):
    """Return receipts and frames of a datagram of lockstep, and the time of its mark, ms."""
    *rest, mark = datagram
    assert mark.name == "SYSTEM_TIME"
    receipts = [receipt_time(each.fields["data"]) for each in rest[::2]]
    assert {each.name for each in rest[::2]} <= {RECEIPT}
    return receipts, [each.frame for each in rest[1::2]], mark.fields["time_boot_ms"]


def test_lockstep_waits_for_every_message(rig):
    hub, radio, (leader, one, two), note = rig()
    radio.copies = [(0.0, 0, 0), (0.0, 1, 0), (0.0, 1, 1)]
    note(0.0)
    hub.observe(sample(0, N))
    frames = [leader.broadcast(0.0), one.broadcast(0.0)]
    hub.poll(0.0)
    assert one.received() == two.received() == []
    two.broadcast(0.0)  # which reaches nobody
    hub.poll(0.0)
    assert [told(each) for each in one.received()] == [([0.0], frames[:1], 0)]
    assert [told(each) for each in two.received()] == [([0.0, 0.0], frames, 0)]
    assert leader.received() == []
    # once for each sample
    hub.poll(0.0)
    assert one.received() == []


def test_lockstep_gives_late_copies_with_their_times(rig):
    """In the order of their arrival, whatever the order of sending; a lost one is not given."""
    hub, radio, (leader, one, two), note = rig()
    plan = {0: [(0.1 + 0.05, 0, 0)], 1: [(0.04 + 0.04, 0, 0), (0.0400001, 0, 2)], 2: []}
    sent = {}
    for k in range(5):
        now = k / 25
        radio.copies = plan.get(k, [])
        note(now)
        hub.observe(sample(k, N))
        sent[k] = [each.broadcast(now) for each in (leader, one, two)]
        hub.poll(now)
        ((receipts, frames, mark),) = (told(each) for each in one.received())
        assert mark == 40 * k
        expected = {
            2: ([0.0400001, 0.04 + 0.04], [sent[1][2], sent[1][0]] if k > 1 else []),
            4: ([0.1 + 0.05], [sent[0][0]]),
        }
        assert (receipts, frames) == expected.get(k, ([], []))


def test_lockstep_does_not_wait_for_silent_aircraft(rig):
    hub, radio, (leader, one, two), note = rig()
    radio.muted[2] = True
    note(0.0)
    hub.observe(sample(0, N))
    leader.broadcast(0.0)
    one.broadcast(0.0)
    hub.poll(0.0)
    assert len(one.received()) == len(two.received()) == 1


def test_receipts_keep_every_bit():
    codec, random = Codec(1, 1), np.random.default_rng(3)
    for value in [0.0, 0.04, 1e-9, 1079.96, *(random.uniform(0, 2000, 300)).tolist()]:
        (found,) = Codec(2, 1).feed(pack_receipt(codec, value), datagram=True)
        assert receipt_time(found.fields["data"]) == value
        assert float(np.float32(value)) != value or value in (0.0,)


def test_real_time_sends_at_the_arrival(rig):
    """By the wall clock: two simulated seconds per second."""
    wall = [100.0]
    hub, radio, (leader, one, two), note = rig(2.0, lambda: wall[0])
    radio.copies = [(1.0, 0, 0), (1.06, 1, 0)]
    note(1.0)
    hub.poll(1.0)
    assert one.received() == []  # the message has not come yet
    frame = leader.broadcast(1.0)
    hub.poll(1.0)
    assert [[each.frame for each in got] for got in one.received()] == [[frame]]
    assert two.received() == []
    assert hub.due_s() == pytest.approx(0.03)
    wall[0] += 0.031
    assert hub.due_s() == math.inf
    hub.poll(1.0)
    assert [[each.frame for each in got] for got in two.received()] == [[frame]]
    assert hub.counts["missing"] == 0


def test_real_time_forgets_what_is_not_sent(rig):
    wall = [0.0]
    hub, radio, (leader, one, _), note = rig(1.0, lambda: wall[0])
    radio.copies = [(0.0, 0, 0)]
    note(0.0)
    hub.poll(0.0)
    wall[0] = LATE_S + 0.01
    hub.poll(1.0)
    assert hub.counts["missing"] == 1
    leader.broadcast(0.0)
    hub.poll(1.0)
    assert one.received() == []


def test_other_programs_are_not_companions(rig):
    hub, *_ = rig()
    other = Companion(hub, 8)
    other.codec = Codec(9, 1)
    other.broadcast(0.0)
    other.socket.send(b"\xfd garbage")
    hub.poll(0.0)
    assert hub.listening == {0, 1, 2}
    other.socket.close()
