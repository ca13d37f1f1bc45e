"""What breaks a link does not break the one who listens. TESTBED_FRAMES sets how many are tried."""

import os
import random
from collections import Counter

import pytest

from testbed.mavlink.door import Codec
from testbed.mavlink.signing import Signing

FRAMES = int(os.environ.get("TESTBED_FRAMES", "10000"))
SEED = 20261121
LONGEST = 280  # bytes of a frame with its signature
KEY = bytes(range(32))
# A checksum of 16 bits lets one broken frame of 65536 pass, which hides what it seems to hold.
COINCIDENCES = 2 + FRAMES // 10000


def spoken(codec, rng):
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


def broken(frame, rng):
    """A frame as bad links and bad people make it; never the frame itself."""
    way = rng.randrange(5)
    if way == 0:
        return bytes(rng.randrange(256) for _ in range(rng.randrange(400)))
    if way == 1:
        return frame[: rng.randrange(len(frame))]
    if way == 2:
        return bytes(rng.choice(b"\xfd\xfe\x00\x01\xff") for _ in range(rng.randrange(60)))
    changed = bytearray(frame)
    if way == 3:
        at = rng.randrange(len(changed))
        changed[at] ^= 1 << rng.randrange(8)
    else:
        for _ in range(rng.randrange(2, 12)):
            at = rng.randrange(len(changed))
            changed[at] = (changed[at] + rng.randrange(1, 256)) % 256
    return b"" if bytes(changed) == frame else bytes(changed)


@pytest.mark.parametrize("key", [None, KEY], ids=["open", "signed"])
def test_no_datagram_raises_or_costs_the_next_one(key):
    rng = random.Random(SEED)
    signing = Signing(key) if key else None
    speaker, listener, check = Codec(7, 1, signing), Codec(1, 1, signing), Codec(1, 1)
    believed = 0
    for _ in range(FRAMES // 2):
        believed += len(listener.feed(broken(spoken(speaker, rng), rng), whole=True))
        good = spoken(speaker, rng)
        assert listener.feed(good, whole=True) == check.feed(good, whole=True) != []
    # a signature lets none pass
    assert believed <= (0 if key else COINCIDENCES)


def test_every_good_frame_of_a_stream_is_found_however_it_is_cut():
    rng = random.Random(SEED + 1)
    speaker, listener = Codec(7, 1), Codec(1, 1)
    stream, said = bytearray(), []
    for _ in range(FRAMES // 2):
        stream += broken(spoken(speaker, rng), rng)
        good = spoken(speaker, rng)
        said.append(good)
        stream += good
    # what waits for the end of a false frame is let go by whatever comes after it
    stream += bytes(LONGEST)
    found, at = [], 0
    while at < len(stream):
        step = rng.randrange(1, 200)
        found += listener.feed(bytes(stream[at : at + step]))
        at += step
    wanted = Counter(str(Codec(1, 1).feed(frame)[0]) for frame in said)
    heard = Counter(map(str, found))
    assert (wanted - heard).total() <= COINCIDENCES
    assert (heard - wanted).total() <= COINCIDENCES
    assert listener.skipped > 0


def test_a_false_beginning_delays_a_stream_by_one_frame_at_most():
    listener, speaker = Codec(1, 1), Codec(7, 1)
    heard = listener.feed(b"\xfd\xff\x01")
    fed = 0
    while not heard:
        frame = speaker.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        heard = listener.feed(frame)
        fed += len(frame)
    assert fed <= LONGEST + 14
    assert [m.sequence for m in heard] == list(range(len(heard)))


def test_a_datagram_that_is_cut_off_does_not_wait():
    listener, speaker = Codec(1, 1), Codec(7, 1)
    frame = speaker.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    assert listener.feed(frame[:-1], whole=True) == []
    assert listener.skipped == len(frame) - 1
    assert len(listener.feed(frame, whole=True)) == 1
    # but a stream does
    assert listener.feed(frame[:-1]) == []
    assert len(listener.feed(frame[-1:])) == 1
