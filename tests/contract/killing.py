"""Runs as processes of their own that are killed, and what they had done by then."""

import json
import os
import signal
import struct
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from commands import environment
from given_time import last_s
from patience import until
from record_flight import RECORDS

LONGEST_S = 0.5  # of the time a run is given, of what was flown and is not in the log
SECONDS = 100.0  # of the flights
PAGE = "simulation-3"
_NOTE = struct.Struct("dd")

# Forks a `testbed run` for each line it is told, and tells its id and how it ended. After each
# frame a run notes the moment and its time, past all buffers.
_FORKING = """
import json, os, struct, sys
import testbed.console
from given_time import GivenTime
from testbed.cli import main
from testbed.scenario import load, shorten
from testbed.sim.run import run

run(shorten(load("simulation-3"), 0.1), write=False)  # loads what flights need

class Notes:
    borrows = True
    def __init__(self, paper, given):
        self.paper = os.open(paper, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self.given = given
    def begin(self, info): pass
    def observe(self, frame):
        os.write(self.paper, struct.pack("dd", self.given.now_s, frame.time_s))
    def end(self, summary, events): pass

print("ready", flush=True)
for line in sys.stdin:
    paper, clock, *arguments = json.loads(line)
    child = os.fork()
    if not child:
        notes = Notes(paper, GivenTime(clock).__enter__())
        testbed.console.run = lambda *a, observers=(), **k: run(
            *a, observers=[*observers, notes], **k
        )
        sys.argv = ["testbed", *arguments]
        main()
        sys.exit()
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@contextmanager
def hangar():
    """Where runs are begun."""
    with subprocess.Popen(
        [sys.executable, "-c", _FORKING],
        env=environment(100, Path(__file__).parent),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            os.killpg(process.pid, signal.SIGKILL)


@dataclass
class Killed:
    """A run that was killed, or had ended just before."""

    out: Path
    killed_s: float  # of the time it was given
    ended: bool  # by itself
    sockets: int  # that it had
    notes: list[tuple[float, float]] = field(default_factory=list)  # when, which time

    def missing_s(self, last_s):
        """How long ago it flew the first frame that is behind the log's last one, at the kill."""
        gone = [at for at, time_s in self.notes if time_s > last_s]
        return max(0.0, self.killed_s - min(gone)) if gone else 0.0


@dataclass(frozen=True)
class Moment:
    """When to kill: a while after something that one waits for."""

    after: str  # start, log, end
    wait_s: float
    pace: float = 0.0
    seconds: float = SECONDS


def moments(count, seed):
    """Some in start-up, some in flights of every pace, some about the end."""
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


def kill(hangar, folder, moment):
    """Fly and kill."""
    out, paper, clock = folder / "run", folder / "notes", folder / "clock"
    command = ["run", PAGE, "--quiet", "--out", str(out)]
    command += [f"--duration={moment.seconds:g}", f"--pace={moment.pace:g}"]
    hangar.stdin.write(json.dumps([str(paper), str(clock), *command]) + "\n")
    hangar.stdin.flush()
    process = int(hangar.stdout.readline())
    until(lambda: _begun(moment, out, paper))
    time.sleep(moment.wait_s)
    sockets = _sockets(process)
    with suppress(ProcessLookupError):  # it has ended by itself
        os.kill(process, signal.SIGKILL)
    code = int(hangar.stdout.readline())
    assert code in (0, -signal.SIGKILL)
    notes = paper.read_bytes() if paper.exists() else b""
    whole = notes[: len(notes) // _NOTE.size * _NOTE.size]
    killed = last_s(clock) if clock.exists() else 0.0
    return Killed(out, killed, code == 0, sockets, [*_NOTE.iter_unpack(whole)])


def _begun(moment, out, paper):
    if moment.after == "start":
        return True
    if moment.after == "log":
        return (out / "run.mcap").exists()
    return paper.exists() and paper.stat().st_size >= _NOTE.size * round(25 * moment.seconds - 1)


def _sockets(process):
    try:
        links = [os.readlink(each) for each in Path(f"/proc/{process}/fd").iterdir()]
    except OSError:  # it has just ended
        return 0
    return sum(link.startswith("socket:") for link in links)


def assert_same_beginning(log, whole):
    """Frames and events are those of a whole flight, to the bit, as far as they go."""
    count = log.tick.size
    assert log.tick.tobytes() == whole.tick[:count].tobytes()
    for record in (*RECORDS, "links"):
        for name in getattr(log, record)._fields:
            one, other = getattr(getattr(log, record), name), getattr(getattr(whole, record), name)
            assert one.tobytes() == np.ascontiguousarray(other[:count]).tobytes(), (record, name)
    assert log.lost.tobytes() == whole.lost[:count].tobytes()
    known = [each for each in whole.events if each.time_s <= log.time_s[-1]]
    assert [e for e in log.events if not e.text.startswith("recovered:")] == known
