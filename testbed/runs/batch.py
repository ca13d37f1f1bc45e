"""Many flights in one process, side by side."""

from __future__ import annotations

import math
import os
import time
import weakref
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.call_list import run_each
from testbed.core.compile import is_interpreted, reporting
from testbed.core.errors import InputError, NotCopied
from testbed.core.exclusive import Exclusive, exclusive
from testbed.core.records import (
    AIRCRAFT,
    COMMAND,
    FOLLOWER,
    LINK,
    Array,
    BoolArray,
    Event,
    Records,
    allocate_rows,
)
from testbed.core.saved_state import SavedState
from testbed.flight.loop import Flight
from testbed.flight.tick_loop import PAUSED, PLACE
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver
from testbed.plan.world import RowRecords, build
from testbed.runs.command_ranges import RANGES, wrong_part
from testbed.runs.flight_progress import Progress, compiling_report, reporting_progress
from testbed.runs.run import stop_bounds
from testbed.runs.simulation import EventCollector, flight_metrics
from testbed.scenario import Scenario, ScenarioError, find_loaded, set_seed
from testbed.scenario.aircraft import ArduPlane
from testbed.scenario.arguments import check_argument, check_count, check_list, check_overrides
from testbed.scenario.fields import MAX_DURATION_S
from testbed.scenario.sections import Header
from testbed.scenario.set_keys import KeyUse
from testbed.scenario.validate import shown_value

Flown: TypeAlias = "Scenario | str | os.PathLike[str]"
_PARTS = 4  # of the rows, for each thread


