"""How far the time in another aircraft's messages is from the own GPS time."""

from __future__ import annotations

import math
from collections import deque

WINDOW_S = 5.0


class ClockOffset:
    """The offset of a sender's clock, from time stamps of messages that were delayed.

    A delay makes a message look old and never young. So the largest of stamp minus receipt within
    some seconds is that of the message with the least delay.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()  # receipts, s, and falling offsets, s

    def add(self, stamp_s: float, received_s: float) -> float:
        """Take a message.

        Args:
            stamp_s: time of measurement by the sender's GPS time, s of the own boot time.
            received_s: time of receipt, s of the own boot time.

        Returns:
            The sender's time minus the own, s, less the least delay within 5 s.
        """
        offset = stamp_s - received_s
        while self._seen and self._seen[-1][1] <= offset:
            self._seen.pop()
        self._seen.append((received_s, offset))
        while self._seen[0][0] < received_s - WINDOW_S:
            self._seen.popleft()
        return self._seen[0][1]

    @property
    def offset_s(self) -> float:
        """The last estimate, s; NaN: there is none."""
        return self._seen[0][1] if self._seen else math.nan
