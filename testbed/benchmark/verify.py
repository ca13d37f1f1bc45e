"""Repeat flights of a result, to the bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from testbed.benchmark.campaign import conditions
from testbed.benchmark.cell import CellKey, fly_cell
from testbed.benchmark.entry import Entry, EntryLaw, Settings
from testbed.benchmark.result import CellRecord, EntryResult, check_seeds
from testbed.benchmark.task import Benchmark
from testbed.core.errors import InputError
from testbed.core.random import named_stream
from testbed.pool.flight_pool import open_flight_pool
from testbed.pool.flight_task import FlightTask
from testbed.scenario import Scenario, load_scenario
from testbed.tuning.tune_schema import GainBounds

SAMPLE = 6  # flights that are repeated by default


@dataclass(frozen=True, slots=True)
class RepeatedCell:
    """A flight that was repeated.

    Attributes:
        key: of it.
        different: names of its numbers that are others now; empty: all are equal to the bit.
        result: of the file.
        now: of the repeated flight.
    """

    key: CellKey
    different: tuple[str, ...]
    result: CellRecord
    now: CellRecord


def check_law(result: EntryResult, law: EntryLaw) -> None:
    """Check that a law is that of a result, before any of its code runs.

    Raises:
        InputError: it is another.
    """
    record = result.entry
    if law.sha256 != record.law_sha256 or law.function != record.function:
        own = record.law_sha256 or record.law
        raise InputError(
            f"{law.describe()}: is not the law of {record.name}, {record.law}:{record.function} "
            f"SHA-256 {own} (name the file that was entered)"
        )
    tune = {} if record.tuning is None else record.tuning.gains
    bounds = {
        key: GainBounds(low=each.low, high=each.high, scale=each.scale, start=each.start)
        for key, each in tune.items()
    }
    if Entry(record.name, law, record.set, bounds).digest != record.digest:
        raise InputError(
            f"{record.name}: settings and bounds are not those of its digest {record.digest[:12]}"
        )


def check_present(result: EntryResult, benchmark: Benchmark) -> None:
    """Check that flights of a result can be repeated here, and have the seeds that they must have.

    Raises:
        InputError: code, pins, limits or tasks are others.
    """
    here = conditions(benchmark, result.conditions.seeds)
    one, two = (each.model_dump(mode="json") for each in (result.conditions, here))
    for name, value in two.items():
        if isinstance(value, dict):
            for key in value:
                if value[key] != one[name].get(key):
                    raise InputError(
                        f"{result.entry.name}: was flown with {name}.{key} {one[name].get(key)}, "
                        f"and here is {value[key]} (install what it was flown with)"
                    )
        elif one[name] != value:
            raise InputError(f"{result.entry.name}: was flown with {name} {one[name]}, not {value}")
    check_seeds(result)


def draw_sample(result: EntryResult, count: int, seed: int) -> list[CellKey]:
    """Draw flights of a result, in their order."""
    keys = [each.key for each in result.cells]
    order = named_stream(seed, f"verify/{result.entry.digest}").permutation(len(keys))
    return [keys[k] for k in sorted(order[:count].tolist())]


def repeat_cells(
    result: EntryResult,
    law: EntryLaw,
    keys: Sequence[CellKey],
    *,
    benchmark: Benchmark,
    jobs: int | None = None,
    log: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[RepeatedCell]:
    """Fly flights of a result again; `check_law` and `check_present` come first.

    Args:
        result: of an entry.
        law: its code.
        keys: of the flights.
        benchmark: the tasks.
        jobs: processes; None: one for each processor.
        log: folder in which each flight gets one with its log; None: nothing is written.
        progress: called with the numbers of flights done and of all.

    Raises:
        InputError: the result has no such flight.
        KeyboardInterrupt: Ctrl-C or SIGTERM.
    """
    known = {each.key: each for each in result.cells}
    for key in keys:
        if key not in known:
            raise InputError(f"--cell {key}: {result.entry.name} has no such flight")
    scenario = load_scenario(next(iter(benchmark.tasks.values())).path)
    tasks = (
        FlightTask(k, scenario, measure=partial(_measure, key, law, result.gains, log))
        for k, key in enumerate(keys)
    )
    found: dict[int, RepeatedCell] = {}
    with open_flight_pool(jobs=jobs) as pool:
        for done in pool.run(tasks):
            if done.metrics is None:
                raise InputError(f"{keys[done.number]}: {done.error}")
            now = CellRecord(**{k: v for k, v in done.metrics.items() if k != "cpu_s"})
            was = known[keys[done.number]]
            one, two = was.model_dump(), now.model_dump()
            if was.failure == now.failure != "":  # of which the text is that of the machine
                two["why"] = one["why"]
            different = tuple(name for name in one if one[name] != two[name])
            found[done.number] = RepeatedCell(was.key, different, was, now)
            progress(len(found), len(keys))
    return [found[k] for k in sorted(found)]


def _measure(
    key: CellKey,
    law: EntryLaw,
    gains: Settings,
    log: Path | None,
    scenario: Scenario,
) -> dict[str, Any]:
    return fly_cell(key, law, gains, log=log)
