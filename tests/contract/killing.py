"""Runs as processes of their own that are killed, and what they had done by then."""

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from commands import environment
from record_flight import RECORDS

LONGEST_S = 0.5  # of the clock on the wall, of what was flown and is not in the log
SECONDS = 150.0  # of the flights
PAGE = "simulation-3"
PATIENCE_S = 120.0
_NOTE = struct.Struct("dd")

# `testbed run`, and after each frame the moment and its time, past all buffers.
NOTING = """
import os, struct, sys, time
import testbed.console

paper = os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT | os.O_APPEND)

class Notes:
    borrows = True
    def begin(self, info): pass
    def observe(self, frame):
        os.write(paper, struct.pack("dd", time.monotonic(), frame.time_s))
    def end(self, summary, events): pass

run = testbed.console.run
testbed.console.run = lambda *a, observers=(), **k: run(*a, observers=[*observers, Notes()], **k)
from testbed.cli import main
main()
"""


@dataclass
class Killed:
    """A run that was killed, or had ended just before."""

    out: Path
    killed_s: float  # of the monotonic clock
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
            yield Moment("start", rng.uniform(0.0, 4.0))
        else:
            yield Moment("end", rng.uniform(0.0, 0.15), seconds=2.0)


def kill(folder, moment):
    """Fly and kill."""
    out, paper = folder / "run", folder / "notes"
    command = [sys.executable, "-c", NOTING, str(paper), "run", PAGE, "--quiet"]
    command += ["--out", str(out), f"--duration={moment.seconds:g}", f"--pace={moment.pace:g}"]
    with subprocess.Popen(
        command, cwd=folder, env=environment(100), stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            stop = time.monotonic() + PATIENCE_S
            while not _begun(moment, out, paper) and process.poll() is None:
                assert time.monotonic() < stop, "it did not begin"
                time.sleep(0.002)
            time.sleep(moment.wait_s)
            sockets = _sockets(process.pid)
            killed = time.monotonic()
            process.send_signal(signal.SIGKILL)
            said = process.communicate()[1]
        finally:
            process.kill()
    assert process.returncode in (0, -signal.SIGKILL), said
    notes = paper.read_bytes() if paper.exists() else b""
    whole = notes[: len(notes) // _NOTE.size * _NOTE.size]
    return Killed(out, killed, process.returncode == 0, sockets, [*_NOTE.iter_unpack(whole)])


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
