"""The interval of a mean that studies, tunes and reports give."""

from __future__ import annotations

import math

from testbed.state import Array

LEVEL = 0.95
FEWEST = 3  # values that an interval is made of


def student(values: Array) -> tuple[float, float, float]:
    """The mean of independent, nearly normal values (n,), and Student's interval around it.

    Args:
        values: finite, at least one.

    Returns:
        The mean, and the interval's low and high, which are not numbers below `FEWEST` values.
    """
    from scipy.special import stdtrit  # not for who only reads pages

    mean, count = float(values.mean()), values.size
    if count < FEWEST:
        return mean, math.nan, math.nan
    reach = stdtrit(count - 1, 0.5 + LEVEL / 2.0) * values.std(ddof=1) / math.sqrt(count)
    return mean, mean - float(reach), mean + float(reach)
