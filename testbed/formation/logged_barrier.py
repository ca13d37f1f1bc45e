"""The barriers h of a log, with samples of a user's own function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array, RunInfo
from testbed.formation.barrier import (
    NO_BARRIER,
    OUTSIDE,
    OWN_BARRIER,
    Barrier,
    OwnBarrier,
    barrier_curve,
)

SAMPLES = 201  # of an own function


class LoggedBarrier(NamedTuple):
    """h of one follower."""

    example: int  # of [HBH23]; 0: an own function
    nu: float
    samples: tuple[float, ...]  # of an own function, at equal steps: see `_speeds`


def sample_barrier(barrier: Barrier | OwnBarrier, s_min: float, s_max: float) -> tuple[float, ...]:
    """Sample an own h on S and up to 5 m/s outside; empty for an example of the paper."""
    if isinstance(barrier, Barrier):
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
    return barrier_curve(Barrier(barrier.example, barrier.nu), s, s_min, s_max)[0]


def _speeds(s_min: float, s_max: float, count: int) -> Array:
    """Return the speeds of so many samples, m/s."""
    return np.linspace(max(s_min - OUTSIDE, 0.0), s_max + OUTSIDE, count)
