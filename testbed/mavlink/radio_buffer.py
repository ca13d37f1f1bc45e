"""Flow control by RADIO_STATUS: a telemetry radio tells how full its transmit buffer is.

The rule and its numbers are those of ArduPilot (libraries/GCS_MAVLink/GCS_Common.cpp,
handle_radio_status and last_txbuf_is_greater; GCS_Param.cpp, queued_param_send).
"""

from __future__ import annotations

MAX_SLOWDOWN_MS = 2000
FAST_ABOVE_MS = 200  # of slowdown: below it the larger step back is not made
VERY_LOW, LOW, GOOD, PLENTY = 20, 50, 90, 95  # free share of the buffer, %
LIST_ABOVE = 33  # %: with less, no list of parameters is sent
LIST_EVERY_S = 0.025  # ArduPilot gives a list 30 % of its line: of 57.6 kbit/s 40 values a second
OUTDATED_S = 5.0  # wall-clock s after which a report does not count for lists


class RadioBuffer:
    """What the reports of a radio say about sending.

    Attributes:
        slowdown_ms: added to the interval of every telemetry message.
    """

    def __init__(self) -> None:
        self.slowdown_ms = 0
        self._free, self._reported_s, self._listed_s = 100, float("-inf"), float("-inf")

    def report(self, free: int, wall_s: float) -> None:
        """Take a report.

        Args:
            free: share of the buffer, %.
            wall_s: wall-clock time.
        """
        self._free, self._reported_s = free, wall_s
        slowdown = self.slowdown_ms
        if free < VERY_LOW and slowdown < MAX_SLOWDOWN_MS:
            slowdown += 60
        elif free < LOW and slowdown < MAX_SLOWDOWN_MS:
            slowdown += 20
        elif free > PLENTY and slowdown > FAST_ABOVE_MS:
            slowdown -= 40
        elif free > GOOD and slowdown > 0:
            slowdown -= 20
        self.slowdown_ms = min(max(slowdown, 0), MAX_SLOWDOWN_MS)

    def list_room(self, most: int, wall_s: float) -> int:
        """Return how many values of a list of parameters may be sent now.

        Args:
            most: without a radio.
            wall_s: wall-clock time.
        """
        if wall_s - self._reported_s > OUTDATED_S:
            return most
        if self._free <= LIST_ABOVE or wall_s - self._listed_s < LIST_EVERY_S:
            return 0
        self._listed_s = wall_s
        return 1
