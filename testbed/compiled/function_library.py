"""Functions of JSBSim's <function> elements that `math` does not have."""

from __future__ import annotations

from math import copysign, inf, isinf, log, log10, nan, sqrt

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Array


@kernel
def fraction_of(x: float) -> float:
    """Return the fraction of a number, with its sign."""
    return copysign(0.0 if isinf(x) else x - np.trunc(x), x)


@kernel
def nearest(x: float) -> float:
    """Return the nearest whole number, halves away from zero."""
    found: float = np.trunc(x)
    return found + copysign(1.0, x) if abs(x - found) >= 0.5 else found


@kernel
def modulo(one: float, other: float) -> float:
    """Return the remainder of the whole parts, with the sign of the first; 0 is positive."""
    found: float = np.fmod(np.trunc(one), np.trunc(other)) + 0.0
    return found


# Where the C library has NaN, JSBSim has an infinite number.


@kernel
def root(x: float) -> float:
    """Return the square root; of a negative number or NaN minus infinity."""
    return sqrt(x) if x >= 0.0 else -inf


@kernel
def logarithm(x: float) -> float:
    """Return the natural logarithm; of 0, a negative number or NaN minus infinity."""
    return log(x) if x > 0.0 else -inf


@kernel
def logarithm_10(x: float) -> float:
    """Return the logarithm to base 10; of 0, a negative number or NaN minus infinity."""
    return log10(x) if x > 0.0 else -inf


@kernel
def remainder_of(one: float, other: float) -> float:
    """Return the remainder of a division, with the sign of the first; infinity where it is by 0."""
    found: float = np.fmod(one, other) if other != 0.0 else inf
    return found


@kernel
def power_of(base: float, exponent: float, one: float) -> float:
    """Return a power as the C library has it, of numbers that the compiler does not know.

    LLVM replaces `pow` of some numbers that it knows by other functions, which differ in the last
    bit: an exponent of 2, 0.5 or -1, and a base of 2 or a power of it.

    Args:
        base: any number.
        exponent: any number.
        one: 1, of a variable that the compiler does not know either.
    """
    found: float = pow(base * one, exponent * one)
    return found


@kernel
def table_1(x: float, keys: Array, values: Array) -> float:
    """Interpolate linearly, with the end values held.

    Args:
        x: looked up in `keys`.
        keys: (N,) breakpoints, which increase; 2 or more.
        values: (N,).
    """
    if x <= keys[0]:
        first: float = values[0]
        return first
    if x >= keys[-1]:
        last: float = values[-1]
        return last
    k = _first_not_below(x, keys)
    rise = values[k] - values[k - 1]
    found: float = (x - keys[k - 1]) / (keys[k] - keys[k - 1]) * rise + values[k - 1]
    return found


@kernel
def interpolate_1(x: float, keys: Array, values: Array) -> float:
    """Interpolate as <interpolate1d> does, whose search and terms are not a table's."""
    low, high = 0, len(keys) - 1
    if x <= keys[0]:
        high = 0
    elif x >= keys[-1]:
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if x < keys[middle]:
            high = middle
        elif x > keys[middle]:
            low = middle
        else:  # also of NaN
            low = high = middle
    found: float = values[low]
    if high > low:
        rise = values[high] - values[low]
        found += (x - keys[low]) * rise / (keys[high] - keys[low])
    return found


@kernel
def least(found: float, other: float) -> float:
    """Return the smaller one; NaN is none."""
    return other if other < found else found


@kernel
def largest(found: float, other: float) -> float:
    """Return the larger one; NaN is none."""
    return other if other > found else found


@kernel
def chosen(number: float, wanted: float, value: float, otherwise: float) -> float:
    """Return a value where a number is the wanted one."""
    return value if number == wanted else otherwise


@kernel
def pick(number: float, values: Array) -> float:
    """Return the value with a whole number, from 0; NaN: there is none."""
    if 0.0 <= number < len(values):
        found: float = values[int(number)]
        return found
    return nan


@kernel
def _first_not_below(x: float, points: Array) -> int:
    """Return the number, from 1 on, of the first breakpoint that is not below a value.

    It is the last one where all are below, and 1 for NaN.
    """
    low, high = 1, len(points) - 1
    while low < high:
        middle = (low + high) // 2
        if points[middle] < x:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def table_2(row: float, column: float, rows: Array, columns: Array, data: Array) -> float:
    """Interpolate linearly in both variables, which are held to the table.

    Args:
        row: looked up in `rows` (R,), which increase.
        column: looked up in `columns` (C,), which increase.
        rows: breakpoints.
        columns: breakpoints.
        data: (R, C)
    """
    r, along = _interval(row, rows)
    c, across = _interval(column, columns)
    low = (1.0 - along) * data[r - 1, c - 1] + along * data[r, c - 1]
    high = (1.0 - along) * data[r - 1, c] + along * data[r, c]
    value: float = low + across * (high - low)
    return value


@kernel
def _interval(x: float, points: Array) -> tuple[int, float]:
    """Return the number of the breakpoint above a value, and its share of the way there."""
    k = _first_not_below(x, points)
    share = (x - points[k - 1]) / (points[k] - points[k - 1])
    return k, min(max(share, 0.0), 1.0)
