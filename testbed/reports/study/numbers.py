"""Statistics of a study: confidence intervals at one level, rank correlation, shares, quantiles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from testbed.core.random import named_stream
from testbed.core.records import Array
from testbed.core.stats import LEVEL, MIN_VALUES, student_interval

PERCENT = round(100.0 * LEVEL)  # of all intervals
DRAWS, MIN_DRAWS = 2000, 400  # of a bootstrap
MAX_DRAWN = 4_000_000  # values of all draws, above which there are fewer draws
DRAWN_AT_ONCE = 1_000_000  # values in memory
SEED = 1  # of all draws: the same file gives the same report

Statistic = Callable[..., Array]
STATISTICS: dict[str, Statistic] = {"median": np.median, "mean": np.mean}


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its interval; low and high are NaN if there are too few values."""

    value: float
    low: float
    high: float
    count: int  # of the values


NOTHING = Estimate(math.nan, math.nan, math.nan, 0)


def bootstrap(values: Array, statistic: str, name: str) -> Estimate:
    """Return the median or mean of values (n,) with its percentile bootstrap interval.

    Efron and Tibshirani, An Introduction to the Bootstrap, 13.3. For few values it is too narrow:
    for n = 5 normal values, the 95 % interval of a mean contains it in about 85 % of cases.

    Args:
        values: independent, finite; for example one for each seed.
        statistic: a key of `STATISTICS`.
        name: of the random stream: the same name gives the same interval.
    """
    compute = STATISTICS[statistic]
    if not values.size:
        return NOTHING
    value = float(compute(values))
    if values.size < MIN_VALUES:
        return Estimate(value, math.nan, math.nan, values.size)
    # scipy.stats.bootstrap is not used: it would draw other samples, and so move every interval
    random = named_stream(SEED, f"study-report/{name}")
    draws = max(min(DRAWS, MAX_DRAWN // values.size), MIN_DRAWS)
    step = max(DRAWN_AT_ONCE // values.size, 1)
    resampled = np.concatenate(
        [
            compute(
                values[random.integers(values.size, size=(min(step, draws - k), values.size))], 1
            )
            for k in range(0, draws, step)
        ]
    )
    low, high = np.quantile(resampled, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return Estimate(value, float(low), float(high), values.size)


def mean_estimate(values: Array) -> Estimate:
    """Return the mean of independent, nearly normal values (n,) with Student's interval."""
    return Estimate(*student_interval(values), values.size) if values.size else NOTHING


def wilson(hits: int, of: int) -> Estimate:
    """Return a share of counts with Wilson's score interval; J. Am. Stat. Assoc. 22 (1927)."""
    if not of:
        return NOTHING
    interval = stats.binomtest(hits, of).proportion_ci(LEVEL, method="wilson")
    # at the ends exactly 0 and 1, which rounding would miss
    low = float(interval.low) if hits else 0.0
    high = float(interval.high) if hits < of else 1.0
    return Estimate(hits / of, low, high, of)


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
