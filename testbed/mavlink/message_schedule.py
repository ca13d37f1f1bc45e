"""Schedule of a vehicle's telemetry messages, in simulation time."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from testbed.mavlink.codec import constant
from testbed.mavlink.telemetry_messages import (
    HEARTBEAT,
    LOCKSTEP_STATE,
    TELEMETRY_MESSAGES,
    Stream,
)

DISABLED = -1  # in place of an interval, as in MESSAGE_INTERVAL
_MAX_INTERVAL_US = (1 << 31) - 1


@functools.cache
def message_names() -> Mapping[int, str]:
    """Return the names of the telemetry messages by their MAVLink numbers."""
    return {constant(f"MAVLINK_MSG_ID_{name}"): name for name in TELEMETRY_MESSAGES}


class MessageSchedule:
    """Send intervals and next send times of the telemetry messages of one vehicle.

    Messages are sent with samples, so that no rate exceeds the sample rate.
    """

    def __init__(self, sample_rate_hz: float, *, lockstep: bool) -> None:
        """Start with the default rates and all messages due.

        Args:
            sample_rate_hz: rate of the samples.
            lockstep: send `LOCKSTEP_STATE` with every sample.
        """
        self._min_interval_us = round(1e6 / sample_rate_hz)
        self._always = frozenset(LOCKSTEP_STATE if lockstep else ())
        self._intervals = {name: self._default(name) for name in TELEMETRY_MESSAGES}
        self._next = {name: 0 for name, every in self._intervals.items() if every != DISABLED}

    def due(self, time_s: float) -> list[str]:
        """Return the messages to send with the sample of this time, and schedule the next."""
        now = round(time_s * 1e6)
        names = []
        for name in TELEMETRY_MESSAGES:  # in its order
            when = self._next.get(name)
            if name in self._always:
                names.append(name)
            elif when is not None and when <= now:
                names.append(name)
                every = self._intervals[name]
                # keeps the mean rate where samples are not at multiples of the interval
                self._next[name] = when + every if when + every > now else now + every
        return names

    def interval_us(self, name: str) -> int:
        """Return the interval of a message, µs; `DISABLED`: it is not sent."""
        return self._min_interval_us if name in self._always else self._intervals[name]

    def set_interval(self, name: str, interval_us: float) -> None:
        """Set the interval of a message from the next sample on, µs.

        Negative disables the message, 0 restores the default. The heartbeat and the messages that
        lockstep needs do not change.
        """
        if name == HEARTBEAT or name in self._always:
            return
        if interval_us < 0:
            self._intervals[name] = DISABLED
            self._next.pop(name, None)
            return
        every = round(interval_us) if interval_us > 0 else self._default(name)
        if every == DISABLED:
            self.set_interval(name, DISABLED)
            return
        self._intervals[name] = min(max(every, self._min_interval_us), _MAX_INTERVAL_US)
        self._next[name] = 0

    def set_stream(self, stream: int, rate_hz: float) -> None:
        """Set the rate of a group of messages; 0 disables it, unknown groups are ignored."""
        for name, message in TELEMETRY_MESSAGES.items():
            if message.stream is not None and stream in (Stream.ALL, message.stream):
                self.set_interval(name, 1e6 / rate_hz if rate_hz > 0.0 else DISABLED)

    def _default(self, name: str) -> int:
        rate = TELEMETRY_MESSAGES[name].rate_hz
        return max(round(1e6 / rate), self._min_interval_us) if rate > 0.0 else DISABLED
