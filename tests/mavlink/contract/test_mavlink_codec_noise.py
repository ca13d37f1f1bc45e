"""The codec finds good frames in damaged data. TESTBED_FRAMES sets the number of frames."""

import os
import random
from collections import Counter

import pytest
from frame_damage import broken

from testbed.mavlink.codec import Codec
from testbed.mavlink.signing import Signing

FRAMES = int(os.environ.get("TESTBED_FRAMES", "5000"))
SEED = 20261121
MAX_FRAME_BYTES = 280  # bytes of a frame with its signature
KEY = bytes(range(32))
# A 16-bit checksum passes one broken frame in 65536, which hides the frames inside it.
COINCIDENCES = 2 + FRAMES // 10000


def random_frame(codec, rng):
    attitude = [rng.uniform(-3, 3) for _ in range(6)]
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    return rng.choice(
        [
            lambda: codec.pack(
                "ATTITUDE", time_boot_ms=1, **dict(zip(names, attitude, strict=True))
            ),
            lambda: codec.pack("STATUSTEXT", severity=1, text="\xfd\xfe" * rng.randrange(12)),
            lambda: codec.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1),
        ]
    )()


@pytest.mark.parametrize("key", [None, KEY], ids=["open", "signed"])
def test_codec_broken_datagram_keeps_next_one(key):
    rng = random.Random(SEED)
    signing = Signing(key) if key else None
    sender, receiver, check = Codec(7, 1, signing), Codec(1, 1, signing), Codec(1, 1)
    accepted = 0
    for _ in range(FRAMES // 2):
        accepted += len(receiver.feed(broken(random_frame(sender, rng), rng), datagram=True))
        good = random_frame(sender, rng)
        assert receiver.feed(good, datagram=True) == check.feed(good, datagram=True) != []
    # a signature lets none pass
    assert accepted <= (0 if key else COINCIDENCES)


def test_codec_stream_finds_every_good_frame():
    rng = random.Random(SEED + 1)
    sender, receiver = Codec(7, 1), Codec(1, 1)
    stream, sent = bytearray(), []
    for _ in range(FRAMES // 2):
        stream += broken(random_frame(sender, rng), rng)
        good = random_frame(sender, rng)
        sent.append(good)
        stream += good
    # frames inside an unfinished false frame are found when more data follows
    stream += bytes(MAX_FRAME_BYTES)
    found, at = [], 0
    while at < len(stream):
        step = rng.randrange(1, 200)
        found += receiver.feed(bytes(stream[at : at + step]))
        at += step
    wanted = Counter(str(Codec(1, 1).feed(frame)[0]) for frame in sent)
    received = Counter(map(str, found))
    assert (wanted - received).total() <= COINCIDENCES
    assert (received - wanted).total() <= COINCIDENCES
    assert receiver.skipped > 0


def test_codec_false_start_delays_one_frame():
    receiver, sender = Codec(1, 1), Codec(7, 1)
    received = receiver.feed(b"\xfd\xff\x01")
    fed = 0
    while not received:
        frame = sender.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        received = receiver.feed(frame)
        fed += len(frame)
    assert fed <= MAX_FRAME_BYTES + 14
    assert [m.sequence for m in received] == list(range(len(received)))


def test_codec_cut_datagram_does_not_wait():
    receiver, sender = Codec(1, 1), Codec(7, 1)
    frame = sender.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    assert receiver.feed(frame[:-1], datagram=True) == []
    assert receiver.skipped == len(frame) - 1
    assert len(receiver.feed(frame, datagram=True)) == 1
    # of a stream it does
    assert receiver.feed(frame[:-1]) == []
    assert len(receiver.feed(frame[-1:])) == 1
