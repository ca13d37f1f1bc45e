"""Results side by side: the document of the page, with ranks where results are complete."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from typing import Any

from testbed.benchmark.cell import FAILED, LOST, LOST_M
from testbed.benchmark.result import (
    CellRecord,
    EntryResult,
    check_complete,
    check_same_conditions,
    check_seeds,
    missing_cells,
    seed_numbers,
)
from testbed.benchmark.score import ALL, ALPHA, PairComparison, compare, standings, with_all
from testbed.benchmark.task import Benchmark
from testbed.core.errors import InputError

SCHEMA = 1


def rank(results: Sequence[EntryResult], benchmark: Benchmark) -> list[PairComparison]:
    """Compare complete results.

    Raises:
        InputError: they do not stand in one table, or one is a part.
    """
    _check(results, benchmark)
    for each in results:
        check_complete(each, benchmark)
    return compare({each.entry.name: with_all(seed_numbers(each, benchmark)) for each in results})


def _check(results: Sequence[EntryResult], benchmark: Benchmark) -> None:
    if not results:
        raise InputError("there is no result to rank (name the file of one)")
    names = [each.entry.name for each in results]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name}: two results have this name (leave one out)")
    check_same_conditions(results)
    conditions = results[0].conditions
    if conditions.benchmark_digest != benchmark.digest:
        raise InputError(
            f"{names[0]}: was flown on {conditions.benchmark} {conditions.benchmark_digest[:12]}, "
            f"and here is {benchmark.name} {benchmark.digest[:12]} (fly it again)"
        )
    for each in results:
        check_seeds(each)


def ranking(results: Sequence[EntryResult], benchmark: Benchmark) -> dict[str, Any]:
    """Return the document of results; without ranks if one is a part.

    Raises:
        InputError: they do not stand in one table.
    """
    _check(results, benchmark)
    missing = {each.entry.name: len(missing_cells(each, benchmark)) for each in results}
    conditions = results[0].conditions
    tables: list[dict[str, Any]] = []
    comparisons: list[PairComparison] = []
    if not any(missing.values()):
        comparisons = rank(results, benchmark)
        numbers = {each.entry.name: with_all(seed_numbers(each, benchmark)) for each in results}
        questions = {name: task.head.question for name, task in benchmark.tasks.items()}
        tables = [
            {
                "name": table,
                "question": questions.get(table, ""),
                "standings": [
                    {
                        "entry": each.entry,
                        "mean_m": each.mean_m,
                        "low_m": _finite(each.low_m),
                        "high_m": _finite(each.high_m),
                        "rank": each.rank,
                        "last_rank": each.last_rank,
                        "equal": list(each.equal),
                    }
                    for each in rows
                ],
            }
            for table, rows in standings(numbers, comparisons).items()
        ]
    return {
        "schema": SCHEMA,
        "conditions": conditions.model_dump(mode="json"),
        "levels": max(len(task.draws) for task in benchmark.tasks.values()),
        "lost_m": LOST_M,
        "alpha": ALPHA,
        "missing": missing,
        "tables": tables,
        "comparisons": [
            {
                "table": each.table,
                "better": each.better,
                "worse": each.worse,
                "difference_m": each.difference_m,
                "low_m": _finite(each.low_m),
                "high_m": _finite(each.high_m),
                "p": each.p,
                "claimed": each.claimed,
            }
            for each in comparisons
        ],
        "entries": [_entry(each, benchmark) for each in results],
    }


def _entry(result: EntryResult, benchmark: Benchmark) -> dict[str, Any]:
    """Return what the page says of an entry, with its numbers by task."""
    cells = result.cells
    return {
        **result.entry.model_dump(mode="json"),
        "gains": dict(result.gains),
        "messages": None if result.messages is None else result.messages.model_dump(),
        "margins": [each.model_dump() for each in result.margins],
        "cpu_s": result.cpu_s,
        "command": result.command,
        **_counts(cells),
        "failures": sorted({each.why for each in cells if each.failure})[:3],
        "tasks": {
            name: _task([each for each in cells if each.task == name])
            for name in benchmark.tasks
            if any(each.task == name for each in cells)
        },
    }


def _counts(cells: Sequence[CellRecord]) -> dict[str, int]:
    return {
        "flights": len(cells),
        "lost": sum(each.outcome == LOST for each in cells),
        "failed": sum(each.outcome == FAILED for each in cells),
    }


def _task(cells: Sequence[CellRecord]) -> dict[str, Any]:
    levels = sorted({each.level for each in cells})
    return {
        **_counts(cells),
        "levels_m": [
            statistics.fmean(each.number_m for each in cells if each.level == level)
            for level in levels
        ],
        "separation_joining_m": _least(each.separation_joining_m for each in cells),
        "separation_window_m": _least(each.separation_window_m for each in cells),
        "saturated_s": _mean(each.saturated_s for each in cells),
        "effort": _mean(each.effort for each in cells),
    }


def _least(values: Iterable[float | None]) -> float | None:
    return min((each for each in values if each is not None), default=None)


def _mean(values: Iterable[float | None]) -> float | None:
    found = [each for each in values if each is not None]
    return statistics.fmean(found) if found else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


__all__ = ["ALL", "rank", "ranking"]
