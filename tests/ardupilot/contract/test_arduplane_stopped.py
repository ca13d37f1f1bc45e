"""Ctrl-C and SIGTERM while the run waits for an ArduPlane, played by the stand-in."""

import json
import os
import signal
import threading
from contextlib import contextmanager, suppress

import pytest
from arduplanes import SOON, binary, make_scenario, running
from cases import in_full
from process_time import ProcessTime
from waiting import TIMEOUT_S, until

import testbed
from testbed.ardupilot.sitl_process import SitlProcess

assert binary  # a fixture


@pytest.fixture(autouse=True)
def handlers():
    """Ignore signals that come too late, so that they do not end the test process."""
    before = {
        each: signal.signal(each, lambda *_: None) for each in (signal.SIGINT, signal.SIGTERM)
    }
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@contextmanager
def signalled(*after_s, number=signal.SIGTERM, started):
    """Send signals to this process, each this many s after the one before.

    The first delay starts when `started()` is true. Yields the times at which signals were sent
    and the clock of these times. No signal is sent after the block.
    """
    sent, over = [], threading.Event()

    def send():
        while not started():
            if over.wait(0.02):
                return
        for each in after_s:
            if over.wait(each):
                return
            sent.append(given.now_s)
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=send, daemon=True)
    with ProcessTime() as given:
        thread.start()
        try:
            yield sent, given
        finally:
            over.set()
            thread.join()


def printed(folders, words):
    return any(words in each.read_text() for each in folders.glob("*/arduplane.log"))


@pytest.mark.parametrize(
    ("misbehaviour", "words", "number"),
    [
        ("never-listens", "frozen", signal.SIGINT),
        pytest.param("hang@60", "frozen", signal.SIGTERM, marks=in_full),
        (f"hang@{SOON}", "frozen", signal.SIGINT),
        ("never-arms", "JSON received", signal.SIGTERM),
    ],
    ids=["never listens", "freezes in its boot", "freezes in flight", "never arms"],
)
def test_stop_ends_wait_for_arduplane(binary, monkeypatch, tmp_path, misbehaviour, words, number):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", misbehaviour)
    monkeypatch.setattr("testbed.ardupilot.startup._STAGE_TIMEOUT_S", 3600.0)
    folders = tmp_path / "folders"
    scenario = make_scenario(5.0, "log.mcap=true", timeout_s=TIMEOUT_S)
    signals = signalled(0.3, number=number, started=lambda: printed(folders, words))
    with signals as (sent, clock):
        result = testbed.run(scenario, out=tmp_path / "run")
        # 0.3 s until the next check, 1 s from SIGTERM to SIGKILL, and the end of the run
        assert clock.now_s - sent[0] < 5.0
    assert (result.outcome, result.exit_code) == ("interrupted", 130)
    assert json.loads((tmp_path / "run/metrics.json").read_text())["outcome"] == "interrupted"
    assert (tmp_path / "run/run.mcap").stat().st_size > 0


def test_repeated_signals_leave_nothing(binary, monkeypatch, tmp_path):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "never-listens")
    more = []

    def wait(process, moment, original=SitlProcess.wait):
        with signalled(0.1, 0.2, 0.2, started=lambda: True) as (sent, _):
            original(process, moment)
            until(lambda: len(sent) == 3)
            more.extend(sent)

    monkeypatch.setattr(SitlProcess, "wait", wait)
    with (
        signalled(0.0, started=lambda: printed(tmp_path / "folders", "frozen")),
        suppress(KeyboardInterrupt),  # after the ending, if the signals take more than a second
    ):
        testbed.run(make_scenario(5.0, timeout_s=TIMEOUT_S), out=tmp_path / "run")
    assert len(more) >= 3
    assert json.loads((tmp_path / "run/metrics.json").read_text())["outcome"] == "interrupted"
    assert not running()
