"""Times of telemetry messages from the clocks of the vehicle and of the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array
from testbed.flight_logs.flight_log import increasing
from testbed.mavlink.codec import MavlinkError, Message

_RESTART = 1.0  # s by which the vehicle's clock decreases, or gains on the receiver's, at a start
_SAME_CLOCK = 1.0  # s between the offsets of one clock
_PAUSE = 1.001  # s before a start, if the receiver's clock has no room for it


class Received(NamedTuple):
    """A message with its place in the file and the receiver's time, s."""

    order: int
    time: float
    message: Message


class VehicleClock:
    """Map the vehicle's clock and times of receipt to log time.

    The vehicle's clock is aligned with the log at the first attitude after each start. A start is
    a step back of the vehicle's clock, or a step ahead that the receiver's clock does not have.
    The order of messages is that of the file, because the receiver's clock may step.

    Attributes:
        starts: log times of all starts but the first, s.

    Raises:
        MavlinkError: a clock that was replaced by another one comes back: two vehicles.
    """

    def __init__(self, attitudes: Sequence[Received]) -> None:
        """Find the starts of the vehicle's clock in its attitudes, which are in file order."""
        order, received, boot = _orders(attitudes), _receipts(attitudes), _boot_times(attitudes)
        step, passed = np.diff(boot), np.diff(received)
        starts = (step < -_RESTART) | ((step > _RESTART) & (step - passed > _RESTART))
        first = np.concatenate([[0], np.flatnonzero(starts) + 1])
        raw = [_receipt(received[k : k + 3]) - boot[k] for k in first]
        _check_one_clock(raw)
        self._first_orders = order[first]
        offsets: list[float] = []
        end = -np.inf  # log time of the latest attitude
        for k, offset, stop in zip(first, raw, [*first[1:], len(boot)], strict=True):
            begin = boot[k] + offset
            offsets.append(offset if begin > end else offset + end + _PAUSE - begin)
            end = float(np.max(boot[k:stop])) + offsets[-1]
        self._offsets = np.array(offsets)
        self.starts = tuple((boot[first] + self._offsets)[1:].tolist())
        times = self.from_boot_times(attitudes)
        keep = increasing(times)
        if not keep.any():
            raise MavlinkError("no two times of ATTITUDE are close; the log is damaged")
        self._order, self._received, self._times = order[keep], received[keep], times[keep]

    def from_boot_times(self, messages: Sequence[Received]) -> Array:
        """Convert the vehicle's times in messages to log time (M,)."""
        order, boot = _orders(messages), _boot_times(messages)
        epoch = np.maximum(np.searchsorted(self._first_orders, order, side="right") - 1, 0)
        times: Array = boot + self._offsets[epoch]
        return times

    def from_receipt(self, messages: Sequence[Received]) -> Array:
        """Interpolate log time (M,) between the attitudes received before and after."""
        order, received = _orders(messages), _receipts(messages)
        after = np.searchsorted(self._order, order, side="right")
        last = len(self._order) - 1
        low, high = np.clip(after - 1, 0, last), np.clip(after, 0, last)
        span = self._received[high] - self._received[low]
        share = (received - self._received[low]) / np.where(span > 0.0, span, np.inf)
        gain = np.clip(share, 0.0, 1.0) * (self._times[high] - self._times[low])
        beyond = np.where(after == 0, np.minimum(received - self._received[0], 0.0), 0.0)
        beyond += np.where(after > last, np.maximum(received - self._received[-1], 0.0), 0.0)
        times: Array = self._times[low] + gain + beyond
        return times


def _orders(messages: Sequence[Received]) -> Array:
    """Return the places of messages in the file (M,)."""
    return np.array([one.order for one in messages])


def _receipts(messages: Sequence[Received]) -> Array:
    """Return the receiver's times of messages (M,), s."""
    return np.array([one.time for one in messages], dtype=np.float64)


def _boot_times(messages: Sequence[Received]) -> Array:
    """Return the vehicle's times of messages (M,), s since its boot."""
    return 1e-3 * np.array([one.message.number("time_boot_ms") for one in messages])


def _receipt(received: Array) -> float:
    """Return the first of these times, or their median if the first is damaged."""
    first, middle = float(received[0]), float(np.median(received))
    return first if abs(first - middle) <= _RESTART or len(received) < 3 else middle


def _check_one_clock(offsets: Sequence[float]) -> None:
    for k, offset in enumerate(offsets):
        for j in range(k - 1):
            between = max(abs(other - offset) for other in offsets[j + 1 : k])
            if abs(offsets[j] - offset) <= _SAME_CLOCK < between:
                raise MavlinkError(
                    f"two vehicles, whose clocks differ by {between:.1f} s, send in turns"
                )
