"""Runs in child processes that are killed, with the time and the last sample at the kill."""

import json
import os
import signal
import struct
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from commands import environment
from forked import Forked
from process_time import ProcessTime, last_s
from record_flight import RECORDS
from waiting import TIMEOUT_S, until

MAX_MISSING_S = 0.5  # of the process's running time, whose samples are not in the log
SECONDS = 100.0  # of the flights
SCENARIO = "simulation-3"
_NOTE = struct.Struct("dd")


def work():
    """Fork a `testbed run` for each line of input; print its process id, and its exit code.

    After each sample a run writes the running time and the simulated time to a file, without
    buffers.
    """
    from testbed.cli.main import main
    from testbed.runs import run as runs

    run = runs.run
    print("ready", flush=True)
    for line in sys.stdin:
        path, clock, *arguments = json.loads(line)
        child = os.fork()
        if not child:
            notes = Notes(path, ProcessTime(clock).__enter__())
            runs.run = partial(_run_noting, run, notes)
            sys.argv = ["testbed", *arguments]
            main()
            sys.exit()
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _run_noting(run, notes, *arguments, observers=(), **named):
    return run(*arguments, observers=[*observers, notes], **named)


class Notes:
    """Observer that writes times to a file."""

    zero_copy = True

    def __init__(self, path, running):
        self.file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self.running = running

    def begin(self, info):
        pass

    def observe(self, frame):
        os.write(self.file, _NOTE.pack(self.running.now_s, frame.time_s))

    def end(self, summary, events):
        pass


@contextmanager
def process_starter():
    """Process that starts runs, with its input and its output."""
    (theirs_in, to), (back, theirs_out) = os.pipe(), os.pipe()
    with os.fdopen(to, "w") as stdin, os.fdopen(back) as stdout:
        with os.fdopen(theirs_in) as input, os.fdopen(theirs_out, "w") as output:
            process = Forked(
                "killing:work",
                cwd=tempfile.gettempdir(),
                env=environment(100),
                stdin=input,
                stdout=output,
                stderr=sys.__stderr__,
            )
        try:
            assert stdout.readline() == "ready\n"
            yield SimpleNamespace(stdin=stdin, stdout=stdout)
        finally:
            os.killpg(process.pid, signal.SIGKILL)


@dataclass
class Killed:
    """A run that was killed, or ended just before."""

    out: Path
    killed_s: float  # running time at the kill
    ended: bool  # before the kill
    sockets: int  # open at the kill
    notes: list[tuple[float, float]] = field(default_factory=list)  # running time, simulated time

    def missing_s(self, last_s):
        """Running time since the first sample after the last one in the log."""
        missing = [at for at, time_s in self.notes if time_s > last_s]
        return max(0.0, self.killed_s - min(missing)) if missing else 0.0


@dataclass(frozen=True)
class Moment:
    """When to kill a run: a time after an event."""

    after: str  # start, scenario, log, flight, end
    wait_s: float
    pace: float = 0.0
    seconds: float = SECONDS


