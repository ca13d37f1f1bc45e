"""The flights of a study, estimates of their numbers, and words for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from testbed.core.random import named_stream
from testbed.core.records import Array, BoolArray
from testbed.core.stats import LEVEL, MIN_VALUES
from testbed.metrics.side_effects import (
    NO_CHANGE,
    NOT_COMPLETED,
    Columns,
    PairedChange,
    SideEffects,
    change_of,
    mean_by_unit,
    repeats,
    side_effects,
)
from testbed.reports.study.uneven_values import UnevenValues

UNITS = {
    "m": "m", "mps": "m/s", "s": "s", "deg": "°", "percent": "%", "hz": "Hz", "radps": "rad/s",
}  # fmt: skip
# of quantities that `metrics.json` abbreviates
WORDS = {
    "mean_rms_m": "mean RMS error",
    "rms_m": "RMS error",
    "estimated_rms_m": "RMS error by estimates",
    "estimated_mean_rms_m": "mean RMS error by estimates",
    "max_error_m": "largest error",
    "min_separation_m": "smallest separation",
    "joined_at_s": "time of joining",
}
WITHOUT_MEANING = ("windows",)


def metric_words(metric: str) -> tuple[str, str]:
    """Return a metric's words and unit, "" without one: "mean RMS error, circles" and "m".

    The words are the quantity, what it is of, and the part of `metrics.json`.
    """
    names = metric.split(".")
    for k in range(len(names) - 1, -1, -1):
        stem, _, suffix = names[k].rpartition("_")
        if stem and suffix in UNITS:
            quantity = WORDS.get(names[k]) or _plain(stem)
            others = [_plain(each) for each in names[k + 1 :] + names[:k]]
            others = [each for each in others if each not in WITHOUT_MEANING]
            return ", ".join([quantity, *others]), UNITS[suffix]
    words = [WORDS.get(each) or _plain(each) for each in names]
    return ", ".join(each for each in words if each not in WITHOUT_MEANING), ""


def metric_title(metric: str) -> str:
    """Return the words of a metric with a capital letter."""
    words, _ = metric_words(metric)
    return words[0].upper() + words[1:]


def axis_label(metric: str) -> str:
    """Return the words and the unit of a metric."""
    return ", ".join(filter(None, metric_words(metric)))


def _plain(name: str) -> str:
    return name.replace("_", " ")


PERCENT = round(100.0 * LEVEL)  # of all intervals
DRAWS, MIN_DRAWS = 2000, 400  # of a bootstrap
MAX_DRAWN = 4_000_000  # values of all draws, above which there are fewer draws
DRAWN_AT_ONCE = 1_000_000  # values in memory
SEED = 1  # of all draws: the same file gives the same report

Statistic = Callable[..., Array]
STATISTICS: dict[str, Statistic] = {"median": np.median, "mean": np.mean}


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A number with its interval; low and high are NaN if there are too few values."""

    value: float
    low: float
    high: float
    count: int  # of the values


NOTHING = IntervalEstimate(math.nan, math.nan, math.nan, 0)


def bootstrap(values: Array, statistic: str, name: str) -> IntervalEstimate:
    """Return the median or mean of values (n,) with its percentile bootstrap interval.

    Efron and Tibshirani, An Introduction to the Bootstrap, 13.3. For few values it is too narrow:
    for n = 5 normal values, the 95 % interval of a mean contains it in about 85 % of cases.

    Args:
        values: independent, finite; for example one for each seed.
        statistic: a key of `STATISTICS`.
        name: of the random stream: the same name gives the same interval.
    """
    return _bootstrap(
        float(STATISTICS[statistic](values)) if values.size else math.nan,
        values.size,
        lambda drawn: values[drawn],
        statistic,
        name,
    )


