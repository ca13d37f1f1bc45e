"""Ctrl-C and SIGTERM while an ArduPlane, played by the stand-in, is waited for."""

import json
import os
import signal
import threading
from contextlib import contextmanager

import pytest
from arduplanes import SOON, binary, page, running
from given_time import GivenTime
from patience import PATIENCE_S, until

import testbed
from testbed.ardupilot.process import Process

assert binary  # a fixture


@pytest.fixture(autouse=True)
def handlers():
    """A signal that comes too late fails a test, and does not end all of them."""
    before = {
        each: signal.signal(each, lambda *_: None) for each in (signal.SIGINT, signal.SIGTERM)
    }
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@contextmanager
def signalled(*after_s, number=signal.SIGTERM, begun):
    """Send this process signals, each s after the one before, once something has begun.

    When they were sent, on a clock that goes on until the block is left: nobody is signalled then.
    """
    sent, over = [], threading.Event()

    def send():
        while not begun():
            if over.wait(0.02):
                return
        for each in after_s:
            if over.wait(each):
                return
            sent.append(given.now_s)
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=send, daemon=True)
    with GivenTime() as given:
        thread.start()
        try:
            yield sent, given
        finally:
            over.set()
            thread.join()


def printed(folders, words):
    return any(words in each.read_text() for each in folders.glob("*/arduplane.log"))


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("never-listens", "thinking"),
        ("hang@60", "thinking"),
        (f"hang@{SOON}", "thinking"),
        ("never-arms", "JSON received"),
    ],
    ids=["never listens", "hangs in its boot", "hangs in flight", "boots on and on"],
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_is_heeded_while_it_is_waited_for(
    binary, monkeypatch, tmp_path, trouble, words, number
):
    monkeypatch.setenv("STAND_IN", trouble)
    monkeypatch.setattr("testbed.ardupilot.bring_up._STAGE_S", 3600.0)
    folders = tmp_path / "folders"
    asked = page(5.0, "log.mcap=true", patience_s=PATIENCE_S)
    begun = signalled(0.3, number=number, begun=lambda: printed(folders, words))
    with begun as (sent, given):
        flown = testbed.run(asked, out=tmp_path / "run")
        # 0.3 s until it is looked at, 1 s for one that does not heed SIGTERM, and its end
        assert given.now_s - sent[0] < 5.0
    assert (flown.outcome, flown.exit_code) == ("interrupted", 130)
    assert json.loads((tmp_path / "run/metrics.json").read_text())["outcome"] == "interrupted"
    assert (tmp_path / "run/run.mcap").stat().st_size > 0


def test_more_signals_while_it_is_being_ended_leave_nothing(binary, monkeypatch, tmp_path):
    monkeypatch.setenv("STAND_IN", "never-listens")
    more = []

    def wait(process, moment, really=Process.wait):
        with signalled(0.1, 0.2, 0.2, begun=lambda: True) as (sent, _):
            really(process, moment)
            until(lambda: len(sent) == 3)
            more.extend(sent)

    monkeypatch.setattr(Process, "wait", wait)  # for its end
    with signalled(0.0, begun=lambda: printed(tmp_path / "folders", "thinking")):
        flown = testbed.run(page(5.0, patience_s=PATIENCE_S), out=tmp_path / "run")
    assert len(more) >= 3
    assert flown.outcome == "interrupted"
    assert not running()
    assert (tmp_path / "run/metrics.json").exists()
