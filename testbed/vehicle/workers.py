"""A fleet that several processes step in parallel, for large formations.

Each process steps some of the aircraft. The processes are forked from the one that flies the
scenario at its first step, so that nothing is loaded, trimmed or placed twice, and share memory
with it. Flight models are independent of one another, so the numbers do not depend on the number of
processes, to the bit.
"""

from __future__ import annotations

import gc
import mmap
import multiprocessing
import os
import signal
import sys
import warnings
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.synchronize import Semaphore
from pathlib import Path

import numpy as np

from testbed.core.errors import ExternalProgramLost
from testbed.core.records import Array, Indices, NedOrigin, Records
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_io import CONTROLS, WIND
from testbed.vehicle.trim import InitialState

MIN_AIRCRAFT = 20  # from which on two processes were measured to be faster than one
SPINS = 400  # tries of a waiting process before it yields the processor, some 0.1 ms
CHECK_S = 0.5  # how often a waiting process checks that the other still runs
_PER_AIRCRAFT = {"_numbers": 17, "_air_numbers": 5, "_wind_numbers": 7, "_controls": 4}
_DOUBLE = np.dtype(np.float64).itemsize
# Called in a worker process, returns what it does at each step.
Setup = Callable[[], Callable[[], None]]


def default_processes(aircraft: int) -> int:
    """Return how many processes are best for so many flight models on this machine."""
    if sys.platform != "linux" or aircraft < MIN_AIRCRAFT:
        return 1
    return max(1, min(len(os.sched_getaffinity(0)), aircraft // (MIN_AIRCRAFT // 2)))


def make_fleet(
    folders: Sequence[Path],
    starts: Sequence[InitialState],
    origin: NedOrigin,
    base_rate_hz: int,
    integrators: Integrators = INTEGRATORS,
    *,
    processes: int | None,
) -> JsbsimFleet:
    """Make a fleet stepped by so many processes; None: `default_processes`."""
    count = default_processes(len(folders)) if processes is None else processes
    count = min(count, len(folders))
    if count < 2:
        return JsbsimFleet(folders, starts, origin, base_rate_hz, integrators)
    return ParallelFleet(folders, starts, origin, base_rate_hz, integrators, processes=count)


class ParallelFleet(JsbsimFleet):
    """N JSBSim aircraft on one clock, as a `JsbsimFleet`, stepped by several processes."""

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[InitialState],
        origin: NedOrigin,
        base_rate_hz: int,
        integrators: Integrators = INTEGRATORS,
        *,
        processes: int,
    ) -> None:
        """See `JsbsimFleet`.

        Args:
            folders: N aircraft folders.
            starts: N initial states.
            origin: of the local frame.
            base_rate_hz: steps per second.
            integrators: of the flight models.
            processes: in which the N aircraft are stepped, this one included.
        """
        super().__init__(folders, starts, origin, base_rate_hz, integrators)
        n = len(folders)
        doubles = n * (sum(_PER_AIRCRAFT.values()) + 1)
        memory = mmap.mmap(-1, _DOUBLE * (doubles + 2) + 2 * n)
        shared, at = np.frombuffer(memory, dtype=np.float64, count=doubles), 0
        for name, columns in _PER_AIRCRAFT.items():
            own = getattr(self, name)
            each = shared[at : at + n * columns].reshape(n, columns)
            each[:] = own
            setattr(self, name, each)
            at += n * columns
        self._charge = shared[at:]  # to which a battery is emptied at the next step; nan: not
        self._charge[:] = np.nan
        # ticks to run, and how often the wind was set
        self._orders = memoryview(memory)[_DOUBLE * doubles : _DOUBLE * (doubles + 2)].cast("q")
        flags = np.frombuffer(memory, dtype=bool, offset=_DOUBLE * (doubles + 2)).reshape(2, n)
        flags[0] = self._stopped
        self._stopped, self._removed = flags
        parts = np.array_split(np.arange(n), min(processes, n))
        self._mine, *self._theirs = parts
        self._workers: _Workers | None = None
        self.bind(self.aircraft, self.rows)

    def bind(self, aircraft: Records, rows: Indices) -> None:
        """See `JsbsimFleet`."""
        super().bind(aircraft, rows)
        aircraft["stopped"][rows] = self._stopped

    def close(self) -> None:
        """End the other processes; the numbers read last remain."""
        if self._workers is not None:
            self._workers.end()

    def discharge(self, charge: Array) -> None:
        """Empty batteries to a state of charge (N,) 0..1; NaN: no change."""
        if self._workers is None:
            super().discharge(charge)
            return
        mine = np.full(len(charge), np.nan)
        mine[self._mine] = charge[self._mine]
        super().discharge(mine)
        self._charge[:] = charge

    def _run_all(self, ticks: int, read: Indices) -> None:
        workers = self._workers or self._start_workers()
        self._orders[0] = ticks
        self._orders[1] += self._changed[WIND]
        workers.start_step()
        self._run_models(self._mine, ticks, read)
        workers.wait()
        self.aircraft["stopped"][self.rows] = self._stopped

    def _stop(self, i: int) -> None:
        super()._stop(i)
        self._removed[i] = True

    def _start_workers(self) -> _Workers:
        """Fork the workers, and leave their aircraft to them."""
        workers = _Workers([(rows.tolist(), partial(self._work, rows)) for rows in self._theirs])
        self._workers = workers
        weakref.finalize(self, workers.end)
        self._leave(np.concatenate(self._theirs).tolist())
        return workers

    def _work(self, which: Indices) -> Callable[[], None]:
        """Return what a worker with these aircraft does at each step; called in that process."""
        rows = which.tolist()
        self._leave([i for i in range(len(self._models)) if i not in rows])
        wind = 0

        def work() -> None:
            nonlocal wind
            if self._orders[1] != wind:
                wind = self._orders[1]
                self._changed[WIND] = True
            for i in rows:
                if not np.isnan(self._charge[i]):
                    self._models[i].power.discharge(float(self._charge[i]))
                    self._charge[i] = np.nan
                if self._removed[i] and self._runs[i] is not None:
                    self._stop(i)
            self._changed[CONTROLS] = True
            self._run_models(which, self._orders[0], self.all_rows)
            self._read_air_numbers(rows)

        return work


class _Workers:
    """Processes that run a function at each request, and end with this one.

    Args:
        setups: for each process its aircraft, and a function called there that returns the work.
    """

    def __init__(self, setups: Sequence[tuple[Sequence[int], Setup]]) -> None:
        make = multiprocessing.get_context("fork").Semaphore
        self._begin, self._done = ([make(0) for _ in setups] for _ in range(2))
        self._rows = [rows for rows, _ in setups]
        self._parent, self._children = os.getpid(), list[int]()
        for (_, setup), begin, done in zip(setups, self._begin, self._done, strict=True):
            with warnings.catch_warnings():
                # threads are not copied; the copy calls nothing that could wait for one of them
                warnings.simplefilter("ignore", DeprecationWarning)
                child = os.fork()
            if not child:
                self._serve(setup, begin, done)
            self._children.append(child)

    def start_step(self) -> None:
        """Have all workers do one step."""
        for each in self._begin:
            each.release()

    def wait(self) -> None:
        """Wait until all workers are done.

        Raises:
            ExternalProgramLost: one has ended.
        """
        for k, done in enumerate(self._done):
            while not _acquired(done):
                ended, status = os.waitpid(self._children[k], os.WNOHANG)
                if ended:
                    self._children[k] = 0
                    rows = ", ".join(map(str, self._rows[k]))
                    raise ExternalProgramLost(
                        f"a process that steps aircraft ({rows} of the flight models, from 0) has "
                        f"ended with {os.waitstatus_to_exitcode(status)} (is there enough memory? "
                        "--processes 1 does without)"
                    )

    def end(self) -> None:
        """End all workers. Harmless when repeated, and in a copy of this process."""
        if os.getpid() != self._parent:
            return
        for k, child in enumerate(self._children):
            if child:
                os.kill(child, signal.SIGKILL)  # they hold nothing that could be lost
                os.waitpid(child, 0)
            self._children[k] = 0

    def _serve(self, setup: Setup, begin: Semaphore, done: Semaphore) -> None:
        """Run a forked process to its end."""
        try:
            for number in (signal.SIGINT, signal.SIGTERM):  # the parent handles them
                signal.signal(number, signal.SIG_IGN)
            gc.freeze()
            work = setup()
            while os.getppid() == self._parent:
                if _acquired(begin):
                    work()
                    done.release()
        finally:
            os._exit(1)


def _acquired(semaphore: Semaphore) -> bool:
    """Wait for a semaphore for a while: first without sleeping, for most waits are short."""
    for _ in range(SPINS):
        if semaphore.acquire(False):
            return True
    return semaphore.acquire(True, CHECK_S)
