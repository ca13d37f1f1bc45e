"""The only module that imports joblib: processes on this machine, one flight in each at a time.

Each is a pool of one process, so that one that is killed takes nobody else's flight with it and it
is known which it had. They are joblib's (loky) rather than Python's: those import the script that
started them again, which one without `if __name__ == "__main__"` does not survive.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Future

import joblib
from joblib.externals.loky import BrokenProcessPool, ProcessPoolExecutor
from joblib.externals.loky.process_executor import ShutdownExecutorError

from testbed.study.crew import Flown, Task, fly

# Flights are what is done in parallel; in each of them one thread is quickest, and there are no
# more of them than processors.
_ONE_THREAD = {
    name: "1"
    for name in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    )
}
_LOOK_S = 0.5  # between two looks at whether who started us is still there
_GRACE_S = 5.0  # for a flight to end what it has started


class Processes:
    """Processes of one thread each."""

    def __init__(self, jobs: int | None = None) -> None:
        """This many; by default one for each processor that this process may use."""
        self._free: list[ProcessPoolExecutor | None] = [None] * (jobs or joblib.cpu_count())
        self._all: set[ProcessPoolExecutor] = set()
        self._size = len(self._free)

    def room(self) -> int:
        """One task for each."""
        return self._size

    def submit(self, task: Task) -> Future[Flown]:
        """Have a task flown by one that is free; it is started if need be."""
        process = self._free.pop() or self._start()
        future: Future[Flown] = process.submit(fly, task)
        future.add_done_callback(lambda done: self._back(process, done))
        return future

    def killed(self, error: BaseException) -> bool:
        """Whether it says that a process has ended."""
        return isinstance(error, BrokenProcessPool | ShutdownExecutorError)

    def end(self) -> None:
        """Kill them, with what they have started."""
        for process in tuple(self._all):  # which those that end leave by themselves
            process.shutdown(wait=True, kill_workers=True)
        self._all.clear()

    def _start(self) -> ProcessPoolExecutor:
        process = ProcessPoolExecutor(
            max_workers=1, initializer=_begin, initargs=(os.getpid(),), env=_ONE_THREAD
        )
        self._all.add(process)
        return process

    def _back(self, process: ProcessPoolExecutor, done: Future[Flown]) -> None:
        """Take back one that is done; in the place of one that is gone another will be started."""
        error = done.exception()
        if error is not None and self.killed(error):
            self._all.discard(process)
            self._free.append(None)
        else:
            self._free.append(process)


def _begin(parent: int) -> None:
    """What a process does first: it leaves Ctrl-C to who started it, and does not outlive them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: int) -> None:
    """End this process when its parent has."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os.kill(os.getpid(), signal.SIGTERM)  # a flight ends what it has started, such as an ArduPlane
    time.sleep(_GRACE_S)
    os._exit(1)
