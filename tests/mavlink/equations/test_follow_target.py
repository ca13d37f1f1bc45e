"""FOLLOW_TARGET frames equal those of the codec, and error detection of the checksum.

TESTBED_FRAMES sets the number of damaged frames: a hundred times as many.
"""

import os
from fractions import Fraction
from math import comb

import numpy as np
import pytest
from cases import ALL
from reference.frames import rotation_ned_body
from scipy.stats import binomtest, chisquare

from testbed.core.frames import (
    body_rates,
    euler_from_quaternion,
    quaternion_xyzw,
)
from testbed.core.geodetic import geodetic_from_ned, ned_from_geodetic
from testbed.core.records import Broadcast, NedOrigin
from testbed.mavlink.codec import Codec, decode
from testbed.mavlink.follow_target import (
    BEGIN_MS,
    FRAME,
    LENGTH,
    FollowTarget,
    checksum,
)
from testbed.network.encoding import flip_bits
from testbed.network.philox import key_of
from testbed.scenario.network import Network

DAMAGED = 100 * int(os.environ.get("TESTBED_FRAMES", "4000"))
CHUNK = 1 << 16
LEVEL = 0.01 / 4  # of significance; four statistical tests
ORIGINS = [NedOrigin(), NedOrigin(-35.5, 149.25, 584.0), NedOrigin(51.0, -179.999, -20.0)]


def broadcasts(rng, count):
    """Make broadcasts of aircraft within 2 km, in any attitude but near vertical."""
    vectors = [rng.normal(0.0, each, (count, 3)) for each in (700.0, 25.0, 4.0)]
    euler = rng.uniform(-1.0, 1.0, (count, 3)) * [np.pi, 1.5, np.pi]
    return Broadcast(np.floor(rng.uniform(0, 4e6, count)) / 1000, *vectors, euler, rng.normal(
        0.0, 1.0, (count, 3)))  # fmt: skip


def packed(rng, count, origin=ORIGINS[0]):
    message = broadcasts(rng, count)
    rows = np.arange(count) % 255
    return message, FollowTarget(origin).pack(message, rows, rows + 200)


def decoded(frame):
    message = decode(frame.tobytes())
    return message if message and message.name == "FOLLOW_TARGET" else None


def test_frame_length_is_that_of_the_scenario():
    network = Network.model_validate({"encoding": "follow-target"})
    rng = np.random.default_rng(1)
    assert packed(rng, 3)[1].shape == (3, network.sent_bytes)
    assert LENGTH == network.sent_bytes
    assert Network().sent_bytes == Network().message_bytes


@pytest.mark.parametrize("origin", ORIGINS)
def test_packed_frames_equal_those_of_the_codec(origin):
    """Every field is computed here for each broadcast."""
    message, frames = packed(np.random.default_rng(2), 200, origin)
    place = geodetic_from_ned(message.position_ned, origin)
    attitude = quaternion_xyzw(message.euler)
    rates = body_rates(message.euler, message.euler_rates)
    for k, frame in enumerate(frames):
        codec = Codec(k % 255 + 1, 1)
        for _ in range((k % 255 + 200) % 256):
            codec.pack("PING", time_usec=0, seq=0, target_system=0, target_component=0)
        theirs = codec.pack(
            "FOLLOW_TARGET",
            timestamp=round(message.stamp_s[k] * 1000) + BEGIN_MS,
            custom_state=0,
            lat=round(float(place[k, 0]) * 1e7),
            lon=round(((float(place[k, 1]) + 180.0) % 360.0 - 180.0) * 1e7),
            alt=place[k, 2],
            vel=message.velocity_ned[k].tolist(),
            acc=message.acceleration_ned[k].tolist(),
            attitude_q=[attitude[k, 3], *attitude[k, :3]],
            rates=rates[k].tolist(),
            position_cov=[0.0] * 3,
            est_capabilities=15,
        )
        assert frame.tobytes() == theirs


@pytest.mark.parametrize("origin", ORIGINS)
def test_unpacked_broadcast_is_the_packed_one(origin):
    message, frames = packed(np.random.default_rng(3), 500, origin)
    read, rows, good = FollowTarget(origin).unpack(frames)
    assert good.all()
    assert np.array_equal(rows, np.arange(500) % 255)
    assert np.array_equal(read.stamp_s, message.stamp_s)
    off = np.abs(read.position_ned - message.position_ned)
    # half of 1e-7 degrees of 111 km each at most; half of a float's last digit at 600 m to 4 km
    assert 0.005 < off[:, :2].max() < 0.5e-7 * 111.7e3
    assert off[:, 2].max() < 2.0**-13
    for name in ("velocity_ned", "acceleration_ned"):
        assert np.array_equal(getattr(read, name), getattr(message, name).astype(np.float32))
    # angles beside a pitch of 86° magnify 32-bit numbers by 1 / cos: compared as rotations
    turned = np.abs(rotation_ned_body(read.euler) - rotation_ned_body(message.euler))
    assert turned.max() < 1e-6
    again = body_rates(read.euler, read.euler_rates)
    assert np.abs(again - body_rates(message.euler, message.euler_rates)).max() < 1e-6


