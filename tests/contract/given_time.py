"""Time as a process is given it: the clock on the wall, which stands still while it may not run.

How long something may take is a promise of a machine that lets it run. On one that is busy with
other things a process wakes late, and stands still in between: that is not counted here. What is:
every wait for something else, and all that the process computes.
"""

import os
import struct
import threading
import time
from pathlib import Path

STEP_S = 0.005
LATE_S = 0.005  # of waking, which is never to the point
_NOTE = struct.Struct("d")


class GivenTime:
    """The time given to this process since the block was entered.

    Args:
        paper: a file that has the time always, also when the process has been killed.
    """

    def __init__(self, paper=None):
        self.now_s = 0.0
        self._paper = None if paper is None else os.open(paper, os.O_WRONLY | os.O_CREAT)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._count, name="given time", daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()

    def _count(self):
        wall, own = time.monotonic(), time.process_time()
        while not self._over.wait(STEP_S):
            before, wall = wall, time.monotonic()
            used, own = own, time.process_time()
            # beyond the step it asked for, it had as much time as it has used
            self.now_s += min(wall - before, STEP_S + LATE_S + own - used)
            if self._paper is not None:
                os.pwrite(self._paper, _NOTE.pack(self.now_s), 0)


def last_s(paper):
    """The time when a process ended that had this paper."""
    note = Path(paper).read_bytes()
    return _NOTE.unpack(note)[0] if note else 0.0