def moments(count, seed):
    """Moments during start-up, in flights at several paces, and around the end."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        if k % 4 == 0:
            yield Moment("log", rng.uniform(0.0, 1.5))
        elif k % 4 == 1:
            pace = [1.0, 0.2, 20.0, 1.0, 0.05][k // 4 % 5]
            yield Moment("log", rng.uniform(0.0, 2.5), pace=pace)
        elif k % 4 == 2:
            yield Moment("start", rng.uniform(0.0, 1.5))
        else:
            yield Moment("end", rng.uniform(0.0, 0.15), seconds=2.0)


def start_run(starter, folder, moment):
    """Start a run; return the id of its process."""
    command = ["run", SCENARIO, "--quiet", "--out", str(folder / "run")]
    command += [f"--duration={moment.seconds:g}", f"--pace={moment.pace:g}"]
    files = [str(folder / "notes"), str(folder / "clock")]
    starter.stdin.write(json.dumps([*files, *command]) + "\n")
    starter.stdin.flush()
    return int(starter.stdout.readline())


def kill(starter, folder, moment):
    """Start a run and kill it."""
    out, notes_file, clock = folder / "run", folder / "notes", folder / "clock"
    process = start_run(starter, folder, moment)
    until(lambda: _reached(moment, out, notes_file))
    time.sleep(moment.wait_s)
    sockets = _sockets(process)
    with suppress(ProcessLookupError):  # it has ended
        os.kill(process, signal.SIGKILL)
    code = int(starter.stdout.readline())
    assert code in (0, -signal.SIGKILL)
    notes = notes_file.read_bytes() if notes_file.exists() else b""
    whole = notes[: len(notes) // _NOTE.size * _NOTE.size]
    killed = last_s(clock) if clock.exists() else 0.0
    return Killed(out, killed, code == 0, sockets, [*_NOTE.iter_unpack(whole)])


def kill_command(arguments, folder, begun, wait_s):
    """Start a command in a process of its own, and kill it some time after it has begun."""
    process = Forked("testbed.cli.main:main", *arguments, cwd=folder, env=environment(100))
    try:
        until(lambda: begun() or process.poll() is not None)
        time.sleep(wait_s)
    finally:
        process.kill()
    assert process.wait(TIMEOUT_S) in (0, -signal.SIGKILL)


@dataclass(frozen=True)
class SignalPair:
    """Two signals, the second soon after the first."""

    first: Moment
    gap_s: float
    numbers: tuple[int, int] = (signal.SIGINT, signal.SIGINT)


def signal_pairs(count, seed):
    """Pairs 0.2 to 50 ms apart, while a run starts, flies and ends."""
    rng = np.random.default_rng(seed)
    kinds = ("scenario", "log", "flight", "end")
    longest_s = {"scenario": 0.3, "log": 0.3, "flight": 0.5, "end": 0.1}
    for k in range(count):
        kind = kinds[k % len(kinds)]
        pace = [0.0, 0.0, 1.0, 20.0][k // len(kinds) % 4] if kind != "end" else 0.0
        seconds = 2.0 if kind == "end" else SECONDS
        first = Moment(kind, rng.uniform(0.0, longest_s[kind]), pace, seconds)
        numbers = [(signal.SIGINT, signal.SIGINT), (signal.SIGTERM, signal.SIGINT)][k % 5 == 4]
        yield SignalPair(first, 2e-4 * 250.0 ** rng.uniform(), numbers)


def interrupt(starter, folder, pair):
    """Start a run and send it a pair of signals; return its exit code."""
    process = start_run(starter, folder, pair.first)
    until(lambda: _reached(pair.first, folder / "run", folder / "notes"))
    time.sleep(pair.first.wait_s)
    with suppress(ProcessLookupError):  # it has ended
        os.kill(process, pair.numbers[0])
        time.sleep(pair.gap_s)
        os.kill(process, pair.numbers[1])
    return int(starter.stdout.readline())


def _reached(moment, out, notes_file):
    if moment.after == "start":
        return True
    if moment.after == "scenario":
        return (out / "scenario.resolved.yaml").exists()
    if moment.after == "flight":
        return notes_file.exists() and notes_file.stat().st_size > 0
    if moment.after == "log":
        return (out / "run.mcap").exists()
    return notes_file.exists() and notes_file.stat().st_size >= _NOTE.size * round(
        25 * moment.seconds - 1
    )


def _sockets(process):
    try:
        links = [os.readlink(each) for each in Path(f"/proc/{process}/fd").iterdir()]
    except OSError:  # it has just ended
        return 0
    return sum(link.startswith("socket:") for link in links)


def assert_same_beginning(log, whole):
    """Samples and events equal those of a complete run in every bit, up to the last sample."""
    count = log.tick.size
    assert log.tick.tobytes() == whole.tick[:count].tobytes()
    for record in (*RECORDS, "links"):
        for name in getattr(log, record)._fields:
            one, other = getattr(getattr(log, record), name), getattr(getattr(whole, record), name)
            assert one.tobytes() == np.ascontiguousarray(other[:count]).tobytes(), (record, name)
    assert log.lost.tobytes() == whole.lost[:count].tobytes()
    known = [each for each in whole.events if each.time_s <= log.time_s[-1]]
    assert [e for e in log.events if not e.text.startswith("recovered:")] == known
