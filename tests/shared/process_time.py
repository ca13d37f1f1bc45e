"""Running time of a process: wall-clock time without the time in which it was not scheduled.

Time limits hold for a machine with a free processor. On a busy machine a process wakes late and is
suspended; this time is not counted. Computing, and waiting for anything else, is counted.
"""

import os
import struct
import threading
import time
from pathlib import Path

STEP_S = 0.005
LATE_S = 0.005  # tolerated delay of waking
_NOTE = struct.Struct("d")


class ProcessTime:
    """Running time of this process since the block was entered.

    Args:
        path: a file to which the time is written at every step, to be read after a kill.
    """

    def __init__(self, path=None):
        self.now_s = 0.0
        self._file = None if path is None else os.open(path, os.O_WRONLY | os.O_CREAT)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._count, name="process time", daemon=True)

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
            # time beyond the step counts only as far as it was computing time
            self.now_s += min(wall - before, STEP_S + LATE_S + own - used)
            if self._file is not None:
                os.pwrite(self._file, _NOTE.pack(self.now_s), 0)


def last_s(path):
    """The last running time that a process wrote to this file."""
    note = Path(path).read_bytes()
    return _NOTE.unpack(note)[0] if note else 0.0
