"""Ctrl-C and SIGTERM while an ArduPlane, played by the stand-in, is waited for."""

import json
import os
import signal
import threading
import time

import pytest
from arduplanes import SOON, binary, page, running

import testbed

assert binary  # a fixture

PATIENCE_S = 60


@pytest.fixture(autouse=True)
def handlers():
    """A signal that comes too late fails a test, and does not end all of them."""
    before = {
        each: signal.signal(each, lambda *_: None) for each in (signal.SIGINT, signal.SIGTERM)
    }
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


def signalled(*after_s, number=signal.SIGTERM, begun):
    """Send this process signals, s after something has begun; when the first was sent."""
    sent = []

    def send():
        deadline = time.monotonic() + 30
        while not begun() and time.monotonic() < deadline:
            time.sleep(0.02)
        since = time.monotonic()
        for each in after_s:
            time.sleep(max(0.0, since + each - time.monotonic()))
            sent.append(time.monotonic())
            os.kill(os.getpid(), number)

    threading.Thread(target=send, daemon=True).start()
    return sent


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
    sent = signalled(0.3, number=number, begun=lambda: printed(folders, words))
    flown = testbed.run(page(5.0, "log.mcap=true", patience_s=PATIENCE_S), out=tmp_path / "run")
    # 0.3 s until it is looked at, 1 s for one that does not heed SIGTERM, and a busy machine
    assert time.monotonic() - sent[0] < 5.0
    assert (flown.outcome, flown.exit_code) == ("interrupted", 130)
    assert json.loads((tmp_path / "run/metrics.json").read_text())["outcome"] == "interrupted"
    assert (tmp_path / "run/run.mcap").stat().st_size > 0


def test_more_signals_while_it_is_being_ended_leave_nothing(binary, monkeypatch, tmp_path):
    monkeypatch.setenv("STAND_IN", "never-listens")
    # the first is heeded within 0.3 s; it is killed 1 s after it was asked to end
    sent = signalled(0.0, 0.5, 0.7, 0.9, begun=lambda: printed(tmp_path / "folders", "thinking"))
    flown = testbed.run(page(5.0, patience_s=PATIENCE_S), out=tmp_path / "run")
    assert len(sent) >= 3
    assert flown.outcome == "interrupted"
    assert not running()
    assert (tmp_path / "run/metrics.json").exists()
