"""Statistics of a study: intervals that say their level, and that draw from streams with names."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from testbed import intervals
from testbed.intervals import FEWEST, LEVEL
from testbed.state import Array
from testbed.streams import stream

PERCENT = round(100.0 * LEVEL)  # of all intervals
DRAWS, FEWEST_DRAWS = 2000, 400  # of a bootstrap
MOST_DRAWN = 4_000_000  # values of all draws together, above which there are fewer
AT_ONCE = 1_000_000  # of these in memory
SEED = 1  # of all draws here: the same file gives the same page

Statistic = Callable[..., Array]
STATISTICS: dict[str, Statistic] = {"median": np.median, "mean": np.mean}


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its interval; bounds that are not numbers: too few values for one."""

    value: float
    low: float
    high: float
    count: int  # of values it is made of


NOTHING = Estimate(math.nan, math.nan, math.nan, 0)


def bootstrap(values: Array, statistic: str, name: str) -> Estimate:
    """The median or mean of independent values (n,) with its percentile bootstrap interval.

    Efron and Tibshirani, An Introduction to the Bootstrap, 13.3. Of few values it is too narrow:
    for n = 5 normal ones, 95 % of a mean's are near 85 %.

    Args:
        values: finite, one for each seed, say.
        statistic: a key of `STATISTICS`.
        name: of the stream that draws: the same name gives the same interval.
    """
    taken = STATISTICS[statistic]
    if not values.size:
        return NOTHING
    value = float(taken(values))
    if values.size < FEWEST:
        return Estimate(value, math.nan, math.nan, values.size)
    dice = stream(SEED, f"study-report/{name}")
    draws = max(min(DRAWS, MOST_DRAWN // values.size), FEWEST_DRAWS)
    step = max(AT_ONCE // values.size, 1)
    again = np.concatenate(
        [
            taken(values[dice.integers(values.size, size=(min(step, draws - k), values.size))], 1)
            for k in range(0, draws, step)
        ]
    )
    low, high = np.quantile(again, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return Estimate(value, float(low), float(high), values.size)


def student(values: Array) -> Estimate:
    """The mean of independent, nearly normal values (n,) with Student's interval."""
    return Estimate(*intervals.student(values), values.size) if values.size else NOTHING


def wilson(hits: int, of: int) -> Estimate:
    """A share of counted things with Wilson's score interval; J. Am. Stat. Assoc. 22 (1927)."""
    if not of:
        return NOTHING
    z = float(ndtri(0.5 + LEVEL / 2.0))
    share, grown = hits / of, 1.0 + z * z / of
    middle = (share + z * z / (2.0 * of)) / grown
    reach = z / grown * math.sqrt(share * (1.0 - share) / of + (z / (2.0 * of)) ** 2)
    # at the ends exactly, which rounding would miss
    low, high = (0.0 if not hits else middle - reach), (1.0 if hits == of else middle + reach)
    return Estimate(share, low, high, of)


def ranks(values: Array) -> Array:
    """Ranks (n,) from 1; equals share their mean."""
    _, where, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    mean: Array = (last - 0.5 * (count - 1.0))[where]
    return mean


def rank_correlation(x: Array, y: Array) -> float:
    """Spearman's: that of the ranks of (n,) and (n,); not a number if one of them is constant."""
    a, b = ranks(x), ranks(y)
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size > 0.0 else math.nan


def variance_share(values: Array, group: NDArray[Any]) -> float:
    """How much of the variance of values (n,) the means of their groups (n,) have: η², 0..1."""
    total = float(((values - values.mean()) ** 2).sum()) if values.size else 0.0
    if not total > 0.0:
        return math.nan
    _, where, count = np.unique(group, return_inverse=True, return_counts=True)
    means = np.bincount(where, weights=values) / count
    return float((count * (means - values.mean()) ** 2).sum()) / total


def running_quantiles(
    x: Array, y: Array, shares: tuple[float, ...], *, window: int
) -> tuple[Array, Array]:
    """Quantiles of y over the `window` values nearest in order of x, window after window.

    Args:
        x: (n,).
        y: (n,).
        shares: 0..1.
        window: how many values each quantile is of; n at most.

    Returns:
        Medians of x (n - window + 1,), and the quantiles (len(shares), n - window + 1).
    """
    order = np.argsort(x, kind="stable")
    along = np.lib.stride_tricks.sliding_window_view(x[order], window)
    across = np.lib.stride_tricks.sliding_window_view(y[order], window)
    return np.median(along, axis=1), np.quantile(across, shares, axis=1)
