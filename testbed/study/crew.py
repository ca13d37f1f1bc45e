"""Flights apart from one another, in processes that outlast them: here, or on a cluster.

Whoever flies many pages opens one crew and hands it tasks as often as need be. What comes of a page
depends on the page alone: not on how many fly, where, in which order, or what flew before.
"""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from testbed.errors import InputError
from testbed.sim.stop import Stop, stopping

if TYPE_CHECKING:
    from testbed.scenario import Scenario

FLOWN, LOST, UPSET, FAILED, REFUSED = "flown", "lost", "upset", "failed", "cannot be flown"
INTERRUPTED = "interrupted"
CHANCES = 2  # of a flight whose process ends under it
POLL_S = 0.1  # between two looks at whether a signal came
_ALONE = threading.Lock()  # a process of a cluster may have several threads


@dataclass(frozen=True, slots=True)
class Task:
    """A page to fly under a number; or, in its place, why there is none."""

    number: int
    page: Scenario | str


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of a task.

    Args:
        number: the task's.
        outcome: "flown", "lost", "upset", "failed" or "cannot be flown".
        error: what went wrong; empty where nothing did.
        metrics: the document of metrics.json; None where there is none.
        wall_s: how long it took.
    """

    number: int
    outcome: str
    error: str
    metrics: Mapping[str, Any] | None
    wall_s: float = 0.0


class Pool(Protocol):
    """Processes that fly."""

    def room(self) -> int:
        """How many tasks should be with them at once."""

    def submit(self, task: Task) -> Future[Flown]:
        """Have a task flown by `fly`."""

    def killed(self, error: BaseException) -> bool:
        """Whether it says that the process which had the task has ended."""

    def end(self) -> None:
        """End them, with what they fly."""


class Crew:
    """Flies tasks, for as long as it is open."""

    def __init__(self, pool: Pool, stop: Stop) -> None:
        """Fly in these processes, until told to stop."""
        self._pool = pool
        self._stop = stop

    def fly(self, tasks: Iterable[Task]) -> Iterator[Flown]:
        """What comes of tasks, in the order in which they end.

        They are taken one by one as there is room. One whose process is killed is flown once more;
        killed again, it has failed.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM came.
            InputError: the cluster is gone.
        """
        waiting = iter(tasks)
        again: deque[Task] = deque()
        ended: Counter[int] = Counter()
        flying: dict[Future[Flown], Task] = {}
        done: queue.SimpleQueue[Future[Flown]] = queue.SimpleQueue()
        more = True
        while more or again or flying:
            while (more or again) and len(flying) < self._pool.room() and not self._stop():
                task = again.popleft() if again else next(waiting, None)
                if task is None:
                    more = False
                elif isinstance(task.page, str):
                    yield Flown(task.number, REFUSED, task.page, None)
                else:
                    future = self._pool.submit(task)
                    flying[future] = task
                    future.add_done_callback(done.put)
            if self._stop():
                raise KeyboardInterrupt
            try:
                future = done.get(timeout=POLL_S)
            except queue.Empty:
                continue
            task = flying.pop(future)
            flown = self._result(future, task)
            if flown is None:
                ended[task.number] += 1
                if ended[task.number] < CHANCES:
                    again.append(task)
                    continue
                error = f"failed: its process was killed {CHANCES} times"
                flown = Flown(task.number, FAILED, error, None)
            yield flown

    def _result(self, future: Future[Flown], task: Task) -> Flown | None:
        """What came of a task; nothing, if its process ended under it."""
        try:
            error = future.exception()
        except CancelledError:
            raise InputError("the cluster has gone, with the flights it had") from None
        if error is None:
            flown = future.result()
            return None if flown.outcome == INTERRUPTED else flown
        if isinstance(error, KeyboardInterrupt) or self._pool.killed(error):
            return None
        return Flown(task.number, FAILED, f"failed: {type(error).__name__}: {error}", None)


@contextmanager
def crew(
    *, jobs: int | None = None, backend: str = "joblib", scheduler: str | None = None
) -> Iterator[Crew]:
    """A crew for as long as the block lasts; whatever happens in it, its processes end.

    In the block Ctrl-C and SIGTERM are heeded by who flies: `Crew.fly` raises KeyboardInterrupt at
    the first, everything at the second.

    Args:
        jobs: processes at once, here; default one for each processor that is ours.
        backend: "joblib" is here, "dask" a cluster.
        scheduler: the address of the cluster's.

    Raises:
        InputError: there is no such backend, or no such cluster.
    """
    with stopping() as stop:
        pool = _pool(jobs, backend, scheduler)
        try:
            yield Crew(pool, stop)
        finally:
            stop.undisturbed(pool.end)


def _pool(jobs: int | None, backend: str, scheduler: str | None) -> Pool:
    if backend == "joblib":
        from testbed.study.processes import Processes

        if scheduler is not None:
            raise InputError(f"--scheduler {scheduler}: goes with --backend dask")
        return Processes(jobs)
    if backend == "dask":
        from testbed.study.cluster import Cluster

        if scheduler is None:
            raise InputError(
                "--backend dask: say where the scheduler is, as in --scheduler tcp://HOST:8786"
            )
        if jobs is not None:
            raise InputError(f"--jobs {jobs}: a cluster has the workers it has; leave it out")
        return Cluster(scheduler)
    raise InputError(f"--backend {backend}: there is no such backend (write joblib or dask)")


def fly(task: Task) -> Flown:
    """Fly a task in this process; what every backend does."""
    # which take their time, and are not for who only waits
    from testbed.metrics.document import losses, upsets
    from testbed.sim.run import run

    page = task.page
    assert not isinstance(page, str)
    metrics: Mapping[str, Any] | None = None
    with _ALONE:
        began = time.perf_counter()
        try:
            metrics = run(page, write=False).metrics
            outcome = str(metrics["outcome"])
            wrong = {LOST: losses, UPSET: upsets}.get(outcome)
            error = f"{outcome}: {', '.join(wrong(metrics))}" if wrong else ""
        except InputError as refusal:
            outcome, error = REFUSED, f"cannot be flown: {refusal}"
        except Exception as fault:
            last = traceback.extract_tb(fault.__traceback__)[-1]
            where = f"{Path(last.filename).name}:{last.lineno}"
            outcome, error = FAILED, f"failed: {type(fault).__name__}: {fault} ({where})"
    return Flown(task.number, outcome, error, metrics, time.perf_counter() - began)
