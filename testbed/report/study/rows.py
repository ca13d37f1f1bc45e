"""A study as its report needs it: columns of its rows, and what its page says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.report.study.numbers import STATISTICS, Estimate, bootstrap
from testbed.state import Array, Truths

Value = float | int | bool | str
RANDOM = ("latin-hypercube", "monte-carlo")
MANY = 12  # numbers of a parameter that are drawn one by one: of more, as a scatter


@dataclass(frozen=True)
class Rows:
    """R flights, in order of `run`.

    Args:
        run: numbers of the flights (R,).
        case: names (R,).
        seed: (R,).
        outcome: (R,) words.
        error: (R,) what went wrong, or nothing.
        settings: by key of the scenario, what each flight had (R,).
        metrics: by path in metrics.json, numbers (R,), not a number where a flight has none.
        good: which flights were flown to their end and lost nobody (R,).
    """

    run: NDArray[np.int64]
    case: Sequence[str]
    seed: NDArray[np.int64]
    outcome: Sequence[str]
    error: Sequence[str]
    settings: Mapping[str, Sequence[Value]]
    metrics: Mapping[str, Array]
    good: Truths

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases in order of their first flight."""
        return tuple(dict.fromkeys(self.case))

    @cached_property
    def case_index(self) -> NDArray[np.int64]:
        """Which of `cases` each flight is of (R,)."""
        where = {name: k for k, name in enumerate(self.cases)}
        return np.array([where[name] for name in self.case], dtype=np.int64)

    @cached_property
    def point(self) -> NDArray[np.int64]:
        """A number for each set of values of the parameters (R,)."""
        seen: dict[tuple[Value, ...], int] = {}
        columns = list(self.settings.values())
        found = [
            seen.setdefault(values, len(seen))
            for values in (zip(*columns, strict=True) if columns else [()] * len(self.run))
        ]
        return np.array(found, dtype=np.int64)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What was varied: keys of which there is more than one value."""
        every = [parameter_of(key, values) for key, values in self.settings.items()]
        return tuple(each for each in every if len(each.levels) > 1)


@dataclass(frozen=True)
class Parameter:
    """A key that was varied."""

    key: str
    levels: tuple[Value, ...]  # numbers in order, other things as they came
    index: NDArray[np.int64]  # which level each flight has (R,)
    numeric: bool

    @property
    def continuous(self) -> bool:
        """Whether there are too many numbers to draw each by itself."""
        return self.numeric and len(self.levels) > MANY

    @property
    def numbers(self) -> Array:
        """The levels as numbers, or their places."""
        known: Sequence[Any] = self.levels if self.numeric else range(len(self.levels))
        return np.array(known, dtype=np.float64)

    @property
    def logarithmic(self) -> bool:
        """Whether the numbers stand as on a logarithmic axis: all above 0, over a wide range."""
        if not self.numeric:
            return False
        numbers = self.numbers
        # of drawn numbers a few may come near 0 by chance
        low, high = np.quantile(numbers, [0.1, 0.9] if self.continuous else [0.0, 1.0])
        return bool(numbers[0] > 0.0 and high >= 30.0 * low)


def parameter_of(key: str, values: Sequence[Value]) -> Parameter:
    """A key with what each flight had (R,)."""
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    known: list[Any] = list(dict.fromkeys(values))
    levels = tuple(sorted(known)) if numeric else tuple(known)
    where = {level: k for k, level in enumerate(levels)}
    return Parameter(key, levels, np.array([where[v] for v in values], dtype=np.int64), numeric)


@dataclass(frozen=True)
class Study:
    """What is reported.

    Args:
        name: of the study.
        file: name of the file it was read from.
        question: of the page.
        scenario: that was flown.
        design: "factorial", one of `RANDOM`, or "" where nothing was varied.
        metrics: paths in metrics.json, in the order they are shown.
        statistic: of the numbers over seeds: "median" or "mean".
        rows: the flights.
        planned: how many there are when the study has ended.
        versions: of what flew them.
        pages: texts that repeat it, by file name.
        command: the command that repeats a flight, by its number.
        repeat: the command that flies the whole study again.
    """

    name: str
    file: str
    question: str
    scenario: str
    design: str
    metrics: tuple[str, ...]
    statistic: str
    rows: Rows
    planned: int
    versions: Mapping[str, str] = field(default_factory=dict)
    pages: Mapping[str, str] = field(default_factory=dict)
    command: Callable[[int], str] = str
    repeat: str = ""

    @property
    def random(self) -> bool:
        """Whether the points were drawn: then a point is a unit, else a seed is."""
        return self.design in RANDOM

    @property
    def unit_name(self) -> str:
        """What intervals are over, as a plural."""
        return "drawn points" if self.random else "seeds"

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """Which independent unit each flight is of (R,)."""
        return self.rows.point if self.random else self.rows.seed

    def by_unit(self, values: Array, where: Truths) -> Array:
        """Means of the finite values (R,) of each unit (n,), of flights that were flown well."""
        some = where & self.rows.good & np.isfinite(values)
        if not some.any():
            return np.empty(0)
        _, index, count = np.unique(self.unit[some], return_inverse=True, return_counts=True)
        means: Array = np.bincount(index, weights=values[some]) / count
        return means

    def centre(self, metric: str, where: Truths) -> float:
        """The statistic over the units; not a number of none."""
        values = self.by_unit(self.rows.metrics[metric], where)
        return float(STATISTICS[self.statistic](values)) if values.size else math.nan

    def estimate(self, metric: str, where: Truths, name: str) -> Estimate:
        """The statistic over the units with its interval."""
        values = self.by_unit(self.rows.metrics[metric], where)
        return bootstrap(values, self.statistic, f"{metric}/{name}")

    def differences(self, metric: str, case: int) -> Array:
        """A case less the first, flight by flight of the same point and seed, by unit (n,)."""
        rows = self.rows
        values = np.where(rows.good, rows.metrics[metric], math.nan)
        first = {
            (p, s): value
            for p, s, value in zip(
                rows.point[rows.case_index == 0],
                rows.seed[rows.case_index == 0],
                values[rows.case_index == 0],
                strict=True,
            )
        }
        against = np.array(
            [first.get(key, math.nan) for key in zip(rows.point, rows.seed, strict=True)]
        )
        return self.by_unit(values - against, rows.case_index == case)


def said(value: Value) -> str:
    """A level in words."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else value
