"""Which numbers of flights got worse beyond noise, beside the number that is asked for.

A change is larger than noise if the 95 % interval of the differences, paired by seed, excludes
zero. Of one flight each there is no interval: any change beyond the rounding of the printed numbers
counts. So do flights of several seeds that are the same flight, because nothing in them is random.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, BoolArray
from testbed.core.stats import LEVEL, student_interval
from testbed.metrics.flat_numbers import Numbers, flatten_metrics

COMMANDS = ("pitch", "roll", "throttle")
NOT_COMPLETED = "not_completed"  # name of a number: 1 of a flight that was not completed, else 0
Integers = NDArray[np.int64]
Columns = Mapping[str, Array]  # values (R,) of flights by name of the number; NaN for null


@dataclass(frozen=True, slots=True)
class FlightQuantity:
    """A number of a flight that may get worse.

    Attributes:
        key: of JSON and tables.
        words: for people.
        unit: "" without one.
        better: 1: larger is better; -1: smaller is.
        decimals: of the printed number.
        begin: of the names of the numbers that it combines.
        end: of these names.
        combine: how; of values (m, R).
        rare: also told where there was none before, whatever the interval.
    """

    key: str
    words: str
    unit: str
    better: int
    decimals: int
    begin: str
    end: str
    combine: Callable[..., Array]
    rare: bool = False

    @property
    def label(self) -> str:
        """The words and the unit."""
        return f"{self.words}, {self.unit}" if self.unit else self.words

    @property
    def rounding(self) -> float:
        """A unit of the last printed digit."""
        return float(10.0**-self.decimals)

    def text(self, value: float, *, signed: bool = False) -> str:
        """Return a value as it is printed."""
        return f"{value:{'+' * signed}.{self.decimals}f}"


def _sum(values: Array) -> Array:
    total: Array = values.sum(axis=0)
    return total


def _count(values: Array) -> Array:
    count: Array = np.isfinite(values).sum(axis=0).astype(np.float64)
    return count


def _of_command(command: str) -> tuple[FlightQuantity, ...]:
    start = f"margins.{command}_"
    return tuple(
        FlightQuantity(f"{command}_{end}", words, unit, 1, decimals, start, end, np.fmin.reduce)
        for end, words, unit, decimals in (
            ("factor", f"{command} gain margin, factor", "", 1),
            ("latency_s", f"{command} latency margin", "s", 2),
            ("phase_deg", f"{command} phase margin", "°", 0),
        )
    )


WHOLE_SEPARATION = FlightQuantity(
    "separation_m", "smallest separation", "m", 1, 2, "min_separation_m", "", np.fmin.reduce
)  # of flights without the next two
QUANTITIES = (
    FlightQuantity(
        "separation_in_windows_m", "smallest separation in the windows", "m", 1, 2,
        "windows.", ".min_separation_m", np.fmin.reduce,
    ),
    FlightQuantity(
        "separation_outside_windows_m", "smallest separation outside the windows", "m", 1, 2,
        "min_separation_outside_windows_m", "", np.fmin.reduce,
    ),
    FlightQuantity(
        "saturated_s", "commands at a limit, sum of the followers", "s", -1, 1,
        "saturations.", ".seconds", _sum,
    ),
    FlightQuantity(
        "left_speed_set", "times the speed set was left, sum of the followers", "", -1, 1,
        "left_speed_set.", ".times", _sum,
    ),
    FlightQuantity(
        "ringing_s", "ringing of the bank, sum of the followers", "s", -1, 1,
        "ringing.", ".seconds", _sum,
    ),
    FlightQuantity(
        "lost", "aircraft lost per flight", "", -1, 2, "lost_at_s.", "", _count, rare=True
    ),
    FlightQuantity(
        NOT_COMPLETED, "share of flights not completed", "", -1, 2,
        NOT_COMPLETED, "", _sum, rare=True,
    ),
    FlightQuantity("damping", "damping ratio", "", 1, 2, "margins.damping", "", np.fmin.reduce),
    *(each for command in COMMANDS for each in _of_command(command)),
)  # fmt: skip


def side_numbers(numbers: Columns) -> dict[FlightQuantity, Array]:
    """Return the quantities (R,) that flights have numbers of."""
    found: dict[FlightQuantity, Array] = {}
    for each in QUANTITIES:
        names = _names(each, numbers)
        if names:
            found[each] = each.combine(np.stack([numbers[name] for name in names]))
    if not any(each.key.startswith("separation") for each in found):
        whole = numbers.get(WHOLE_SEPARATION.begin)
        found |= {} if whole is None else {WHOLE_SEPARATION: whole}
    return found


def _names(quantity: FlightQuantity, numbers: Columns) -> list[str]:
    if not quantity.end and not quantity.begin.endswith("."):
        return [quantity.begin] if quantity.begin in numbers else []
    return [
        name for name in numbers if name.startswith(quantity.begin) and name.endswith(quantity.end)
    ]


@dataclass(frozen=True, slots=True)
class PairedChange:
    """Change of a number from one set of flights to another, paired by independent unit.

    Attributes:
        before: mean over the pairs.
        after: the same.
        mean: of the differences.
        low: of their interval; NaN of one flight, and where there are too few.
        high: the same.
        units: seeds, or points that were drawn; 1 if all seeds have the same flight; 0: no pair.
    """

    before: float
    after: float
    mean: float
    low: float
    high: float
    units: int

    @property
    def one_flight(self) -> bool:
        """Whether there is no interval, because the seeds change nothing or there is only one."""
        return self.units == 1

    @property
    def too_few(self) -> bool:
        """Whether there are several seeds, too few for an interval."""
        return self.units != 1 and math.isnan(self.low)

    def sign(self, rounding: float) -> int:
        """Return whether the number is larger (1) or smaller (-1) beyond noise; 0: neither.

        Args:
            rounding: of the printed number, which decides where there is no interval.
        """
        if self.one_flight:
            return int(math.copysign(1, self.mean)) if abs(self.mean) > rounding else 0
        return 1 if self.low > 0.0 else -1 if self.high < 0.0 else 0


NO_CHANGE = PairedChange(math.nan, math.nan, math.nan, math.nan, math.nan, 0)


def change_of(before: float, after: float, differences: Array, *, one_flight: bool) -> PairedChange:
    """Return the change with its interval.

    Args:
        before: mean over the pairs.
        after: the same.
        differences: (n,) after minus before, by independent unit.
        one_flight: whether all units have the same flights.
    """
    if not differences.size:
        return NO_CHANGE
    if one_flight:
        mean = float(differences.mean())
        return PairedChange(before, after, mean, math.nan, math.nan, 1)
    return PairedChange(before, after, *student_interval(differences), differences.size)


def mean_by_unit(values: Array, unit: Integers, point: Integers) -> Array:
    """Return the means (n,) of values (R,) of each independent unit."""
    _, index, count = np.unique(unit, return_inverse=True, return_counts=True)
    means: Array = np.bincount(index, weights=values) / count
    return means


Pool = Callable[[Array, Integers, Integers], Array]  # as `mean_by_unit`


def repeats(numbers: Columns, point: Integers) -> BoolArray:
    """Return which flights (R,) have all numbers of the first flight of their point.

    Args:
        numbers: by name.
        point: (R,) number of the set of settings, without the seed.
    """
    _, first, index = np.unique(point, return_index=True, return_inverse=True)
    same = np.ones(point.size, dtype=np.bool_)
    for values in numbers.values():
        of_first = values[first][index]
        same &= (values == of_first) | (np.isnan(values) & np.isnan(of_first))
    return same


def seeds_change_nothing(numbers: Columns, point: Integers) -> bool:
    """Return whether all flights of each point have the same numbers; see `repeats`."""
    return bool(repeats(numbers, point).all())


@dataclass(frozen=True, slots=True)
class SideEffect:
    """A quantity that got worse."""

    quantity: FlightQuantity
    change: PairedChange

    @property
    def interval(self) -> str:
        """The difference as text, with its interval if there is one."""
        one, change = self.quantity, self.change
        text = one.text(change.mean, signed=True)
        if math.isnan(change.low):
            return text
        low, high = (one.text(each, signed=True) for each in (change.low, change.high))
        return f"{text} [{low}, {high}]"

    @property
    def cells(self) -> tuple[str, str, str]:
        """Before, after and difference as text."""
        text = self.quantity.text
        return text(self.change.before), text(self.change.after), self.interval


def is_worse(quantity: FlightQuantity, change: PairedChange) -> bool:
    """Return whether a quantity got worse beyond noise, by more than its printed rounding."""
    if quantity.rare and change.units and change.after > change.before == 0.0:
        return True
    by = change.sign(quantity.rounding)
    return by == -quantity.better and abs(change.mean) > quantity.rounding


@dataclass(frozen=True, slots=True)
class SideEffects:
    """The quantities that got worse, and what that is based on.

    Attributes:
        worse: in the order of `QUANTITIES`.
        basis: seeds and interval, or one flight each, as text.
        too_few: whether there are several seeds, too few for an interval.
    """

    worse: tuple[SideEffect, ...]
    basis: str
    too_few: bool

    def __bool__(self) -> bool:
        """Return whether there is something to be told."""
        return bool(self.worse) or self.too_few

    @property
    def lines(self) -> list[str]:
        """A line for each quantity."""
        return [
            f"  {each.quantity.label}: {before} before, {after} after, {difference}"
            for each in self.worse
            for before, after, difference in (each.cells,)
        ]


def collect(
    changes: Mapping[FlightQuantity, PairedChange], unit_name: str, units: int
) -> SideEffects:
    """Choose the quantities that got worse.

    Args:
        changes: of all that are known.
        unit_name: plural of what is independent: seeds, or drawn points.
        units: how many of them were flown.
    """
    worse = tuple(
        SideEffect(quantity, change)
        for quantity, change in changes.items()
        if is_worse(quantity, change)
    )
    typical = max(changes.values(), key=lambda each: each.units, default=NO_CHANGE)
    if typical.one_flight:
        basis = "of one flight each" + (": no seed changes them" if units > 1 else "")
    elif typical.too_few:
        basis = f"{units} {unit_name} are too few for an interval (fly 3 or more)"
    else:
        basis = f"paired over {typical.units} {unit_name}, {100 * LEVEL:g} % interval"
    return SideEffects(worse, basis, bool(changes) and typical.too_few)


def side_effects(
    before: Columns,
    after: Columns,
    unit: Integers,
    point: Integers,
    *,
    unit_name: str = "seeds",
    pool: Pool = mean_by_unit,
) -> SideEffects:
    """Return the quantities that got worse in R pairs of flights.

    Of flights that were not completed, see `NOT_COMPLETED`, and of pairs with other durations or
    windows, only losses count.

    Args:
        before: numbers by name.
        after: the same of the flights with other settings, in the same order.
        unit: (R,) what is independent: the seed of both flights of a pair, or a drawn point.
        point: (R,) number of the set of settings that they share, without the seed.
        unit_name: plural of the unit.
        pool: returns values by unit.
    """
    one_flight = seeds_change_nothing(before, point) and seeds_change_nothing(after, point)
    old, new = side_numbers(before), side_numbers(after)
    usable = _completed(before) & _completed(after) & _same_times(before, after)
    changes = {}
    for quantity in (each for each in old if each in new):
        both = np.isfinite(old[quantity]) & np.isfinite(new[quantity])
        both &= np.ones_like(usable) if quantity.rare else usable
        changes[quantity] = NO_CHANGE
        if both.any():
            values = old[quantity][both], new[quantity][both]
            means = [pool(each, unit[both], point[both]) for each in values]
            changes[quantity] = change_of(
                float(means[0].mean()),
                float(means[1].mean()),
                pool(values[1] - values[0], unit[both], point[both]),
                one_flight=one_flight,
            )
    return collect(changes, unit_name, len(set(unit.tolist())))


def _completed(numbers: Columns) -> BoolArray:
    """Return which flights (R,) were completed."""
    size = next(iter(numbers.values())).size if numbers else 0
    completed: BoolArray = numbers.get(NOT_COMPLETED, np.zeros(size)) == 0.0
    return completed


def _same_times(before: Columns, after: Columns) -> BoolArray:
    """Return which pairs (R,) have one duration and the same windows."""
    size = next(iter(before.values())).size if before else 0
    same = np.ones(size, dtype=np.bool_)
    nothing = np.full(size, math.nan)
    for name in {*before, *after}:
        if name == "simulated_s" or (name.startswith("windows.") and ".window_s." in name):
            one, two = before.get(name, nothing), after.get(name, nothing)
            same &= (one == two) | (np.isnan(one) & np.isnan(two))
    return same


def flight_numbers(document: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Return the numbers of a flight by name, with `NOT_COMPLETED`.

    Args:
        document: of metrics.json; None of a flight that failed.
    """
    if document is None:
        return {NOT_COMPLETED: 1.0}
    return flatten_metrics(document) | {NOT_COMPLETED: float(document["outcome"] != "completed")}


