"""FOLLOW_TARGET between companions: GPS time, digests, and the numbers of a run's messages."""

import numpy as np
import pytest

from testbed.companion.formation_messages import FormationMessages, write_link
from testbed.core.records import LINK, MESSAGE, Broadcast, NedOrigin, allocate
from testbed.mavlink.codec import Codec, decode
from testbed.mavlink.follow_target import BEGIN_MS, FollowTarget

ORIGIN = NedOrigin(47.3, 8.5, 430.0)
BASE_MS = 1_800_000_000_123
TIME = {"time_unix_usec": 1, "time_boot_ms": 1}


@pytest.fixture
def message():
    drawn = np.random.default_rng(5)
    found = allocate(MESSAGE, 1)
    found["position_ned"] = drawn.normal(0.0, 500.0, 3)
    found["velocity_ned"] = drawn.normal(0.0, 15.0, 3)
    found["acceleration_ned"] = drawn.normal(0.0, 3.0, 3)
    found["euler"], found["euler_rates"] = drawn.normal(0.0, 0.3, 3), drawn.normal(0.0, 0.3, 3)
    found["stamp_s"] = 12.48
    return found


def sent(message, boot_ms=12_480, digests=0xFEDCBA9876543210):
    made = FormationMessages(ORIGIN, 4)
    fields = made.fields(message, BASE_MS + boot_ms, digests)
    (read,) = made.read([decode(Codec(2, 191).pack("FOLLOW_TARGET", **fields))])
    return read


def test_content_is_that_of_a_run(message):
    """To the bit: what the radio of a run makes of the same broadcast."""
    of_run = FollowTarget(ORIGIN)
    broadcast = Broadcast(*(message[name] for name in Broadcast._fields))
    expected, _, _ = of_run.unpack(of_run.pack(broadcast, np.array([1]), np.array([0])))
    link = allocate(LINK, 1)[0]
    link["stamp_s"] = np.nan
    assert write_link(link, sent(message), BASE_MS, 12.5)
    for name in Broadcast._fields:
        assert np.array_equal(link[name], getattr(expected, name)[0]), name
    assert link["received_s"] == 12.5


def test_time_is_gps_time_of_both(message):
    """A receiver that was switched on a minute later has a stamp a minute lower."""
    read = sent(message)
    assert read.timestamp_ms == BASE_MS + 12_480
    link = allocate(LINK, 1)[0]
    link["stamp_s"] = np.nan
    write_link(link, read, BASE_MS + 60_000, 1.0)
    assert link["stamp_s"] == -47.52
    assert BEGIN_MS < BASE_MS  # unlike the times of a run's own messages


def test_digests_and_sender_are_read(message):
    read = sent(message)
    assert (read.row, read.digests) == (1, 0xFEDCBA9876543210)
    assert read.height_m == pytest.approx(430.0 - message["position_ned"][0, 2], abs=1e-3)


def test_message_of_no_aircraft_is_not_read(message):
    made = FormationMessages(ORIGIN, 4)
    fields = made.fields(message, BASE_MS, 0)
    for system, known in ((4, True), (5, False), (255, False)):
        frame = Codec(system, 191).pack("FOLLOW_TARGET", **fields)
        assert (made.sender(decode(frame)) == 3) is known
    assert made.sender(decode(Codec(4, 191).pack("SYSTEM_TIME", **TIME))) is None


def test_shortened_payload_is_read_whole(message):
    """MAVLink 2 leaves out zeros at the end of a payload."""
    made = FormationMessages(ORIGIN, 4)
    fields = {**made.fields(message, BASE_MS, 0), "est_capabilities": 0}
    frame = Codec(2, 191).pack("FOLLOW_TARGET", **fields)
    assert len(frame) < 105
    (read,) = made.read([decode(frame)])
    assert np.allclose(read.content.velocity_ned, message["velocity_ned"], atol=1e-6)


def test_messages_that_are_read_together_are_the_same(message):
    """To the bit; one that is absurd takes none of the others with it."""
    made, frames = FormationMessages(ORIGIN, 4), []
    for k in range(5):
        message["position_ned"] += 3.7
        fields = made.fields(message, BASE_MS + k, k)
        if k == 2:
            fields["vel"] = (float("nan"), 0.0, 0.0)
        frames.append(decode(Codec(1 + k % 4, 191).pack("FOLLOW_TARGET", **fields)))
    together = made.read(frames)
    assert together[2] is None
    for frame, read in zip(frames, together, strict=True):
        (alone,) = made.read([frame])
        assert (alone is None) == (read is None)
        if read is not None:
            assert read[:4] == alone[:4]
            assert all(map(np.array_equal, read.content, alone.content))
