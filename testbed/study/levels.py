"""The values of one key of a study: its levels in order, or where a share of the way leads."""

from __future__ import annotations

import math
from fractions import Fraction
from statistics import NormalDist
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from testbed.study.page import Spread

Value = bool | int | float | str


def count_levels(spread: Spread) -> int:
    """How many levels there are; 1 of a distribution."""
    if spread.choice is not None:
        return len(spread.choice)
    if spread.start is None or spread.to is None:
        return 1
    if spread.count is not None:
        return spread.count
    assert spread.step is not None
    return math.floor((_exact(spread.to) - _exact(spread.start)) / _exact(spread.step)) + 1


def level(spread: Spread, index: int) -> Value:
    """The level at an index from 0.

    Rows of numbers are counted in decimals as they are written, so that 0 to 1 by 0.1 has a 0.3;
    a row of whole numbers alone is one of whole numbers.
    """
    if spread.choice is not None:
        return spread.choice[index]  # type: ignore[no-any-return]
    assert spread.start is not None and spread.to is not None
    start, to = _exact(spread.start), _exact(spread.to)
    if spread.count is not None:
        step = (to - start) / (spread.count - 1)
    else:
        assert spread.step is not None
        step = _exact(spread.step)
    whole = start.denominator == 1 and step.denominator == 1
    value = start + index * step
    return int(value) if whole else float(value)


def at(spread: Spread, share: float) -> Value:
    """The value below which this share of the distribution lies; of levels, each has its part.

    Args:
        spread: the distribution, or levels.
        share: from 0 to below 1.
    """
    if spread.uniform is not None:
        low, high = spread.uniform
        return low + share * (high - low)
    if spread.log_uniform is not None:
        low, high = spread.log_uniform
        return min(low * math.pow(high / low, share), high)
    if spread.normal is not None:
        # a share of 0 would be minus infinity; half of the smallest step of a draw is as good
        return NormalDist(*spread.normal).inv_cdf(share or 2.0**-54)
    return level(spread, min(int(share * count_levels(spread)), count_levels(spread) - 1))


def _exact(number: float) -> Fraction:
    """The decimal that is written on the page."""
    return Fraction(repr(number))