class Batch(NotCopied):
    """Flights of one scenario in this process, as rows of arrays.

    Each row flies as `testbed.run` of its scenario and seed, to the bit. Threads fly rows at the
    same time. Nothing is written. A forked child flies its own rows on; copies and pickles are
    refused, and so is a call while another thread is within one.

    Args:
        scenario: a scenario, or the name or path of one; or the scenario of each row.
        overrides: `key=value` as for `--set`, for all rows; only with a name or path.
        seeds: of the rows; None: that of the scenario for each of `rows`.
        rows: for each row `key=value` of its own; only with a name or path. None: none.
        threads: that fly; None: one for each available processor.
        duration_s: of all flights, s; None: that of the scenario.
        progress: of compiling, as of `testbed.run`.

    Attributes:
        seeds: R, of the flights.
        names: of all N aircraft, the leader first.
        aircraft: (R, N) of AIRCRAFT, live.
        followers: (R, n) of FOLLOWER, live.
        links: (R, n, N) of LINK, live: the newest message of each aircraft, and counters.
        commands: (R, N) of COMMAND: fly-by-wire-A commands in rad, rad and 0..1, of aircraft with
            `commanded_by: external`; first their trim.
        times_s: (R,) s, of the present ticks.
        outcomes: R, how each flight ended; None: it has not.

    Raises:
        InputError: a scenario cannot be flown, has ArduPlanes, or the rows have other aircraft.
    """

    def __init__(
        self,
        scenario: Flown | Sequence[Scenario],
        overrides: Sequence[str] = (),
        *,
        seeds: Sequence[int] | None = None,
        rows: Sequence[Sequence[str]] | None = None,
        threads: int | None = None,
        duration_s: float | None = None,
        progress: Progress = None,
    ) -> None:
        self._threads = _processors() if threads is None else check_count("threads", threads)
        self._scenarios = _row_scenarios(scenario, overrides, seeds, rows, duration_s)
        self.seeds = [each.scenario.seed for each in self._scenarios]
        first = self._scenarios[0]
        self.names = first.aircraft_names
        self._exclusive = Exclusive(f"the batch of {first.name}")
        self._pool: tuple[int, ThreadPoolExecutor] | None = None  # the process, and its threads
        for row, each in enumerate(self._scenarios):
            if each.aircraft_names != self.names:
                raise InputError(f"rows[{row}]: has other aircraft than the first row")
            for one in each.aircraft:
                if isinstance(one.autopilot, ArduPlane):
                    raise InputError(
                        f"{one.name} has autopilot: ardupilot (fly it with testbed.run)"
                    )
        size, n = len(self.seeds), len(self.names)
        self.aircraft, aircraft = allocate_rows(AIRCRAFT, size, n)
        self.followers, followers = allocate_rows(FOLLOWER, size, n - 1)
        self.links, links = allocate_rows(LINK, size, n - 1, n)
        self.commands, commands = allocate_rows(COMMAND, size, n)
        places, place = allocate_rows(PLACE, size, 1)
        self._places = places[:, 0]
        arrays = zip(aircraft, followers, links, commands, strict=True)
        self._records = [(RowRecords(*each), own) for each, own in zip(arrays, place, strict=True)]
        self.outcomes: list[str | None] = [None] * size
        with (
            reporting_progress(progress, first.name) as report,
            reporting(compiling_report(report)),
        ):
            self._rows = [self._build(row) for row in range(size)]
        self._refuse_unused()
        self.times_s: Array = self._places["now"]
        self._commanded = np.array([each.commanded for each in self._rows])

    def _build(self, row: int) -> _Row:
        return _Row(self.scenario(row), *self._records[row])

    def _refuse_unused(self) -> None:
        """Refuse keys that have no effect in any row that sets them."""
        use = KeyUse()
        for scenario, row in zip(self._scenarios, self._rows, strict=True):
            use.add(scenario.set_keys, row.unused)
        if use.refused:
            raise ScenarioError([each.problem for each in use.refused])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.seeds)

    def scenario(self, row: int) -> Scenario:
        """Return the scenario of a row, as resolved, with the seed that is flown."""
        row = self._checked(row)
        if self._scenarios[row].scenario.seed != self.seeds[row]:
            self._scenarios[row] = set_seed(self._scenarios[row], self.seeds[row])
        return self._scenarios[row]

    @exclusive
    def step(self, until: float | Sequence[float] | Array) -> None:
        """Fly all rows that have not ended to the first tick at or after a time.

        Args:
            until: s, from 0 to a day; or (R,) of these. A row that is there already stays.

        Raises:
            InputError: `until` or a command is wrong. No row has then moved.
        """
        times = _as_times(until)
        shapes = (), (len(self),)
        if times is None or times.shape not in shapes or not _are_times(times):
            raise InputError(
                f"until: is {shown_value(until)} (write a time from 0 to {MAX_DURATION_S:g} s, or "
                f"{len(self)} of these)"
            )
        self._advance(np.broadcast_to(times, len(self)))

    @exclusive
    def run(self) -> list[Metrics]:
        """Fly all rows to their ends, and return the metrics of each, as in metrics.json."""
        self._advance(np.full(len(self), math.inf))
        return [self.metrics(row) for row in range(len(self))]

    def _advance(self, until_s: Array) -> None:
        self._check_commands()
        flying = [
            row
            for row in np.flatnonzero(until_s > self.times_s).tolist()
            if self.outcomes[row] is None
            and self.times_s[row] < self._rows[row].set_pause(until_s[row])
        ]
        if self._threads == 1 or len(flying) < 2:
            self._fly(flying)
            return
        # some parts for each thread: the rows of one can take longer
        parts, pool = min(len(flying), _PARTS * self._threads), self._threads_of_process()
        done = [pool.submit(self._fly, flying[k::parts]) for k in range(parts)]
        try:
            wait(done)  # for all, also after an error in one
        finally:
            for each in done:  # after Ctrl-C
                each.cancel()
            wait(done)
        for each in done:
            each.result()

    def _threads_of_process(self) -> ThreadPoolExecutor:
        """Return the threads that fly; a forked child has none of its parent's."""
        if self._pool is None or self._pool[0] != os.getpid():
            pool = ThreadPoolExecutor(self._threads, "testbed-batch")
            self._pool = os.getpid(), pool
            weakref.finalize(self, pool.shutdown, wait=False)
        return self._pool[1]

    def _fly(self, rows: Sequence[int]) -> None:
        """Fly some rows to their pauses: together, and one by one what needs Python."""
        if is_interpreted():
            found = np.zeros(len(rows), dtype=np.int64)
        else:
            found = np.empty(len(rows), dtype=np.int64)
            run_each(np.array([self._rows[row].address for row in rows], dtype=np.uint64), found)
        errors = list[BaseException]()
        for row, each in zip(rows, found.tolist(), strict=True):
            if each != PAUSED:
                try:
                    self.outcomes[row] = self._rows[row].fly_on(each)
                except BaseException as error:  # the other rows of the part fly on
                    self.outcomes[row] = self._rows[row].outcome = "failed"
                    if not isinstance(error, Exception):
                        raise
                    errors.append(error)
        if errors:
            raise errors[0]

    def _check_commands(self) -> None:
        for name, (low, high) in RANGES.items() if self._commanded.any() else ():
            values = self.commands[name]
            wrong = ~((values >= low) & (values <= high)) & self._commanded
            if wrong.any():
                row, i = np.argwhere(wrong)[0].tolist()
                wrong_value = wrong_part(name, values[row, i].item())
                raise InputError(f"commands[{row}, {i}], of {self.names[i]}: {wrong_value}")

    def metrics(self, row: int) -> Metrics:
        """Return the metrics of a row up to now; of a flight that goes on, "interrupted"."""
        self._exclusive.check("metrics")
        return self._rows[self._checked(row)].metrics()

    def depends_on_seed(self, row: int) -> bool:
        """Return whether another seed may change the numbers of a row."""
        return self._rows[self._checked(row)].is_random

    def events(self, row: int) -> list[Event]:
        """Return all events of a row up to now."""
        return self._rows[self._checked(row)].events.all

    @exclusive
    def reset(self, rows: Sequence[int] | None = None, seeds: Sequence[int] | None = None) -> None:
        """Return rows to their starts.

        Args:
            rows: None: all.
            seeds: of the new flights; None: the same as before.

        Raises:
            InputError: there is no such row, or a seed is wrong.
        """
        chosen = list(range(len(self)))
        if rows is not None:
            chosen = [self._checked(row) for row in check_list("rows", rows, "numbers of rows")]
        new = [self.seeds[row] for row in chosen]
        if seeds is not None:
            given = check_list("seeds", seeds, "whole numbers")
            if len(given) != len(chosen):
                raise InputError(f"seeds: has {len(given)} (write {len(chosen)}, one for each row)")
            new = [check_argument("seeds", seed, Header, "seed") for seed in given]
        for row, seed in zip(chosen, new, strict=True):
            if not self._rows[row].reset(seed):
                self._rebuild(row, seed)
            self.seeds[row], self.outcomes[row] = seed, None

    def _rebuild(self, row: int, seed: int) -> None:
        """Build a row anew; it stays as it is where that fails."""
        records, place = self._records[row]
        arrays = *records, place
        before = [each.copy() for each in arrays], self.seeds[row]
        for each in arrays:
            each[...] = 0
        self.seeds[row] = seed
        try:
            self._rows[row] = self._build(row)
        except BaseException:
            for each, copy in zip(arrays, before[0], strict=True):
                each[...] = copy
            self.seeds[row] = before[1]
            raise

    def _checked(self, row: int) -> int:
        if isinstance(row, int | np.integer) and not isinstance(row, bool) and 0 <= row < len(self):
            return int(row)
        raise InputError(f"row: is {shown_value(row)} (write a number from 0 to {len(self) - 1})")

    def _why_not_copied(self) -> str:
        """See `NotCopied`: compiled code has the addresses of the rows."""
        return (
            f"the batch of {self._scenarios[0].name} cannot be copied or pickled (make another "
            "one, with the same seeds, and give it the same commands)"
        )

    def __repr__(self) -> str:
        """Describe the batch in one line."""
        flying = self.outcomes.count(None)
        return f"<Batch: {len(self)} of {self._scenarios[0].name}; {flying} flying>"


