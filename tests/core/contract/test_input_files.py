"""Files from outside: size before reading, and nothing but regular files."""

import io
import os
import signal

import pytest
from rich.table import Table
from rich.text import Text

from testbed.airframes import airframe_validation
from testbed.autopilot.parameters import ParamError, read_params
from testbed.cli.output import PipeSafeConsole
from testbed.commissioning.command_files import CommandsError, read_commands
from testbed.core import csv_table
from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, ReadError, read_bounded, read_bounded_text
from testbed.flight_logs.flight_import import read_flight
from testbed.golden.golden_table import read_table as read_golden
from testbed.logs.mcap_file import LogError
from testbed.logs.read import read_log
from testbed.mavlink.signing import is_shared, read_key
from testbed.plan import user_code
from testbed.scenario import ScenarioError, load_middle_loop, load_scenario
from testbed.studies.plan import load_study
from testbed.tuning.tune_schema import load_tune

SPARSE_BYTES = 8 << 30
READERS = {
    "scenario.yaml": load_scenario,
    "study.yaml": load_study,
    "tune.yaml": load_tune,
    "gains.yaml": lambda path: load_middle_loop("rascal", "tuned", file=path),
    "golden.json": read_golden,
    "recording.csv": read_table,
    "commands.csv": read_commands,
    "tune.param": read_params,
    "key": read_key,
    "run.mcap": read_log,
    "flight.bin": read_flight,
}


@pytest.fixture(params=READERS)
def reader(request, tmp_path):
    return READERS[request.param], tmp_path / request.param


def refuse_to_read(monkeypatch):
    """Let reading fail, so that only the size decides."""

    def fail(*_):
        raise AssertionError("read before its size was checked")

    monkeypatch.setattr("pathlib.Path.read_bytes", fail)
    monkeypatch.setattr("pathlib.Path.read_text", fail)


def test_sparse_file_is_refused_unread(reader, monkeypatch):
    read, path = reader
    with path.open("wb") as file:
        file.truncate(SPARSE_BYTES)
    refuse_to_read(monkeypatch)
    with pytest.raises(InputError, match=rf"{path.name}.* is larger than [\d,]+ bytes"):
        read(path)


LIMITS = {
    1_000_000: ("scenario.yaml", "study.yaml", "tune.yaml", "gains.yaml", "tune.param", "law.py"),
    4096: ("key",),
    10_000_000: ("aircraft.xml",),
    64_000_000: ("recording.csv", "commands.csv"),
    1_000_000_000: ("flight.bin", "flight.tlog"),
    4_000_000_000: ("run.mcap",),
}
MORE_READERS = {
    "law.py": user_code._read,
    "flight.tlog": read_flight,
    "aircraft.xml": airframe_validation.check_files,
}


def reason(read, path):
    """Text of the error; empty: there is none."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("limit", "names"), LIMITS.items(), ids=map(str, LIMITS))
def test_largest_sizes_are_those_of_security_md(tmp_path, limit, names):
    """One byte more is refused with the limit in the error; the limit itself is read."""
    for name in names:
        read, path = (READERS | MORE_READERS)[name], tmp_path / name
        path.touch()
        for size in (limit + 1, limit):
            os.truncate(path, size)
            if size == limit > 10_000_000:
                continue  # reading it takes long
            text = reason(read, path)
            assert (f"is larger than {limit:,} bytes" in text) == (size > limit), (name, text)


class Waiting(BaseException):
    """No error that a reader would explain."""


def test_fifos_are_refused_without_waiting(tmp_path):
    """A wait for a writer would have no end."""

    def end(*_):
        raise Waiting

    earlier = signal.signal(signal.SIGALRM, end)
    signal.alarm(30)
    try:
        for name, read in READERS.items():
            os.mkfifo(tmp_path / name)
            # not a regular file, or there is no scenario
            with pytest.raises(ValueError, match="no") as refused:
                read(tmp_path / name)
            assert name in str(refused.value)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, earlier)


def test_growing_file_is_read_to_the_limit(tmp_path, monkeypatch):
    path = tmp_path / "growing"
    path.write_bytes(b"x" * 100)
    small = os.stat_result((*os.stat(path)[:6], 10, 0, 0, 0))
    monkeypatch.setattr(os, "fstat", lambda handle: small)
    with pytest.raises(ReadError, match="larger than 50 bytes"):
        read_bounded(path, 50)


def test_error_names_the_kind_of_a_non_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReadError, match="pipe: cannot be read: it is a pipe, not a regular file"):
        read_bounded(tmp_path / "pipe")
    with pytest.raises(ReadError, match="cannot be read: it is a directory, not a regular file"):
        read_bounded(tmp_path)
    with pytest.raises(ReadError, match="zero: cannot be read: it is a device"):
        read_bounded("/dev/zero")
    with pytest.raises(ReadError, match="missing: cannot be read: No such file or directory"):
        read_bounded(tmp_path / "missing")
    with pytest.raises(ReadError, match="cannot be read: embedded null"):
        read_bounded(tmp_path / "a\0b")


def test_text_that_is_no_utf8_names_its_line(tmp_path):
    path = tmp_path / "text"
    path.write_bytes(b"\xef\xbb\xbfone\n\xfftwo\n")
    with pytest.raises(ReadError, match="text: line 2 is not UTF-8 text"):
        read_bounded_text(path)
    path.write_bytes(b"\xef\xbb\xbfone\n")
    assert read_bounded_text(path) == "one\n"


def test_error_has_the_class_of_the_reader(tmp_path):
    expected = {
        "tune.param": ParamError,
        "commands.csv": CommandsError,
        "run.mcap": LogError,
        "scenario.yaml": ScenarioError,
    }
    for name, kind in expected.items():
        (tmp_path / name).touch()
        os.truncate(tmp_path / name, SPARSE_BYTES)
        with pytest.raises(kind):
            READERS[name](tmp_path / name)


@pytest.mark.parametrize("text", ["t_s\n" * 40, "t_s," * 40], ids=["rows", "cells"])
def test_tables_of_too_many_parts_are_refused(tmp_path, monkeypatch, text):
    monkeypatch.setattr(csv_table, "MAX_ROWS", 30)
    monkeypatch.setattr(csv_table, "MAX_CELLS", 30)
    path = tmp_path / "recording.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=r"recording.csv:\d+: more than 30 rows or 30 values"):
        read_table(path)
    assert MAX_TABLE_BYTES < 100e6


def test_key_that_others_can_read_is_named(tmp_path):
    path = tmp_path / "key"
    path.write_text("a passphrase")
    path.chmod(0o644)
    assert is_shared(path)
    path.chmod(0o600)
    assert not is_shared(path)


def test_controls_in_texts_do_not_reach_the_terminal():
    """Texts may come from a file of somebody else: a published source, a log's names."""
    stream = io.StringIO()
    console = PipeSafeConsole(file=stream, force_terminal=True, width=60)
    evil = "\x1b]0;title\x07\x1b[2J\u202e\x9b31m"
    console.print(Text(evil, style="bold"))
    console.write_line(evil)
    table = Table("a column")
    table.add_row(evil)
    console.print(table)
    shown = stream.getvalue()
    for forbidden in ("\x1b]", "\x07", "\x1b[2J", "\u202e", "\x9b"):
        assert forbidden not in shown
    assert "\x1b[1m" in shown and "\\x1b[2J" in shown
