"""Student's t: the quantile, and the confidence interval of a mean."""

from __future__ import annotations

import math

from testbed.core.records import Array

LEVEL = 0.95
MIN_VALUES = 3  # for an interval


def student_quantile(tail: float, freedom: int) -> float:
    """Return the t that |T| exceeds with probability `tail`, for Student's T."""
    from scipy.special import stdtrit  # not loaded by commands that only read scenarios

    return -float(stdtrit(freedom, 0.5 * tail))


def student_interval(values: Array) -> tuple[float, float, float]:
    """Return the mean of values (n,) and its confidence interval at `LEVEL`.

    Args:
        values: independent, nearly normal, finite; at least one.

    Returns:
        Mean, low and high; low and high are NaN for fewer than `MIN_VALUES` values.
    """
    mean, count = float(values.mean()), values.size
    if count < MIN_VALUES:
        return mean, math.nan, math.nan
    half = student_quantile(1.0 - LEVEL, count - 1) * float(values.std(ddof=1)) / math.sqrt(count)
    return mean, mean - half, mean + half
