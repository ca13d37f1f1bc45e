"""Pacing of simulated time by the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from testbed.core.errors import InputError

_MIN_RATE, _MAX_RATE = 1e-3, 1e6  # simulated s per s: a slower run looks as if it hung
_BIN_S = 1e-4  # of the histogram of delays
_WARM_UP_S = 0.2  # simulated; the first ticks of a first flight compile
_MAX_DELAY_S = 0.25  # after a longer one the schedule restarts, without catching up


class RealTimePacer:
    """Wait for the wall-clock time of each tick, and measure how late ticks are.

    The schedule starts after the first ticks. Small delays are caught up; after a long one the
    schedule restarts, because clients could not follow a run that catches up at full speed.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Keep this many simulated seconds per second.

        Raises:
            InputError: the rate is out of range.
        """
        if not _MIN_RATE <= rate <= _MAX_RATE:
            raise InputError(
                f"--pace {rate:g}: write a number from {_MIN_RATE:g} to {_MAX_RATE:g}, as 1 for "
                "real time"
            )
        self.rate, self._clock = rate, clock
        self._first: tuple[float, float] | None = None  # simulated and wall-clock s
        self._schedule = (0.0, 0.0)
        self._last = (0.0, 0.0)
        self._bins = np.zeros(round(_MAX_DELAY_S / _BIN_S) + 1, dtype=np.int64)
        self._sum = self._max = 0.0

    def wait(self, now_s: float, idle: Callable[[float], bool]) -> None:
        """Wait until the tick at `now_s` is due.

        Args:
            now_s: simulated s.
            idle: called with the time left, s; may return earlier. False: the wait ends and that
                tick does not count.
        """
        wall = self._clock()
        if self._first is None:
            if now_s >= _WARM_UP_S:
                self._first = self._schedule = self._last = (now_s, wall)
            return
        due = self._schedule[1] + (now_s - self._schedule[0]) / self.rate
        while (left := due - wall) > 0.0:
            if not idle(left):
                return
            wall = self._clock()
        delay = wall - due
        if delay > _MAX_DELAY_S:
            self._schedule = (now_s, wall)
        self._bins[min(int(delay / _BIN_S), len(self._bins) - 1)] += 1
        self._sum += delay
        self._max = max(self._max, delay)
        self._last = (now_s, wall)

    def summary(self) -> Mapping[str, object]:
        """Return requested and achieved pace and the delays of ticks, ready for JSON."""
        first = self._first or (0.0, 0.0)
        wall = self._last[1] - first[1]
        count = int(self._bins.sum())
        rank = int(np.searchsorted(np.cumsum(self._bins), 0.99 * count)) + 1
        return {
            "requested": self.rate,
            "achieved": (self._last[0] - first[0]) / wall if wall > 0.0 else None,
            "late_s": {
                "mean": self._sum / count if count else 0.0,
                "p99": min(rank * _BIN_S, self._max),
                "max": self._max,
            },
        }
