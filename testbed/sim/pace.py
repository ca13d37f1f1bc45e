"""Simulated time held to the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from testbed.errors import InputError

_BIN_S = 1e-4  # of the histogram of lateness
_WARM_S = 0.2  # simulated; a first flight compiles in its first ticks what it needs
_LATEST_S = 0.25  # later than this, and what is lost is not made good


class Pace:
    """Waits for the wall-clock moment of each tick, and remembers how late ticks were.

    The schedule begins after the first ticks, and small delays are made good; after a long one it
    begins anew, for a run that races to catch up is no use to whoever watches it.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Hold this many simulated seconds per second.

        Raises:
            InputError: the rate is not above 0.
        """
        if not 0.0 < rate < 1e6:
            raise InputError(f"--pace {rate:g}: write a number above 0, as 1 for real time")
        self.rate, self._clock = rate, clock
        self._begun: tuple[float, float] | None = None  # simulated and wall-clock s
        self._schedule = (0.0, 0.0)
        self._last = (0.0, 0.0)
        self._bins = np.zeros(round(_LATEST_S / _BIN_S) + 1, dtype=np.int64)
        self._sum = self._most = 0.0

    def wait(self, now_s: float, idle: Callable[[float], bool]) -> None:
        """Return when it is time for the tick at `now_s`.

        Args:
            now_s: simulated s.
            idle: called with what is left, s; may return sooner. False: it is waited no longer,
                and that tick does not count.
        """
        wall = self._clock()
        if self._begun is None:
            if now_s >= _WARM_S:
                self._begun = self._schedule = self._last = (now_s, wall)
            return
        due = self._schedule[1] + (now_s - self._schedule[0]) / self.rate
        while (left := due - wall) > 0.0:
            if not idle(left):
                return
            wall = self._clock()
        late = wall - due
        if late > _LATEST_S:
            self._schedule = (now_s, wall)
        self._bins[min(int(late / _BIN_S), len(self._bins) - 1)] += 1
        self._sum += late
        self._most = max(self._most, late)
        self._last = (now_s, wall)

    def report(self) -> Mapping[str, object]:
        """What was asked and achieved, and how late ticks were, ready for JSON."""
        begun = self._begun or (0.0, 0.0)
        wall = self._last[1] - begun[1]
        count = int(self._bins.sum())
        rank = int(np.searchsorted(np.cumsum(self._bins), 0.99 * count)) + 1
        return {
            "asked": self.rate,
            "achieved": (self._last[0] - begun[0]) / wall if wall > 0.0 else None,
            "late_s": {
                "mean": self._sum / count if count else 0.0,
                "p99": min(rank * _BIN_S, self._most),
                "max": self._most,
            },
        }
