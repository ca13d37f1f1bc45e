"""Frames compared with those of pymavlink, and signatures with the specification."""

import hashlib
import math
import random
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from testbed.mavlink.codec import Codec, MavlinkError, constant, decode
from testbed.mavlink.signing import Signing, signing_time

SEED = 20261121
HEARTBEAT = {
    "type": 1,
    "autopilot": 3,
    "base_mode": 81,
    "custom_mode": 5,
    "system_status": 4,
    "mavlink_version": 3,
}
INTEGERS = {"int8_t": 8, "uint8_t": 8, "int16_t": 16, "uint16_t": 16, "int32_t": 32, "uint32_t": 32}
INTEGERS |= {"int64_t": 64, "uint64_t": 64}
DEFINITIONS = sorted(dialect.mavlink_map.values(), key=lambda kind: kind.id)


def random_value(rng, kind, count):
    """Make a random value of a field, as it is unpacked."""

    def one():
        if kind in INTEGERS:
            low = 0 if kind.startswith("u") else -(2 ** (INTEGERS[kind] - 1))
            return rng.randrange(low, low + 2 ** INTEGERS[kind])
        value = rng.uniform(-1e6, 1e6)
        return value if kind == "double" else struct.unpack("<f", struct.pack("<f", value))[0]

    if kind == "char":
        return "".join(rng.choice("abcXYZ019_ ") for _ in range(rng.randrange(max(count, 1)))) + "e"
    return tuple(one() for _ in range(count)) if count else one()


def random_fields(rng, kind):
    counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return {
        name: random_value(rng, of, counts[name])
        for name, of in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    }


def pack_with_pymavlink(kind, fields, sender, **how):
    values = [v.encode() if isinstance(v, str) else v for v in fields.values()]
    return kind(*values).pack(sender, **how)


def pymavlink_sender(system, component, sequence=0):
    mavlink = dialect.MAVLink(None, system, component)
    mavlink.seq = sequence
    return mavlink


@pytest.mark.parametrize("first", range(0, len(DEFINITIONS), 50))
def test_every_message_agrees_with_pymavlink(first):
    rng = random.Random(SEED + first)
    for kind in DEFINITIONS[first : first + 50]:
        fields = random_fields(rng, kind)
        codec = Codec(7, 42)
        frame = codec.pack(kind.msgname, **fields)
        assert frame == pack_with_pymavlink(kind, fields, pymavlink_sender(7, 42)), kind.msgname
        (found,) = codec.feed(frame, datagram=True)
        assert (found.name, found.system, found.component) == (kind.msgname, 7, 42)
        assert found.fields == fields, kind.msgname
        assert codec.skipped == 0
        if kind.id < 256:
            old = decode(
                pack_with_pymavlink(kind, fields, pymavlink_sender(7, 42), force_mavlink1=True)
            )
            assert (old.name, old.system, old.fields) == (kind.msgname, 7, fields)


def test_trailing_zeros_are_truncated():
    codec = Codec(1, 1)
    text = codec.pack("STATUSTEXT", severity=6, text="up")
    assert len(text) == 10 + 3 + 2
    (found,) = codec.feed(text)
    assert found.fields == {"severity": 6, "text": "up", "id": 0, "chunk_seq": 0}
    nothing = codec.pack("SYSTEM_TIME", time_unix_usec=0, time_boot_ms=0)
    assert len(nothing) == 10 + 1 + 2


def test_sequence_numbers_wrap():
    codec = Codec(1, 1)
    frames = b"".join(codec.pack("HEARTBEAT", **HEARTBEAT) for _ in range(300))
    assert [m.sequence for m in Codec(2, 1).feed(frames)] == [k % 256 for k in range(300)]


def test_nan_and_inf_are_transferred():
    hud = dict(airspeed=math.nan, groundspeed=math.inf, heading=0, throttle=0, alt=0, climb=0)
    (found,) = Codec(2, 1).feed(Codec(1, 1).pack("VFR_HUD", **hud))
    assert math.isnan(found.fields["airspeed"])
    assert found.number("groundspeed") == math.inf


def test_short_buffers_are_padded_arrays_are_not():
    codec = Codec(1, 1)
    ftp = dict(target_network=0, target_system=1, target_component=1)
    (found,) = codec.feed(codec.pack("FILE_TRANSFER_PROTOCOL", **ftp, payload=b"\1\2"))
    assert found.fields["payload"] == (1, 2, *[0] * 249)
    with pytest.raises(MavlinkError, match=r"ACTUATOR_CONTROL_TARGET.controls: .* float\[8\]"):
        codec.pack("ACTUATOR_CONTROL_TARGET", time_usec=0, group_mlx=0, controls=[1.0, 2.0])


