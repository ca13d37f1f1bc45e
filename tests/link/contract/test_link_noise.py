"""Nothing that is parsed is trusted: any bytes come out as they went in."""

import os
import random

import pytest
from frame_damage import broken
from link_loop import LinkLoop, attitude, make_settings

from testbed.mavlink.codec import Codec

NOISE = int(os.environ.get("TESTBED_LINK_NOISE", "400"))
CURVE = "network.range_loss=[[1e5, 0], [1e6, 0.1]]"


def noise(rng, count):
    """Damaged frames of messages that are read, datagrams of many, and the longest."""
    codec = Codec(1, 1)
    zeros = dict.fromkeys(("time_boot_ms", "lat", "lon", "alt", "relative_alt", "vx", "vy"), 0)
    place = codec.pack("GLOBAL_POSITION_INT", **zeros, vz=0, hdg=0)
    for _ in range(count):
        frames = [
            rng.choice((place, attitude(rng.randrange(1000)))) for _ in range(rng.choice((1, 8)))
        ]
        yield b"".join(broken(each, rng) if rng.random() < 0.7 else each for each in frames)
    yield from (b"", bytes(9000), b"\xfd" * 9000, b"\xfe" * 9000, rng.randbytes(9000))


@pytest.mark.parametrize("unit", ["frames", "datagrams"])
def test_noise_is_forwarded_as_it_came(unit):
    rng = random.Random(1)
    sent = list(noise(rng, NOISE))
    with LinkLoop(make_settings(CURVE, unit=unit)) as loop:
        arrived = loop.carry(sent, lossless=True)
        summary = loop.emulator.summary()
    if unit == "datagrams":
        assert arrived == sent
    assert b"".join(arrived) == b"".join(sent)
    assert summary["emulator"]["unread"] == summary["emulator"]["overflow"] == 0
    kinds = {each["message"] for each in summary["links"]["a"]["b"]["messages"]}
    assert {"ATTITUDE", "GLOBAL_POSITION_INT", "other"} <= kinds


def test_kinds_of_messages_are_bounded():
    """A program that invents systems and messages does not fill the memory."""
    from testbed.link.frame_cutter import Frame
    from testbed.link.message_counts import MAX_KINDS, OTHER, MessageCounts

    counts = MessageCounts()
    for number in range(3 * MAX_KINDS):
        counts.add((Frame(0, 20, number % 250, 70_000 + number, 10, 18, known=False),), 20, 0, 0.1)
    kinds = counts.summary(1.0)
    assert len(kinds) <= MAX_KINDS + 1
    assert sum(each["offered"] for each in kinds) == 3 * MAX_KINDS
    assert kinds[-1]["message"] == OTHER and kinds[-1]["offered"] >= 2 * MAX_KINDS
