"""Numbers of entries beside each other: means by task, paired differences, and ranks.

The number of a task and a seed is the mean over its levels. Entries fly the same seeds, so their
differences are paired by seed: a difference is judged by Student's t over the seeds. Of all pairs
of entries in all tables of the page those are claimed that Holm's procedure (Scand. J. Statist. 6,
1979) rejects at `ALPHA`: with 95 % confidence no claim of the whole page is false. All other pairs
show no difference.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.core.stats import student_interval

ALPHA = 0.05
ROUNDING_M = 0.005  # of the printed numbers: a smaller difference is none
ALL = "all"  # the table of all tasks
Numbers = Mapping[str, Mapping[str, Array]]  # by entry and table: (S,) of the seeds, m


@dataclass(frozen=True, slots=True)
class PairComparison:
    """Two entries in one table.

    Attributes:
        table: name of a task, or `ALL`.
        better: entry with the smaller mean.
        worse: the other one.
        difference_m: mean of worse minus better, over the seeds.
        low_m: of its interval, not corrected.
        high_m: the same.
        p: of Student's t.
        claimed: whether better is claimed to be better.
    """

    table: str
    better: str
    worse: str
    difference_m: float
    low_m: float
    high_m: float
    p: float
    claimed: bool


@dataclass(frozen=True, slots=True)
class Standing:
    """An entry in a table.

    Attributes:
        entry: its name.
        mean_m: over the seeds.
        low_m: of the interval of the mean; NaN: too few seeds.
        high_m: the same.
        rank: 1 plus the number of entries that are claimed to be better.
        last_rank: the number of entries, less those that are claimed to be worse.
        equal: entries that it is not parted from.
    """

    entry: str
    mean_m: float
    low_m: float
    high_m: float
    rank: int
    last_rank: int
    equal: tuple[str, ...]


def student_p(differences: Array) -> float:
    """Return the two-sided p of Student's t for differences (n,) with mean 0.

    Equal differences have p 0, unless they are 0; fewer than two have 1.
    """
    from scipy.special import stdtr  # not loaded by commands that only read scenarios

    count, mean = differences.size, float(differences.mean())
    deviation = float(differences.std(ddof=1)) if count > 1 else math.inf
    if mean == 0.0 or math.isinf(deviation):
        return 1.0
    if deviation == 0.0:
        return 0.0
    return 2.0 * float(stdtr(count - 1, -abs(mean) / (deviation / math.sqrt(count))))


def holm(values: Sequence[float], alpha: float = ALPHA) -> list[bool]:
    """Return which hypotheses Holm's procedure rejects.

    Args:
        values: p of each hypothesis.
        alpha: probability of any false rejection.
    """
    rejected = [False] * len(values)
    order = sorted(range(len(values)), key=lambda k: values[k])
    for number, k in enumerate(order):
        if values[k] > alpha / (len(values) - number):
            break
        rejected[k] = True
    return rejected


def with_all(by_task: Mapping[str, Array]) -> dict[str, Array]:
    """Return the tables of an entry: tasks, and of all of them the geometric mean by seed."""
    logs = np.log([np.maximum(each, ROUNDING_M) for each in by_task.values()])
    return {ALL: np.exp(logs.mean(axis=0)), **by_task}


def compare(numbers: Numbers) -> list[PairComparison]:
    """Compare all pairs of entries in all tables.

    Args:
        numbers: all entries have the same tables, and the same seeds in the same order.
    """
    names = sorted(numbers)
    pairs = [
        (table, one, two)
        for table in (numbers[names[0]] if names else ())
        for one, two in itertools.combinations(names, 2)
    ]
    differences = [numbers[two][table] - numbers[one][table] for table, one, two in pairs]
    values = [student_p(each) for each in differences]
    found = []
    for pair, each, p, rejected in zip(pairs, differences, values, holm(values), strict=True):
        table, better, worse = pair
        if each.mean() < 0.0:
            better, worse, each = worse, better, -each
        mean, low, high = student_interval(each)
        claimed = rejected and mean > ROUNDING_M
        found.append(PairComparison(table, better, worse, mean, low, high, p, claimed))
    return found


def standings(numbers: Numbers, comparisons: Iterable[PairComparison]) -> dict[str, list[Standing]]:
    """Return the entries of each table, the smallest mean first."""
    claims = {(c.table, c.better, c.worse) for c in comparisons if c.claimed}
    tables = next(iter(numbers.values()), {})
    found: dict[str, list[Standing]] = {}
    for table in tables:
        rows = []
        for name in numbers:
            others = [other for other in numbers if other != name]
            above = [each for each in others if (table, each, name) in claims]
            below = [each for each in others if (table, name, each) in claims]
            equal = sorted(set(others) - set(above) - set(below))
            mean, low, high = student_interval(numbers[name][table])
            last = len(numbers) - len(below)
            rows.append(Standing(name, mean, low, high, 1 + len(above), last, tuple(equal)))
        found[table] = sorted(rows, key=lambda each: (each.mean_m, each.entry))
    return found


@dataclass(frozen=True, slots=True)
class Agreement:
    """What a second set of seeds says about the claims of a first.

    Attributes:
        claimed: pairs that the first parts.
        again: of these, that the second parts in the same direction.
        reversed: of these, that the second parts in the other direction.
    """

    claimed: int
    again: int
    reversed: int


def agreement(first: Iterable[PairComparison], second: Iterable[PairComparison]) -> Agreement:
    """Compare the claims on two sets of seeds."""
    claims = {(c.table, c.better, c.worse) for c in first if c.claimed}
    others = {(c.table, c.better, c.worse) for c in second if c.claimed}
    reversed_ = sum((table, two, one) in others for table, one, two in claims)
    return Agreement(len(claims), len(claims & others), reversed_)
