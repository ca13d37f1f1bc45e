"""What does not end by itself is ended by signals: compiled laws, and what is being written."""

import os
import signal
import sys
import time
import weakref
from pathlib import Path

import pytest
from cases import some
from commands import ROOT, call_command, children, environment
from forked import Forked
from waiting import TIMEOUT_S, until

from testbed.cli.main import main
from testbed.core.interrupts import Interrupt, count_signals
from testbed.logs.read import read_log

WHOLE = "TESTBED_STUDIES" in os.environ

LAW = """
import testbed
from testbed.law import FbwaCommand


@testbed.kernel(memory=[("rounds", int)])
def endless(now, own, inbox, memory, config, from_s=-1.0):
    while now > from_s:
        memory.rounds += 1
    return FbwaCommand(0.0, 0.0, 0.5)
"""
SCENARIO = "extends: simulation-3\ncontroller: {law: 'endless:endless', options: {from_s: 3.0}}\n"
STUDY = """
study: {schema: 1, name: stuck, scenario: law.yaml, duration_s: 4, design: factorial, seeds: [1, 2]}
vary: {network.loss: [0, 0.4]}
"""
STUCK = "stopping, but still in compiled code"
ENDS_S = 6.0  # a second signal, on a busy machine


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("endless")
    (folder / "endless.py").write_text(LAW)
    (folder / "law.yaml").write_text(SCENARIO)
    (folder / "study.yaml").write_text(STUDY)
    return folder


class Started:
    """A command in a process of its own, whose signals are those of a terminal."""

    def __init__(self, *arguments, cwd):
        self.errors = cwd / f"errors-{time.monotonic_ns()}.txt"
        with self.errors.open("w") as errors:
            self.process = Forked(
                "testbed.cli.main:main", *arguments, cwd=cwd, env=environment(200), stderr=errors
            )

    def end(self, within_s):
        try:
            return self.process.wait(within_s)
        finally:
            self.process.kill()
            self.process.wait(TIMEOUT_S)

    @property
    def text(self):
        return self.errors.read_text()


def is_stuck(log, from_s):
    """Whether the samples of a run end where its law does."""
    try:
        return log.exists() and read_log(log).time_s[-1] > from_s - 0.1
    except Exception:  # it has only begun
        return False


def test_second_signal_ends_a_compiled_law(folder):
    numbers = signal.SIGINT, signal.SIGTERM
    out = folder / "run"
    run = Started("run", "law.yaml", "--duration", "5", "--quiet", "--out", out, cwd=folder)
    try:
        until(lambda: is_stuck(out / "run.mcap", 3.0) or run.process.poll() is not None)
        run.process.send_signal(numbers[0])
        until(lambda: STUCK in run.text)
        assert run.process.poll() is None, run.text
        run.process.send_signal(numbers[1])
    finally:
        code = run.end(ENDS_S)
    assert code == 130, run.text
    assert "Traceback" not in run.text
    assert not list(folder.glob(".*.part"))
    call_command("recover", out, cwd=folder, code=0, columns=200)
    assert read_log(out / "run.mcap").time_s[-1] >= 2.9  # as of a run that is killed


@pytest.mark.parametrize(
    ("act", "code", "texts"),
    [
        ("stuck", 130, [STUCK, "ended: compiled code did not return"]),
        ("waiting", 1, ["handled"]),  # controls: Python handles the first signal
        ("calling", 1, ["handled"]),
    ],
    ids=["stuck", "waiting", "calling"],
)
@pytest.mark.parametrize("number", some([signal.SIGINT, signal.SIGTERM], 1))
def test_signals_in_compiled_code(tmp_path, act, code, texts, number):
    """Of each command, also one that flies nothing."""
    errors, output = tmp_path / "errors.txt", tmp_path / "output.txt"
    with errors.open("w") as stderr, output.open("w") as stdout:
        process = Forked(
            "endless_call:work",
            act,
            cwd=tmp_path,
            env=environment(200),
            stdout=stdout,
            stderr=stderr,
        )
    try:
        until(lambda: output.read_text() == "begun\n")
        begun_s = process_s(process.pid)
        until(lambda: act == "waiting" or process_s(process.pid) > begun_s + 0.2)
        process.send_signal(number)
        until(lambda: texts[0] in errors.read_text() or process.poll() is not None)
        if code == 130:
            process.send_signal(number)
        assert process.wait(ENDS_S) == code
    finally:
        process.kill()
    lines = [each for each in errors.read_text().splitlines() if each]
    assert len(lines) == len(texts)
    assert all(text in line for text, line in zip(texts, lines, strict=True))


@pytest.mark.skipif(not WHOLE, reason="TESTBED_STUDIES=1: processes that compute for 10 s")
def test_workers_with_such_a_law_are_ended(folder):
    study = Started("sweep", "study.yaml", "--jobs", "2", "--out", "study.parquet", cwd=folder)
    workers = []
    try:
        # no flight of 4 s takes as long
        until(
            lambda: (
                ended(study) or max(map(process_s, children(study.process.pid)), default=0.0) > 15.0
            )
        )
        workers += children(study.process.pid)
        for _ in range(2):
            study.process.send_signal(signal.SIGINT)
            time.sleep(1.2)
    finally:
        code = study.end(TIMEOUT_S)
    assert code == 130, study.text
    assert workers
    until(lambda: not any(map(process_s, workers)))


def process_s(number):
    """Processor time of a process, s; 0: it has ended."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    ticks = 0 if fields[0] == "Z" else int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize("number", some([signal.SIGINT, signal.SIGTERM], 1))
def test_new_aircraft_that_is_ended_leaves_nothing(tmp_path, number):
    file = ROOT / "aircraft" / "rascal110" / "rascal110.xml"
    for attempt in range(5):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        code, command = end_new_aircraft(folder, file, number)
        if code != 0:  # else it was faster than the signal
            break
    assert code == 130, command.text
    assert "Traceback" not in command.text
    assert [*folder.iterdir()] == [command.errors]


def end_new_aircraft(folder, file, number):
    """Send a signal to the command when it has begun to write; return its exit code, and it."""
    command = Started("new", "aircraft", str(file), "--into", "mine", cwd=folder)
    try:
        until(lambda: list(folder.glob(".testbed-*.part/mine/*.xml")) or ended(command))
        command.process.send_signal(number)
        until(lambda: ended(command))
    finally:
        code = command.end(ENDS_S)
    return code, command


def ended(command):
    return command.process.poll() is not None


def test_signal_in_a_callback_is_not_lost():
    """Python ignores what a callback of a weak reference raises: the signal is sent again."""

    class Object:
        pass

    sent = []

    def interrupt(reference):
        sent.append(reference)
        signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupt), count_signals():
        held = Object()
        reference = weakref.ref(held, interrupt)
        del held
        time.sleep(5.0)
    assert sent == [reference]
    assert signal.getsignal(signal.SIGTERM) is before


def test_early_end_of_a_file_is_a_defect(monkeypatch, capsys):
    """It is neither Ctrl-D at a prompt nor exit code 1, that of a lost aircraft."""

    def read_file(*_, **__):
        raise EOFError("Ran out of input")

    monkeypatch.setattr("testbed.scenario.load_scenario", read_file)
    monkeypatch.setattr(sys, "argv", ["testbed", "validate", "simulation-3"])
    with pytest.raises(SystemExit) as ending:
        main()
    text = capsys.readouterr().err
    assert ending.value.code == 4
    assert "Ran out of input" in text and "internal error" in text and "Aborted" not in text
