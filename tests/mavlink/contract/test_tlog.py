"""Telemetry logs: written, read, compared with pymavlink, and damaged."""

import random
from contextlib import closing

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from testbed.mavlink.codec import Codec, MavlinkError
from testbed.mavlink.signing import Signing
from testbed.mavlink.tlog import Tlog, TlogWriter

START = 1_700_000_000_000_000


def frames(count, codec=None):
    codec = codec or Codec(3, 1)
    return [
        codec.pack("SYSTEM_TIME", time_unix_usec=START + k, time_boot_ms=40 * k)
        for k in range(count)
    ]


def written(path, packed):
    with closing(TlogWriter(path)) as log:
        for k, frame in enumerate(packed):
            log.write(START + 40_000 * k, frame)
    return path


def boots(log):
    return [message.fields["time_boot_ms"] // 40 for _, message in log]


def test_tlog_reads_what_was_written(tmp_path):
    packed = frames(50)
    path = written(tmp_path / "run.tlog", packed)
    log = Tlog(path)
    assert [time for time, _ in log] == [START + 40_000 * k for k in range(50)]
    assert boots(log) == list(range(50))
    assert (log.unread, log.damaged, log.cut) == (0, 0, 0)
    # and pymavlink reads the frame
    data, parser = path.read_bytes(), dialect.MAVLink(None)
    assert data[:8] == START.to_bytes(8, "big")
    assert parser.decode(bytearray(data[8 : 8 + len(packed[0])])).time_boot_ms == 0


def test_tlog_reads_both_versions_and_signed(tmp_path):
    sender = dialect.MAVLink(None, 3, 1)
    old = dialect.MAVLink_system_time_message(START, 40).pack(sender, force_mavlink1=True)
    signed = frames(1, Codec(3, 1, Signing(b"k" * 32)))
    assert boots(Tlog(written(tmp_path / "a.tlog", [old, *signed]))) == [1, 0]


@pytest.mark.parametrize("missing", [1, 5, 21, 22, 24, 30, 31])
def test_tlog_cut_end_loses_one_record(tmp_path, missing):
    path = written(tmp_path / "a.tlog", frames(20))
    data = path.read_bytes()
    path.write_bytes(data[:-missing])
    last = 8 + len(frames(20)[-1])
    assert last == 30
    log = Tlog(path)
    assert boots(log) == list(range(19 if missing <= last else 18))
    assert log.cut == (last - missing) % last
    assert log.damaged == 0


def test_tlog_damage_loses_only_its_record(tmp_path):
    path = written(tmp_path / "a.tlog", frames(20))
    rng = random.Random(1)
    good = path.read_bytes()
    lengths = [8 + len(frame) for frame in frames(20)]
    begin = sum(lengths[:10])
    noise = bytes(rng.choice(b"\xfd\xfe\x00\xff") for _ in range(100))
    path.write_bytes(good[:begin] + noise + good[begin:])
    log = Tlog(path)
    assert boots(log) == list(range(20))
    assert (log.unread, log.damaged) == (0, 100)
    flipped = bytearray(good)
    flipped[begin + 20] ^= 0xFF
    path.write_bytes(flipped)
    log = Tlog(path)
    assert boots(log) == [k for k in range(20) if k != 10]
    assert (log.unread, log.damaged) == (1, 0)


def test_tlog_unknown_messages_are_skipped(tmp_path):
    known = frames(2)
    strange = bytes([0xFD, 4, 0, 0, 0, 3, 1, 0xFF, 0xFF, 0x7F]) + b"what" + b"ab"
    log = Tlog(written(tmp_path / "a.tlog", [known[0], strange, known[1]]))
    assert boots(log) == [0, 1]
    assert (log.unread, log.damaged) == (1, 0)


def test_tlog_random_damage_never_raises(tmp_path):
    rng = random.Random(2)
    good = written(tmp_path / "a.tlog", frames(30)).read_bytes()
    for _ in range(200):
        data = bytearray(good[: rng.randrange(len(good))])
        for _ in range(rng.randrange(8)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        (tmp_path / "b.tlog").write_bytes(data)
        log = Tlog(tmp_path / "b.tlog")
        read = sum(8 + len(frames(30)[k]) for k in boots(log) if k < 30)
        assert read + log.damaged + log.cut <= len(data)


def test_tlog_unusable_file_is_an_error(tmp_path):
    with pytest.raises(MavlinkError, match="nothing.tlog"):
        Tlog(tmp_path / "nothing.tlog")
    with pytest.raises(MavlinkError, match="cannot be written"):
        TlogWriter(tmp_path)