def test_stamp_is_truncated_to_milliseconds():
    # steps of 9 have all fractions of a second, too
    ticks = np.arange(0, 200_000, 1 if ALL else 9) / 200.0
    fine = np.array([0.0009, 12.3456789, 99.9999])
    times = np.concatenate([ticks, fine, [-3600.0, -0.0001]])
    nothing = np.zeros((len(times), 3))
    converter, rows = FollowTarget(NedOrigin()), np.zeros(len(times), np.int64)
    read = converter.unpack(converter.pack(Broadcast(times, *[nothing] * 5), rows, rows))[0].stamp_s
    assert np.array_equal(read[: len(ticks)], ticks)
    assert read[len(ticks) :].tolist() == [0.0, 12.345, 99.999, -3600.0, -0.001]


def test_geodetic_and_ned_are_inverse():
    rng = np.random.default_rng(4)
    for origin in ORIGINS:
        ned = rng.normal(0.0, 3000.0, (100, 3))
        back = ned_from_geodetic(geodetic_from_ned(ned, origin), origin)
        assert back == pytest.approx(ned, abs=1e-6)  # 1e-14 of 180° is 2e-7 m
    across = ned_from_geodetic(np.array([51.0, 179.999, 0.0]), NedOrigin(51.0, -179.999, 0.0))
    assert across[1] == pytest.approx(-0.002 * 111_320 * np.cos(np.radians(51.0)), rel=3e-3)


def test_euler_of_quaternion_of_any_norm():
    rng = np.random.default_rng(5)
    euler = broadcasts(rng, 300).euler
    lengths = np.exp(rng.uniform(-20, 20, (300, 1)))
    back = euler_from_quaternion(quaternion_xyzw(euler) * lengths)
    assert back == pytest.approx(euler, abs=1e-12)
    assert np.isnan(euler_from_quaternion(np.zeros(4))[1])


# the checksum


def test_checksum_finds_every_single_bit_error():
    """Test every bit, in arrays and with the codec."""
    converter = FollowTarget(NedOrigin())
    _, frames = packed(np.random.default_rng(6), 1)
    wrong = frames ^ np.packbits(np.eye(8 * LENGTH, dtype=bool), axis=1)
    assert not converter.unpack(wrong)[2].any()
    for frame in wrong:
        assert decode(frame.tobytes()) is None
        assert not Codec(9, 1).feed(frame.tobytes(), datagram=True)


def test_checksum_finds_double_and_odd_errors():
    """Each bit has a different effect on the checksum, of an odd number of bits.

    x^16 + x^12 + x^5 + 1 has the factor x + 1, so its multiples have an even number of bits.
    """
    _, frames = packed(np.random.default_rng(7), 1)
    summed = np.packbits(np.eye(8 * LENGTH, dtype=bool)[8:-16], axis=1)
    changes = checksum(frames ^ summed) ^ checksum(frames)
    changes = np.concatenate([changes, np.uint16(1) << np.arange(16, dtype=np.uint16)])
    assert len(changes) == 8 * LENGTH - 8
    assert len(set(changes.tolist())) == len(changes)
    assert all(change.bit_count() % 2 for change in changes.tolist())


def test_any_payload_is_unpacked_like_the_codec():
    """Any bytes with the right checksum, including NaN."""
    rng = np.random.default_rng(8)
    converter = FollowTarget(NedOrigin())
    _, frames = packed(rng, 400)
    frames[:, 10:-2] = rng.integers(0, 256, (400, LENGTH - 12))
    frames[:, -3] |= 1  # a last byte of zero would be truncated
    floats = frames[:, 34:102].copy().view("<u4")
    floats[:100] |= 0x7F800000  # exponents of infinities and NaN,
    floats[:50] &= 0xFFBFFFFF  # half of these signalling
    frames[:, 34:102] = floats.view(np.uint8)
    frames.view(FRAME)["checksum"][:, 0] = checksum(frames)
    read, rows, good = converter.unpack(frames)
    assert good.all()
    for k, frame in enumerate(frames):
        message = decoded(frame)
        assert message.system == rows[k] + 1
        assert read.stamp_s[k] == (float(message.fields["timestamp"]) - BEGIN_MS) / 1000
        for name, ours in (("vel", read.velocity_ned), ("acc", read.acceleration_ned)):
            np.testing.assert_array_equal(ours[k], message.fields[name])
        place = [message.fields["lat"] / 1e7, message.fields["lon"] / 1e7, message.fields["alt"]]
        np.testing.assert_array_equal(
            read.position_ned[k], ned_from_geodetic(np.array(place), NedOrigin())
        )


