"""Ends of a link: addresses, serial lines and pseudo-terminals."""

import errno
import os
import pty
import re
import time
import tty

import pytest

from testbed.core.errors import ExternalProgramLost, InputError
from testbed.link.ends import MAX_OUTPUT_BYTES, check_apart, open_end, parse_end


@pytest.mark.parametrize(
    ("text", "stream", "may_reach"),
    [
        ("udpin:127.0.0.1:14550", False, False),
        ("udpout:localhost:14550", False, False),
        ("udpin::14550", False, False),
        ("udpin:0.0.0.0:14550", False, True),
        ("udpout:192.168.4.1:14550", False, True),
        ("serial:/dev/ttyUSB0:57600", True, True),
        ("pty:", True, False),
        ("pty:here/radio", True, False),
    ],
)
def test_an_address_says_what_it_may_reach(text, stream, may_reach):
    address = parse_end(text)
    assert (address.is_stream, address.may_reach_aircraft) == (stream, may_reach)
    assert str(parse_end(str(address))) == str(address)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("14550", "write udpin:HOST:PORT to listen there"),
        ("tcp:127.0.0.1:5760", "is no end of a link"),
        ("udpin:127.0.0.1:0", "give one of 1 to 65535"),
        ("udpin:127.0.0.1:14550+10", "leave +10 out"),
        ("serial:/dev/ttyUSB0", "write serial:DEVICE:BAUD"),
        ("serial:/dev/ttyUSB0:57601", "write one of 9600, 19200, 38400, 57600"),
        ("serial::57600", "write serial:DEVICE:BAUD"),
        ("serial:/dev/ttyUSB0:５７６００", "write serial:DEVICE:BAUD"),
    ],
)
def test_a_wrong_address_says_what_to_write(text, said):
    with pytest.raises(InputError, match=re.escape(said)):
        parse_end(text)


@pytest.mark.parametrize(
    ("one", "other", "refused"),
    [
        ("udpin:127.0.0.1:5000", "udpout:127.0.0.1:5000", True),
        ("udpout:localhost:5000", "udpin:127.0.0.1:5000", True),
        ("udpin:0.0.0.0:5000", "udpout:10.1.2.3:5000", True),
        ("udpin:127.0.0.1:5000", "udpout:127.0.0.1:5001", False),
        ("udpin:127.0.0.1:5000", "udpout:10.1.2.3:5000", False),
        ("udpout:127.0.0.1:5000", "udpout:127.0.0.1:5000", False),
        ("udpin:127.0.0.1:5000", "pty:", False),
    ],
)
def test_packets_that_would_go_round_are_refused(one, other, refused):
    ends = parse_end(one), parse_end(other)
    if refused:
        with pytest.raises(InputError, match="go round for ever; write the port of a program"):
            check_apart(*ends)
    else:
        check_apart(*ends)


@pytest.mark.parametrize("device", ["nothing", "file", "fifo", "/dev/null"])
def test_what_is_no_serial_device_is_refused(device, tmp_path):
    """A pipe is not waited for."""
    (tmp_path / "file").write_text("a")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(InputError, match=r"serial:.*(No such file|is no device|serial device)"):
        open_end(parse_end(f"serial:{tmp_path / device}:57600"))


def received(end):
    return b"".join(data for data, _ in end.receive(64))


def test_a_pseudo_terminal_carries_all_bytes_both_ways(tmp_path):
    path, every = tmp_path / "radio", bytes(range(256))
    end = open_end(parse_end(f"pty:{path}"))
    try:
        assert end.describe() == f"serial device {path}"
        program = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(program, every)
        assert received(end) == every and received(end) == b""
        end.send(every)
        assert os.read(program, 1000) == every
        os.close(program)
        assert received(end) == b""  # the program is gone, and may come again
    finally:
        end.close()
    assert not path.is_symlink()


def test_a_program_that_is_slow_loses_whole_packets(tmp_path):
    end = open_end(parse_end("pty:"))
    try:
        for _ in range(1000):
            end.send(bytes(100))
        assert end.has_output and 500 < end.dropped < 1000
        device = end.describe().removeprefix("serial device ")
        program = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        got, nothing = 0, 0
        while nothing < 20:
            try:
                got, nothing = got + len(os.read(program, 1 << 16)), 0
            except BlockingIOError:
                nothing += 1
                time.sleep(0.005)
            end.flush()
        assert not end.has_output
        assert got == 100 * (1000 - end.dropped) and got >= MAX_OUTPUT_BYTES - 100
        os.close(program)
    finally:
        end.close()


def test_a_path_that_exists_is_not_replaced(tmp_path):
    (tmp_path / "radio").write_text("mine")
    with pytest.raises(InputError, match="exists; remove it"):
        open_end(parse_end(f"pty:{tmp_path / 'radio'}"))
    assert (tmp_path / "radio").read_text() == "mine"


def test_a_serial_device_that_is_unplugged_is_an_error():
    """A pseudo-terminal stands for the device; its other side is closed."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    end = open_end(parse_end(f"serial:{os.ttyname(theirs)}:57600"))
    try:
        os.write(ours, b"\xfd\x00\r\n\x03")
        assert received(end) == b"\xfd\x00\r\n\x03"
        end.send(b"\x11\x13\n")
        assert os.read(ours, 100) == b"\x11\x13\n"
        os.close(ours)
        with pytest.raises(ExternalProgramLost, match=r"serial:.*:57600: the device is gone"):
            for _ in range(3):
                received(end)
    finally:
        end.close()
        os.close(theirs)


@pytest.mark.parametrize("number", [errno.EIO, errno.ENXIO, errno.ENODEV])
@pytest.mark.parametrize("call", ["read", "write"])
def test_errors_of_a_device_that_is_gone_are_told(call, number, monkeypatch):
    """Else the loop would turn without an end; that nothing is there now is no error."""
    end = open_end(parse_end("pty:"))

    def fail_with(reason):
        def fail(*_):
            raise OSError(reason, os.strerror(reason))

        monkeypatch.setattr(f"testbed.link.ends.os.{call}", fail)

    try:
        fail_with(errno.EAGAIN)
        end.send(b"a")
        assert received(end) == b""
        fail_with(number)
        with pytest.raises(ExternalProgramLost, match="the device is gone: .*; connect it again"):
            received(end) if call == "read" else end.send(b"b")
    finally:
        monkeypatch.undo()
        end.close()
