"""Tune an entry: the search of `testbed tune`, with one budget, on the tuning tasks.

The cost of a set of gains is the mean over the tuning flights of their numbers; of a lost flight it
is 50 to 100 m, the more the earlier it was lost, and of one that failed 150 m. Where the gains that
the search begins with fail in all flights, there is no search.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from testbed.benchmark.cell import FAILED, LOST, LOST_M, CellKey
from testbed.benchmark.entry import Entry
from testbed.benchmark.result import TunedGain, TuningRecord
from testbed.benchmark.seeds import TUNING
from testbed.benchmark.task import Benchmark
from testbed.tuning.tune_schema import Search
from testbed.tuning.tune_search import (
    Candidate,
    Evaluation,
    Gains,
    GainSpace,
    default_population,
    generation_count,
    search,
)

FAILED_M = 3.0 * LOST_M  # cost of a flight that failed
MAX_TIMEOUTS = 3  # flights that run out of time, after whose generation the search ends
BUDGET = 150  # flights of the search, with those of the gains that it begins with
Fly = Callable[[Sequence[tuple[CellKey, Mapping[str, Any]]]], Iterator[tuple[int, dict[str, Any]]]]


def tuning_cells(benchmark: Benchmark) -> list[CellKey]:
    """Return the flights of a set of gains."""
    return [
        CellKey(name, level, seed)
        for name, task in benchmark.tuning.items()
        for level in range(1, len(task.draws) + 1)
        for seed in TUNING
    ]


def cell_cost(cell: Mapping[str, Any], duration_s: float) -> float:
    """Return what a tuning flight costs, m."""
    if cell["outcome"] == FAILED:
        return FAILED_M
    if cell["outcome"] == LOST:
        at_s = cell["lost_at_s"] if cell["lost_at_s"] is not None else duration_s
        return LOST_M * (2.0 - min(at_s / duration_s, 1.0))
    return float(cell["number_m"])


def tune_entry(
    entry: Entry,
    benchmark: Benchmark,
    fly: Fly,
    report: Callable[[str], None] = lambda line: None,
    budget: int = BUDGET,
) -> TuningRecord:
    """Search the gains of an entry.

    Args:
        entry: with bounds.
        benchmark: whose tuning tasks are flown.
        fly: flies cells with settings at the same time, and yields the number and the result of
            each as it ends.
        report: called with a line for each generation.
        budget: of flights.
    """
    cells = tuning_cells(benchmark)
    space = GainSpace(entry.tune, entry.starts)
    settings = Search(max_flights=budget)
    population = default_population(len(space.names))
    generations = generation_count(settings, population, len(cells))
    flights = timeouts = 0

    def evaluate(candidates: Sequence[Gains]) -> list[Evaluation]:
        nonlocal flights, timeouts
        work = [
            (cell, {**entry.set, **dict(zip(space.names, gains, strict=True))})
            for gains in candidates
            for cell in cells
        ]
        flights += len(work)
        costs = [0.0] * len(work)
        for number, found in fly(work):
            task = benchmark.task(work[number][0].task)
            costs[number] = cell_cost(found, task.head.duration_s)
            timeouts += found["failure"] == "time"
        per = len(cells)
        each = [tuple(costs[k * per : (k + 1) * per]) for k in range(len(candidates))]
        return [Evaluation(of, statistics.fmean(of), statistics.fmean(of)) for of in each]

    start = tuple(space.start.tolist())
    best = first = Candidate(0, 0, start, evaluate([start])[0])
    report(f"{entry.name}: {first.cost:.3f} m before tuning")
    all_fail = all(cost == FAILED_M for cost in first.evaluation.costs)
    generations = 0 if all_fail else generations
    for found in search(space, evaluate, settings=settings, generations=generations):
        cheapest = min(found, key=lambda each: each.cost)
        best = cheapest if cheapest.cost < best.cost else best
        report(
            f"{entry.name}: generation {cheapest.generation} of {generations}, "
            f"best {best.cost:.3f} m"
        )
        if timeouts >= MAX_TIMEOUTS:
            report(f"{entry.name}: the search ends, as {timeouts} flights did not end in time")
            break
    return TuningRecord(
        tasks=tuple(benchmark.tuning),
        seeds=TUNING,
        budget=budget,
        flights=flights,
        cost_before_m=first.cost,
        cost_after_m=best.cost,
        gains={
            key: TunedGain(
                low=bounds.low, high=bounds.high, scale=bounds.scale, start=before, tuned=after
            )
            for (key, bounds), before, after in zip(
                entry.tune.items(), first.gains, best.gains, strict=True
            )
        },
    )