def test_frames_of_other_messages_are_rejected():
    converter = FollowTarget(NedOrigin())
    _, frames = packed(np.random.default_rng(9), 5)
    heads = frames.view(FRAME)[:, 0]
    heads["magic"][0], heads["length"][1], heads["incompat_flags"][2] = 0xFE, 92, 1
    heads["number"][3, 0], heads["number"][4, 1] = 32, 1
    heads["checksum"] = checksum(frames)  # right with this message's seed
    assert not converter.unpack(frames)[2].any()
    assert not any(decoded(frame) for frame in frames)


def chunks(count):
    """Yield (first number, count) of frames tested together."""
    return [(at, min(CHUNK, count - at)) for at in range(0, count, CHUNK)]


def test_checksum_passes_one_in_65536_of_noise():
    converter = FollowTarget(NedOrigin())
    _, frames = packed(np.random.default_rng(10), 1)
    rng = np.random.default_rng(11)
    passed = 0
    for _, count in chunks(DAMAGED):
        noise = np.repeat(frames, count, axis=0)
        noise[:, 10:] = rng.integers(0, 256, (count, LENGTH - 10), dtype=np.uint8)
        sums = noise[:, -2].astype(np.uint16) | noise[:, -1].astype(np.uint16) << 8
        right = np.flatnonzero(checksum(noise) == sums)
        assert converter.unpack(noise[right])[2].all()
        assert all(decoded(frame) for frame in noise[right] if frame[-3])
        passed += len(right)
    assert binomtest(passed, DAMAGED, 2.0**-16).pvalue > LEVEL


@pytest.mark.parametrize("bits", [7, 8])
def test_checksum_pass_rate_by_number_of_errors(bits):
    """Pass 2^-15 of those with intact start, length, flags and message id."""
    converter = FollowTarget(NedOrigin())
    _, frames = packed(np.random.default_rng(12), 1)
    tried, passed = DAMAGED // 4, 0
    key = np.array([key_of(3, "damage")], dtype=np.uint64)
    for first, count in chunks(tried):
        number = np.arange(first, first + count)
        wrong = flip_bits(
            np.repeat(frames, count, axis=0),
            np.full(count, frames.shape[1]),
            np.full(count, bits),
            np.repeat(key, count, axis=0),
            number,
            np.zeros(count, np.int64),
        )
        passed += int(converter.unpack(wrong)[2].sum())
    touched = 8 * (1 + 1 + 1 + 3)
    untouched = Fraction(comb(8 * LENGTH - touched, bits), comb(8 * LENGTH, bits))
    if bits % 2:
        assert passed == 0
    else:
        assert binomtest(passed, tried, float(untouched) / 2**15).pvalue > LEVEL


def test_flipped_bits_are_uniform():
    rng = np.random.default_rng(13)
    count = 6000 if ALL else 2400
    frames = rng.integers(0, 256, (count, LENGTH), dtype=np.uint8)
    bits = rng.choice([1, 2, 9, 839, 840], count)
    keys = rng.integers(0, 2**32, (count, 2), dtype=np.uint64)
    number, copy = rng.integers(0, 1000, count), rng.integers(0, 2, count)
    length = np.full(count, frames.shape[1])
    turned = np.unpackbits(flip_bits(frames, length, bits, keys, number, copy) ^ frames, axis=1)
    assert np.array_equal(turned.sum(axis=1), bits)
    few = turned[bits < 100].sum(axis=0)
    assert chisquare(few).pvalue > LEVEL
    # where all but one are flipped, that one is uniform, too
    left = 1 - turned[bits == 839]
    assert chisquare(left.sum(axis=0).reshape(20, 42).sum(axis=1)).pvalue > LEVEL
    some = np.arange(0, count, 7)
    others = bits[some], keys[some], number[some], copy[some]
    alone = flip_bits(frames[some], length[some], *others)
    assert np.array_equal(np.unpackbits(alone ^ frames[some], axis=1), turned[some])