def to_columns(flights: Sequence[Numbers]) -> dict[str, Array]:
    """Return the numbers of flights by name; NaN where a flight does not have one."""
    names = dict.fromkeys(name for numbers in flights for name in numbers)
    return {name: np.array([_value(numbers.get(name)) for numbers in flights]) for name in names}


def _value(number: float | None) -> float:
    return math.nan if number is None else number


def to_document(effects: SideEffects) -> list[dict[str, Any]]:
    """Return what got worse as plain data for JSON."""
    return [
        {
            "key": each.quantity.key,
            "words": each.quantity.label,
            "before": each.change.before,
            "after": each.change.after,
            "difference": {
                name: None if math.isnan(value) else value
                for name, value in (
                    ("mean", each.change.mean),
                    ("low", each.change.low),
                    ("high", each.change.high),
                )
            },
            "one_flight": each.change.one_flight,
        }
        for each in effects.worse
    ]


# parts of the names of metrics by which it is known whether larger is better
_SMALLER = frozenset({
    "rms_m", "mean_rms_m", "estimated_rms_m", "estimated_mean_rms_m", "percent_error",
    "max_error_m", "relative_position_error_m", "estimate_error", "joined_at_s", "saturations",
    "limiter_flags", "left_speed_set", "age_of_information_s",
})  # fmt: skip
_LARGER = frozenset({
    "min_separation_m", "min_separation_outside_windows_m", "kappa_mps", "damping_ratio",
    "damping",
})  # fmt: skip
_MARGINS = ("_factor", "_latency_s", "_phase_deg", "_distance")


@cache
def better_sign(metric: str) -> int:
    """Return 1 if a larger number is better, -1 if a smaller one is; 0: neither is known."""
    parts = metric.split(".")
    if _SMALLER.intersection(parts) or parts[0] == "ringing" and parts[-1] == "seconds":
        return -1
    if _LARGER.intersection(parts) or parts[0] == "margins" and metric.endswith(_MARGINS):
        return 1
    return 0


def describe_change(metric: str, change: PairedChange, rounding: float) -> str:
    """Return a verdict on a metric, such as "worse" or "not significant".

    Args:
        metric: its name, of which follows what is better; "larger" or "smaller" if that is unknown.
        change: of it.
        rounding: of the printed number.
    """
    if change.too_few:
        return "too few"
    by = change.sign(rounding)
    if not by:
        return "no change" if change.one_flight else "not significant"
    better = better_sign(metric)
    word = ("better" if by == better else "worse") if better else ("larger", "smaller")[by < 0]
    return f"{word}, of one flight" if change.one_flight else word
