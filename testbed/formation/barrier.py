"""The speed barrier h that keeps an agent inside its speed set, [HBH23] examples 4-6."""

from __future__ import annotations

from collections.abc import Sequence
from math import tanh
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, Record, Records, RunInfo, Values, record_of
from testbed.core.tabulated import TABLE, Function, Rough, interpolate, make_table, pack_functions

NO_BARRIER = 7  # h = 1, as in the paper's experiments: the speeds are saturated instead
OWN_BARRIER = 0  # a user's own h
OUTSIDE = 5.0  # m/s, how far beyond the bounds a barrier is checked and an own one is tabulated


class SpeedBarrier(NamedTuple):
    """h by the number of its example in [HBH23].

    4: ν (s_hi − s)(s − s_lo), ν in s²/m². 5: tanh of example 4. 6: 1 but for parabolas within ν
    (m/s) of either bound and beyond. 7: no barrier, h = 1.
    """

    example: int
    nu: float


BARRIER = record_of(SpeedBarrier, ("table", TABLE))  # of an own barrier: h over s − s_lo


class UserBarrier(NamedTuple):
    """A user's own h."""

    table: Records  # (1,) of TABLE


def make_own(function: Function, s_min: float, s_max: float) -> UserBarrier:
    """Tabulate a user's own h(s) on S and up to 5 m/s outside.

    Beyond, it is a straight line.

    Args:
        function: h of ground speeds (K,), m/s.
        s_min: s_lo, m/s.
        s_max: s_hi, m/s.

    Raises:
        ValueError: its derivative is not continuous.
    """
    start = max(-OUTSIDE, -s_min)
    try:
        table = make_table(lambda x: function(s_min + x), start, s_max - s_min + OUTSIDE)
    except Rough as error:
        raise ValueError(
            f"h has no continuous derivative, or changes too fast, near {s_min + error.x:.4g} m/s "
            "(write a smoother h)"
        ) from None
    return UserBarrier(table)


@kernel
def h(barrier: Record, s: float, s_min: float, s_max: float) -> Values:
    """Return the barrier and its slope at a ground speed s, m/s.

    Args:
        barrier: record of BARRIER.
        s: m/s.
        s_min: s_lo, m/s.
        s_max: s_hi, m/s.
    """
    nu = barrier.nu
    if barrier.example == NO_BARRIER:
        return 1.0, 0.0
    if barrier.example == OWN_BARRIER:
        # with bounds of the airspeed, h moves with them
        own: Values = interpolate(barrier.table, s - s_min)
        return own
    if barrier.example == 6:
        # how far s has left the flat part, in parts of ν: negative below it
        past = (max(s + nu - s_max, 0.0) - max(s_min + nu - s, 0.0)) / nu
        return 1.0 - past * past, -2.0 * past / nu
    value, slope = nu * (s_max - s) * (s - s_min), nu * (s_max + s_min - 2.0 * s)
    if barrier.example == 5:
        value = tanh(value)
        slope *= 1.0 - value * value
    return value, slope


def barrier_curve(
    barrier: SpeedBarrier | UserBarrier, s: Array, s_min: float, s_max: float
) -> tuple[Array, Array]:
    """Sample h and h' at ground speeds s (K,), m/s, for figures and checks."""
    out = np.empty((2, len(s)))
    _write_curve(barrier_records(barrier), np.ascontiguousarray(s, dtype=float), s_min, s_max, out)
    return out[0], out[1]


def barrier_records(*barriers: SpeedBarrier | UserBarrier) -> Records:
    """Pack barriers into records (n,) of BARRIER."""
    return pack_functions(BARRIER, barriers)


def barriers_of(records: Records) -> list[SpeedBarrier | UserBarrier]:
    """Unpack the barriers of records (n,) of BARRIER."""
    return [
        UserBarrier(records["table"][k : k + 1])
        if example == OWN_BARRIER
        else SpeedBarrier(int(example), float(records["nu"][k]))
        for k, example in enumerate(records["example"])
    ]


@entry
def _write_curve(barrier: Records, s: Array, s_min: float, s_max: float, out: Array) -> None:
    for k in range(len(s)):
        out[0, k], out[1, k] = h(barrier[0], s[k], s_min, s_max)


SAMPLES = 201  # of an own function


class LoggedBarrier(NamedTuple):
    """h of one follower."""

    example: int  # of [HBH23]; 0: an own function
    nu: float
    samples: tuple[float, ...]  # of an own function, at equal steps: see `_speeds`


def sample_barrier(
    barrier: SpeedBarrier | UserBarrier, s_min: float, s_max: float
) -> tuple[float, ...]:
    """Sample an own h on S and up to 5 m/s outside.

    Empty for an example of the paper.
    """
    if isinstance(barrier, SpeedBarrier):
        return ()
    value, _ = barrier_curve(barrier, _speeds(s_min, s_max, SAMPLES), s_min, s_max)
    return tuple(np.round(value, 6).tolist())


def logged_barriers(info: RunInfo) -> Sequence[LoggedBarrier | None]:
    """List the barriers of the followers (n,); None where h is 1 or unknown."""
    own = info.barrier_samples or ((),) * len(info.barriers)
    known = [
        None
        if example == NO_BARRIER or (example == OWN_BARRIER and not samples)
        else LoggedBarrier(int(example), nu, tuple(samples))
        for (example, nu), samples in zip(info.barriers, own, strict=True)
    ]
    return known or [None] * (len(info.names) - 1)


def logged_curve(barrier: LoggedBarrier, s: Array, s_min: float, s_max: float) -> Array:
    """Compute h at speeds s (K,), m/s; an own function is linear between its samples."""
    if barrier.samples:
        at = _speeds(s_min, s_max, len(barrier.samples))
        value: Array = np.interp(s, at, barrier.samples)
        return value
    return barrier_curve(SpeedBarrier(barrier.example, barrier.nu), s, s_min, s_max)[0]


def _speeds(s_min: float, s_max: float, count: int) -> Array:
    """Return the speeds of so many samples, m/s."""
    return np.linspace(max(s_min - OUTSIDE, 0.0), s_max + OUTSIDE, count)
