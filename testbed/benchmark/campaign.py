"""Fly entries on the benchmark: tune them, fly all cells in worker processes, keep what is found.

What is found is kept in a folder, with a digest of all that it depends on, so that an interrupted
campaign goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import platform
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from testbed.benchmark.cell import FAILED, CellKey, find_mistake, fly_cell, lost_numbers
from testbed.benchmark.entry import Entry, EntryLaw
from testbed.benchmark.gain_search import BUDGET, MAX_TIMEOUTS, tune_entry
from testbed.benchmark.limited_flight import LIMITS, FlightLimits
from testbed.benchmark.probes import probe_entry
from testbed.benchmark.result import (
    CellRecord,
    Conditions,
    EntryRecord,
    EntryResult,
    MarginRecord,
    MessagesRecord,
    SeedsRecord,
    TuningRecord,
    cell_keys,
)
from testbed.benchmark.seeds import PRACTICE, rank_seeds
from testbed.benchmark.task import Benchmark, load_benchmark
from testbed.core.compile import source_digest
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.metrics.document import to_json
from testbed.plan.scenario_files import digests, referenced_files, referents
from testbed.plan.world import versions
from testbed.pool.flight_code import flight_code
from testbed.pool.flight_pool import FlightPool, open_flight_pool
from testbed.pool.flight_task import COMPLETED, FlightTask
from testbed.scenario import Scenario, load_scenario

STOPPED = "time: not flown, as {} flights of this entry did not end in time"
_KEPT_BYTES = 4_000_000
Report = Callable[[str], None]
Progress = Callable[[int, int], None]
Found = dict[str, Any]


def conditions(
    benchmark: Benchmark, seeds: SeedsRecord, limits: FlightLimits = LIMITS
) -> Conditions:
    """Return all that the numbers of entries must have in common."""
    package = Path(__file__).parents[1]
    code = {
        "flight": flight_code(),
        "benchmark": source_digest(package, ("benchmark", "tuning"))[:12],
        "aircraft": _aircraft_digest(benchmark),
    }
    libraries = {name: version(name) for name in ("numba", "llvmlite", "scipy", "cma")}
    return Conditions(
        benchmark=benchmark.name,
        benchmark_digest=benchmark.digest,
        code=code,
        pins={**versions(), **libraries, "machine": platform.machine()},
        limits=asdict(limits),
        seeds=seeds,
    )


@cache
def _scenario(path: Path) -> Scenario:
    return load_scenario(path)


def _aircraft_digest(benchmark: Benchmark) -> str:
    """Return a digest of the aircraft's files of all tasks."""
    tasks = (*benchmark.tasks.values(), *benchmark.tuning.values())
    files = {
        name: digest
        for path in sorted({task.path for task in tasks})
        for name, digest in digests(referenced_files(referents(_scenario(path)))).items()
    }
    return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()[:12]


def practice_seeds() -> SeedsRecord:
    """Return the public seeds."""
    return SeedsRecord(kind="practice", pulse="", entries=(), values=PRACTICE)


def pulse_seeds(benchmark: Benchmark, entries: Sequence[Entry], pulse: str) -> SeedsRecord:
    """Return the seeds of a rank of entries with a pulse."""
    names = tuple(sorted(each.digest for each in entries))
    values = rank_seeds(f"{benchmark.name} {benchmark.digest}", names, pulse)
    return SeedsRecord(kind="pulse", pulse=pulse, entries=names, values=values)


@dataclass(frozen=True, slots=True)
class Campaign:
    """What is flown.

    Attributes:
        entries: with different names.
        seeds: of all cells.
        folder: of what is found.
        jobs: processes; None: one for each processor.
        limits: of each flight.
        budget: flights of each search.
        tasks: folder of the benchmark; None: the one that comes with the testbed.
        only: tasks to fly; empty: all.
    """

    entries: Sequence[Entry]
    seeds: SeedsRecord
    folder: Path
    jobs: int | None = None
    limits: FlightLimits = LIMITS
    budget: int = BUDGET
    tasks: Path | None = None
    only: Sequence[str] = ()

    @property
    def benchmark(self) -> Benchmark:
        """The tasks."""
        return load_benchmark(self.tasks)

    def cells(self) -> list[CellKey]:
        """Return the flights of each entry, in their order."""
        found = cell_keys(self.benchmark, self.seeds.values)
        return [each for each in found if not self.only or each.task in self.only]


