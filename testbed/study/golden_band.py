"""How far a flight with another seed may lie from those of the table: Student's prediction band."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

FEWEST = 3  # values a band is made of: with two it is wider than the numbers it bounds


def student_tail(t: float, freedom: int) -> float:
    """P(|T| > t) for Student's T with a whole number of degrees of freedom.

    The finite series in cos θ = 1/√(1 + t²/ν): Abramowitz and Stegun, Handbook of Mathematical
    Functions, 26.7.3 (odd ν) and 26.7.4 (even ν).
    """
    angle = math.atan(t / math.sqrt(freedom))
    sine, cosine = math.sin(angle), math.cos(angle)
    odd = freedom % 2
    term = cosine if odd else 1.0
    total = term if freedom > 1 else 0.0
    for k in range(2 + odd, freedom - 1, 2):
        term *= cosine * cosine * (k - 1) / k
        total += term
    inside = 2.0 / math.pi * (angle + sine * total) if odd else sine * total
    return 1.0 - inside


def student_quantile(tail: float, freedom: int) -> float:
    """The t that |T| exceeds with this probability, by bisection.

    Raises:
        ValueError: the probability is below 1e-12, where the series loses its digits, or not
            below 1.
    """
    if not 1e-12 <= tail < 1.0:
        raise ValueError(f"a probability of {tail:g} is not from 1e-12 to 1")
    low, high = 0.0, 1.0
    while student_tail(high, freedom) > tail:
        low, high = high, 2.0 * high
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if student_tail(middle, freedom) > tail else (low, middle)
    return 0.5 * (low + high)


def prediction_band(
    values: Sequence[float], *, false_alarm: float, least: float, of: int = 1
) -> tuple[float, float]:
    """Where the mean of `of` more values of the same kind lies, but for a chance of `false_alarm`.

    Mean ± t s √(1/m + 1/n) of n independent normal values, s with n − 1 degrees of freedom. An RMS
    error over many correlation times of its noise is close to normal.

    Args:
        values: none below zero, at least `FEWEST`, one per seed.
        false_alarm: probability of a correct value outside, both sides together.
        least: half-width that the band has at least: what rounding may do.
        of: m, how many values the mean is of.

    Raises:
        ValueError: there are too few values.
    """
    n = len(values)
    if n < FEWEST:
        raise ValueError(f"a band needs {FEWEST} values, not {n}")
    middle = statistics.fmean(values)
    spread = statistics.stdev(values) * math.sqrt(1.0 / of + 1.0 / n)
    half = max(student_quantile(false_alarm, n - 1) * spread, least)
    return max(middle - half, 0.0), middle + half
