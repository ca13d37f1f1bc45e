"""Worker processes on this machine; the only importer of joblib.

Each worker is an executor of one process, so that killing one affects only its own task, and that
task is known. The processes are those of loky rather than of `multiprocessing`, which would import
the user's script again, and run it if it has no `if __name__ == "__main__"`.

Workers start as `python -m joblib...`, and the processes that clean up after them as `python -c`:
without PYTHONSAFEPATH both would import a joblib.py or a numpy.py of the current directory.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager

import joblib
from joblib.externals.loky import BrokenProcessPool, ProcessPoolExecutor
from joblib.externals.loky.process_executor import ShutdownExecutorError

from testbed.core.errors import InputError, describe_error
from testbed.core.kept_files import REPORTED
from testbed.pool.flight_task import FlightResult, FlightTask, run_task

_SAFE_PATH = "PYTHONSAFEPATH"
# One thread per flight: flights run in parallel, so more threads would compete for processors.
_ENVIRONMENT = {
    name: "1"
    for name in (
        *(_SAFE_PATH, REPORTED),
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    )
}
_PARENT_POLL_S = 0.5  # interval at which a worker checks that its parent runs
_GRACE_S = 5.0  # for a flight to end the programs it has started


class LocalWorkers:
    """Processes of one thread each."""

    def __init__(self, jobs: int | None = None) -> None:
        """Set the number of processes; default one for each processor this process may use."""
        self._free: list[ProcessPoolExecutor | None] = [None] * (jobs or joblib.cpu_count())
        self._started: set[ProcessPoolExecutor] = set()
        self._size = len(self._free)

    def capacity(self) -> int:
        """Return one task for each process."""
        return self._size

    def submit(self, task: FlightTask) -> Future[FlightResult]:
        """Run a task in a free process, which is started if necessary.

        Of several free ones it is the first that became free. The pool submits tasks in the order
        in which earlier ones ended, so that a process gets the next task of the group it has flown.

        Raises:
            InputError: no process can be started.
        """
        started = (k for k, each in enumerate(self._free) if each is not None)
        process = self._free.pop(next(started, 0))
        try:
            with _safe_path():
                try:
                    process = process or self._start()
                    future: Future[FlightResult] = process.submit(run_task, task)
                except (BrokenProcessPool, ShutdownExecutorError):  # it was killed while free
                    if process is not None:
                        self._started.discard(process)
                    process = self._start()
                    future = process.submit(run_task, task)
        except (OSError, MemoryError) as error:
            raise InputError(
                f"no process can be started for a flight: {describe_error(error)} (write --jobs 1, "
                "or end other programs)"
            ) from error
        future.add_done_callback(lambda done: self._release(process, done))
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether an error means that a process ended."""
        return isinstance(error, BrokenProcessPool | ShutdownExecutorError)

    def shutdown(self) -> None:
        """Kill the processes and the programs they have started."""
        for process in tuple(self._started):  # broken ones remove themselves meanwhile
            process.shutdown(wait=True, kill_workers=True)
        self._started.clear()

    def _start(self) -> ProcessPoolExecutor:
        process = ProcessPoolExecutor(
            max_workers=1, initializer=_initialise, initargs=(os.getpid(),), env=_ENVIRONMENT
        )
        self._started.add(process)
        return process

    def _release(self, process: ProcessPoolExecutor, done: Future[FlightResult]) -> None:
        """Mark a process as free; replace one that ended by a place to start another."""
        error = done.exception()
        if error is not None and self.lost_worker(error):
            self._started.discard(process)
            self._free.append(None)
        else:
            self._free.append(process)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let Python processes that start in the block import nothing from the current directory.

    Also those that inherit the environment, to which `env` of an executor does not apply.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


def _initialise(parent: int) -> None:
    """Ignore Ctrl-C in a worker, which its parent handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()


def _end_with_parent(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_PARENT_POLL_S)
    os.kill(os.getpid(), signal.SIGTERM)  # a flight ends what it started, such as ArduPlane
    time.sleep(_GRACE_S)
    os._exit(1)
