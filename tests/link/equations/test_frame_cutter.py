"""What was received is cut at frames, and no byte is lost, changed or moved."""

import random

import pytest
from frame_damage import broken
from link_loop import attitude

from testbed.link.frame_cutter import (
    StreamCutter,
    cut_datagram,
    find_frames,
    load_messages,
    message_name,
)
from testbed.mavlink.codec import Codec, checksum, decode
from testbed.mavlink.signing import Signing

KEY = bytes(range(32))


def old_frame(number=1):
    """A HEARTBEAT of MAVLink 1."""
    body = bytes([9, number, 1, 1, 0]) + bytes(9)
    return b"\xfe" + body + checksum(body + bytes([50])).to_bytes(2, "little")


def of_another_dialect(payload=b"abc"):
    """A frame of a message that the dialect lacks: its checksum cannot be computed."""
    number = next(k for k in range(60_000, 70_000) if k not in load_messages())
    head = bytes([0xFD, len(payload), 0, 0, 7, 3, 1]) + number.to_bytes(3, "little")
    return head + payload + b"\x12\x34"


def frames():
    signed = Codec(2, 1, Signing(KEY, time=1))
    return [attitude(1), old_frame(), attitude(2, signed), attitude(3), of_another_dialect()]


def test_a_datagram_is_cut_at_its_frames():
    each = frames()
    units = cut_datagram(b"".join(each))
    assert [unit.data for unit in units] == each
    assert [(f.system, message_name(f.message), f.known) for u in units for f in u.frames] == [
        (1, "ATTITUDE", True),
        (1, "HEARTBEAT", True),
        (2, "ATTITUDE", True),
        (1, "ATTITUDE", True),
        (3, f"message {units[-1].frames[0].message}", False),
    ]
    for unit, frame in zip(units, each, strict=True):
        assert (unit.frames[0].begin, unit.frames[0].end) == (0, len(frame))


@pytest.mark.parametrize("noise", [b"hello", b"\xfd", b"\xfe\xfe\xfe", b"\xfd\xff\x00 no frame"])
def test_what_is_no_frame_is_a_unit_between(noise):
    one, other = attitude(1), attitude(2)
    units = cut_datagram(noise + one + noise + other + noise)
    assert [unit.data for unit in units] == [noise, one, noise, other, noise]
    assert [len(unit.frames) for unit in units] == [0, 1, 0, 1, 0]


def test_a_wrong_checksum_is_no_frame():
    frame = bytearray(attitude(1))
    frame[12] ^= 1
    assert find_frames(bytes(frame))[0] == [] and decode(bytes(frame)) is None
    assert len(cut_datagram(bytes(frame))) == 1


def pieces(data, rng):
    at = 0
    while at < len(data):
        size = rng.choice((1, 2, 7, 40, 300))
        yield data[at : at + size]
        at += size


@pytest.mark.parametrize("seed", range(20))
def test_no_byte_is_lost_changed_or_moved(seed):
    """Of frames, damaged frames and noise, as datagrams and as a line in any pieces."""
    rng, good = random.Random(seed), frames()
    parts = [rng.choice(good) for _ in range(60)]
    parts = [broken(each, rng) if rng.random() < 0.5 else each for each in parts]
    for part in parts:
        assert b"".join(unit.data for unit in cut_datagram(part)) == part
    data, cutter, found = b"".join(parts), StreamCutter(), []
    for piece in pieces(data, rng):
        found += cutter.feed(piece)
    found += cutter.flush()
    assert b"".join(unit.data for unit in found) == data and not cutter.is_waiting
    known = [unit.data for unit in found for frame in unit.frames if frame.known]
    assert all(map(decode, known))
    # what a receiver reads from the whole line is in units of their own, but for a frame that lies
    # in noise with the head of an unknown message
    read = [message.frame for message in Codec(255, 1).feed(data, datagram=True)]
    assert len(read) >= 10 and 0.9 * len(read) <= len(known) <= len(read)


def test_a_line_waits_for_the_rest_of_a_frame():
    cutter, frame = StreamCutter(), attitude(1)
    assert cutter.feed(b"text" + frame[:20])[0].data == b"text" and cutter.is_waiting
    (unit,) = cutter.feed(frame[20:])
    assert unit.data == frame and unit.frames and not cutter.is_waiting
    assert cutter.feed(b"\xfd\xff") == [] and cutter.is_waiting
    assert [each.data for each in cutter.flush()] == [b"\xfd\xff"]
    # a frame behind a marker that begins none comes out at last
    assert cutter.feed(b"\xfd\xff" + frame) == []
    assert [each.data for each in cutter.flush()] == [b"\xfd\xff", frame]