@pytest.mark.parametrize(
    ("name", "changes", "text"),
    [
        ("HEARTBEET", {}, "did you mean HEARTBEAT"),
        ("HEARTBEAT", {"colour": 1}, "HEARTBEAT: no field colour; its fields are"),
        ("HEARTBEAT", {"type": None}, "type missing"),
        ("HEARTBEAT", {"type": 300}, "HEARTBEAT.type: 300 does not fit uint8_t"),
        ("HEARTBEAT", {"type": 1.5}, "HEARTBEAT.type: 1.5 does not fit uint8_t"),
        ("STATUSTEXT", {"severity": 1, "text": "é" * 26}, "52 bytes"),
    ],
)
def test_unpackable_message_is_an_error(name, changes, text):
    fields = (HEARTBEAT if name == "HEARTBEAT" else {}) | changes
    codec = Codec(1, 1)
    with pytest.raises(MavlinkError, match=text):
        codec.pack(name, **{k: v for k, v in fields.items() if v is not None})
    # and uses no sequence number
    assert codec.feed(codec.pack("HEARTBEAT", **HEARTBEAT))[0].sequence == 0


def test_systems_and_constants_are_checked():
    for system, component in ((0, 1), (256, 1), (1, 0)):
        with pytest.raises(MavlinkError, match="1 to 255"):
            Codec(system, component)
    assert constant("MAV_TYPE_FIXED_WING") == 1
    with pytest.raises(MavlinkError, match="MAV_TYPE_BROOM"):
        constant("MAV_TYPE_BROOM")


KEY = bytes(range(32))


def test_signature_follows_the_specification():
    start = signing_time(1_700_000_000.0)
    assert start == (1_700_000_000 - 1_420_070_400) * 100_000
    codec = Codec(7, 1, Signing(KEY, link=3, time=start))
    frames = [codec.pack("HEARTBEAT", **HEARTBEAT) for _ in range(2)]
    for k, frame in enumerate(frames):
        assert frame[2] == 1
        assert frame[-13:-6] == bytes([3]) + struct.pack("<Q", start + k)[:6]
        assert frame[-6:] == hashlib.sha256(KEY + frame[:-6]).digest()[:6]
    parser = dialect.MAVLink(None, 1, 1)
    parser.signing.secret_key = KEY
    assert [m.get_signed() for m in parser.parse_buffer(b"".join(frames))] == [True, True]


def test_signatures_of_pymavlink_are_accepted():
    peer = pymavlink_sender(7, 1)
    peer.signing.secret_key, peer.signing.sign_outgoing = KEY, True
    peer.signing.timestamp = 5
    frame = dialect.MAVLink_heartbeat_message(1, 3, 81, 5, 4, 3).pack(peer)
    assert len(Codec(1, 1, Signing(KEY)).feed(frame)) == 1


def test_signed_codec_rejects_forged_and_replayed():
    def heartbeat(codec):
        return codec.pack("HEARTBEAT", **HEARTBEAT)

    receiver = Codec(1, 1, Signing(KEY, time=1000))
    peer = Codec(7, 1, Signing(KEY, time=2000))
    first, second = heartbeat(peer), heartbeat(peer)
    assert len(receiver.feed(heartbeat(Codec(7, 1)))) == 0
    assert len(receiver.feed(heartbeat(Codec(7, 1, Signing(bytes(32), time=9_000_000))))) == 0
    assert len(receiver.feed(second)) == 1
    assert len(receiver.feed(second)) == 0
    assert len(receiver.feed(first)) == 0
    assert receiver.rejected == {"unsigned": 1, "forged": 1, "replayed": 2}
    # a forged later time does not block the true sender
    assert len(receiver.feed(heartbeat(peer))) == 1
    # another link of the same sender has its own times
    assert len(receiver.feed(heartbeat(Codec(7, 1, Signing(KEY, link=1, time=1500))))) == 1
    # a frame that is sent back to its sender is not one of another sender
    assert len(receiver.feed(heartbeat(receiver))) == 0
    assert receiver.rejected["replayed"] == 3
    # without a key every frame is accepted
    assert len(Codec(1, 1).feed(first + second)) == 2


def test_first_signature_may_be_a_minute_old():
    now = 100_000_000
    for behind, accepted in ((6_000_000, 1), (6_000_001, 0)):
        peer = Codec(7, 1, Signing(KEY, time=now - behind))
        receiver = Codec(1, 1, Signing(KEY, time=now))
        assert len(receiver.feed(peer.pack("HEARTBEAT", **HEARTBEAT))) == accepted


@pytest.mark.parametrize(
    ("signing", "text"),
    [
        ({"key": b"short"}, "give 32"),
        ({"key": KEY, "link": 256}, "0 to 255"),
        ({"key": KEY, "time": 1 << 48}, "10 µs since 2015"),
    ],
)
def test_invalid_signing_is_an_error(signing, text):
    with pytest.raises(ValueError, match=text):
        Signing(**signing)


def test_key_is_not_in_repr():
    assert "key" not in repr(Signing(b"k" * 32))