class _Row:
    """One flight of a batch."""

    def __init__(self, scenario: Scenario, records: RowRecords, place: Records) -> None:
        self._expect = scenario.expect
        self.outcome: str | None = None
        self._world = world = build(scenario, in_process=True, records=records, unused="list")
        self.unused = world.unused
        self._meter = MetricsObserver(published=scenario.published, stop_at=stop_bounds(scenario))
        self.events = EventCollector()
        self._flight = Flight(world, (self._meter, self.events), place=place)
        self._flight.compile()
        for each in (self._meter, self.events):
            each.begin(world.info)
        self._first_seed = self._seed = scenario.scenario.seed
        self._built: SavedState | None = None  # before the first tick
        if world.fleet is None or world.fleet.engine == "compiled":
            self._built = self._save()
        self._start: SavedState | None = None  # at the first tick; made when it is used
        self._begin()

    @property
    def address(self) -> int:
        """See `Flight.address`."""
        return self._flight.address

    @property
    def is_random(self) -> bool:
        """See `World.is_random`."""
        return self._world.is_random

    @property
    def commanded(self) -> BoolArray:
        """Which of the N aircraft take commands."""
        array = self._world.array_commands
        return np.zeros(len(self._world.names), dtype=bool) if array is None else array.commanded

    def _save(self) -> SavedState:
        return SavedState(flight=self._flight, metrics=self._meter, events=self.events)

    def _begin(self) -> None:
        self._flight.settle()
        self._begun_s = time.perf_counter()
        self._flight.fly_to(-math.inf)

    def reset(self, seed: int) -> bool:
        """Return to the start, with a seed.

        Returns:
            Whether this is possible; false: nothing has changed.
        """
        world, is_first = self._world, seed == self._first_seed
        if self._built is None or not (is_first or world.make_of_seed):
            return False
        is_same = seed == self._seed or not world.is_random
        self._seed, self.outcome = seed, None
        if is_same and self._start is not None:
            self._start.restore()
            self._meter.reseed(seed)
            self._begun_s = time.perf_counter()
            return True
        self._built.restore()
        if not is_first and world.is_random:
            world.reseed(seed)
        self._meter.reseed(seed)
        self._begin()
        self._start = self._save() if is_same else None  # the next is likely the same
        return True

    def set_pause(self, until_s: float) -> float:
        """Set the time to which `fly_on` flies; return that of the tick, s."""
        return self._flight.set_pause(until_s)

    def fly_on(self, found: int | None = None) -> str | None:
        """Fly to the pause, see `Flight.fly_on`; return how the flight has ended, None: not yet."""
        self.outcome = None if self._flight.fly_on(found) else self._flight.ending
        return self.outcome

    def metrics(self) -> Metrics:
        """Return the metrics up to now."""
        outcome = self.outcome or "interrupted"
        return flight_metrics(self._world, self._meter, outcome, self._begun_s, self._expect)


