"""A study for its report: columns of its flights, and the content of its YAML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, BoolArray
from testbed.reports.study.numbers import STATISTICS, Estimate, bootstrap

Value = float | int | bool | str
RANDOM_DESIGNS = ("latin-hypercube", "monte-carlo")
LAW = "controller.law"  # flights of different laws are not pooled
MAX_GROUPS = 12  # of cases and laws; more are pooled
MAX_LEVELS = 12  # numbers of a parameter that are drawn one by one; of more, as a scatter


@dataclass(frozen=True)
class StudyFlights:
    """The R flights of a study, in order of `run`.

    Args:
        run: numbers of the flights (R,).
        case: names (R,).
        seed: (R,).
        outcome: (R,).
        error: (R,) messages, "" without an error.
        settings: values (R,) by key of the scenario.
        metrics: values (R,) by path in metrics.json; NaN where a flight has none.
        completed: (R,) whether a flight was completed without losing an aircraft.
    """

    run: NDArray[np.int64]
    case: Sequence[str]
    seed: NDArray[np.int64]
    outcome: Sequence[str]
    error: Sequence[str]
    settings: Mapping[str, Sequence[Value]]
    metrics: Mapping[str, Array]
    completed: BoolArray

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases in order of their first flight."""
        return tuple(dict.fromkeys(self.case))

    @cached_property
    def case_index(self) -> NDArray[np.int64]:
        """Index (R,) into `cases`."""
        index = {name: k for k, name in enumerate(self.cases)}
        return np.array([index[name] for name in self.case], dtype=np.int64)

    @cached_property
    def point(self) -> NDArray[np.int64]:
        """Number (R,) of the set of parameter values."""
        seen: dict[tuple[Value, ...], int] = {}
        columns = list(self.settings.values())
        found = [
            seen.setdefault(values, len(seen))
            for values in (zip(*columns, strict=True) if columns else [()] * len(self.run))
        ]
        return np.array(found, dtype=np.int64)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters with more than one value."""
        parameters = [make_parameter(key, values) for key, values in self.settings.items()]
        return tuple(each for each in parameters if len(each.levels) > 1)

    @cached_property
    def law(self) -> Parameter | None:
        """The formation law, if it is a parameter."""
        return next((each for each in self.parameters if each.key == LAW), None)

    @cached_property
    def by_case(self) -> tuple[FlightGroup, ...]:
        """Flights of each case; all in one group without a name if there is one case, or many."""
        if not 1 < len(self.cases) <= MAX_GROUPS:
            return (FlightGroup("", np.ones(len(self.run), dtype=np.bool_)),)
        return tuple(FlightGroup(c, self.case_index == k) for k, c in enumerate(self.cases))

    @cached_property
    def groups(self) -> tuple[FlightGroup, ...]:
        """Flights of each case and formation law, whose numbers are not pooled."""
        law = self.law
        if law is None or len(law.levels) * len(self.by_case) > MAX_GROUPS:
            return self.by_case
        return tuple(
            FlightGroup(
                ", ".join(filter(None, (case.name, format_level(level)))),
                case.flights & (law.index == k),
            )
            for case in self.by_case
            for k, level in enumerate(law.levels)
        )

    @property
    def groups_title(self) -> str:
        """What `groups` are: "case", "law", "case, law", or "" if there is one group."""
        cases, law = len(self.by_case) > 1, len(self.groups) > len(self.by_case)
        return ", ".join(name for name, several in (("case", cases), ("law", law)) if several)


@dataclass(frozen=True)
class FlightGroup:
    """Flights (R,) whose numbers are pooled, and their name; "" for all."""

    name: str
    flights: BoolArray


@dataclass(frozen=True)
class Parameter:
    """A key of the scenario that was varied."""

    key: str
    levels: tuple[Value, ...]  # numbers in order, other values by first flight
    index: NDArray[np.int64]  # (R,) into levels
    numeric: bool

    @property
    def continuous(self) -> bool:
        """Whether there are too many numbers to draw one by one."""
        return self.numeric and len(self.levels) > MAX_LEVELS

    @property
    def numbers(self) -> Array:
        """The levels as numbers, or 0, 1, … where they are not numeric."""
        known: Sequence[Any] = self.levels if self.numeric else range(len(self.levels))
        return np.array(known, dtype=np.float64)

    @property
    def logarithmic(self) -> bool:
        """Whether a logarithmic axis is better: all above 0, over a wide range."""
        if not self.numeric:
            return False
        numbers = self.numbers
        # a few drawn numbers may be near 0 by chance
        low, high = np.quantile(numbers, [0.1, 0.9] if self.continuous else [0.0, 1.0])
        return bool(numbers[0] > 0.0 and high >= 30.0 * low)


def make_parameter(key: str, values: Sequence[Value]) -> Parameter:
    """Make a parameter from its values (R,)."""
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    known: list[Any] = list(dict.fromkeys(values))
    levels = tuple(sorted(known)) if numeric else tuple(known)
    index = {level: k for k, level in enumerate(levels)}
    return Parameter(key, levels, np.array([index[v] for v in values], dtype=np.int64), numeric)


@dataclass(frozen=True)
class StudyData:
    """A study to report.

    Args:
        name: of the study.
        file: name of its file.
        question: of its YAML.
        scenario: that was flown.
        design: "factorial", one of `RANDOM_DESIGNS`, or "" where nothing was varied.
        metrics: paths in metrics.json, in the order of the report.
        statistic: of the values over seeds: a key of `STATISTICS`.
        flights: that have ended.
        planned: number of flights of the complete study.
        versions: of the software that flew them.
        files: texts of the YAML files that repeat it, by name.
        command: returns the command that repeats a flight, by its number.
        repeat: the command that repeats the study.
    """

    name: str
    file: str
    question: str
    scenario: str
    design: str
    metrics: tuple[str, ...]
    statistic: str
    flights: StudyFlights
    planned: int
    versions: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    command: Callable[[int], str] = str
    repeat: str = ""

    @property
    def random(self) -> bool:
        """Whether points were drawn, so that points instead of seeds are independent."""
        return self.design in RANDOM_DESIGNS

    @property
    def unit_name(self) -> str:
        """Plural of the independent unit."""
        return "drawn points" if self.random else "seeds"

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """Number (R,) of the independent unit."""
        return self.flights.point if self.random else self.flights.seed

    def unit_means(self, values: Array, where: BoolArray) -> Array:
        """Average the finite values (R,) of completed flights by independent unit (n,)."""
        some = where & self.flights.completed & np.isfinite(values)
        if not some.any():
            return np.empty(0)
        _, index, count = np.unique(self.unit[some], return_inverse=True, return_counts=True)
        means: Array = np.bincount(index, weights=values[some]) / count
        return means

    def centre(self, metric: str, where: BoolArray) -> float:
        """Compute the statistic over the units; NaN without values."""
        values = self.unit_means(self.flights.metrics[metric], where)
        return float(STATISTICS[self.statistic](values)) if values.size else math.nan

    def estimate(self, metric: str, where: BoolArray, name: str) -> Estimate:
        """Compute the statistic over the units with its interval; see `bootstrap`."""
        values = self.unit_means(self.flights.metrics[metric], where)
        return bootstrap(values, self.statistic, f"{metric}/{name}")

    def differences(self, metric: str, case: int) -> Array:
        """Compute a case minus the first one (n,), paired by point and seed, by unit."""
        flights = self.flights
        values = np.where(flights.completed, flights.metrics[metric], math.nan)
        first = {
            (p, s): value
            for p, s, value in zip(
                flights.point[flights.case_index == 0],
                flights.seed[flights.case_index == 0],
                values[flights.case_index == 0],
                strict=True,
            )
        }
        baseline = np.array(
            [first.get(key, math.nan) for key in zip(flights.point, flights.seed, strict=True)]
        )
        return self.unit_means(values - baseline, flights.case_index == case)


def format_level(value: Value) -> str:
    """Format a level of a parameter."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else value