def fly_campaign(
    campaign: Campaign,
    *,
    report: Report = lambda line: None,
    progress: Progress = lambda done, total: None,
) -> list[EntryResult]:
    """Fly the entries, and return their results in the order of their names.

    Args:
        campaign: what to fly.
        report: called with a line for what is done.
        progress: called with the number of flights that have ended, and of all.

    Raises:
        InputError: something cannot be read or written.
        KeyboardInterrupt: Ctrl-C or SIGTERM; what was found so far is in the folder.
    """
    benchmark = campaign.benchmark
    shared = conditions(benchmark, campaign.seeds, campaign.limits)
    store = _Kept(campaign.folder, shared)
    cells = campaign.cells()
    total = sum(len(cells) + (campaign.budget if entry.tune else 0) for entry in campaign.entries)
    for entry in campaign.entries:
        _check_entry(entry, campaign)
    with open_flight_pool(jobs=campaign.jobs, report=report) as pool:
        flights = _CampaignFlights(campaign, pool, total, progress, report)
        tunings = {each.name: _tune(each, flights, store, report) for each in campaign.entries}
        gains = {each.name: {**each.set, **_tuned(tunings[each.name])} for each in campaign.entries}
        found: dict[str, list[Found]] = {}
        for entry in campaign.entries:
            found[entry.name] = _fly_entry(entry, gains[entry.name], flights, store, report)
        probes = {
            each.name: _probe(
                each, gains[each.name], flights, store, stopped=_is_stopped(found[each.name])
            )
            for each in campaign.entries
        }
    results = []
    for entry in sorted(campaign.entries, key=lambda each: each.name):
        rows = found[entry.name]
        probe = probes[entry.name]
        times = [row["cpu_s"] for row in rows if row["outcome"] != FAILED]
        results.append(
            EntryResult(
                schema=1,
                conditions=shared,
                entry=entry_record(entry, tunings[entry.name]),
                gains=gains[entry.name],
                cells=tuple(
                    CellRecord(**{k: v for k, v in row.items() if k != "cpu_s"}) for row in rows
                ),
                messages=None if probe["messages"] is None else MessagesRecord(**probe["messages"]),
                margins=tuple(MarginRecord(**each) for each in probe["margins"]),
                cpu_s=statistics.median(times) if times else 0.0,
                command=repeat_command(entry),
            )
        )
    return results


def _check_entry(entry: Entry, campaign: Campaign) -> None:
    """Check that an entry can be flown, before any flight.

    Raises:
        InputError: law or settings have a mistake.
    """
    settings = {**entry.set, **dict(zip(entry.tune, entry.starts, strict=True))}
    first = campaign.cells()[0]
    mistake = find_mistake(
        first, entry.law, settings, folder=campaign.tasks, limits=campaign.limits
    )
    if mistake:
        raise InputError(f"{entry.name}: {mistake}")


def entry_record(entry: Entry, tuning: TuningRecord | None) -> EntryRecord:
    """Return an entry as a result has it."""
    return EntryRecord(
        name=entry.name,
        digest=entry.digest,
        law=entry.law.file.name if entry.law.file else entry.law.reference,
        law_sha256=entry.law.sha256,
        function=entry.law.function,
        set=dict(entry.set),
        tuning=tuning,
    )


def repeat_command(entry: Entry) -> str:
    """Return the command that repeats a cell of an entry's result."""
    law = "" if entry.law.file is None else f" {entry.law.file.name}:{entry.law.function}"
    return f"testbed benchmark verify {entry.name}.json{law} --cell CELL"[:300]


def _tuned(tuning: TuningRecord | None) -> dict[str, float]:
    return {} if tuning is None else {key: each.tuned for key, each in tuning.gains.items()}


