"""The clock of a companion: the time since its autopilot's boot, by the monotonic clock."""

from __future__ import annotations

import math
import time
from collections import deque

SAMPLES = 50  # of which the one with the least delay counts
_NS = 1e-9


def monotonic_of(stamp_ns: int, now_s: float) -> float:
    """Convert a time of receipt by the system's clock to the monotonic clock.

    Args:
        stamp_ns: ns since 1970.
        now_s: s of the monotonic clock.

    Returns:
        s; at most a second ago, so that a clock that is set makes no message old.
    """
    age_s = (time.time_ns() - stamp_ns) * _NS
    return now_s - min(max(age_s, 0.0), 1.0)


class BootClock:
    """Extrapolate the autopilot's time since boot.

    A delay on the way makes a sample look old and never young: of the last samples the one with the
    largest difference of times has had the least delay.
    """

    def __init__(self) -> None:
        self._offsets: deque[float] = deque(maxlen=SAMPLES)
        self._offset = math.nan

    def add(self, boot_s: float, received_s: float) -> None:
        """Take a sample.

        Args:
            boot_s: its time, s since the autopilot's boot.
            received_s: when it came, s of the monotonic clock.
        """
        self._offsets.append(boot_s - received_s)
        self._offset = max(self._offsets)

    def restart(self) -> None:
        """Forget all samples: the autopilot was started again."""
        self._offsets.clear()
        self._offset = math.nan

    def at(self, monotonic_s: float) -> float:
        """Return the time since boot at a time of the monotonic clock, s; NaN: not known."""
        return monotonic_s + self._offset
