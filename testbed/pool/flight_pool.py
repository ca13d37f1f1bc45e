"""Run flights in worker processes: on this machine, or on a Dask cluster.

The result of a flight depends on its scenario only: not on the number of workers, their place,
the order, or earlier flights.
"""

from __future__ import annotations

import queue
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager

from testbed.core.compile import cache_folder, is_compiling, notice
from testbed.core.errors import ExternalProgramLost, InputError, raise_memory_shortage
from testbed.pool.dask_workers import LOST, DaskWorkers
from testbed.pool.flight_task import (
    FAILED,
    INTERRUPTED,
    INVALID,
    FlightResult,
    FlightTask,
    WorkerPool,
)
from testbed.runs.stop_request import StopRequest, stop_on_signals

Progress = Callable[[int, int], None]  # called with the flights done, and all
Report = Callable[[str], None]  # called with a line for people

MAX_ATTEMPTS = 2  # of a flight whose worker process ends
POLL_S = 0.1  # interval at which a pending signal is looked for


def group_numbers(keys: Iterable[Hashable]) -> list[list[int]]:
    """Return the positions of keys, those of equal keys in one list."""
    groups: dict[Hashable, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return list(groups.values())


class _GroupedTasks:
    """Tasks of groups, in the order in which free workers take them."""

    def __init__(self, groups: Iterable[Iterable[FlightTask]]) -> None:
        self._new = map(iter, groups)
        self._open: list[Iterator[FlightTask]] = []  # groups of which tasks were taken
        self._group_of: dict[int, Iterator[FlightTask]] = {}  # of running tasks, by number
        self._preferred: Iterator[FlightTask] | None = None

    def prefer_group_of(self, task: FlightTask) -> None:
        """Take the next task from the group of one that has ended."""
        self._preferred = self._group_of.pop(task.number, None)

    def take(self) -> FlightTask | None:
        """Return the next task; None: there are no more."""
        for group in self._candidates():
            task = next(group, None)
            if task is not None:
                self._preferred, self._group_of[task.number] = None, group
                return task
            self._open.remove(group)
        return None

    def _candidates(self) -> Iterator[Iterator[FlightTask]]:
        if self._preferred is not None and self._preferred in self._open:
            yield self._preferred
        for group in self._new:
            self._open.append(group)
            yield group
        yield from tuple(self._open)


class FlightPool:
    """Distributes tasks over the workers of a pool, and collects their results."""

    def __init__(
        self,
        workers: WorkerPool,
        stop: StopRequest,
        report: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Use these workers until a stop is requested; `report` is called once if they compile."""
        self._workers = workers
        self._stop = stop
        self._report: Callable[[str], None] | None = report

    def run(self, tasks: Iterable[FlightTask]) -> Iterator[FlightResult]:
        """Fly tasks in this order; see `run_groups`."""
        return self.run_groups([tasks])

    def run_groups(self, groups: Iterable[Iterable[FlightTask]]) -> Iterator[FlightResult]:
        """Fly groups of tasks and yield their results in the order in which they end.

        Tasks are taken from the iterables as workers become free: the next one of the group whose
        task has ended, else the first of the next group, else one of a group that others fly. Thus
        a worker flies the tasks of one group one after another. A task whose worker process is
        killed is flown once more; after `MAX_ATTEMPTS` it has failed.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM was received.
            ExternalProgramLost: the connection to the cluster was lost.
            InputError: no process can be started.
            MemoryError: a flight had too little memory.
        """
        pending = _GroupedTasks(groups)
        retries: deque[FlightTask] = deque()
        attempts: Counter[int] = Counter()
        running: dict[Future[FlightResult], FlightTask] = {}
        # not a SimpleQueue: in CPython 3.11 its `get` waits for ever after a signal whose handler
        # returns later than the timeout
        done: queue.Queue[Future[FlightResult]] = queue.Queue()
        more = True
        while more or retries or running:
            capacity = self._workers.capacity()  # also notices a cluster that has gone
            while (more or retries) and len(running) < capacity and not self._stop():
                task = retries.popleft() if retries else pending.take()
                if task is None:
                    more = False
                elif task.scenario is None:
                    pending.prefer_group_of(task)
                    yield FlightResult(task.number, INVALID, task.error, None)
                else:
                    future = self._workers.submit(task)
                    running[future] = task
                    future.add_done_callback(done.put)
            if self._stop():
                raise KeyboardInterrupt
            try:
                future = done.get(timeout=POLL_S)
            except queue.Empty:
                self._report_compiling()
                continue
            task = running.pop(future)
            pending.prefer_group_of(task)
            result = self._result(future, task)
            if result is None:
                attempts[task.number] += 1
                if attempts[task.number] < MAX_ATTEMPTS:
                    retries.append(task)
                    continue
                error = f"failed: its process was killed {MAX_ATTEMPTS} times"
                result = FlightResult(task.number, FAILED, error, None)
            yield result

    def _report_compiling(self) -> None:
        """Report that a worker compiles kernels, the first time that one does."""
        if self._report and is_compiling(cache_folder()):
            self._report(notice())
            self._report = None

    def _result(self, future: Future[FlightResult], task: FlightTask) -> FlightResult | None:
        """Return the result of a finished future; None if its worker process ended."""
        try:
            error = future.exception()
        except CancelledError:
            raise ExternalProgramLost(LOST.format("its scheduler has ended")) from None
        if error is None:
            result = future.result()
            return None if result.outcome == INTERRUPTED else result
        raise_memory_shortage(error)  # no result of the flight, which would be kept as one
        if isinstance(error, KeyboardInterrupt) or self._workers.lost_worker(error):
            return None
        return FlightResult(task.number, FAILED, f"failed: {type(error).__name__}: {error}", None)


class FlightWorkers:
    """Worker processes that start when they are first needed.

    Args:
        jobs: processes on this machine; default one for each available processor.
        backend: "joblib" for this machine, "dask" for a cluster.
        scheduler: address of the cluster's scheduler.
        report: called with a line when workers compile kernels, once.
    """

    def __init__(
        self,
        jobs: int | None = None,
        backend: str = "joblib",
        scheduler: str | None = None,
        report: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._choice = jobs, backend, scheduler
        self._report = report
        self._workers: WorkerPool | None = None
        self._pool: FlightPool | None = None  # of the block that is open

    @contextmanager
    def pool(self, *, keep: bool = False) -> Iterator[FlightPool]:
        """Return the pool for a block; see `open_flight_pool`. A block within it has the same one.

        Args:
            keep: whether the processes stay for the next block, unless this one raises an error.

        Raises:
            InputError: the backend is unknown, or the cluster cannot be reached.
        """
        if self._pool is not None:
            yield self._pool
            return
        with stop_on_signals() as stop:
            self._workers = self._workers or _open_workers(*self._choice)
            self._pool = FlightPool(self._workers, stop, self._report)
            try:
                yield self._pool
            except BaseException:
                keep = False
                raise
            finally:
                self._pool = None
                if not keep:
                    stop.without_interruption(self.close)

    def close(self) -> None:
        """End the processes."""
        workers, self._workers = self._workers, None
        if workers is not None:
            workers.shutdown()


@contextmanager
def open_flight_pool(
    *,
    jobs: int | None = None,
    backend: str = "joblib",
    scheduler: str | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Iterator[FlightPool]:
    """Open worker processes, and end them with the block, whatever happens in it.

    In the block, the first Ctrl-C or SIGTERM makes `FlightPool.run` raise KeyboardInterrupt;
    another one more than a second later raises it anywhere.

    Args:
        jobs: see `FlightWorkers`.
        backend: see there.
        scheduler: see there.
        report: see there.

    Raises:
        InputError: the backend is unknown, or the cluster cannot be reached.
    """
    with FlightWorkers(jobs, backend, scheduler, report).pool() as pool:
        yield pool


def _open_workers(jobs: int | None, backend: str, scheduler: str | None) -> WorkerPool:
    if backend == "joblib":
        from testbed.pool.local_workers import LocalWorkers

        if scheduler is not None:
            raise InputError(f"--scheduler {scheduler}: needs --backend dask")
        return LocalWorkers(jobs)
    if backend == "dask":
        if scheduler is None:
            raise InputError(
                "--backend dask: needs the address of the scheduler (write --scheduler "
                "tcp://HOST:8786)"
            )
        if jobs is not None:
            raise InputError(f"--jobs {jobs}: the cluster has its own workers (leave --jobs out)")
        return DaskWorkers(scheduler)
    raise InputError(f"--backend {backend}: unknown backend (write joblib or dask)")
