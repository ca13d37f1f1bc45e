"""Many flights in one process, side by side."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from testbed.core.compile import reporting
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, COMMAND, FOLLOWER, Event, allocate
from testbed.flight.loop import Flight, NeverEnded
from testbed.metrics import MetricsObserver
from testbed.metrics.model import Metrics
from testbed.plan.world import RowRecords, build
from testbed.runs.run import find_loaded
from testbed.runs.simulation import EventCollector, StepArguments, flight_metrics
from testbed.scenario import Scenario, set_seed
from testbed.scenario.aircraft import ArduPlane
from testbed.scenario.arguments import check_argument, check_count, check_overrides
from testbed.scenario.validate import shown_value


class Batch:
    """Flights of one scenario in this process, as rows of arrays.

    Each row flies as `testbed.run` of its scenario and seed, to the bit. Threads fly rows at the
    same time. Nothing is written.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`, for all rows; only with a name or path.
        seeds: of the rows; None: that of the scenario for each of `rows`.
        rows: for each row `key=value` of its own; only with a name or path. None: none.
        threads: that fly; None: one for each available processor.
        compiling: as of `testbed.run`.

    Attributes:
        scenarios: R, as resolved.
        names: of all N aircraft, the leader first.
        aircraft: (R, N) of AIRCRAFT, live.
        followers: (R, n) of FOLLOWER, live.
        commands: (R, N) of COMMAND: fly-by-wire-A commands in rad, rad and 0..1, of aircraft with
            `commanded_by: external`; first their trim.
        times_s: (R,) s, of the present ticks.
        outcomes: R, how each flight ended; None: it has not.

    Raises:
        InputError: a scenario cannot be flown, has ArduPlanes, or the rows have other aircraft.
    """

    def __init__(
        self,
        scenario: Scenario | str | os.PathLike[str],
        overrides: Sequence[str] = (),
        *,
        seeds: Sequence[int] | None = None,
        rows: Sequence[Sequence[str]] | None = None,
        threads: int | None = None,
        compiling: Callable[[int, int], None] | None = None,
    ) -> None:
        """See the class."""
        self._threads = _processors() if threads is None else check_count("threads", threads)
        self.scenarios = _row_scenarios(scenario, overrides, seeds, rows)
        first = self.scenarios[0]
        self.names = first.aircraft_names
        for row, each in enumerate(self.scenarios):
            if each.aircraft_names != self.names:
                raise InputError(f"rows[{row}]: has other aircraft than the first row")
            for one in each.aircraft:
                if isinstance(one.autopilot, ArduPlane):
                    raise InputError(
                        f"{one.name} has autopilot: ardupilot (fly it with testbed.run)"
                    )
        size, n = len(self.scenarios), len(self.names)
        self.aircraft = allocate(AIRCRAFT, size, n)
        self.followers = allocate(FOLLOWER, size, n - 1)
        self.commands = allocate(COMMAND, size, n)
        with reporting(compiling):
            self._rows = [self._build(row) for row in range(size)]
        self.times_s = [0.0] * size
        self.outcomes: list[str | None] = [None] * size
        self._advance(-math.inf)

    def _build(self, row: int) -> _Row:
        arrays = self.aircraft[row], self.followers[row], self.commands[row]
        return _Row(self.scenarios[row], RowRecords(*arrays))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.scenarios)

    def step(self, until: float) -> None:
        """Fly all rows that have not ended to the first tick at or after a time.

        Args:
            until: s, from 0 to a day.

        Raises:
            InputError: `until` is wrong.
        """
        self._advance(check_argument("until", until, StepArguments, "until"))

    def run(self) -> list[Metrics]:
        """Fly all rows to their ends, and return the metrics of each, as in metrics.json."""
        self._advance(math.inf)
        return [self.metrics(row) for row in range(len(self))]

    def _advance(self, until_s: float) -> None:
        flying = [row for row, outcome in enumerate(self.outcomes) if outcome is None]
        with ThreadPoolExecutor(self._threads) as pool:
            for row, time_s in zip(
                flying, pool.map(lambda row: self._rows[row].advance(until_s), flying), strict=True
            ):
                self.times_s[row], self.outcomes[row] = time_s, self._rows[row].outcome

    def metrics(self, row: int) -> Metrics:
        """Return the metrics of a row up to now; of a flight that goes on, "interrupted"."""
        return self._rows[self._checked(row)].metrics()

    def events(self, row: int) -> list[Event]:
        """Return all events of a row up to now."""
        return self._rows[self._checked(row)].events.all

    def reset(self, rows: Sequence[int] | None = None, seeds: Sequence[int] | None = None) -> None:
        """Return rows to their starts.

        Args:
            rows: None: all.
            seeds: of the new flights; None: the same as before.

        Raises:
            InputError: there is no such row, or a seed is wrong.
        """
        chosen = range(len(self)) if rows is None else [self._checked(row) for row in rows]
        if seeds is not None and len(seeds) != len(chosen):
            raise InputError(f"seeds: has {len(seeds)} (write {len(chosen)}, one for each row)")
        for k, row in enumerate(chosen):
            if seeds is not None:
                self.scenarios[row] = set_seed(self.scenarios[row], seeds[k])
        for row in chosen:
            for array in (self.aircraft, self.followers, self.commands):
                array[row] = 0
            self._rows[row] = self._build(row)
            self.outcomes[row] = None
            self.times_s[row] = self._rows[row].advance(-math.inf)

    def _checked(self, row: int) -> int:
        if isinstance(row, int) and 0 <= row < len(self):
            return row
        raise InputError(f"row: is {shown_value(row)} (write a number from 0 to {len(self) - 1})")

    def __repr__(self) -> str:
        """Describe the batch in one line."""
        flying = self.outcomes.count(None)
        return f"<Batch: {len(self)} of {self.scenarios[0].name}; {flying} flying>"


class _Row:
    """One flight of a batch."""

    def __init__(self, scenario: Scenario, records: RowRecords) -> None:
        self.scenario = scenario
        self.outcome: str | None = None
        self._world = world = build(scenario, in_process=True, records=records)
        self._meter, self.events = MetricsObserver(published=scenario.published), EventCollector()
        observers = self._meter, self.events
        self._flight = Flight(world, observers)
        self._flight.prepare()
        for each in observers:
            each.begin(world.info)
        self._ticks = self._flight.ticks(NeverEnded())
        self._begun_s = time.perf_counter()

    def advance(self, until_s: float) -> float:
        """Fly to the first tick at or after a time, s, or to the end; return the time there."""
        self._flight.pause_at(until_s)
        for time_s in self._ticks:
            return time_s
        self.outcome = self._flight.ending
        return self._flight.last_s

    def metrics(self) -> Metrics:
        """Return the metrics up to now."""
        outcome, expect = self.outcome or "interrupted", self.scenario.expect
        return flight_metrics(self._world, self._meter, outcome, self._begun_s, expect)


def _row_scenarios(
    scenario: Scenario | str | os.PathLike[str],
    overrides: Sequence[str],
    seeds: Sequence[int] | None,
    rows: Sequence[Sequence[str]] | None,
) -> list[Scenario]:
    """Return the scenario of each row."""
    texts = check_overrides("overrides", overrides)
    own = [()] if rows is None else [check_overrides(f"rows[{k}]", e) for k, e in enumerate(rows)]
    if seeds is not None and rows is None:
        own = [()] * len(seeds)
    if not own or (seeds is not None and len(seeds) != len(own)):
        raise InputError("rows, seeds: write one seed for each row, and at least one row")
    known: dict[tuple[str, ...], Scenario] = {}
    found = []
    for k, each in enumerate(own):
        if each not in known:
            known[each] = find_loaded(scenario, (*texts, *each))
        found.append(known[each] if seeds is None else set_seed(known[each], seeds[k]))
    return found


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
