"""Tables of a user's own functions μ and h, which kernels interpolate.

A table has value and slope at equal steps, and is a cubic between them: Hermite's, with a
continuous derivative. Outside it continues along straight lines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.errors import Portable
from testbed.core.records import Array, Record, Records, Values, allocate

KNOTS = 513
FINE = 16  # points in a step at which a table is compared with its function
VALUE_TOLERANCE, SLOPE_TOLERANCE = 1e-3, 0.05  # shares of the largest magnitude in the table
TABLE = np.dtype(
    [("start", "f8"), ("step", "f8"), ("values", "f8", KNOTS), ("slopes", "f8", KNOTS)],
    align=True,
)

Function = Callable[[Array], Array]


class Rough(Portable):
    """A function that a table does not describe, near `x`."""

    def __init__(self, x: float) -> None:
        super().__init__(f"{x:g}")
        self.x = x


@kernel
def interpolate(table: Record, x: float) -> Values:
    """Return value and slope at x; `table` is a record of TABLE."""
    values, slopes = table.values, table.slopes
    position = (x - table.start) / table.step
    last = len(values) - 1
    if position <= 0.0:
        return values[0] + slopes[0] * (x - table.start), slopes[0]
    if position >= last:
        end = table.start + last * table.step
        return values[last] + slopes[last] * (x - end), slopes[last]
    k = int(position)
    t = position - k
    a, b = values[k], values[k + 1]
    m, n = table.step * slopes[k], table.step * slopes[k + 1]
    # a + t (m + t (c + t d)), with value b and slope n at t = 1
    c, d = 3.0 * (b - a) - 2.0 * m - n, 2.0 * (a - b) + m + n
    return a + t * (m + t * (c + t * d)), (m + t * (2.0 * c + 3.0 * t * d)) / table.step


def make_table(function: Function, start: float, end: float) -> Records:
    """Sample a function from `start` to `end` into a table (1,) of TABLE.

    Args:
        function: of an array (K,), with finite values (K,).
        start: where the table begins.
        end: where it ends.

    Raises:
        Rough: the function has no continuous derivative, or changes too fast for the table.
    """
    table = allocate(TABLE, 1)
    table["start"], table["step"] = start, (end - start) / (KNOTS - 1)
    fine = np.linspace(start, end, FINE * (KNOTS - 1) + 1)
    width = fine[1] - fine[0]
    exact = function(fine)
    table["values"] = exact[::FINE]
    # central differences of fourth order; at the ends, one-sided ones of second order
    d = 1e-3 * width
    inner = fine[FINE:-FINE:FINE]
    near, far = (function(inner + k * d) - function(inner - k * d) for k in (1, 2))
    table["slopes"][0, 1:-1] = (8.0 * near - far) / (12.0 * d)
    for row, sign in ((0, 1.0), (-1, -1.0)):
        one, two = function(fine[row] + sign * d * np.array([1.0, 2.0]))
        table["slopes"][0, row] = sign * (4.0 * one - two - 3.0 * exact[row]) / (2.0 * d)
    _compare(table, fine, exact)
    return table


def _compare(table: Records, x: Array, exact: Array) -> None:
    """Compare a table with its function's values (K,) at x (K,), and with their differences."""
    middle = 0.5 * (x[:-1] + x[1:])
    value, _ = sample_table(table, x)
    _, slope = sample_table(table, middle)
    for errors, at, allowed in (
        (np.abs(value - exact), x, VALUE_TOLERANCE * np.ptp(exact)),
        (
            np.abs(slope - np.diff(exact) / np.diff(x)),
            middle,
            SLOPE_TOLERANCE * np.abs(table["slopes"]).max(),
        ),
    ):
        worst = int(errors.argmax())
        if errors[worst] > allowed + 1e-9:
            raise Rough(float(at[worst]))


def pack_functions(dtype: np.dtype[Any], functions: Sequence[Any]) -> Records:
    """Pack named tuples, whose tables are records (1,) of TABLE, into records (n,)."""
    records = allocate(dtype, len(functions))
    for k, function in enumerate(functions):
        for name, value in function._asdict().items():
            records[name][k] = value[0] if isinstance(value, np.ndarray) else value
    return records


def sample_table(table: Records, x: Array) -> tuple[Array, Array]:
    """Return values and slopes (K,) of a table (1,) at x (K,)."""
    out = np.empty((2, len(x)))
    _write_samples(table, np.ascontiguousarray(x, dtype=np.float64), out)
    return out[0], out[1]


@entry
def _write_samples(table: Records, x: Array, out: Array) -> None:
    for k in range(len(x)):
        out[0, k], out[1, k] = interpolate(table[0], x[k])