def _row_scenarios(
    scenario: Flown | Sequence[Scenario],
    overrides: Sequence[str],
    seeds: Sequence[int] | None,
    rows: Sequence[Sequence[str]] | None,
    duration_s: float | None,
) -> list[Scenario]:
    own_seeds = None if seeds is None else check_list("seeds", seeds, "one for each row")
    settings = None if rows is None else check_list("rows", rows, "one for each row")
    if isinstance(scenario, list | tuple):
        if overrides or rows is not None or not all(isinstance(e, Scenario) for e in scenario):
            raise InputError("scenario: is a list (write scenarios alone, without overrides, rows)")
        if not scenario or (own_seeds is not None and len(own_seeds) != len(scenario)):
            raise InputError("seeds: write one seed for each scenario, and at least one scenario")
        return [
            find_loaded(each, (), duration_s=duration_s, seed=seed)
            for each, seed in zip(scenario, own_seeds or [None] * len(scenario), strict=True)
        ]
    texts = check_overrides("overrides", overrides)
    own = [check_overrides(f"rows[{k}]", each) for k, each in enumerate(settings or [()])]
    if own_seeds is not None and settings is None:
        own = [()] * len(own_seeds)
    if settings == [] or not own or (own_seeds is not None and len(own_seeds) != len(own)):
        raise InputError("rows, seeds: write one seed for each row, and at least one row")
    known: dict[tuple[str, ...], Scenario] = {}
    found = []
    for k, each in enumerate(own):
        if each not in known:
            one: Any = scenario  # of any type, which is checked there
            known[each] = find_loaded(one, (*texts, *each), duration_s=duration_s)
        found.append(known[each] if own_seeds is None else set_seed(known[each], own_seeds[k]))
    return found


def _as_times(until: object) -> NDArray[Any] | None:
    """Return a number or numbers as an array; None: they are none."""
    listed = until if isinstance(until, list | tuple) else [until]
    if any(isinstance(each, bool | np.bool_) for each in listed):
        return None
    try:
        times = np.asarray(until)
    except (TypeError, ValueError, OverflowError):  # lists of different lengths
        return None
    return times.astype(float) if times.dtype.kind in "fiu" else None


def _are_times(times: NDArray[Any]) -> bool:
    return bool(((times >= 0.0) & (times <= MAX_DURATION_S)).all())


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
