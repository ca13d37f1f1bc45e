"""Tasks for a crew that take no flying: what a process does with each is its first word."""

import os
import signal
import threading
import time
from pathlib import Path

from testbed.study.crew import Flown


def act(task):
    """In place of `testbed.study.crew.fly`."""
    what, *more = task.page
    return Flown(task.number, "flown", "", {"said": globals()[what](*more)})


def say(text):
    return text


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(mark):
    if not Path(mark).exists():
        Path(mark).touch()
        die()
    return "again"


def raise_it():
    raise SystemExit(3)


def tell():
    """Who this is and what it was given."""
    threads = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    return {"pid": os.getpid(), "threads": threads, "here": threading.active_count() > 0}


def linger(mark):
    """Say who this is, and never end by itself."""
    part = Path(f"{mark}.part")
    part.write_text(str(os.getpid()))
    part.rename(mark)
    while True:
        time.sleep(0.05)