def _measure_cell(
    key: CellKey,
    law: EntryLaw,
    settings: Mapping[str, Any],
    folder: Path | None,
    limits: FlightLimits,
    scenario: Scenario,
) -> Found:
    return fly_cell(key, law, settings, folder=folder, limits=limits)


def _measure_probe(
    law: EntryLaw,
    settings: Mapping[str, Any],
    folder: Path | None,
    limits: FlightLimits,
    scenario: Scenario,
) -> Found:
    return probe_entry(law, settings, folder=folder, limits=limits)


class _CampaignFlights:
    """Flights of a campaign in the workers of a pool."""

    def __init__(
        self,
        campaign: Campaign,
        pool: FlightPool,
        total: int,
        progress: Progress,
        report: Report,
    ) -> None:
        self.campaign = campaign
        self._pool, self._total, self._progress = pool, total, progress
        self._report = report
        self._told = set[str]()  # laws of which a failure was reported
        self._done = 0
        self._any = _scenario(next(iter(campaign.benchmark.tasks.values())).path)

    def count(self, flights: int) -> None:
        """Count flights as done."""
        self._done += flights
        self._progress(min(self._done, self._total), self._total)

    def fly(
        self, law: EntryLaw, work: Iterator[tuple[int, CellKey, Mapping[str, Any]]]
    ) -> Iterator[tuple[int, Found]]:
        """Fly cells with settings, and yield the number and the numbers of each as it ends."""
        campaign = self.campaign
        keys: dict[int, CellKey] = {}

        def tasks() -> Iterator[FlightTask]:
            for number, key, settings in work:
                keys[number] = key
                measure = partial(
                    _measure_cell, key, law, settings, campaign.tasks, campaign.limits
                )
                yield FlightTask(number, self._any, measure=measure)

        for result in self._pool.run(tasks()):
            key = keys[result.number]
            if result.outcome == COMPLETED and result.metrics is not None:
                found = dict(result.metrics)
            else:  # the worker itself was killed, or the task cannot be flown at all
                why = f"crash: {result.error}"[:200]
                found = {**_failed(key, "crash", why), "cpu_s": 0.0}
            self.count(1)
            if found["failure"] and law.reference not in self._told:
                self._told.add(law.reference)
                name = law.function or law.reference
                self._report(f"{name}: the first flight that fails, {key}: {found['why']}")
            yield result.number, found

    def probe(self, law: EntryLaw, settings: Mapping[str, Any]) -> Found:
        """Return messages and margins of an entry."""
        campaign = self.campaign
        measure = partial(_measure_probe, law, settings, campaign.tasks, campaign.limits)
        [result] = self._pool.run([FlightTask(0, self._any, measure=measure)])
        found = result.metrics if result.outcome == COMPLETED else None
        return dict(found) if found else {"messages": None, "margins": []}


def _failed(key: CellKey, failure: str, why: str) -> Found:
    head = {"task": key.task, "level": key.level, "seed": key.seed}
    return {**head, **lost_numbers(), "outcome": FAILED, "failure": failure, "why": why}


def _tune(
    entry: Entry, flights: _CampaignFlights, store: _Kept, report: Report
) -> TuningRecord | None:
    """Return the tuning of an entry, which is found if it is not kept; None: it has no bounds."""
    if not entry.tune:
        return None
    campaign = flights.campaign
    name, depends = f"tune-{entry.name}", [entry.digest, campaign.budget]
    if (kept := store.read(name, depends)) is not None:
        report(f"{entry.name}: tuned gains are kept")
        flights.count(campaign.budget)
        return TuningRecord.model_validate_json(json.dumps(kept["tuning"]))

    def fly(work: Sequence[tuple[CellKey, Mapping[str, Any]]]) -> Iterator[tuple[int, Found]]:
        numbered = ((k, cell, settings) for k, (cell, settings) in enumerate(work))
        return flights.fly(entry.law, numbered)

    found = tune_entry(entry, campaign.benchmark, fly, report, campaign.budget)
    flights.count(campaign.budget - found.flights)
    store.write(name, depends, {"tuning": found.model_dump(mode="json")})
    return found


