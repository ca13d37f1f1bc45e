"""A fleet that is stepped by several processes at once, for large formations.

Each process steps some of the aircraft. They are forked from the one that flies the scenario when
it takes its first step, so that nothing is loaded, trimmed or placed twice, and share a piece of
memory with it. Flight models know nothing of one another: whoever steps them, the numbers are the
same to the bit.
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
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from multiprocessing.synchronize import Semaphore
from pathlib import Path

import numpy as np

from testbed.errors import PartnerLost
from testbed.state import AirFelt, Array, Origin, Surfaces
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.instruments import MOTION
from testbed.vehicle.legs import LONGEST, Leg, parts_of
from testbed.vehicle.properties import READY_READ, READY_WRITE, joined
from testbed.vehicle.start import Start

WORTH_IT = 20  # aircraft from which on two processes were measured to be faster than one
LOOKS = 400  # of one who waits before it leaves the processor to others, some 0.1 ms
AGAIN_S = 0.5  # how often who waits looks whether the other is still there
_NUMBERS = {"notes": LONGEST * len(MOTION), "air": 8, "surfaces": 4, "told": 7, "charge": 1}
_WORDS = 2 + LONGEST
_DOUBLE = np.dtype(np.float64).itemsize
# Called in a process of its own, gives what it does whenever it is told to.
Post = Callable[[], Callable[[], None]]


def crew_of(aircraft: int) -> int:
    """How many processes are best for so many flight models on this machine."""
    if sys.platform != "linux" or aircraft < WORTH_IT:
        return 1
    return max(1, min(len(os.sched_getaffinity(0)), aircraft // (WORTH_IT // 2)))


def make_fleet(
    folders: Sequence[Path],
    starts: Sequence[Start],
    origin: Origin,
    base_rate_hz: int,
    *,
    processes: int | None,
) -> JsbsimFleet:
    """A fleet as `JsbsimFleet` takes it, stepped by so many processes; None: `crew_of`."""
    crew = crew_of(len(folders)) if processes is None else min(processes, len(folders))
    if crew < 2:
        return JsbsimFleet(folders, starts, origin, base_rate_hz)
    return CrewedFleet(folders, starts, origin, base_rate_hz, processes=crew)


class _Shared:
    """Numbers that all processes see, of N aircraft; doubles but for the last four."""

    def __init__(self, n: int) -> None:
        words = n * sum(_NUMBERS.values()) + _WORDS
        memory = mmap.mmap(-1, _DOUBLE * words + (2 + LONGEST) * n)
        numbers, at = np.frombuffer(memory, dtype=np.float64, count=words - _WORDS), 0
        self.of: dict[str, Array] = {}
        for name, each in _NUMBERS.items():
            self.of[name] = numbers[at : at + each * n]
            at += each * n
        self.of["charge"][:] = np.nan  # to which a battery is emptied now
        # how many legs to fly, how often it was told what blows, and the ticks of the legs
        self.words = memoryview(memory)[_DOUBLE * (words - _WORDS) : _DOUBLE * words].cast("q")
        flags = np.frombuffer(memory, dtype=bool, offset=_DOUBLE * words).reshape(-1, n)
        self.broken, self.gone, self.wanted = flags[0], flags[1], flags[2:]


class CrewedFleet(JsbsimFleet):
    """N JSBSim aircraft on one clock, as a `JsbsimFleet`, stepped by several processes."""

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[Start],
        origin: Origin,
        base_rate_hz: int,
        *,
        processes: int,
    ) -> None:
        """See `JsbsimFleet`.

        Args:
            folders: N aircraft folders.
            starts: N starts.
            origin: of the local frame.
            base_rate_hz: steps per second.
            processes: in which the N aircraft are stepped, this one included.
        """
        super().__init__(folders, starts, origin, base_rate_hz)
        n = len(folders)
        self._shared = _Shared(n)
        self._broken, numbers = self._shared.broken, self._shared.of
        for name, own in (("notes", self._notes), ("air", self._raw_air), ("told", self._told)):
            numbers[name][:] = own.ravel()
        self._notes = numbers["notes"].reshape(self._notes.shape)
        self._raw_air, self._told = numbers["air"], numbers["told"]
        self._shared.wanted[:] = self._wanted
        self._wanted = self._shared.wanted
        surfaces = numbers["surfaces"].reshape(4, n)
        surfaces[:] = self._surfaces
        self._surfaces = Surfaces(*surfaces)
        self._bind()
        parts = np.array_split(np.arange(n), min(processes, n))
        self._mine, *self._theirs = (tuple(part.tolist()) for part in parts)
        self._crew: _Crew | None = None

    def _take(self, surfaces: Surfaces) -> None:
        """Tell everybody."""
        self._shared.of["surfaces"].reshape(4, -1)[:] = surfaces
        super()._take(self._surfaces)

    def _run(self, legs: tuple[Leg, ...]) -> None:
        """Run everyone through legs, all at once."""
        crew, words = self._crew or self._hire(), self._shared.words
        words[0] = len(legs)
        for k, leg in enumerate(legs):
            words[2 + k] = leg.ticks
        crew.go()
        self._run_through(self._mine, parts_of(legs, self._mine))
        crew.wait()

    def blow(self, felt: AirFelt) -> None:
        """Say what the air does to the aircraft from now on."""
        super().blow(felt)
        self._shared.words[1] += 1

    def discharge(self, charge: Array) -> None:
        """Empty batteries to a state of charge (N,) 0..1 at once; not a number: as they are."""
        if self._crew is None:
            super().discharge(charge)
            return
        mine = np.full(len(charge), np.nan)
        own = list(self._mine)
        mine[own] = charge[own]
        super().discharge(mine)
        self._shared.of["charge"][:] = charge

    def close(self) -> None:
        """End the other processes; what was read last stays."""
        if self._crew is not None:
            self._crew.end()

    def _bind_to_air(self) -> None:
        super()._bind_to_air()
        self._hear = READY_WRITE(joined(self._blown), self._told)
        self._tell_air = READY_READ(joined(self._of_air), self._raw_air)

    def _remove(self, i: int) -> None:
        super()._remove(i)
        self._shared.gone[i] = True

    def _hire(self) -> _Crew:
        """Fork the others, and leave their aircraft to them."""
        crew = _Crew([(rows, partial(self._work, rows)) for rows in self._theirs])
        self._crew = crew
        weakref.finalize(self, crew.end)
        self._leave({i for rows in self._theirs for i in rows})
        return crew

    def _leave(self, rows: Iterable[int]) -> None:
        """Leave these aircraft to others: what they read is found in the shared memory."""
        for i in rows:
            self._runs[i] = None
            for nodes in (self._motion, self._of_air, self._controls, self._blown):
                nodes[i] = [None] * len(nodes[i])
        self._bind()

    def _work(self, rows: Sequence[int]) -> Callable[[], None]:
        """What a process that has these aircraft does at each step; called in that process."""
        shared, n = self._shared, len(self._models)
        self._leave(set(range(n)) - set(rows))
        charge, heard = shared.of["charge"], 0

        def work() -> None:
            nonlocal heard
            count, told, *ticks = shared.words
            if told != heard:
                heard = told
                self._hear()
            for i in rows:
                if not np.isnan(charge[i]):
                    self._models[i].discharge(float(charge[i]))
                    charge[i] = np.nan
                if shared.gone[i] and self._runs[i] is not None:
                    self._remove(i)
            self._command()
            wanted = map(tuple, shared.wanted[:count, list(rows)].tolist())
            legs = tuple(map(Leg, ticks[:count], wanted))
            self._run_through(rows, parts_of(legs, tuple(range(len(rows)))))
            self._tell_air()

        return work


class _Crew:
    """Processes that do something each time they are told to, and die with this one.

    Args:
        posts: of each process its aircraft, and what gives, there, what it does.
    """

    def __init__(self, posts: Sequence[tuple[Sequence[int], Post]]) -> None:
        """Fork them."""
        make = multiprocessing.get_context("fork").Semaphore
        self._told, self._done = ([make(0) for _ in posts] for _ in range(2))
        self._rows = [rows for rows, _ in posts]
        self._parent, self._children = os.getpid(), list[int]()
        for (_, begin), told, done in zip(posts, self._told, self._done, strict=True):
            with warnings.catch_warnings():
                # threads are not copied; the copy calls nothing that could wait for one of them
                warnings.simplefilter("ignore", DeprecationWarning)
                child = os.fork()
            if not child:
                self._serve(begin, told, done)
            self._children.append(child)

    def go(self) -> None:
        """Have everyone work."""
        for each in self._told:
            each.release()

    def wait(self) -> None:
        """Until everyone is done.

        Raises:
            PartnerLost: one is gone.
        """
        for k, done in enumerate(self._done):
            while not _taken(done):
                ended, status = os.waitpid(self._children[k], os.WNOHANG)
                if ended:
                    self._children[k] = 0
                    rows = ", ".join(map(str, self._rows[k]))
                    raise PartnerLost(
                        f"a process that steps aircraft ({rows} of the flight models, from 0) has "
                        f"ended with {os.waitstatus_to_exitcode(status)} (is there enough memory? "
                        "--processes 1 does without)"
                    )

    def end(self) -> None:
        """End everyone. Harmless when repeated, and in a copy of this process."""
        if os.getpid() != self._parent:
            return
        for k, child in enumerate(self._children):
            if child:
                os.kill(child, signal.SIGKILL)  # they hold nothing that could be lost
                os.waitpid(child, 0)
            self._children[k] = 0

    def _serve(self, begin: Post, told: Semaphore, done: Semaphore) -> None:
        """The life of a forked process."""
        try:
            for number in (signal.SIGINT, signal.SIGTERM):  # of the group: the parent decides
                signal.signal(number, signal.SIG_IGN)
            gc.freeze()
            work = begin()
            while os.getppid() == self._parent:
                if _taken(told):
                    work()
                    done.release()
        finally:
            os._exit(1)


def _taken(semaphore: Semaphore) -> bool:
    """Wait for a semaphore a while: first awake, for most waits are short."""
    for _ in range(LOOKS):
        if semaphore.acquire(False):
            return True
    return semaphore.acquire(True, AGAIN_S)
