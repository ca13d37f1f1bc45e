"""Tasks for worker processes that fly nothing: the first word of a task names a function here."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

from testbed.pool.flight_task import FlightResult


def run_task(task):
    """In place of `testbed.pool.flight_task.run_task`."""
    name, *arguments = task.scenario
    metrics = {"value": globals()[name](*arguments)}
    return FlightResult(task.number, "completed", "", metrics)


def echo(text):
    return text


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(mark):
    if not Path(mark).exists():
        Path(mark).touch()
        die()
    return "again"


def exit_worker():
    raise SystemExit(3)


def describe():
    """Return the id, the thread limits and the threads of this process."""
    threads = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    return {"pid": os.getpid(), "threads": threads, "here": threading.active_count() > 0}


def module_folders():
    """Return the folders that this process imports from."""
    return sys.path


def run_for_ever(mark):
    """Write the id of this process into a file, and never end."""
    part = Path(f"{mark}.part")
    part.write_text(str(os.getpid()))
    part.rename(mark)
    while True:
        time.sleep(0.05)