def _fly_entry(
    entry: Entry, gains: Mapping[str, Any], flights: _CampaignFlights, store: _Kept, report: Report
) -> list[Found]:
    """Return all cells of an entry; those of a task are kept when all of them are flown."""
    campaign = flights.campaign
    cells = campaign.cells()
    depends = [entry.digest, dict(gains), campaign.seeds.values]
    found: dict[CellKey, Found] = {}
    for task in campaign.benchmark.tasks:
        if (kept := store.read(f"cells-{entry.name}-{task}", depends)) is not None:
            found |= {CellKey(c["task"], c["level"], c["seed"]): c for c in kept["cells"]}
    flights.count(len(found))
    missing = [key for key in cells if key not in found]
    left = {task: sum(key.task == task for key in missing) for task in campaign.benchmark.tasks}
    timeouts = sum(each["failure"] == "time" for each in found.values())

    def work() -> Iterator[tuple[int, CellKey, Mapping[str, Any]]]:
        for number, key in enumerate(missing):
            if timeouts < MAX_TIMEOUTS:
                yield number, key, gains

    for number, numbers in flights.fly(entry.law, work()):
        key = missing[number]
        found[key] = numbers
        timeouts += int(numbers["failure"] == "time")
        left[key.task] -= 1
        if not left[key.task]:
            mine = [found[each] for each in cells if each.task == key.task]
            store.write(f"cells-{entry.name}-{key.task}", depends, {"cells": mine})
            mean = statistics.fmean(each["number_m"] for each in mine)
            lost = sum(each["outcome"] != "flown" for each in mine)
            report(f"{entry.name}: {key.task} {mean:.2f} m, {lost} of {len(mine)} lost or failed")
    return _stopped(cells, found)


def _is_stopped(rows: Sequence[Found]) -> bool:
    return [row["failure"] for row in rows].count("time") >= MAX_TIMEOUTS


def _stopped(cells: Sequence[CellKey], found: Mapping[CellKey, Found]) -> list[Found]:
    """Return the cells in order; those behind the third that ran out of time have failed.

    Which of them were flown at the same time depends on the number of processes; the result does
    not.
    """
    rows, timeouts = list[Found](), 0
    for key in cells:
        if timeouts >= MAX_TIMEOUTS:
            rows.append({**_failed(key, "time", STOPPED.format(MAX_TIMEOUTS)), "cpu_s": 0.0})
            continue
        rows.append(found[key])
        timeouts += found[key]["failure"] == "time"
    return rows


def _probe(
    entry: Entry,
    gains: Mapping[str, Any],
    flights: _CampaignFlights,
    store: _Kept,
    *,
    stopped: bool,
) -> Found:
    """Return messages and margins of an entry; none of one whose flights do not end."""
    name, depends = f"probe-{entry.name}", [entry.digest, dict(gains)]
    if stopped:
        return {"messages": None, "margins": []}
    kept = store.read(name, depends)
    if kept is None:
        kept = flights.probe(entry.law, gains)
        store.write(name, depends, kept)
    return kept


class _Kept:
    """What was found before, in a folder, with a digest of what it depends on.

    All depends on the conditions but their seeds, which tuned gains and probes do not.
    """

    def __init__(self, folder: Path, shared: Conditions) -> None:
        self._folder = folder / "kept"
        self._shared = shared.model_dump(mode="json", exclude={"seeds"})

    def _digest(self, depends: object) -> str:
        text = json.dumps([self._shared, depends], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def read(self, name: str, depends: object) -> Found | None:
        """Return what is kept; None: nothing is, or it depends on something that has changed."""
        try:
            found = parse_json_map(read_bounded(self._folder / f"{name}.json", _KEPT_BYTES))
        except (InputError, ValueError):
            return None
        same = found.get("depends_on") == self._digest(depends)
        return found["found"] if same and isinstance(found.get("found"), dict) else None

    def write(self, name: str, depends: object, found: Found) -> None:
        """Keep something; a file is replaced whole or not at all."""
        path = self._folder / f"{name}.json"
        with report_write_errors(path):
            self._folder.mkdir(parents=True, exist_ok=True)
            with write_text_file(path) as file:
                file.write(to_json({"depends_on": self._digest(depends), "found": found}))