def _bootstrap(
    value: float,
    size: int,
    resample: Callable[[NDArray[np.int64]], Array],
    statistic: str,
    name: str,
) -> IntervalEstimate:
    """Return a statistic of `size` units with its interval.

    Args:
        value: of the statistic.
        size: number of units.
        resample: returns the values of drawn units (d, size) in each of d draws.
        statistic: a key of `STATISTICS`.
        name: of the random stream.
    """
    if not size:
        return NOTHING
    if size < MIN_VALUES:
        return IntervalEstimate(value, math.nan, math.nan, size)
    # scipy.stats.bootstrap is not used: it would draw other samples, and so move every interval
    random = named_stream(SEED, f"study-report/{name}")
    draws = max(min(DRAWS, MAX_DRAWN // size), MIN_DRAWS)
    step = max(DRAWN_AT_ONCE // size, 1)
    resampled = np.concatenate(
        [
            STATISTICS[statistic](
                resample(random.integers(size, size=(min(step, draws - k), size))), 1
            )
            for k in range(0, draws, step)
        ]
    )
    low, high = np.quantile(resampled, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return IntervalEstimate(value, float(low), float(high), size)


def estimate_of(change: PairedChange) -> IntervalEstimate:
    """Return the mean difference of a change with its interval."""
    return IntervalEstimate(change.mean, change.low, change.high, change.units)


def wilson(hits: int, of: int) -> IntervalEstimate:
    """Return a share of counts with Wilson's score interval; J. Am. Stat. Assoc. 22 (1927)."""
    if not of:
        return NOTHING
    interval = stats.binomtest(hits, of).proportion_ci(LEVEL, method="wilson")
    # at the ends exactly 0 and 1, which rounding would miss
    low = float(interval.low) if hits else 0.0
    high = float(interval.high) if hits < of else 1.0
    return IntervalEstimate(hits / of, low, high, of)


def rank_correlation(x: Array, y: Array) -> float:
    """Return Spearman's correlation of (n,) and (n,); NaN if one of them is constant."""
    a, b = stats.rankdata(x), stats.rankdata(y)
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size > 0.0 else math.nan


def variance_share(values: Array, group: NDArray[Any]) -> float:
    """Return the share of the variance of values (n,) between groups (n,): η², 0 to 1."""
    total = float(((values - values.mean()) ** 2).sum()) if values.size else 0.0
    if not total > 0.0:
        return math.nan
    _, index, count = np.unique(group, return_inverse=True, return_counts=True)
    means = np.bincount(index, weights=values) / count
    return float((count * (means - values.mean()) ** 2).sum()) / total


def running_quantiles(
    x: Array, y: Array, shares: tuple[float, ...], *, window: int
) -> tuple[Array, Array]:
    """Return quantiles of y in a window that moves along the order of x.

    Args:
        x: (n,).
        y: (n,).
        shares: probabilities, 0 to 1.
        window: number of values of each quantile, at most n.

    Returns:
        Medians of x (n - window + 1,), and the quantiles (len(shares), n - window + 1).
    """
    order = np.argsort(x, kind="stable")
    along = np.lib.stride_tricks.sliding_window_view(x[order], window)
    across = np.lib.stride_tricks.sliding_window_view(y[order], window)
    return np.median(along, axis=1), np.quantile(across, shares, axis=1)


Value = float | int | bool | str
RANDOM_DESIGNS = ("latin-hypercube", "monte-carlo")
MAP = "map"  # a design whose points are refined while it is flown
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
    case_label: Mapping[str, str] = field(default_factory=dict)  # of cases that have one
    key_label: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def case_labels(self) -> tuple[str, ...]:
        """What stands for the `cases` in figures and tables."""
        return tuple(self.case_label.get(each, each) for each in self.cases)

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
    def case_point(self) -> NDArray[np.int64]:
        """Number (R,) of the case and the set of parameter values."""
        points = int(self.point.max(initial=0)) + 1
        return self.case_index * points + self.point

    def pairs(self, case: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the flights of the first case and those of another at the same point and seed."""
        return self._pairs[case]

    @cached_property
    def _pairs(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        keys = list(zip(self.point.tolist(), self.seed.tolist(), strict=True))
        rows = [np.flatnonzero(self.case_index == k).tolist() for k in range(len(self.cases))]
        first = {keys[k]: k for k in rows[0]}
        found = []
        for own in rows:
            both = [(first[keys[k]], k) for k in own if keys[k] in first]
            before, after = np.array(both, dtype=np.int64).reshape(-1, 2).T
            found.append((before, after))
        return found

    @cached_property
    def repeats(self) -> BoolArray:
        """Whether (R,) a flight has all numbers of the first one of its case and point."""
        return repeats(self.metrics, self.case_point)

    @cached_property
    def same_for_all_seeds(self) -> bool:
        """Whether there are several seeds, and they change no number."""
        several = np.unique(self.case_point).size < len(self.run)
        return several and bool(self.repeats.all())

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters with more than one value."""
        parameters = [make_parameter(key, values) for key, values in self.settings.items()]
        return tuple(
            replace(each, label=self.key_label.get(each.key, each.key))
            for each in parameters
            if len(each.levels) > 1
        )

    @cached_property
    def law(self) -> Parameter | None:
        """The formation law, if it is a parameter."""
        return next((each for each in self.parameters if each.key == LAW), None)

    @cached_property
    def by_case(self) -> tuple[FlightGroup, ...]:
        """Flights of each case; all in one group without a name if there is one case, or many."""
        if not 1 < len(self.cases) <= MAX_GROUPS:
            return (FlightGroup("", np.ones(len(self.run), dtype=np.bool_), ""),)
        return tuple(
            FlightGroup(name, self.case_index == k, label)
            for k, (name, label) in enumerate(zip(self.cases, self.case_labels, strict=True))
        )

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
                ", ".join(filter(None, (case.label, format_level(level)))),
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
    label: str  # in figures and tables


@dataclass(frozen=True)
class Parameter:
    """A key of the scenario that was varied."""

    key: str
    levels: tuple[Value, ...]  # numbers in order, other values by first flight
    index: NDArray[np.int64]  # (R,) into levels
    numeric: bool
    label: str  # in figures and tables

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
    return Parameter(
        key, levels, np.array([index[v] for v in values], dtype=np.int64), numeric, key
    )


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
        missing: metrics that the study names and no flight has.
        refined_metric: of a map, by which it was refined; "": of no map.
        contour: value of that metric whose contour is drawn.
        uneven: whether points have different numbers of seeds, because the study chose them.
        margins: predicted margins that are smaller in a case than in the first one.
        unpredicted: why there are none of a case.
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
    missing: tuple[str, ...] = ()
    refined_metric: str = ""
    contour: float | None = None
    uneven: bool = False
    margins: Mapping[str, SideEffects] = field(default_factory=dict)
    unpredicted: Mapping[str, str] = field(default_factory=dict)

    @property
    def random(self) -> bool:
        """Whether points were drawn, so that points instead of seeds are independent."""
        return self.design in RANDOM_DESIGNS

    @property
    def is_map(self) -> bool:
        """Whether the points are a part of a grid, finer where the metric changes."""
        return self.design == MAP

    @property
    def unit_name(self) -> str:
        """Plural of the independent unit."""
        return "drawn points" if self.random else "seeds"

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """Number (R,) of the independent unit."""
        return self.flights.point if self.random else self.flights.seed

    def unit_means(self, values: Array, where: BoolArray) -> Array:
        """Average the finite values (R,) of completed flights by independent unit (n,).

        Where points have different numbers of seeds, see `UnevenValues`.
        """
        some = where & self.flights.completed & np.isfinite(values)
        if not some.any():
            return np.empty(0)
        if self.pools_uneven(some):
            return self._uneven(values, some).of_units
        _, index, count = np.unique(self.unit[some], return_inverse=True, return_counts=True)
        means: Array = np.bincount(index, weights=values[some]) / count
        return means

    def centre(self, metric: str, where: BoolArray) -> float:
        """Compute the statistic over the units; NaN without values."""
        values = self.unit_means(self.flights.metrics[metric], where)
        return float(STATISTICS[self.statistic](values)) if values.size else math.nan

    def estimate(self, metric: str, where: BoolArray, name: str) -> IntervalEstimate:
        """Compute the statistic over the units with its interval; see `bootstrap`."""
        known = self.flights.metrics[metric]
        values = self.unit_means(known, where)
        if self.same_flights and values.size:
            return IntervalEstimate(float(values[0]), math.nan, math.nan, 1)
        some = where & self.flights.completed & np.isfinite(known)
        if self.pools_uneven(some):
            value = float(STATISTICS[self.statistic](values))
            resample = self._uneven(known, some).resample
            return _bootstrap(value, values.size, resample, self.statistic, f"{metric}/{name}")
        return bootstrap(values, self.statistic, f"{metric}/{name}")

    def pools_uneven(self, some: BoolArray) -> bool:
        """Return whether flights (R,) are of several points with different numbers of seeds."""
        return self.uneven and not self.random and np.unique(self.flights.case_point[some]).size > 1

    def _uneven(self, values: Array, some: BoolArray) -> UnevenValues:
        return UnevenValues(values[some], self.unit[some], self.flights.case_point[some])

    @property
    def same_flights(self) -> bool:
        """Whether all seeds have the same flights, so that there is one for each point."""
        return self.flights.same_for_all_seeds and not self.random

    def change(self, metric: str, case: int, where: BoolArray | None = None) -> PairedChange:
        """Compare a case with the first one, paired by point and seed.

        Args:
            metric: its name.
            case: index of the case.
            where: (R,) the flights of the case to use; None: all.
        """
        flights = self.flights
        values = np.where(flights.completed, flights.metrics[metric], math.nan)
        before, after = flights.pairs(case)
        both = np.isfinite(values[before]) & np.isfinite(values[after])
        both &= True if where is None else where[after]
        if not both.any():
            return NO_CHANGE
        before, after = before[both], after[both]
        old, new = (
            self._pool(values[k], self.unit[k], flights.case_point[k]) for k in (before, after)
        )
        differences = self._pool(
            values[after] - values[before], self.unit[after], flights.case_point[after]
        )
        rows = np.concatenate([before, after])
        one = not self.random and bool(flights.repeats[rows].all())
        return change_of(float(old.mean()), float(new.mean()), differences, one_flight=one)

    def _pool(self, values: Array, unit: NDArray[np.int64], point: NDArray[np.int64]) -> Array:
        """Return values by unit; see `UnevenValues`."""
        if self.uneven and not self.random and np.unique(point).size > 1:
            return UnevenValues(values, unit, point).of_units
        return mean_by_unit(values, unit, point)

    def side_effects(self, case: int, where: BoolArray | None = None) -> SideEffects:
        """Return what is worse in a case than in the first one; see `change`."""
        flights = self.flights
        before, after = flights.pairs(case)
        if where is not None:
            before, after = before[where[after]], after[where[after]]
        numbers = {**flights.metrics, NOT_COMPLETED: (~flights.completed).astype(np.float64)}

        def of(rows: NDArray[np.int64]) -> Columns:
            return {name: values[rows] for name, values in numbers.items()}

        point = np.zeros_like(after) if self.random else flights.point[after]
        return side_effects(
            of(before), of(after), self.unit[after], point,
            unit_name=self.unit_name, pool=self._pool,
        )  # fmt: skip


def named_level(label: str, value: Value) -> str:
    """Format a level behind the label of its parameter: "wind, m/s" and 6 are "wind 6 m/s"."""
    words, _, unit = label.partition(", ")
    return f"{words} {format_level(value)} {unit}".rstrip()


def format_level(value: Value) -> str:
    """Format a level of a parameter."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else value
