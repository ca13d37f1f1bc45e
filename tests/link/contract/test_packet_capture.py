"""Recordings of both ends: a second reader of .pcap, telemetry logs, and a full disk."""

import errno
import os
import struct

import pytest
from link_loop import LinkLoop, attitude, make_settings

from testbed.core.errors import InputError
from testbed.link.ends import parse_end
from testbed.link.packet_capture import EndCapture, PcapWriter, socket_of
from testbed.mavlink.codec import decode
from testbed.mavlink.tlog import Tlog

SOCKETS = (bytes([127, 0, 0, 1]), 14555), (bytes([127, 0, 0, 1]), 14550)


def read_pcap(path):
    """Yield time in ns, source and destination port, and content: by the format's description."""
    data = path.read_bytes()
    magic, major, minor, _, _, longest, link = struct.unpack_from("<IHHiIII", data)
    assert (magic, major, minor, link) == (0xA1B23C4D, 2, 4, 228)
    at = 24
    while at < len(data):
        seconds, ns, kept, length = struct.unpack_from("<IIII", data, at)
        packet = data[at + 16 : at + 16 + kept]
        at += 16 + kept
        assert kept == length == len(packet) <= longest
        assert packet[0] == 0x45 and packet[9] == 17
        assert struct.unpack_from(">H", packet, 2)[0] == length
        total = sum(struct.unpack_from(">10H", packet))
        while total > 0xFFFF:
            total = (total & 0xFFFF) + (total >> 16)
        assert total == 0xFFFF  # the header with its checksum
        source, destination, size, _ = struct.unpack_from(">HHHH", packet, 20)
        assert size == length - 20
        yield seconds * 10**9 + ns, source, destination, packet[28:]


def test_both_ends_are_recorded(tmp_path):
    """What a sends is in its files, and what arrives in those of b, a delay later."""
    files = [[tmp_path / f"{end}.{kind}" for kind in ("pcap", "tlog")] for end in "ab"]
    captures = [EndCapture((SOCKETS[k], SOCKETS[1 - k]), *files[k], pytest.fail) for k in range(2)]
    settings = make_settings("network.loss=0.3", "network.delay_s=0.05", unit="frames")
    frames = [attitude(k) for k in range(40)]
    with LinkLoop(settings, captures) as loop:
        arrived = loop.carry([*frames, b"no frame"])
        answered = loop.carry([attitude(99)] * 3, end=1)
    for capture in captures:
        capture.close()
    at_a, at_b = (list(read_pcap(pair[0])) for pair in files)
    assert [data for _, source, _, data in at_a if source == 14555] == [*frames, b"no frame"]
    assert [data for _, source, _, data in at_b if source == 14555] == arrived
    assert [data for _, source, _, data in at_a if source == 14550] == answered
    sent = {data: time for time, _, _, data in at_a}
    delays = [1e-9 * (time - sent[data]) for time, source, _, data in at_b if source == 14555]
    assert min(delays) >= 0.05 and len(delays) == len(arrived) < 41
    good = [each for each in arrived if decode(each)]
    for pair, expected in zip(files, (frames, good), strict=True):
        log = Tlog(pair[1])
        read = [message.frame for _, message in log]
        assert [each for each in read if each != attitude(99)] == expected
        assert (log.damaged, log.cut, log.unread) == (0, 0, 0)


def test_sockets_stand_for_ends():
    assert socket_of(parse_end("udpin:127.0.0.1:5000"), 0) == (bytes([127, 0, 0, 1]), 5000)
    assert socket_of(parse_end("udpout:10.1.2.3:5000"), 1) == (bytes([10, 1, 2, 3]), 5000)
    assert socket_of(parse_end("udpout:a.name:5000"), 1)[0] == bytes([127, 0, 0, 1])
    assert socket_of(parse_end("pty:"), 0) != socket_of(parse_end("pty:"), 1)


def test_the_longest_packet_is_cut(tmp_path):
    writer = PcapWriter(tmp_path / "it.pcap")
    writer.write(1, *SOCKETS, bytes(65_535))
    writer.close()
    ((_, _, _, data),) = read_pcap(tmp_path / "it.pcap")
    assert len(data) == 65_507


def test_a_full_disk_ends_the_recording_only(tmp_path):
    warnings = []
    capture = EndCapture(SOCKETS, tmp_path / "it.pcap", tmp_path / "it.tlog", warnings.append)

    class FullDisk:
        def __init__(self, file):
            self.close = file.close

        def write(self, data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    capture._pcap._file = FullDisk(capture._pcap._file)
    for k in range(1000):
        capture.record(k, attitude(k), sent_here=True)
    capture.close()
    (warning,) = warnings
    assert "it.pcap: cannot be written: No space left on device" in warning
    assert "the link goes on" in warning
    assert len(list(Tlog(tmp_path / "it.tlog"))) == 1000


def test_a_file_that_cannot_be_made_is_an_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        EndCapture(SOCKETS, tmp_path / "nowhere" / "it.pcap", None, print)
